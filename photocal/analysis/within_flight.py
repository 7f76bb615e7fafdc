"""Whether c, x0 and y0 stay the same through a flight: thirds of it, and changes from end to end."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.score import score
from photocal.base.arrays import Floats
from photocal.hypotheses.fields import FEWEST_IMAGES, LEFT, PARTS, change_of, course, order_of


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


def within_flight(fit: AdjustedNetwork, camera: int) -> tuple[Within, ...]:
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
    values, image = fit.solution.cameras[camera], fit.network.rays.image
    shares = np.array([third == k for k in range(1, PARTS)] + list(courses.values()))[:, image, None]
    names = ("c", "x0", "y0")
    fields = [change_of(values, fit.computed, name) * shares for name in names]
    scored = score(fit.factored, fit.solution.residuals, np.concatenate(fields))
    tested = []
    for k, name in enumerate(names):
        rows = slice(k * len(shares), (k + 1) * len(shares))
        if (scored.share[rows] > LEFT).all():
            tested.append(_within(fit, name, scored.slope[rows], scored.information[rows, rows], courses))
    return tuple(tested)


def _within(
    fit: AdjustedNetwork, name: str, slope: Floats, information: Floats, courses: Iterable[str]
) -> Within:
    """Test one parameter, from the normal equations of its thirds and its drifts."""
    freedom = fit.solution.degrees_of_freedom
    count = PARTS - 1
    covariance = np.linalg.inv(information[:count, :count])
    amounts = -covariance @ slope[:count]

    def statistic(fall: float, unknowns: int) -> float:
        """F of a fall of chi-squared against what is left of it."""
        left = max(fit.solution.chi_squared - fall, 1e-300)
        return fall / unknowns / (left / (freedom - unknowns))

    together = statistic(float(-slope[:count] @ amounts), count)
    drifts = {}
    for k, key in enumerate(courses, start=count):
        normal, along = float(information[k, k]), float(slope[k])
        drifts[key] = -along / normal, normal**-0.5, statistic(along**2 / normal, 1)
    parts = np.vstack([[0.0, 0.0], np.column_stack([amounts, np.sqrt(np.diag(covariance))])])
    return Within(name, parts, drifts, together, float(special.fdtrc(count, freedom - count, together)))
