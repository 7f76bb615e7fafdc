"""Groups of values that may be wrong: which a block is tested for, how they are freed, what they become."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, STRIPS, TIME
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.geometry.camera import PARAMETERS
from photocal.georeferencing.camera_change import Change, split_at

SIGNIFICANCE = 0.001
CHANGE, PRINCIPAL_DISTANCE, STRIP_SHIFTS = "camera change", "principal distance", "strip shifts"
MOUNTED = ("lever arm", "boresight", "time offset", STRIP_SHIFTS)
# What a freed value may be at most, as a weak observation that keeps the network regular: m, rad, s, m.
_LOOSE = {"lever arm": 100.0, "boresight": 1.0, "time offset": 10.0, "datum shift": 1000.0}
LOOSE_CAMERA = 0.1
MEANING = {
    "lever arm": "the lever arm from camera to antenna is wrong",
    "boresight": "the boresight angles between camera and inertial unit are wrong",
    "time offset": "exposures and positions are not on the same time",
    "datum shift": "positions and control are in different datums (base station coordinates, geoid, epoch)",
    "strip shifts": "the positions jump from strip to strip (GNSS ambiguities)",
    "principal distance": "the principal distance is not the one given",
    "principal point": "the principal point is not the one given",
    "camera change": "the principal distance is not the same in all images (zoom, focus, another camera)",
}


@dataclass(frozen=True)
class Estimate:
    """One value of a freed group.

    Attributes
    ----------
    unit : str
        m, deg, s, mm or px.
    correction : float
        Estimated less given.
    value : float
        Estimated.
    sigma : float
        A priori.
    t : float
        correction / sigma.
    significant : bool
        At 0.1 %, two-sided.
    """

    name: str
    unit: str
    correction: float
    value: float
    sigma: float
    t: float
    significant: bool


def groups_of(block: Block) -> tuple[str, ...]:
    """Give the groups that a block may be tested for: what it leaves free itself is none."""
    names = ["lever arm", "datum shift"]
    if len(block.attitudes.image):
        names.append("boresight")
    if np.any(block.positions.velocity):
        names.append("time offset")
    if len(np.unique(block.positions.strip)) > 1:
        names.append("strip shifts")
    if all(not _free(camera.estimated[0], camera.prior_sigma[0]) for camera in block.cameras):
        names.append("principal distance")
    if all(not _free(camera.estimated[k], camera.prior_sigma[k]) for camera in block.cameras for k in (1, 2)):
        names.append("principal point")
    # With a shift of its own for each strip nothing is left of a common one.
    taken = {name for name in MOUNTED if left_free(block, name)}
    if "strip shifts" in taken:
        taken.add("datum shift")
    return tuple(name for name in names if name not in taken)


def left_free(block: Block, name: str) -> bool:
    """Tell whether the block itself leaves all values of a group (one of `MOUNTED`) free."""
    sigma = block.mounting.sigma
    if name == "strip shifts":
        return len(sigma) > STRIPS and bool(np.isinf(sigma[STRIPS : STRIPS + 3]).all())
    return bool(np.isinf(sigma[_columns(name)]).all())


def with_freed(block: Block, name: str, change: Change | None) -> Block:
    """Return the block with one group freed, weakly observed at its given value."""
    if name == CHANGE and change is not None:
        return split_at(block, change, LOOSE_CAMERA)
    if name in ("principal distance", "principal point"):
        which = [0] if name == "principal distance" else [1, 2]
        cameras = []
        for camera in block.cameras:
            estimated, sigma = camera.estimated.copy(), camera.prior_sigma.copy()
            estimated[which], sigma[which] = True, LOOSE_CAMERA * camera.value("c")
            cameras.append(replace(camera, estimated=estimated, prior_sigma=sigma))
        return replace(block, cameras=tuple(cameras))
    sigma = block.mounting.sigma.copy()
    if name == "strip shifts":
        # Images without position have no strip: their columns stay held.
        for strip in np.unique(block.positions.strip):
            at = STRIPS + 6 * int(strip)
            sigma[at : at + 3] = _LOOSE["datum shift"]
    else:
        sigma[_columns(name)] = _LOOSE[name]
    return replace(block, mounting=replace(block.mounting, sigma=sigma))


def _free(estimated: object, prior: float) -> bool:
    return bool(estimated) and not math.isfinite(prior)


def _columns(name: str) -> slice:
    return {
        "lever arm": LEVER,
        "boresight": BORESIGHT,
        "time offset": slice(TIME, TIME + 1),
        "datum shift": SHIFT,
    }[name]


def estimates_of(block: Block, freed: Block, solution: Solution, name: str) -> tuple[Estimate, ...]:
    """Give the values of one group from the solution in which it is freed."""
    critical = float(stats.norm.ppf(1.0 - SIGNIFICANCE / 2.0))

    def one(label: str, unit: str, value: float, given: float, sigma: float) -> Estimate:
        t = (value - given) / sigma if sigma > 0 else 0.0
        return Estimate(label, unit, value - given, value, sigma, t, abs(t) > critical)

    if name in ("principal distance", "principal point", CHANGE):
        which = [1, 2] if name == "principal point" else [0]
        return tuple(
            one(
                f"{PARAMETERS[k]} of {own.id}",
                own.unit,
                float(solution.cameras[index, k]),
                float(own.values[k]),
                math.sqrt(solution.camera_covariance[index, k, k]),
            )
            for index, own in enumerate(freed.cameras if name == CHANGE else block.cameras)
            for k in which
        )
    common, sigma = solution.state.common, np.sqrt(np.diag(solution.common_covariance))
    given = block.mounting.values
    if name == "strip shifts":
        labels = [
            (f"shift_{axis}[{strip}]", STRIPS + 6 * strip + k)
            for strip in np.unique(freed.positions.strip).tolist()
            for k, axis in enumerate("xyz")
        ]
        return tuple(
            one(label, "m", float(common[at]), float(given[at]), float(sigma[at])) for label, at in labels
        )
    unit = {"boresight": "deg", "time offset": "s"}.get(name, "m")
    scale = math.degrees(1.0) if name == "boresight" else 1.0
    return tuple(
        one(COMMON[k], unit, common[k] * scale, given[k] * scale, sigma[k] * scale)
        for k in range(*_columns(name).indices(len(COMMON)))
    )
