"""Checks of what a report says of its camera and flight: pixel, format, resolution, base."""

from __future__ import annotations

import math

from photocal.accuracy.findings import Finding
from photocal.accuracy.plausibility.record import KnownCamera, StatedReport, find_camera

# Figures that should be equal are printed with about three digits.
_AGREE = 0.05
# No camera that flies on a small aircraft has a longer image side.
_LONGEST_SENSOR_MM = 60.0


def pixel_size(report: StatedReport, cameras: tuple[KnownCamera, ...]) -> tuple[Finding, ...]:
    """Compare the pixel size with the sensor, with the running text, and with itself times the format."""
    said: list[Finding] = []
    stated = report.pixel_mm
    if stated is None:
        return ()
    known = find_camera(report.camera_model, cameras)
    if known is not None and abs(stated / known.pixel_mm - 1.0) > _AGREE:
        factor = stated / known.pixel_mm
        times = f"{factor:.3g} times too large" if factor > 1.0 else f"{1.0 / factor:.3g} times too small"
        said.append(
            Finding(
                "pixel-size",
                f"the pixel size of {stated:g} mm is {times}: the sensor of the {known.model} has "
                f"{known.pixel_mm:.5f} mm ({known.sensor_mm[0]:g} mm / {known.columns} px).",
            )
        )
    if report.columns is not None and stated * report.columns > _LONGEST_SENSOR_MM:
        said.append(
            Finding(
                "sensor-too-large",
                f"{report.columns} px of {stated:g} mm make an image {stated * report.columns:.2f} mm "
                "wide: no such "
                "camera flies on a small aircraft; look at the decimal point of the pixel size.",
            )
        )
    if report.pixel_text_mm is not None and abs(stated / report.pixel_text_mm - 1.0) > _AGREE:
        said.append(
            Finding(
                "pixel-size-twice",
                f"the pixel size is {stated:g} mm in one place and {report.pixel_text_mm:g} mm in "
                "another, a factor "
                f"of {max(stated / report.pixel_text_mm, report.pixel_text_mm / stated):.3g}.",
            )
        )
    return tuple(said)


def image_format(report: StatedReport, cameras: tuple[KnownCamera, ...]) -> tuple[Finding, ...]:
    """Compare the image format with the camera that is named."""
    known = find_camera(report.camera_model, cameras)
    if report.columns is None or report.rows is None or known is None:
        return ()
    if (report.columns, report.rows) == (known.columns, known.rows):
        return ()
    others = [c for c in cameras if (c.columns, c.rows) == (report.columns, report.rows)]
    whose = f" It is the format of the {others[0].model} ({others[0].aliases[0]})." if others else ""
    return (
        Finding(
            "image-format",
            f"{report.columns} x {report.rows} px is not the format of the {known.model} ({known.columns} x "
            f"{known.rows} px).{whose} The form may have been filled in from another camera.",
        ),
    )


def resolution(report: StatedReport, cameras: tuple[KnownCamera, ...]) -> tuple[Finding, ...]:
    """Compare the ground sample distance with height, focal length and pixel size."""
    if report.gsd_m is None or report.height_m is None or report.focal_nominal_mm is None:
        return ()
    known = find_camera(report.camera_model, cameras)
    said = []
    pixels = {
        "the stated pixel": report.pixel_mm,
        "the pixel of the sensor": known.pixel_mm if known else None,
    }
    for name, pixel in pixels.items():
        if pixel is None:
            continue
        computed = report.height_m * pixel / report.focal_nominal_mm
        if abs(computed / report.gsd_m - 1.0) > _AGREE:
            needed = report.gsd_m * report.focal_nominal_mm / pixel
            said.append(
                Finding(
                    "gsd",
                    f"{report.height_m:g} m, {report.focal_nominal_mm:g} mm and {name} give a ground "
                    "sample distance "
                    f"of {computed * 100:.2f} cm, not {report.gsd_m * 100:.2f} cm; that needs "
                    f"{needed:.1f} m.",
                )
            )
    return tuple(said)


def focal_length(report: StatedReport, cameras: tuple[KnownCamera, ...]) -> tuple[Finding, ...]:
    """Notice a calibrated focal length in pixels under the unit mm, and a nominal one called calibrated."""
    nominal, table, form = report.focal_nominal_mm, report.focal_calibrated_mm, report.focal_form_mm
    if nominal is None:
        return ()
    said = []
    known = find_camera(report.camera_model, cameras)
    pixel = known.pixel_mm if known else report.pixel_mm
    if table is not None and not 0.5 < table / nominal < 2.0:
        meaning = "" if pixel is None else f"; as pixels it is {table * pixel:.3f} mm"
        text = (
            f"the calibrated focal length of {table:g} mm does not belong to a lens of {nominal:g} mm"
            f"{meaning}."
        )
        said.append(Finding("focal-unit", text))
    if form is not None and form == nominal and table is not None and table != form:
        said.append(
            Finding(
                "focal-nominal",
                f"the form repeats the nominal {nominal:g} mm as the calibrated focal length.",
            )
        )
    return tuple(said)


def air_base(report: StatedReport) -> tuple[Finding, ...]:
    """Compare the air base with footprint and forward overlap.

    Parameters
    ----------
    report : StatedReport
        What the report states.

    Returns
    -------
    tuple of Finding
        Empty when nothing is wrong, or the report does not state enough.
    """
    if None in (report.base_m, report.gsd_m, report.rows, report.columns):
        return ()
    base, gsd = float(report.base_m or 0.0), float(report.gsd_m or 0.0)
    sides = {"rows": (report.rows or 0) * gsd, "columns": (report.columns or 0) * gsd}
    overlaps = {name: 1.0 - base / side for name, side in sides.items()}
    stated = report.forward_overlap
    if stated is not None and any(abs(overlap - stated) <= _AGREE for overlap in overlaps.values()):
        return ()
    if stated is None and all(overlap > 0.0 for overlap in overlaps.values()):
        return ()
    wanted = (
        ""
        if stated is None
        else (
            f"; {stated:.0%} needs {(1 - stated) * sides['rows']:.1f} m "
            f"or {(1 - stated) * sides['columns']:.1f} m"
        )
    )
    return (
        Finding(
            "air-base",
            f"an air base of {base:g} m leaves an overlap of {overlaps['rows']:.0%} along the rows or "
            f"{overlaps['columns']:.0%} along the columns{wanted}. "
            "The base is the distance of two neighbouring photos, not the footprint.",
        ),
    )


def corner_table(report: StatedReport) -> tuple[Finding, ...]:
    """Notice image width and height that changed places in the corner table."""
    if not report.corners or report.columns is None or report.rows is None:
        return ()
    column = max(corner.column_px for corner in report.corners)
    line = max(corner.line_px for corner in report.corners)
    swapped = math.isclose(column, report.rows, abs_tol=1.0) and math.isclose(
        line, report.columns, abs_tol=1.0
    )
    if not swapped or report.columns == report.rows:
        return ()
    return (
        Finding(
            "corner-table",
            f"the corner table gives line {line:g} and column {column:g}, but the image has "
            f"{report.columns} columns "
            f"and {report.rows} lines: the two headings are swapped.",
        ),
    )
