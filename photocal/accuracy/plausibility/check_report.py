"""All plausibility checks of a report, one after the other."""

from __future__ import annotations

from photocal.accuracy.findings import Finding
from photocal.accuracy.plausibility import calibration_checks, camera_checks, position_checks
from photocal.accuracy.plausibility.record import KnownCamera, StatedReport


def check_report(report: StatedReport, cameras: tuple[KnownCamera, ...]) -> tuple[Finding, ...]:
    """Look for figures of a report that contradict each other or the camera."""
    return (
        *camera_checks.pixel_size(report, cameras),
        *camera_checks.image_format(report, cameras),
        *camera_checks.resolution(report, cameras),
        *camera_checks.focal_length(report, cameras),
        *camera_checks.air_base(report),
        *camera_checks.corner_table(report),
        *calibration_checks.correlation_matrix(report),
        *calibration_checks.tables_that_disagree(report),
        *calibration_checks.significance(report),
        *calibration_checks.boresight(report),
        *calibration_checks.exterior_orientation(report),
        *position_checks.position_digits(report),
        *position_checks.roles(report),
        *position_checks.claimed_class(report),
        *position_checks.motion_blur(report),
    )
