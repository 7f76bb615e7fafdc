"""Leaving out a parameter of the camera, adjusted anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError, NotConvergedError
from photocal.analysis.estimates import Array
from photocal.analysis.systematic_errors.refit import Fit, lowest
from photocal.geometry.camera import PARAMETERS


@dataclass(frozen=True)
class Checks:
    """Surveyed coordinates that did not take part in the adjustment.

    Attributes
    ----------
    point : (m,) array of int
        Which points of the network they are.
    surveyed : (m, 3) array
        Their coordinates in the frame of the network, m.
    """

    point: NDArray[np.int64]
    surveyed: Array

    def rmse(self, points: Array) -> Array | None:
        """Root mean square of adjusted minus surveyed, (3,) m; None without check points."""
        if not len(self.point):
            return None
        return np.asarray(np.sqrt(np.mean((points[self.point] - self.surveyed) ** 2, axis=0)))


@dataclass(frozen=True)
class LeftOut:
    """The adjustment without one parameter.

    Attributes
    ----------
    parameter : str
        The parameter, held at zero.
    c, change_of_c : float
        c without it, and minus c with it, in the unit of the camera.
    chi_squared, sigma0_squared : float
        Of the adjustment without it.
    check_rmse_m : (3,) array or None
        At the check points, X, Y, Z.
    """

    parameter: str
    c: float
    change_of_c: float
    chi_squared: float
    sigma0_squared: float
    check_rmse_m: Array | None


def left_out(
    fit: Fit, camera: int, checks: Checks, done: Callable[[], None] = lambda: None
) -> tuple[LeftOut, ...]:
    """Adjust without each estimated parameter but c, one at a time.

    Parameters
    ----------
    fit : Fit
        The network at its minimum.
    camera : int
        Whose parameters.
    checks : Checks
        Check points, perhaps none.
    done : callable
        Called after each adjustment.

    Returns
    -------
    tuple of LeftOut
        Outcomes; parameters without which nothing converges are not among them.
    """
    own = fit.network.cameras[camera]
    found = []
    for at in np.flatnonzero(own.estimated):
        if PARAMETERS[at] == "c":
            continue
        estimated, values = own.estimated.copy(), own.values.copy()
        estimated[at], values[at] = False, 0.0
        cameras = list(fit.network.cameras)
        cameras[camera] = replace(own, estimated=estimated, values=values)
        current = fit.state.cameras.copy()
        current[camera, at] = 0.0
        try:
            state = replace(fit.state, cameras=current)
            minimum = lowest(replace(fit.network, cameras=tuple(cameras)), state)
        except (IllPosedError, NotConvergedError):
            continue
        finally:
            done()
        # A prior goes with its parameter: one observation and one unknown less, or one unknown.
        observed = bool(np.isfinite(own.prior_sigma[at]))
        redundancy = fit.solution.degrees_of_freedom + (0 if observed else 1)
        c = float(minimum.state.cameras[camera, 0])
        found.append(
            LeftOut(
                PARAMETERS[at],
                c,
                c - float(fit.state.cameras[camera, 0]),
                minimum.chi_squared,
                minimum.chi_squared / redundancy if redundancy > 0 else float("nan"),
                checks.rmse(minimum.state.points),
            )
        )
    return tuple(found)
