"""Whether a flight determines the principal distance as well as is wanted, and what is lacking."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from photocal.block.project import WantedCalibration
from photocal.geometry.rotation import matrix_from_angles
from photocal.run.debrief.pictures import Quick

Lacks = Literal["", "crosswise", "height", "more"]
Wanted = Literal["project", "positions", "usual"]
# Where nobody says what is wanted: the share of c at which heights share an error, H dc / c, of this part of
# the sigma of the positions' heights, within these bounds. Reduced pictures hardly tell c better than the
# lower one, pictures in full size do; the upper one is what no calibration should miss.
_PART, _LEAST, _MOST = 1 / 3, 1e-3, 5e-3
# Cosine of the angle from which on strips cross, and the share of the flying height by which heights differ.
_CROSS, _HIGHER = 0.7, 0.1


@dataclass(frozen=True)
class Determined:
    """The principal distance of a camera in flight, beside what is wanted.

    c, sigma: in `unit`, None where rays do not tell c; sigma grows with residuals larger than stated.
    wanted: standard deviation that is wanted, and where it comes from.
    lacks: what determines it better; empty where it is determined.
    """

    camera: str
    unit: str
    c: float | None
    sigma: float | None
    wanted: float
    source: Wanted
    lacks: Lacks


def determined(quick: Quick, keys: WantedCalibration) -> tuple[Determined, ...]:
    """Hold each camera's principal distance against what is wanted of it."""
    return tuple(_of_camera(quick, k, entry, keys) for k, entry in enumerate(quick.cameras))


def _of_camera(quick: Quick, k: int, entry: dict[str, Any], keys: WantedCalibration) -> Determined:
    camera = quick.adjusted.block.cameras[k]
    share, source = wanted_share(quick, keys, camera.value("c") / camera.pitch[0])
    wanted = share * camera.value("c")
    c, sigma = _told(entry)
    good = sigma is not None and sigma <= wanted
    lacks: Lacks = "" if good else _lacks(quick, k)
    return Determined(entry["camera"], entry["unit"], c, sigma, wanted, source, lacks)


def wanted_share(quick: Quick, keys: WantedCalibration, c_px: float) -> tuple[float, Wanted]:
    """Standard deviation of c that is wanted, as a share of it, and where it comes from."""
    if keys.c_sigma_px is not None:
        return keys.c_sigma_px / c_px, "project"
    if keys.c_sigma_percent is not None:
        return keys.c_sigma_percent / 100.0, "project"
    images = quick.adjusted.start.images
    sigma = images.sigma[:, 5]
    if quick.adjusted.start.datum == "free" or not np.isfinite(sigma).any():
        return _LEAST, "usual"
    sigma_m = float(np.median(sigma[np.isfinite(sigma)]))
    return float(np.clip(_PART * sigma_m / _above_m(quick), _LEAST, _MOST)), "positions"


def _told(entry: dict[str, Any]) -> tuple[float | None, float | None]:
    """The principal distance that rays tell, and its standard deviation."""
    released = entry["released"]
    if released is not None:
        if not released["credible"]:
            return None, None
        larger = max(1.0, float(np.sqrt(np.nan_to_num(released["variance_factor"]))))
        return float(released["c"]), larger * float(released["sigma"])
    if "c" in entry["sigma"]:
        return float(entry["parameters"]["c"]), float(entry["sigma"]["c"])
    return None, None


def _above_m(quick: Quick) -> float:
    state = quick.adjusted.solution
    return float(np.median(state.exposures[:, 5]) - np.median(state.points[:, 2]))


def _lacks(quick: Quick, k: int) -> Lacks:
    """What tells c apart from heights and from the lens: strips that cross, else another height."""
    of_camera = quick.adjusted.start.images.camera == k
    values = quick.adjusted.solution.exposures[of_camera]
    # The way the camera's x axis points on the ground, there and back being one.
    right = matrix_from_angles(values[:, :3])[:, 0, :2]
    way = np.arctan2(right[:, 1], right[:, 0])
    apart = np.abs(np.sin(way[:, None] - way[None]))
    if not (apart > _CROSS).any():
        return "crosswise"
    heights = values[:, 5]
    return "height" if np.ptp(heights) < _HIGHER * _above_m(quick) else "more"
