"""Checks of positions, point counts and the claimed class."""

from __future__ import annotations

from photocal.accuracy.findings import Finding
from photocal.accuracy.plausibility.record import StatedReport

# A rounding error (half the last digit) of a tenth does not matter beside what is judged.
_ROUNDING_SHARE = 0.1


def position_digits(report: StatedReport) -> tuple[Finding, ...]:
    """Compare the last printed digit of the positions with what they are used for."""
    if not report.positions_deg:
        return ()
    decimals = max(len(text.partition(".")[2]) for position in report.positions_deg for text in position)
    latitude = float(report.positions_deg[0][0])
    east, north = quantum_m(decimals, latitude)
    need = report.check_rmse_m if report.check_rmse_m is not None else report.gsd_m
    if need is None or max(east, north) / 2.0 <= _ROUNDING_SHARE * need:
        return ()
    return (
        Finding(
            "position-digits",
            f"the target positions are printed to 1e-{decimals} degrees, that is {east:.2f} m east and "
            f"{north:.2f} m "
            f"north: they cannot test {need * 100:.2f} cm. Print at least {decimals_for(need)} decimals.",
        ),
    )


def quantum_m(decimals: int, latitude_deg: float) -> tuple[float, float]:
    """Give the size of the last printed digit of a position."""
    from pyproj import Geod

    step = 10.0**-decimals
    geod = Geod(ellps="GRS80")
    away = latitude_deg - step if latitude_deg > 0.0 else latitude_deg + step
    return (
        float(geod.inv(0.0, latitude_deg, step, latitude_deg)[2]),
        float(geod.inv(0.0, latitude_deg, 0.0, away)[2]),
    )


def decimals_for(need_m: float) -> int:
    """Give the decimals of degrees whose rounding does not matter for an accuracy."""
    decimals = 0
    # One degree of latitude is nowhere longer than 111 700 m.
    while 111_700.0 * 10.0**-decimals / 2.0 > _ROUNDING_SHARE * need_m:
        decimals += 1
    return decimals


def roles(report: StatedReport) -> tuple[Finding, ...]:
    """Notice a report that accepts by check points and does not say which they are.

    Parameters
    ----------
    report : StatedReport
        What the report states.

    Returns
    -------
    tuple of Finding
        Empty when nothing is wrong, or the report does not state enough.
    """
    if report.check_rmse_m is None or report.check_points:
        return ()
    targets = "" if report.targets is None else f" of the {report.targets} targets"
    return (
        Finding(
            "no-check-points",
            f"the RMSE at check points decides, but it is not said which{targets} were check points: "
            "points that "
            "oriented the block cannot check it.",
        ),
    )


def claimed_class(report: StatedReport) -> tuple[Finding, ...]:
    """Notice an accuracy class without scale or contour interval."""
    if report.claimed_class is None or report.claimed_scale or report.claimed_interval_m:
        return ()
    return (
        Finding(
            "class-without-scale",
            f"class {report.claimed_class} is claimed without scale or contour interval: it says nothing, "
            "every "
            "product is of class A at some scale.",
        ),
    )


def motion_blur(report: StatedReport) -> tuple[Finding, ...]:
    """Notice an exposure time that smears the image even at walking pace."""
    if report.exposure_s is None or report.gsd_m is None:
        return ()
    slowest = 0.5 * report.gsd_m / report.exposure_s
    # Half a pixel of smear; survey flights are hardly slower than 3 m/s.
    if slowest >= 3.0:
        return ()
    return (
        Finding(
            "exposure-time",
            f"exposed for {report.exposure_s * 1e3:g} ms, the image smears by more than half a pixel of "
            f"{report.gsd_m * 100:.2f} cm from {slowest:.1f} m/s on.",
        ),
    )
