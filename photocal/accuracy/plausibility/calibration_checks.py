"""Checks of what a report says of the calibration: parameters, correlations, mounting."""

from __future__ import annotations

import math

import numpy as np

from photocal.accuracy.findings import Finding
from photocal.accuracy.plausibility.record import StatedParameter, StatedReport
from photocal.analysis.correlation_check import sign_repair

# A parameter is called significant from three standard deviations on.
_SIGNIFICANT = 3.0


def correlation_matrix(report: StatedReport) -> tuple[Finding, ...]:
    """Notice a matrix that is no correlation matrix, and the sign that was lost."""
    matrix, names = report.correlation, report.correlation_names
    if matrix is None:
        return ()
    least = float(np.linalg.eigvalsh(matrix)[0])
    # Rounding by half a digit moves an eigenvalue by no more than this (Gershgorin, worst case).
    rounding = 0.5 * 10.0**-report.correlation_decimals * (len(matrix) - 1)
    if least >= -rounding:
        return ()
    (j, i), best = sign_repair(matrix)
    cause = (
        f" With the other sign of {names[i]}-{names[j]} ({-matrix[i, j]:+.2f}) it is {best:.4f}, within "
        "the rounding: a minus sign was lost."
        if best >= -rounding
        else ""
    )
    return (
        Finding(
            "correlation-matrix",
            f"the correlation matrix has an eigenvalue of {least:.3f}: no set of parameters has such "
            "correlations."
            f"{cause}",
        ),
    )


def significance(report: StatedReport) -> tuple[Finding, ...]:
    """Name the parameters that are smaller than three of their standard deviations.

    Parameters
    ----------
    report : StatedReport
        What the report states.

    Returns
    -------
    tuple of Finding
        Empty when nothing is wrong, or the report does not state enough.
    """
    return tuple(
        Finding(
            "not-significant",
            f"{kind} {p.name} = {p.value:.4g} with a standard deviation of {p.sigma:.2g} is "
            f"{abs(p.value) / p.sigma:.2f} times that: not significant.",
        )
        for kind, group in (("parameter", report.parameters), ("lever arm", report.lever_arm))
        for p in group
        if p.sigma > 0.0 and abs(p.value) < _SIGNIFICANT * p.sigma and p.value != 0.0
    )


def boresight(report: StatedReport) -> tuple[Finding, ...]:
    """Notice a boresight that was never estimated: all zero with one standard deviation.

    Parameters
    ----------
    report : StatedReport
        What the report states.

    Returns
    -------
    tuple of Finding
        Empty when nothing is wrong, or the report does not state enough.
    """
    angles = report.boresight
    if (
        not angles
        or any(angle.value != 0.0 for angle in angles)
        or len({angle.sigma for angle in angles}) > 1
    ):
        return ()
    return (
        Finding(
            "boresight-not-estimated",
            f"the boresight is exactly 0 with {angles[0].sigma:g} degrees on every axis: that is a "
            "preset, nothing was estimated.",
        ),
    )


def tables_that_disagree(report: StatedReport) -> tuple[Finding, ...]:
    """Compare two printings of the same parameters."""
    elsewhere = {parameter.name: parameter for parameter in report.parameters_elsewhere}
    said = []
    for first in report.parameters:
        second = elsewhere.get(first.name)
        if second is None:
            continue
        for what, a, b in (("value", first.value, second.value), ("sigma", first.sigma, second.sigma)):
            if not math.isclose(a, b, rel_tol=1e-6):
                said.append(_disagreement(first, what, a, b))
    return tuple(said)


def exterior_orientation(report: StatedReport) -> tuple[Finding, ...]:
    """Compare the two things that a report says of the camera positions.

    Parameters
    ----------
    report : StatedReport
        What the report states.

    Returns
    -------
    tuple of Finding
        Empty when nothing is wrong, or the report does not state enough.
    """
    said = []
    rmse, error = report.eo_rmse_m, report.camera_position_error_m
    if rmse is not None and error is not None and error > 10.0 * rmse:
        said.append(
            Finding(
                "exterior-orientation",
                f"the exposure positions are said to agree to {rmse * 1000:.1f} mm, but camera position "
                "errors up to "
                f"{error:g} m are told elsewhere: one of them is something else.",
            )
        )
    if report.eo_angle_rmse_rad == 0.0:
        text = "the angles of the exposures agree exactly: they were not compared with measured ones."
        said.append(Finding("exterior-angles", text))
    return tuple(said)


def _disagreement(parameter: StatedParameter, what: str, a: float, b: float) -> Finding:
    ratio = abs(b / a) if a and b else 0.0
    power = math.log10(ratio) if ratio else 0.5
    why = ": a power of ten" if math.isclose(power, round(power), abs_tol=1e-3) else ""
    return Finding(
        "tables-disagree",
        f"the {what} of {parameter.name} is {a:g} in one table and {b:g} in another{why}.",
    )
