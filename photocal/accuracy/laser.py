"""Laser distances of pictures against the adjusted surface: a check of heights that no observation feeds."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Flags, Floats
from photocal.base.policy import policy
from photocal.findings.finding import Finding, untested

CODE = "laser-heights"
# A rangefinder of DJI is good to 0.2 m and 0.15 % of the distance (Zenmuse H20 series, data sheet): taken for
# three sigmas, and as if all its distances had the error in common.
LASER_M, LASER_SHARE = 0.2 / 3, 0.0015 / 3
# A surface is told by so many of its points, the nearest of them within this share of the distance.
_NEIGHBOURS, _DENSE = 8, 0.05
# A surface of tie points is no better than this, m; with fewer shots nothing is said.
_SMOOTH_M, _FEWEST = 0.05, 8
# Weights fall from so many sigmas on (Huber); beyond the second a shot hit something else.
_HUBER, _ELSEWHERE = 1.5, 4.0


@dataclass(frozen=True)
class LaserShots:
    """Laser distances of oriented pictures, in a frame whose third axis is up.

    station (n, 3): projection centres; direction (n, 3): where the cameras look, unit vectors.
    distance_m (n,): measured.
    """

    station: Floats
    direction: Floats
    distance_m: Floats


@dataclass(frozen=True)
class LaserCheck:
    """What laser distances say of an adjusted surface.

    bias_m, sigma_m: height of the surface less that of the laser, and its standard deviation with what all
        distances have in common: the error of the laser, and that of c.
    spread_m: of single differences, robust; elsewhere: shots that hit something else (gaps of a canopy).
    scale, scale_sigma: change of the difference with distance; NaN where distances are alike.
    lonely: shots without tie points near enough.
    """

    shots: int
    bias_m: float
    sigma_m: float
    spread_m: float
    elsewhere: int
    scale: float
    scale_sigma: float
    lonely: int

    @property
    def biased(self) -> bool:
        """Whether the surface lies beside the laser by more than both explain."""
        return abs(self.bias_m) > policy.times_999 * self.sigma_m


def check_laser(shots: LaserShots, points: Floats, c_share: float = 0.0) -> LaserCheck | None:
    """Hold laser targets against the surface of tie points (m, 3) there; None with too few of them.

    c_share: standard deviation of the principal distance over it: distances to the ground go with it.
    """
    known = np.isfinite(shots.distance_m) & np.isfinite(shots.station + shots.direction).all(axis=1)
    target = shots.station[known] + shots.distance_m[known, None] * shots.direction[known]
    distance, ties = shots.distance_m[known], points[np.isfinite(points).all(axis=1)]
    if len(target) < _FEWEST or len(ties) < _NEIGHBOURS:
        return None
    height, rough, dense = _surface(target[:, :2], ties, _DENSE * distance)
    difference, sigma, distance = height[dense] - target[dense, 2], rough[dense], distance[dense]
    if len(difference) < _FEWEST:
        return None
    design = np.ones((len(difference), 1))
    (bias,), (formal,), spread, far = _robust(design, difference, sigma)
    # What passes through a canopy is farther away, which would look like a scale.
    difference, sigma, distance = difference[~far], sigma[~far], distance[~far]
    middle = float(np.median(distance))
    common = float(np.hypot(LASER_M + LASER_SHARE * middle, c_share * middle))
    scale = scale_sigma = np.nan
    # A scale wants distances that differ by this share.
    span = 0.2
    if np.ptp(distance) > span * np.median(distance):
        design = np.column_stack([np.ones(len(distance)), distance - np.median(distance)])
        (_, scale), (_, scale_sigma), _, _ = _robust(design, difference, sigma)
        scale_sigma = float(np.hypot(scale_sigma, np.hypot(LASER_SHARE, c_share)))
    return LaserCheck(
        int(dense.sum()), float(bias), float(np.hypot(formal, common)), spread, int(far.sum()),
        float(scale), float(scale_sigma), int((~dense).sum()),
    )  # fmt: skip


def _surface(places: Floats, ties: Floats, reach: Floats) -> tuple[Floats, Floats, Flags]:
    """Height of planes through the nearest tie points, their roughness, and which places have them near."""
    from scipy.spatial import KDTree

    found, near = KDTree(ties[:, :2]).query(places, _NEIGHBOURS)
    away = np.asarray(found)
    offset = ties[near] - np.column_stack([places, np.zeros(len(places))])[:, None]
    height, rough = np.empty(len(places)), np.empty(len(places))
    for k, (beside, distances) in enumerate(zip(offset, away, strict=True)):
        # Far ones count less: they are of another slope.
        weight = 1.0 / (distances + 1e-3 + 0.5 * distances[-1])
        design = np.column_stack([np.ones(_NEIGHBOURS), beside[:, :2]])
        plane, *_ = np.linalg.lstsq(design * weight[:, None], beside[:, 2] * weight, rcond=None)
        rest = beside[:, 2] - design @ plane
        height[k] = plane[0]
        rough[k] = np.hypot(_SMOOTH_M, np.sqrt(np.sum(rest**2) / (_NEIGHBOURS - 3)))
    return height, rough, np.asarray(away[:, 2] <= reach)


def _robust(design: Floats, values: Floats, sigma: Floats) -> tuple[Floats, Floats, float, Flags]:
    """Estimates of Huber, their standard deviations, the robust spread of the values, and what is far off."""
    estimates = np.zeros(design.shape[1])
    estimates[0] = np.median(values)
    factor = 1.0
    for _ in range(50):
        share = (values - design @ estimates) / sigma
        factor = max(policy.mad_to_sigma * float(np.median(np.abs(share - np.median(share)))), 1e-6)
        weight = np.minimum(1.0, _HUBER * factor / np.maximum(np.abs(share), 1e-12)) / sigma**2
        normal = design.T @ (design * weight[:, None])
        step = np.linalg.solve(normal, design.T @ (weight * (values - design @ estimates)))
        estimates = estimates + step
        if np.abs(step).max() < 1e-9:
            break
    rest = values - design @ estimates
    spread = policy.mad_to_sigma * float(np.median(np.abs(rest)))
    # Efficiency of Huber's weights with normal errors.
    deviation = max(factor, 1.0) * np.sqrt(np.diag(np.linalg.inv(normal))) * 1.05
    return estimates, deviation, spread, np.abs(rest / sigma) > _ELSEWHERE * max(factor, 1.0)


def laser_finding(check: LaserCheck | None, shots: int) -> Finding:
    """Say what the laser says, as a check beside check points."""
    if check is None:
        return untested(CODE, "few-laser-shots", {"n": float(shots), "needed": float(_FEWEST)})
    figures = {
        "n": float(check.shots), "bias_m": check.bias_m, "sigma_m": check.sigma_m, "spread_m": check.spread_m,
        "elsewhere": float(check.elsewhere), "lonely": float(check.lonely),
        "scale": check.scale, "scale_sigma": check.scale_sigma,
    }  # fmt: skip
    clauses: tuple[str, ...] = ("laser-elsewhere",) if check.elsewhere else ()
    clauses += ("laser-scale",) if np.isfinite(check.scale) else ()
    if check.biased:
        return Finding(CODE, "doubtful", figures=figures, clauses=("laser-beside", *clauses))
    return Finding(CODE, "note", figures=figures, clauses=clauses)
