"""Exposures along a strip: interval, smear by motion, and what tilt does to the overlap."""

from __future__ import annotations

import math

from drivers.errors import ConfigurationError
from photocal.accuracy.findings import Finding

# Konecny: from here on tilt changes the overlap; 5 degrees is the conventional tolerance of vertical
# photographs (Alves Junior et al. 2015, section 4).
TILT_WITH_EFFECT_RAD = math.radians(3.0)
TILT_TOLERANCE_RAD = math.radians(5.0)
# Half a pixel of smear halves the contrast of the finest detail.
SMEAR_LIMIT_PX = 0.5


def exposure_interval(base_m: float, ground_speed_m_s: float) -> float:
    """Give the time between exposures at a ground speed.

    Parameters
    ----------
    base_m : float
        Distance of the exposures, m.
    ground_speed_m_s : float
        Speed over ground, m/s: with head wind a fixed interval gains overlap, with tail wind it loses.

    Returns
    -------
    float
        Interval, s.

    Raises
    ------
    ConfigurationError
        For a speed that is not positive.
    """
    if not ground_speed_m_s > 0.0:
        raise ConfigurationError(f"a ground speed of {ground_speed_m_s:g} m/s gives no exposure interval")
    return base_m / ground_speed_m_s


def smear_px(exposure_s: float, ground_speed_m_s: float, gsd_m: float) -> float:
    """Give the smear of the image by the motion during the exposure.

    Parameters
    ----------
    exposure_s : float
        Exposure time, s.
    ground_speed_m_s : float
        Speed over ground, m/s.
    gsd_m : float
        Ground sample distance, m.

    Returns
    -------
    float
        Smear, px.
    """
    return exposure_s * ground_speed_m_s / gsd_m


def tilt_findings(
    omega_rad: float, phi_rad: float, overlap: float, half_angle_rad: float
) -> tuple[Finding, ...]:
    """Say what a tilt of the camera does to a vertical flight.

    Parameters
    ----------
    omega_rad, phi_rad : float
        Largest tilts across and along, rad.
    overlap : float
        Planned overlap in the direction of the larger tilt, 0 to 1.
    half_angle_rad : float
        Half the field of view in that direction, rad.

    Returns
    -------
    tuple of Finding
        Nothing below 3 degrees; a warning up to 5 degrees, a refusal beyond.
    """
    tilt = max(abs(omega_rad), abs(phi_rad))
    if tilt <= TILT_WITH_EFFECT_RAD:
        return ()
    left = tilted_overlap(overlap, tilt, half_angle_rad)
    text = (
        f"tilts up to {math.degrees(tilt):.1f} degrees: the overlap falls from {overlap:.0%} to about "
        f"{left:.0%} where one photo tilts away from its neighbour"
    )
    if tilt <= TILT_TOLERANCE_RAD:
        return (Finding("tilt", f"{text}."),)
    return (
        Finding(
            "tilt-beyond-tolerance",
            f"{text}; beyond the conventional tolerance of 5 degrees: wait for less wind, use a gimbal or "
            "plan more overlap.",
        ),
    )


def tilted_overlap(overlap: float, tilt_rad: float, half_angle_rad: float) -> float:
    """Give the overlap of a vertical photo with a neighbour that tilts away from it.

    Parameters
    ----------
    overlap : float
        Planned overlap, 0 to 1.
    tilt_rad : float
        Tilt of the neighbour, rad.
    half_angle_rad : float
        Half the field of view in the direction of the tilt, rad.

    Returns
    -------
    float
        Share of the footprint of the vertical photo; the near edge of the tilted one lies at
        tan(half angle - tilt) instead of tan(half angle).
    """
    side = 2.0 * math.tan(half_angle_rad)
    return overlap - (math.tan(half_angle_rad) - math.tan(half_angle_rad - tilt_rad)) / side
