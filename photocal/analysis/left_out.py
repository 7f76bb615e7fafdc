"""Parameters of a camera left out of the adjustment, one by one.

Whether c, x0 and y0 stay the same through a flight: thirds of it, and changes from end to end.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork, lowest
from photocal.adjustment.ledger import because
from photocal.adjustment.near import with_held
from photocal.adjustment.score import score
from photocal.adjustment.shake import carried
from photocal.adjustment.solver import Near
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.camera import PARAMETERS
from photocal.hypotheses.fields import FEWEST_IMAGES, LEFT, PARTS, change_of, course, order_of


@dataclass(frozen=True)
class Checks:
    """Surveyed coordinates that did not take part in the adjustment.

    point (m,): which points of the network they are.
    surveyed (m, 3): their coordinates in the frame of the network, m.
    """

    point: Integers
    surveyed: Floats

    def rmse(self, points: Floats) -> Floats | None:
        """Root mean square of adjusted minus surveyed, (3,) m; None without check points."""
        if not len(self.point):
            return None
        return np.asarray(np.sqrt(np.mean((points[self.point] - self.surveyed) ** 2, axis=0)))


@dataclass(frozen=True)
class WithoutParameter:
    """The adjustment without one parameter.

    parameter: the parameter, held at zero.
    c, change_of_c: c without it, and minus c with it, in the unit of the camera.
    chi_squared, sigma0_squared: of the adjustment without it.
    check_rmse_m (3,): at the check points, X, Y, Z.
    """

    parameter: str
    c: float
    change_of_c: float
    chi_squared: float
    sigma0_squared: float
    check_rmse_m: Floats | None


def without_parameter(fit: AdjustedNetwork, camera: int, parameter: int) -> Near:
    """Find the minimum with a parameter at zero: near the one with it, or from anew."""
    interior, state = fit.network.cameras[camera], fit.state
    # Left of each adjustment, see `minimise`: a hundredth of a standard deviation at most.
    near = 1e-4
    if interior.prior_correlation is None:
        active, columns = fit.factored.problem.layout.camera_columns[camera]
        column = int(columns[active == parameter][0])
        found = with_held(fit.factored, column, -float(state.cameras[camera, parameter]), near)
        # Its prior goes with it; infinite where there is none.
        of_prior = float((interior.values[parameter] / interior.prior_sigma[parameter]) ** 2)
        if found.reached:
            return replace(found, chi_squared=found.chi_squared - of_prior)
        if np.isfinite(found.chi_squared):
            state = found.state
    estimated, values, start = interior.estimated.copy(), interior.values.copy(), state.cameras.copy()
    estimated[parameter], values[parameter], start[camera, parameter] = False, 0.0, 0.0
    cameras = list(fit.network.cameras)
    cameras[camera] = replace(interior, estimated=estimated, values=values)
    without = replace(fit.network, cameras=tuple(cameras))
    # Without a readout no image departs from the given motion.
    start_near = carried(fit.network, without, replace(state, cameras=start))
    with because(f"without {PARAMETERS[parameter]}"):
        return lowest(without, start_near, near)


def left_out(
    fit: AdjustedNetwork, camera: int, checks: Checks, done: Callable[[], None] = lambda: None
) -> tuple[WithoutParameter, ...]:
    """Find the minimum without each estimated parameter but c, one at a time."""
    interior = fit.network.cameras[camera]
    estimates = []
    for at in np.flatnonzero(interior.estimated):
        if PARAMETERS[at] == "c":
            continue
        try:
            minimum = without_parameter(fit, camera, int(at))
        except (IllPosedError, NotConvergedError):
            continue
        finally:
            done()
        # A prior goes with its parameter: one observation and one unknown less, or one unknown.
        observed = bool(np.isfinite(interior.prior_sigma[at]))
        redundancy = fit.solution.degrees_of_freedom + (0 if observed else 1)
        c = float(minimum.state.cameras[camera, 0])
        estimates.append(
            WithoutParameter(
                PARAMETERS[at],
                c,
                c - float(fit.state.cameras[camera, 0]),
                minimum.chi_squared,
                minimum.chi_squared / redundancy if redundancy > 0 else float("nan"),
                checks.rmse(minimum.state.points),
            )
        )
    return tuple(estimates)


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
    changes = np.array([change_of(values, fit.computed, name) for name in names])
    fields = (changes[:, None] * shares).reshape(-1, *fit.computed.shape)
    scored = score(fit.factored, fit.solution.residuals, fields)
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
