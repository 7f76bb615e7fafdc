"""The calibrations that a run holds, for a comparison of their stability."""

from __future__ import annotations

import numpy as np

from photocal.analysis.estimates import Estimates
from photocal.analysis.stability.calibration import Calibration
from photocal.geometry.camera import AFFINITIES, AFFINITY_FORMS, camera
from photocal.report.run import CameraResult, Result


def calibrations_of_run(result: Result, label: str) -> tuple[Calibration, ...]:
    """Give the cameras of a run with the covariance of their estimated parameters."""
    several = len(result.cameras) > 1
    return tuple(
        _calibration(f"{label}/{name}" if several else label, own) for name, own in result.cameras.items()
    )


def _calibration(label: str, own: CameraResult) -> Calibration:
    names = own.correlation.names
    made = camera(
        label,
        own.model,
        own.unit,
        own.size_px,
        own.pitch,
        {name: parameter.value for name, parameter in own.parameters.items()},
        estimate=names,
        reference_radius=own.reference_radius,
        affinity=next(a for a in AFFINITIES if a == own.affinity),
        affinity_form=next(f for f in AFFINITY_FORMS if f == own.affinity_form),
    )
    if not names:
        return Calibration(made)
    sigma = np.array([own.parameters[name].sigma for name in names])
    values = np.array([own.parameters[name].value for name in names])
    covariance = np.outer(sigma, sigma) * np.array(own.correlation.matrix)
    return Calibration(made, Estimates(names, values, covariance))
