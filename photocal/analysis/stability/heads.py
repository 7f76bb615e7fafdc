"""Whether cameras on a frame kept their places on it from one calibration to another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from photocal.results.result import AdjustedHead

# A head that stayed is said to have moved in one of so many comparisons.
LEVEL = 0.05


@dataclass(frozen=True)
class Moved:
    """How a head differs between two calibrations.

    first, second: the calibrations.
    differences, sigma: second less first of what is estimated in both, by name (`adjustment.rig.OF_HEAD`;
        deg, m, s); turns are about the axes of the head.
    p_value: of so large a difference when nothing has changed, with all covariances.
    """

    camera: str
    of: str
    first: str
    second: str
    differences: dict[str, float]
    sigma: dict[str, float]
    p_value: float

    @property
    def different(self) -> bool:
        """Whether the head moved."""
        return self.p_value < LEVEL


def compared_heads(calibrations: Mapping[str, Sequence[AdjustedHead]]) -> tuple[Moved, ...]:
    """Compare the heads that two calibrations have in common, each pair of them."""
    found = []
    for (first, of_first), (second, of_second) in itertools.combinations(calibrations.items(), 2):
        others = {(one.camera, one.of): one for one in of_second}
        pairs = ((one, others[one.camera, one.of]) for one in of_first if (one.camera, one.of) in others)
        found += [moved for a, b in pairs if (moved := _moved(first, second, a, b)) is not None]
    return tuple(found)


def _moved(first: str, second: str, a: AdjustedHead, b: AdjustedHead) -> Moved | None:
    """Difference of one head; None where nothing of it is estimated in both."""
    names = tuple(name for name in a.free if name in b.free)
    if not names:
        return None
    turns = [Rotation.from_rotvec(one.rotation_deg, degrees=True) for one in (a, b)]
    turn = (turns[1] * turns[0].inv()).as_rotvec(degrees=True)
    all_of = dict(zip(("turn_x", "turn_y", "turn_z"), turn.tolist(), strict=True))
    all_of |= {key: b.values[key].value - a.values[key].value for key in a.values if key not in all_of}
    difference = np.array([all_of[name] for name in names])
    covariance = a.covariance(names) + b.covariance(names)
    sigma = np.sqrt(np.diag(covariance))
    # Scaled to correlations: degrees and metres differ in size.
    w = difference / sigma
    chi_squared = float(w @ np.linalg.solve(covariance / np.outer(sigma, sigma), w))
    return Moved(
        a.camera,
        a.of,
        first,
        second,
        dict(zip(names, difference.tolist(), strict=True)),
        dict(zip(names, sigma.tolist(), strict=True)),
        float(stats.chi2.sf(chi_squared, len(names))),
    )


def heads_text(found: Sequence[Moved]) -> str:
    """Write it for people, one line for each head and pair."""
    lines = ['cameras on their frame: turns (") and places (mm), second less first']
    for one in found:
        parts = []
        for name, value in one.differences.items():
            factor = 3600.0 if name.startswith("turn") else 1000.0
            parts.append(f"{name} {factor * value:+.3g} +- {factor * one.sigma[name]:.2g}")
        verdict = "MOVED" if one.different else "as before"
        lines.append(
            f"  {one.camera} beside {one.of}, {one.first} to {one.second}: {', '.join(parts)}; "
            f"p {one.p_value:.2g}: {verdict}"
        )
    return "\n".join(lines)
