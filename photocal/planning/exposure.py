"""Exposures along a strip: interval, smear by motion, and what tilt does to the overlap."""

from __future__ import annotations

import math

from drivers.errors import ConfigurationError
from photocal.findings.finding import Finding

# Konecny: from here on tilt changes the overlap; 5 degrees is the conventional tolerance of vertical
# photographs (Alves Junior et al. 2015, section 4).
TILT_WITH_EFFECT_RAD = math.radians(3.0)
TILT_TOLERANCE_RAD = math.radians(5.0)
# Half a pixel of smear halves the contrast of the finest detail.
SMEAR_LIMIT_PX = 0.5


def exposure_interval(base_m: float, ground_speed_m_s: float) -> float:
    """Give the time between exposures at a ground speed."""
    if not ground_speed_m_s > 0.0:
        raise ConfigurationError(f"a ground speed of {ground_speed_m_s:g} m/s gives no exposure interval")
    return base_m / ground_speed_m_s


def smear_px(exposure_s: float, ground_speed_m_s: float, gsd_m: float) -> float:
    """Give the smear of the image by the motion during the exposure."""
    return exposure_s * ground_speed_m_s / gsd_m


def tilt_findings(
    omega_rad: float, phi_rad: float, overlap: float, half_angle_rad: float
) -> tuple[Finding, ...]:
    """Say what a tilt of the camera does to a vertical flight."""
    tilt = max(abs(omega_rad), abs(phi_rad))
    if tilt <= TILT_WITH_EFFECT_RAD:
        return ()
    left = tilted_overlap(overlap, tilt, half_angle_rad)
    figures = {"tilt_deg": math.degrees(tilt), "overlap": overlap, "left": left}
    if tilt <= TILT_TOLERANCE_RAD:
        return (Finding("tilt", "note", figures=figures),)
    return (Finding("tilt-beyond-tolerance", "doubtful", figures=figures),)


def tilted_overlap(overlap: float, tilt_rad: float, half_angle_rad: float) -> float:
    """Give the overlap of a vertical photo with a neighbour that tilts away from it."""
    side = 2.0 * math.tan(half_angle_rad)
    return overlap - (math.tan(half_angle_rad) - math.tan(half_angle_rad - tilt_rad)) / side
