"""Whether a network has the shape that a method of calibration asks for, and what to fly next time."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from photocal.adjustment.network import Network
from photocal.adjustment.state import State
from photocal.base.arrays import Floats
from photocal.findings.finding import Finding

# Convergent cameras: two photographs 90 degrees apart, one rolled by 90 degrees, both with the tolerance of
# a camera that is held by hand or by a gimbal.
CONVERGENCE_DEG = 90.0
CONVERGENCE_ENOUGH_DEG = 60.0
ROLL_ENOUGH_DEG = 20.0
# Mixed ranges: the relief of the object, or the ratio of known heights, that separates c from height. Where
# axes converge by more than this, that an object is inclined is part of the convergence and no relief.
RANGE_SPREAD = 0.10
HEIGHT_RATIO = 1.2
PARALLEL_DEG = 20.0
DATUM_CONSTRAINTS = 7
CONTROL_POINTS = 5
COVERED = 0.5
PHOTOGRAPHS = 3
METHODS = ("convergent", "mixed-ranges", "self-calibration", "on-the-job")


@dataclass(frozen=True)
class Shape:
    """What counts about the geometry of a network.

    convergence_deg: largest angle between two optical axes.
    roll_deg: the roll between two photographs that comes nearest to 90 degrees (or 270), as its distance from
        it.
    range_spread: relief of the object along parallel axes, or across its own best plane under convergent
        ones: 95th less 5th percentile over the median distance from the cameras.
    height_ratio: largest over smallest median distance of a photograph; 1 where projection centres are not
        observed, since each height is then an unknown that c trades with (Merchant 1972).
    constraints: observed or held coordinates of points and exposures, observations between points, and the
        inner constraints of a free network: what carries the datum.
    quadrants: quarters of the object, seen from its middle, that have control.
    control_share: area of the control's hull over that of all points.
    """

    images: int
    convergence_deg: float
    roll_deg: float
    range_spread: float
    height_ratio: float
    constraints: int
    control_points: int
    quadrants: int
    control_share: float


@dataclass(frozen=True)
class MethodCheck:
    """A method and its requirements.

    method: one of `METHODS`.
    requirements: everything that it asks for, passed or a note; `texts.need_words` says it.
    """

    method: str
    requirements: tuple[Finding, ...]
    met: bool


def shape(network: Network, state: State) -> Shape:
    """Measure the geometry of a network."""
    axes = -state.rotation[:, 2, :]
    rays = network.rays
    apart = state.points[rays.point] - state.centre[rays.image]
    distance = np.einsum("ni,ni->n", apart, axes[rays.image])
    order = np.argsort(rays.image, kind="stable")
    each = np.split(distance[order], np.flatnonzero(np.diff(rays.image[order])) + 1)
    median = np.array([np.median(distances) for distances in each])
    known = network.points.held | network.points.observed
    control = np.flatnonzero(known.any(axis=1))
    # All pairs of images, or those of 60 evenly chosen ones.
    chosen = sorted({round(i) for i in np.linspace(0, len(axes) - 1, min(len(axes), 60))})
    i, j = np.array(chosen)[np.array(np.triu_indices(len(chosen), 1))]
    angles = np.degrees(np.arccos(np.clip(np.sum(axes[i] * axes[j], axis=1), -1.0, 1.0)))
    rolls = _from_right_angle(state.rotation[i] @ np.swapaxes(state.rotation[j], 1, 2))
    inner = 0 if network.datum_points is None else DATUM_CONSTRAINTS
    flat = _across(state.points, axes)
    centres_known = len(network.positions.image) or (network.exposures.sigma[:, 5] < np.inf).any()
    whole, middle_of_object = _hull_area(flat), (flat.min(axis=0) + flat.max(axis=0)) / 2.0
    return Shape(
        len(axes),
        float(angles.max(initial=0.0)),
        float(rolls.min(initial=90.0)),
        _relief(state.points, axes, float(angles.max(initial=0.0))) / float(np.median(distance)),
        float(median.max() / median.min()) if centres_known else 1.0,
        int(known.sum() + np.isfinite(network.exposures.sigma).sum() + len(network.relations.kind) + inner),
        len(control),
        len({(bool(a), bool(b)) for a, b in flat[control] > middle_of_object}),
        _hull_area(flat[control]) / whole if whole > 0.0 else 0.0,
    )


def check_method(method: str, geometry: Shape) -> MethodCheck:
    """Compare a network with what a method asks for.

    Requirements after Brown (1971, 1989) and Merchant (1972), as the Canon ELPH study lists them.
    """
    photographs = _at_least("photographs", geometry.images, PHOTOGRAPHS)
    datum = _at_least("datum", geometry.constraints, DATUM_CONSTRAINTS)
    control = _at_least("control", geometry.control_points, CONTROL_POINTS)
    quarters = {"quarters": float(geometry.quadrants), "share": geometry.control_share, "needed": COVERED}
    spread = geometry.quadrants == 4 and geometry.control_share >= COVERED
    around = _needed("around", met=spread, figures=quarters)
    needed = {"needed_deg": CONVERGENCE_DEG}
    tilted = _at_least("convergence", geometry.convergence_deg, CONVERGENCE_ENOUGH_DEG, needed)
    mixed = _ranges(geometry)
    rolled = {"found": 90.0 - geometry.roll_deg, "tolerance_deg": ROLL_ENOUGH_DEG}
    roll = _needed("roll", met=geometry.roll_deg <= ROLL_ENOUGH_DEG, figures=rolled)
    figures = {**tilted.figures, **mixed.figures}
    either = _needed("height-separated", met=_met(tilted) or _met(mixed), figures=figures)
    requirements = {
        "convergent": (photographs, tilted, roll),
        "mixed-ranges": (photographs, mixed, roll),
        "self-calibration": (photographs, roll, datum, either),
        "on-the-job": (photographs, control, around, either),
    }[method]
    return MethodCheck(method, requirements, all(_met(requirement) for requirement in requirements))


def _ranges(geometry: Shape) -> Finding:
    figures = {
        "spread": geometry.range_spread,
        "ratio": geometry.height_ratio,
        "needed_spread": RANGE_SPREAD,
        "needed_ratio": HEIGHT_RATIO,
    }
    met = geometry.range_spread >= RANGE_SPREAD or geometry.height_ratio >= HEIGHT_RATIO
    return _needed("mixed-ranges", met=met, figures=figures)


def _needed(code: str, *, met: bool, figures: Mapping[str, float]) -> Finding:
    return Finding(code, "passed" if met else "note", figures=figures)


def _met(need: Finding) -> bool:
    return need.severity == "passed"


def _at_least(code: str, value: float, needed: float, figures: Mapping[str, float] | None = None) -> Finding:
    both = {"found": float(value), "needed": float(needed)}
    return _needed(code, met=value >= needed, figures={**both, **(figures or {})})


def _from_right_angle(between: Floats) -> Floats:
    """Give the distance of the rolls between two photographs each, (n, 3, 3), from 90 or 270 degrees, deg."""
    trace = np.trace(between, axis1=1, axis2=2)
    twist = 2.0 * np.arctan2(between[:, 0, 1] - between[:, 1, 0], 1.0 + trace)
    return np.asarray(np.abs(90.0 - np.abs(np.degrees(np.arctan2(np.sin(twist), np.cos(twist))))))


def _relief(points: Floats, axes: Floats, convergence_deg: float) -> float:
    """Give how far the object reaches (95th less 5th percentile) along parallel axes, or across its plane."""
    mean = axes.mean(axis=0)
    if convergence_deg > PARALLEL_DEG:
        apart = points - np.median(points, axis=0)
        far = np.linalg.norm(apart, axis=1)
        # Few points far away, as on a horizon, turn no plane.
        near = points[far <= np.percentile(far, 95)]
        mean = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2][2]
    low, high = np.percentile(points @ mean, [5, 95]) / np.linalg.norm(mean)
    return float(high - low)


def _across(points: Floats, axes: Floats) -> Floats:
    """Project points onto the plane across the mean optical axis, (n, 2)."""
    mean = axes.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-3:
        _, _, directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        return np.asarray(points @ directions[:2].T)
    _, _, directions = np.linalg.svd((mean / length)[None, :])
    return np.asarray(points @ directions[1:].T)


def _hull_area(flat: Floats) -> float:
    from scipy.spatial import ConvexHull, QhullError

    if len(flat) < 3:
        return 0.0
    try:
        return float(ConvexHull(flat).volume)
    except QhullError:  # all on one line
        return 0.0
