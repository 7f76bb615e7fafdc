"""The file of cameras to compare: `[[camera]]` entries as in block.toml, with sigmas and correlations."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, PositiveFloat, PositiveInt

from photocal.analysis.estimates import from_sigmas
from photocal.analysis.stability.comparison import Published
from photocal.analysis.stability.methods import ResectionGround
from photocal.base.checked_toml import Table, checked_tables, read_tables
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.block.camera_setup import CameraKeys, make_camera
from photocal.geometry.camera import PARAMETERS, Camera, among, camera


class _Pix4dParameters(Table):
    f: PositiveFloat
    Px: FiniteFloat
    Py: FiniteFloat
    R1: FiniteFloat = 0.0
    R2: FiniteFloat = 0.0
    R3: FiniteFloat = 0.0
    T1: FiniteFloat = 0.0
    T2: FiniteFloat = 0.0


class _Pix4d(Table):
    id: str
    model: Literal["pix4d"]
    unit: Literal["mm"]
    size_px: tuple[PositiveInt, PositiveInt]
    pitch_mm: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    parameters: _Pix4dParameters


class Comparison(Table):
    """How calibrations are compared.

    thresholds_px: ascending.
    terrains_each: random grounds of each kind.
    seed: of the random grounds and of the distributions.
    """

    grid_step_px: PositiveFloat | None = None
    thresholds_px: Annotated[list[PositiveFloat], AfterValidator(sorted)] = Field(
        default=[0.33, 0.5], min_length=1
    )
    terrain: tuple[ResectionGround, ...] = (
        ResectionGround(height_m=250.0, relief_m=100.0),
        ResectionGround(height_m=250.0, relief_m=20.0),
    )
    terrains_each: Annotated[int, Field(gt=0, le=100)] = 5
    seed: Annotated[int, Field(ge=0)] = 1


class _File(Table):
    camera: Annotated[list[CameraKeys], Field(min_length=1)]
    comparison: Comparison = Comparison()
    published: tuple[Published, ...] = ()


@dataclass(frozen=True)
class CameraFile:
    """What a comparison was asked for."""

    calibrations: tuple[Camera, ...]
    published: tuple[Published, ...]
    comparison: Comparison


def read_camera_file(path: Path) -> CameraFile:
    """Read a file of cameras.

    path: TOML: `[[camera]]` as in block.toml with optional `sigma` and `correlation` (names, matrix);
        optional `[comparison]` and `[[published]]`. The model "pix4d" takes f, Px, Py, R1, R2, R3, T1, T2.
    raises InputNotFoundError: when the file is missing or empty.
    raises InputMalformedError: when it is not TOML.
    raises ConfigurationError: when a key is unknown or missing, or a value impossible.
    """
    return camera_file(read_tables(path), path)


def camera_file(tables: dict[str, Any], path: Path) -> CameraFile:
    """Check the tables of such a file."""
    if isinstance(entries := tables.get("camera"), list):
        tables = {**tables, "camera": [_ours(entry, path) for entry in entries]}
    file = checked_tables(tables, _File, path)
    cameras = [make_camera(entry, path) for entry in file.camera]
    calibrations = map(_with_sigmas, cameras, file.camera, (f"{path}, camera {c.id}" for c in cameras))
    return CameraFile(tuple(calibrations), file.published, file.comparison)


def _ours(entry: Any, path: Path) -> Any:
    """Keys of a camera of Pix4D as those of ours with the same distortion; others as they are."""
    if not isinstance(entry, dict) or entry.get("model") != "pix4d":
        return entry
    given = checked_tables(entry, _Pix4d, f"{path}, camera {entry.get('id', '')}")
    pitch = given.pitch_mm if isinstance(given.pitch_mm, tuple) else (given.pitch_mm,) * 2
    made = brown_from_pix4d(given.id, given.size_px, pitch, given.parameters.model_dump())
    values = {name: made.value(name) for name in made.lens.names}
    return {**entry, "model": made.model, "pitch_mm": pitch, "size_px": given.size_px, "parameters": values}


def _with_sigmas(made: Camera, entry: CameraKeys, where: str) -> Camera:
    """The camera with what the file says of its parameters, as after an adjustment."""
    wrong = ConfigurationError.at(where)
    if entry.sigma is None:
        if entry.correlation is not None:
            raise wrong("has correlations but no sigma", "add [camera.sigma]")
        return made
    names = tuple(entry.sigma) if entry.correlation is None else entry.correlation.names
    if sorted(names) != sorted(entry.sigma):
        raise wrong(
            "sigma and correlation do not name the same parameters",
            "name each estimated parameter once in both",
        )
    try:
        estimates = from_sigmas(
            names,
            [made.value(name) for name in names],
            [entry.sigma[name] for name in names],
            made.correlation_of(names),
        )
    except PhotocalError as refusal:
        raise wrong(refusal.what, refusal.remedy) from None
    least = float(np.linalg.eigvalsh(estimates.correlation)[0])
    # Two decimals of p correlations move an eigenvalue by no more than 0.005 p: more is no rounding.
    rounding_of_a_correlation = 0.005
    if least < -rounding_of_a_correlation * len(names):
        raise wrong(
            f"the correlation matrix is not positive definite (least eigenvalue {least:.3f})",
            "correct the entry that was misprinted",
        )
    correlation = np.eye(len(PARAMETERS)) if made.correlation is None else made.correlation
    return replace(made, estimated=among(*names), correlation=correlation)


def brown_from_pix4d(
    camera_id: str, size_px: tuple[int, int], pitch_mm: tuple[float, float], parameters: dict[str, float]
) -> Camera:
    """Convert Pix4D's parameters in mm to a camera with the same distortion.

    Canon ELPH study (FCT-UNESP), box 1.
    """
    f = parameters["f"]
    width, height = size_px[0] * pitch_mm[0], size_px[1] * pitch_mm[1]
    values = {
        "c": f,
        "x0": parameters["Px"] - width / 2.0,
        "y0": height / 2.0 - parameters["Py"],
        "K1": parameters.get("R1", 0.0) / f**2,
        "K2": parameters.get("R2", 0.0) / f**4,
        "K3": parameters.get("R3", 0.0) / f**6,
        "P1": parameters.get("T2", 0.0) / f,
        "P2": -parameters.get("T1", 0.0) / f,
    }
    return camera(camera_id, "brown-ideal", "mm", size_px, pitch_mm, values)
