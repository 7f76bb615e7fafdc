"""Everything about the parameters of one camera: significance, effect, correlation, components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from photocal.analysis.components import Proposal, propose_removal
from photocal.analysis.correlation import StrongCorrelation, strong_correlations
from photocal.analysis.effects import Effect, effects
from photocal.analysis.estimates import Estimates, scaled
from photocal.analysis.exterior_correlation import ExteriorCorrelation, exterior_correlations
from photocal.analysis.significance import FTest, significance
from photocal.analysis.systematic_errors.drift import Within, within_flight
from photocal.analysis.systematic_errors.left_out import Checks, LeftOut, left_out
from photocal.analysis.systematic_errors.refit import Fit
from photocal.analysis.systematic_errors.search import camera_estimates


@dataclass(frozen=True)
class CameraAnalysis:
    """The parameters of one camera, judged.

    estimates: values with their a priori covariance.
    variance_factor: by which the covariance was scaled for the tests.
    tests: single, group and cumulative tests.
    effects: over the format, px.
    correlations: over the threshold.
    exterior: with elements of the exterior orientation, over the threshold.
    proposal: of the principal component analysis.
    left_out: adjusted anew without each parameter.
    within: c, x0 and y0 over the flight; empty for a few images.
    """

    estimates: Estimates
    variance_factor: float
    tests: tuple[FTest, ...]
    effects: tuple[Effect, ...]
    correlations: tuple[StrongCorrelation, ...]
    exterior: tuple[ExteriorCorrelation, ...]
    proposal: Proposal
    left_out: tuple[LeftOut, ...]
    within: tuple[Within, ...] = ()


def analyse_camera(
    fit: Fit,
    camera: int,
    checks: Checks,
    alpha: float,
    threshold: float,
    done: Callable[[], None] = lambda: None,
) -> CameraAnalysis | None:
    """Judge the parameters of a camera."""
    estimates = camera_estimates(fit, camera)
    if not estimates.names:
        return None
    # Never better than promised: see `hidden.camera_findings`.
    factor = max(1.0, fit.solution.variance_factor)
    judged = scaled(estimates, factor)
    own = fit.network.cameras[camera].with_values(fit.state.cameras[camera])
    return CameraAnalysis(
        estimates,
        factor,
        significance(judged, fit.solution.degrees_of_freedom, alpha),
        effects(own, judged, _reach(fit, camera)),
        strong_correlations(judged, threshold),
        exterior_correlations(fit, camera, threshold, done),
        propose_removal(judged),
        left_out(fit, camera, checks, done),
        within_flight(fit, camera),
    )


def _reach(fit: Fit, camera: int) -> float:
    """Largest distance of an observation of a camera from the image centre."""
    rays = fit.network.rays
    mine = fit.network.exposures.camera[rays.image] == camera
    return float(np.linalg.norm(rays.plane[mine], axis=1).max(initial=0.0))
