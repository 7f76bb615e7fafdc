"""Does a camera stay the same within a flight: its parameters by thirds, and c as a drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats, Integers
from photocal.adjustment.score import score
from photocal.analysis.systematic_errors.refit import Fit
from photocal.geometry.camera import PARAMETERS

PARTS = 3
# A third has at least so many images; what is left of a field beside the other unknowns, a share squared.
FEWEST_IMAGES, LEFT = 4, 1e-6


@dataclass(frozen=True)
class Within:
    """One parameter of a camera over a flight, each estimate beside all other unknowns, to first order.

    parts (3, 2): departure of each third from the first one, and its standard deviation.
    drifts: change from one end to the other, linear in "order" (of the exposures), "time" or "temperature",
        as far as these are known: amount, standard deviation, and F.
    statistic, p_value: F of all thirds together, and its probability in a camera that stays the same.
    """

    parameter: str
    parts: Floats
    drifts: dict[str, tuple[float, float, float]]
    statistic: float
    p_value: float


def order_of(time: Floats | None, mine: Integers) -> Integers:
    """Order in which images of a camera were taken: by time where all are known, else as they are listed."""
    if time is None or not np.isfinite(time[mine]).all():
        return mine
    return np.asarray(mine[np.argsort(time[mine], kind="stable")])


def course(order: Integers, images: int) -> Floats:
    """From -1/2 for the first to 1/2 for the last image in an order; 0 for all others."""
    at = np.zeros(images)
    at[order] = np.linspace(-0.5, 0.5, len(order))
    return at


def change_of(values: Floats, plane: Floats, parameter: str) -> Floats:
    """Change of computed image coordinates, shape (n, 2), with c, x0 or y0, distortion left out."""
    if parameter == "c":
        return np.asarray((plane - values[1:3]) / values[0])
    return np.broadcast_to(np.eye(2)[PARAMETERS.index(parameter) - 1], plane.shape).copy()


def within_flight(fit: Fit, camera: int) -> tuple[Within, ...]:
    """Test c, x0 and y0 of a camera for a change within the flight; nothing for fewer than twelve images."""
    exposures = fit.network.exposures
    order = order_of(exposures.time, np.flatnonzero(exposures.camera == camera))
    if len(order) < PARTS * FEWEST_IMAGES:
        return ()
    third = np.full(len(exposures.camera), -1)
    for k, images in enumerate(np.array_split(order, PARTS)):
        third[images] = k
    courses = {"order": course(order, len(third))}
    for name, given in (("time", exposures.time), ("temperature", exposures.temperature)):
        if given is not None and np.isfinite(given[order]).all() and np.ptp(given[order]) > 0.0:
            courses[name] = np.zeros(len(third))
            courses[name][order] = (given[order] - given[order].mean()) / np.ptp(given[order])
    values = fit.solution.cameras[camera]
    return tuple(
        one
        for name in ("c", "x0", "y0")
        if (one := _within(fit, name, change_of(values, fit.computed, name), third, courses)) is not None
    )


def _within(
    fit: Fit, name: str, change: Floats, third: Integers, courses: dict[str, Floats]
) -> Within | None:
    from scipy import stats

    image, residuals = fit.network.rays.image, fit.solution.residuals
    masks: list[Flags] = [third[image] == k for k in range(1, PARTS)]
    fields = [change * mask[:, None] for mask in masks]
    fields += [change * of[image][:, None] for of in courses.values()]
    found = score(fit.factored, residuals, np.array(fields))
    if not (found.share > LEFT).all():
        return None
    freedom = fit.solution.degrees_of_freedom
    count = PARTS - 1
    covariance = np.linalg.inv(found.information[:count, :count])
    amounts = -covariance @ found.slope[:count]

    def statistic(fall: float, unknowns: int) -> float:
        left = max(fit.solution.chi_squared - fall, 1e-300)
        return fall / unknowns / (left / (freedom - unknowns))

    together = statistic(float(-found.slope[:count] @ amounts), count)
    drifts = {}
    for k, key in enumerate(courses, start=count):
        information, slope = float(found.information[k, k]), float(found.slope[k])
        fall = statistic(slope**2 / information, 1)
        drifts[key] = -slope / information, information**-0.5, fall
    parts = np.vstack([[0.0, 0.0], np.column_stack([amounts, np.sqrt(np.diag(covariance))])])
    return Within(name, parts, drifts, together, float(stats.f.sf(together, count, freedom - count)))
