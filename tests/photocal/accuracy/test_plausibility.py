"""The published record of a Phantom 4 Pro (Unipampa 2023): every contradiction that was found by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.accuracy.acceptance import form_verdict
from photocal.accuracy.plausibility.check_report import check_report
from photocal.accuracy.plausibility.position_checks import decimals_for, quantum_m
from photocal.accuracy.plausibility.record import (
    Corner,
    StatedParameter,
    StatedReport,
    find_camera,
    known_cameras,
)
from photocal.planning.expected_precision import expected_altimetric_accuracy

Published = Callable[[str], list[dict[str, str]]]


def matrix(rows: list[dict[str, str]]) -> NDArray[np.float64]:
    names = [row["parameter"] for row in rows]
    return np.array([[float(row[name]) for name in names] for row in rows])


@pytest.fixture(scope="session")
def report(published: Published) -> StatedReport:
    iop = published("phantom4pro/iop_parameters.csv")
    correlation = published("phantom4pro/iop_correlation_published.csv")
    return StatedReport(
        camera_model="Phantom 4 Pro",
        pixel_mm=0.0241,
        pixel_text_mm=2.41e-6,
        columns=5280,
        rows=3956,
        focal_nominal_mm=8.8,
        focal_calibrated_mm=3673.03,
        focal_form_mm=8.8,
        height_m=100.0,
        gsd_m=0.0317,
        base_m=158.4,
        forward_overlap=0.70,
        exposure_s=0.01,
        parameters=tuple(
            StatedParameter(row["parameter"], float(row["value_fig20_annex"]), float(row["std_fig20_annex"]))
            for row in iop
        ),
        parameters_elsewhere=tuple(
            StatedParameter(row["parameter"], float(row["value_table3"]), float(row["std_table3"]))
            for row in iop
        ),
        correlation_names=tuple(row["parameter"] for row in correlation),
        correlation=matrix(correlation),
        lever_arm=(
            StatedParameter("dX", 1.6734911, 0.1748463),
            StatedParameter("dY", 1.5078943, 3.1715423),
            StatedParameter("dZ", 5.7230301, 1.5515599),
        ),
        boresight=tuple(StatedParameter(name, 0.0, 2.0) for name in ("omega", "phi", "kappa")),
        eo_rmse_m=0.00339,
        eo_angle_rmse_rad=0.0,
        camera_position_error_m=10.0,
        positions_deg=tuple(
            (row["lat_deg"], row["lon_deg"]) for row in published("phantom4pro/control_points.csv")
        ),
        check_rmse_m=0.0102,
        targets=10,
        corners=tuple(
            Corner(float(row["column_px"]), float(row["line_px"]), float(row["x_mm"]), float(row["y_mm"]))
            for row in published("phantom4pro/image_corners.csv")
        ),
        claimed_class="A",
    )


def test_every_contradiction_of_the_published_record_is_listed(report: StatedReport) -> None:
    found = check_report(report, known_cameras())
    said = {finding.code: [f.text for f in found if f.code == finding.code] for finding in found}
    assert set(said) == {
        "pixel-size",
        "sensor-too-large",
        "pixel-size-twice",
        "image-format",
        "gsd",
        "focal-unit",
        "focal-nominal",
        "air-base",
        "corner-table",
        "correlation-matrix",
        "tables-disagree",
        "not-significant",
        "boresight-not-estimated",
        "exterior-orientation",
        "exterior-angles",
        "position-digits",
        "no-check-points",
        "class-without-scale",
        "exposure-time",
    }
    assert "9.99 times too large" in said["pixel-size"][0]
    assert "127.25 mm wide" in said["sensor-too-large"][0]
    assert "Mavic 3" in said["image-format"][0]
    # 100 m and 2.41 um give 2.74 cm, the stated pixel 27.39 cm; 3.17 cm needs 115.7 m (115.75 by hand).
    assert "27.39 cm" in said["gsd"][0]
    assert "2.74 cm" in said["gsd"][1]
    assert "115.6 m" in said["gsd"][1] or "115.7 m" in said["gsd"][1]
    assert "8.86" in said["focal-unit"][0] or "8.85" in said["focal-unit"][0]
    assert "37.6 m" in said["air-base"][0]
    assert "-0.909" in said["correlation-matrix"][0]
    assert "k1-k2 (-0.96)" in said["correlation-matrix"][0]
    assert len(said["tables-disagree"]) == 3
    assert all("power of ten" in text for text in said["tables-disagree"])
    assert [text.split(" = ")[0] for text in said["not-significant"]] == ["parameter p1", "lever arm dY"]
    assert "0.98 m east and 1.11 m north" in said["position-digits"][0]


def test_a_sound_report_raises_nothing(report: StatedReport, published: Published) -> None:
    sound = replace(
        report,
        pixel_mm=0.00241,
        pixel_text_mm=0.00241,
        columns=5472,
        rows=3648,
        focal_calibrated_mm=8.852,
        focal_form_mm=8.852,
        gsd_m=0.0274,
        base_m=30.0,
        exposure_s=1e-3,
        parameters=(StatedParameter("f", 8.852, 0.0007),),
        parameters_elsewhere=(),
        correlation=matrix(published("phantom4pro/iop_correlation_sign_repaired.csv")),
        lever_arm=(),
        boresight=(StatedParameter("omega", 0.31, 0.01),),
        eo_rmse_m=0.02,
        eo_angle_rmse_rad=1e-5,
        camera_position_error_m=0.05,
        positions_deg=(("-28.853391234", "-51.293961234"),),
        check_points=4,
        corners=(Corner(0, 0, -6.6, 4.4), Corner(5471, 3647, 6.6, -4.4)),
        claimed_scale=1000.0,
    )
    assert check_report(sound, known_cameras()) == ()


def test_an_empty_report_raises_nothing() -> None:
    assert check_report(StatedReport(), known_cameras()) == ()


def test_last_digit_of_positions_as_computed_by_hand() -> None:
    assert quantum_m(5, -28.85) == pytest.approx((0.976, 1.108), abs=1e-3)
    assert decimals_for(0.0102) == 8
    assert decimals_for(1.0) == 6


def test_cameras_are_found_by_alias() -> None:
    camera = find_camera("phantom 4 pro", known_cameras())
    assert camera is not None
    assert camera.pixel_mm == pytest.approx(0.00241, abs=5e-6)
    assert find_camera("unheard of", known_cameras()) is None
    assert find_camera(None, known_cameras()) is None


def dz(base_m: float, pixel_m: float) -> float:
    return expected_altimetric_accuracy(100.0, base_m, 8.8e-3, pixel_m)


def test_acceptance_of_the_form_on_the_published_numbers() -> None:
    limit = dz(158.4, 0.0241e-3)
    assert limit * 100 == pytest.approx(24.45086, abs=5e-6)
    verdict = form_verdict((0.81e-6, 0.46e-6), 0.0241e-3, 0.0102, 0.0317, 0.0144, limit)
    assert [entry.kept for entry in verdict.limits] == [True] * 4
    assert verdict.text == "ACCEPTABLE"


def test_acceptance_fails_with_the_pixel_size_of_the_running_text() -> None:
    verdict = form_verdict((0.81e-6, 0.46e-6), 2.41e-9, 0.0102, 0.0317, 0.0144, dz(158.4, 0.0241e-3))
    assert verdict.text == "NEW CALIBRATION REQUIRED"
    assert [entry.kept for entry in verdict.limits] == [False, False, True, True]


def test_acceptance_with_the_true_pixel_and_base_still_passes() -> None:
    for base in (158.4, 34.69):
        verdict = form_verdict((0.81e-6, 0.46e-6), 2.41e-6, 0.0102, 0.0317, 0.0144, dz(base, 2.41e-6))
        assert verdict.acceptable
    assert dz(34.69, 2.41e-6) * 100 == pytest.approx(11.164, abs=1e-3)
    assert math.isclose(dz(158.4, 2.41e-6) * 100, 2.44509, abs_tol=1e-5)
