"""Parameters of a camera left out of the adjustment, one by one."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork, lowest
from photocal.adjustment.near import with_held
from photocal.adjustment.shake import carried
from photocal.adjustment.solver import Near
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.camera import PARAMETERS


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
    interior, current = fit.network.cameras[camera], fit.state.cameras
    if not np.isfinite(interior.prior_sigma[parameter]):
        active, columns = fit.factored.problem.layout.camera_columns[camera]
        column = int(columns[active == parameter][0])
        try:
            # Left of each adjustment, see `minimise`: 0.001 standard deviations at most.
            near = 1e-6
            return with_held(fit.factored, column, -float(current[camera, parameter]), near)
        except NotConvergedError:
            pass
    estimated, values, start = interior.estimated.copy(), interior.values.copy(), current.copy()
    estimated[parameter], values[parameter], start[camera, parameter] = False, 0.0, 0.0
    cameras = list(fit.network.cameras)
    cameras[camera] = replace(interior, estimated=estimated, values=values)
    without = replace(fit.network, cameras=tuple(cameras))
    # Without a readout no image departs from the given motion.
    return lowest(without, carried(fit.network, without, replace(fit.state, cameras=start)))


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
