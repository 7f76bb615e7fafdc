"""Another calibration as prior of a camera: values, standard deviations and correlations of its file."""

import json
from pathlib import Path
from typing import Any

from photocal.base.checked_toml import Table, checked_tables
from photocal.base.errors import ConfigurationError, InputNotFoundError


class _Parameter(Table, extra="ignore"):
    value: float
    sigma: float | None = None
    estimated: bool = False


class _Correlation(Table):
    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


class StoredCalibration(Table, extra="ignore"):
    """What the file of a calibration says of a camera."""

    model: str
    unit: str
    size_px: tuple[int, int]
    affinity: str = "additive"
    affinity_form: str = "fraser"
    distortion_at: str = "adjusted"
    reference_radius: float = 0.0
    parameters: dict[str, _Parameter]
    correlation: _Correlation

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters that were estimated, in the order of the correlations."""
        known = self.parameters
        return tuple(n for n in self.correlation.names if known[n].estimated and known[n].sigma)


def read_prior(path: Path, camera: str) -> StoredCalibration:
    """Read the calibration of a camera: of that name, or the only one.

    path: what a run or a certificate wrote as JSON.
    raises InputNotFoundError, ConfigurationError: when there is none.
    """
    if not path.is_file():
        raise InputNotFoundError("does not exist", "name the result.json of a calibration", where=path)
    wrong = ConfigurationError.at(path)
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        cameras: dict[str, Any] = (content.get("result") or content)["cameras"]
        chosen = cameras[camera] if camera in cameras or len(cameras) != 1 else next(iter(cameras.values()))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise wrong(f"has no calibration of camera {camera}", "name that of this camera") from None
    made = checked_tables(chosen, StoredCalibration, path)
    if set(made.correlation.names) - set(made.parameters):
        raise wrong("has correlations of other parameters", "is it the file that photocal wrote?")
    return made


def prior_keys(made: StoredCalibration) -> dict[str, Any]:
    """Give values, their meaning, estimate, prior sigmas and correlations in the keys of a `[[camera]]`."""
    free = made.free
    at = [made.correlation.names.index(name) for name in free]
    matrix = tuple(tuple(made.correlation.matrix[i][j] for j in at) for i in at)
    return {
        "affinity": made.affinity,
        "affinity_form": made.affinity_form,
        "distortion_at": made.distortion_at,
        "R0": made.reference_radius,
        "parameters": {name: one.value for name, one in made.parameters.items() if one.value},
        "estimate": free,
        "prior_sigma": {name: made.parameters[name].sigma for name in free},
        "prior_correlation": {"names": free, "matrix": matrix},
    }
