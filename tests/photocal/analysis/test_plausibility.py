"""The printed Phantom 4 Pro calibration is refused for what is wrong with it; a sound one is not."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.analysis.correlation import correlation_findings
from photocal.analysis.plausibility import CalibrationRecord, Offsets, effective_unit, plausibility
from photocal.findings.finding import Figure

NAMES = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")

# Table 3 of the study; figure 20 has K2 ten times smaller, and other sigmas of K3 and P1.
TABLE_3 = {
    "c": (3673.03, 0.28),
    "x0": (-2.3621, 0.015),
    "y0": (-14.7955, 0.013),
    "K1": (0.0115868, 3e-5),
    "K2": (-0.574271, 1.5e-4),
    "K3": (0.102937, 2.9e-6),
    "P1": (7.76097e-7, 1e-6),
    "P2": (-1.91316e-3, 7.9e-7),
}

# The lower triangle as printed, two decimals.
PRINTED = """
1
-0.11 1
0.03 -0.02 1
-0.02 -0.01 0.01 1
-0.10 0.02 0.02 0.96 1
0.15 -0.02 -0.06 0.91 -0.99 1
0.09 0.56 0.00 0.00 -0.01 -0.02 1
-0.14 -0.01 0.03 0.00 0.02 0.03 -0.05 1
"""


def matrix() -> np.ndarray:
    rows = [[float(x) for x in line.split()] for line in PRINTED.split("\n") if line]
    full = np.zeros((8, 8))
    for i, row in enumerate(rows):
        full[i, : i + 1] = full[: i + 1, i] = row
    return full


def printed() -> CalibrationRecord:
    return CalibrationRecord(
        unit="mm",
        values={name: value for name, (value, _) in TABLE_3.items()},
        sigmas={name: sigma for name, (_, sigma) in TABLE_3.items()},
        coefficients="normalised",
        direction="ideal",
        names=NAMES,
        correlation=matrix(),
        correlation_rounding=0.005,
        size_px=(5280, 3956),
        pitch_mm=0.0241,
        sensor_mm=(35.0,),
        nominal_focal_mm=8.8,
        height_m=100.0,
        gsd_cm=3.17,
        base_m=158.4,
        forward_overlap=0.70,
        lever_arm_cm=Offsets((1.6734911, 1.5078943, 5.7230301), (0.1748463, 3.1715423, 1.5515599)),
        boresight_deg=Offsets((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)),
    )


def found(record: CalibrationRecord) -> dict[tuple[str, str], dict[str, Figure]]:
    return {(f.code, f.subject): dict(f.figures) for f in plausibility(record)}


def test_printed_matrix_is_refused_and_the_lost_sign_named() -> None:
    findings = found(printed())
    figures = findings["correlation_sign_lost", "K1-K2"]
    assert figures["least_eigenvalue"] == pytest.approx(-0.909144, abs=1e-6)
    assert figures["repaired_eigenvalue"] == pytest.approx(-0.002088, abs=1e-6)


def test_pixels_printed_as_millimetres() -> None:
    figures = found(printed())["px_printed_as_mm", "c"]
    assert figures["implied_pitch_um"] == pytest.approx(8.8 / 3673.03 * 1000)
    assert effective_unit(printed()) == "px"


def test_pitch_ten_times_too_large() -> None:
    findings = found(printed())
    assert findings["pitch_contradicts_sensor", "pitch"]["width_mm"] == pytest.approx(127.248)
    assert findings["pitch_contradicts_focal_length", "pitch"]["implied_um"] == pytest.approx(2.396, abs=1e-3)


def test_folding_k2() -> None:
    """The study: derivative of the distorted radius -0.47 at r = 0.9 by table 3, positive by figure 20."""
    figures = found(printed())["distortion_folds", "K"]
    assert figures["slope"] == pytest.approx(-0.47, abs=0.01)
    better = replace(printed(), values={**printed().values, "K2": -0.0574271})
    assert ("distortion_folds", "K") not in found(better)


def test_insignificant_ones_and_the_prior() -> None:
    findings = found(printed())
    assert findings["not_significant", "P1"]["t"] == pytest.approx(0.776, abs=1e-3)
    assert findings["not_significant", "lever_arm_Y"]["t"] == pytest.approx(0.4754, abs=1e-4)
    assert findings["only_its_prior", "boresight"]["sigma"] == 2.0
    subjects = {subject for code, subject in findings if code == "not_significant"}
    assert subjects == {"P1", "lever_arm_Y"}


def test_ground_sampling_distance_and_base() -> None:
    findings = found(printed())
    assert findings["gsd_contradicts_height", "gsd"]["expected_cm"] == pytest.approx(2.7225, abs=1e-4)
    assert ("base_contradicts_overlap", "base") in findings


def test_refusals_come_first() -> None:
    order = [finding.severity for finding in plausibility(printed())]
    assert order == sorted(order, key=["refused", "doubtful", "note"].index)


@pytest.mark.shared
def test_record_is_the_published_one(shared: Path) -> None:
    folder = shared / "reference" / "phantom4pro"
    with (folder / "iop_correlation_published.csv").open() as stream:
        rows = [[float(x) for x in row[1:]] for row in list(csv.reader(stream))[1:]]
    assert matrix() == pytest.approx(np.array(rows))
    with (folder / "iop_parameters.csv").open() as stream:
        table = list(csv.DictReader(stream))
    assert [float(row["value_table3"]) for row in table] == [v for v, _ in TABLE_3.values()]


@pytest.mark.shared
def test_repaired_matrix_passes(shared: Path) -> None:
    with (shared / "reference/phantom4pro/iop_correlation_sign_repaired.csv").open() as stream:
        rows = [[float(x) for x in row[1:]] for row in list(csv.reader(stream))[1:]]
    assert correlation_findings(NAMES, np.array(rows), 0.005) == []
    assert correlation_findings(NAMES, np.array(rows), 0.0) != []


def sound() -> CalibrationRecord:
    """The same camera as it must have been: pixels, true pitch and format, sign repaired, figure 20."""
    fixed = matrix()
    fixed[3, 4] = fixed[4, 3] = -0.96
    return replace(
        printed(),
        unit="px",
        values={**printed().values, "K2": -0.0574271, "P1": 7.76097e-5},
        correlation=fixed,
        size_px=(5472, 3648),
        pitch_mm=0.00241,
        sensor_mm=(13.2, 8.8),
        gsd_cm=2.72,
        base_m=29.8,
        lever_arm_cm=None,
        boresight_deg=None,
    )


def test_sound_record_has_no_findings() -> None:
    assert plausibility(sound()) == ()


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"sensor_mm": (23.5, 15.6)}, "pitch_contradicts_sensor"),
        ({"pitch_ratio": 0.99804}, "pitch_not_square"),
        ({"nominal_focal_mm": 12.0}, "pitch_contradicts_focal_length"),
        ({"gsd_cm": 3.17}, "gsd_contradicts_height"),
        ({"base_m": 110.0}, "base_contradicts_overlap"),
        ({"prior_sigmas": {"K1": 3e-5}}, "only_its_prior"),
        ({"sigmas": {"c": float("nan")}}, "not_a_number"),
        ({"boresight_deg": Offsets((0.1, 0.2, 0.3), (1.99, 1.98, 1.97), 2.0)}, "only_its_prior"),
    ],
)
def test_one_fault_gives_one_finding(change: dict[str, object], code: str) -> None:
    codes = {finding.code for finding in plausibility(replace(sound(), **change))}  # type: ignore[arg-type]
    assert code in codes


def test_weak_principal_distance_says_why() -> None:
    weak = replace(sound(), sigmas={"c": 0.013 * 3673.03}, convergence_deg=31.0, depth_spread=0.08)
    (finding,) = plausibility(weak)
    assert finding.code == "weak_principal_distance_shape"
    assert finding.figures == pytest.approx({"percent": 1.3, "convergence_deg": 31.0, "depth_percent": 8.0})
    assert plausibility(replace(weak, sigmas={"c": 0.004 * 3673.03})) == ()


def test_a_principal_distance_that_single_images_move_is_weak_whatever_its_formal_sigma() -> None:
    stated = replace(sound(), sigmas={"c": 0.001 * 3673.03}, stated_sigma_c=0.061 * 3673.03)
    (finding,) = plausibility(stated)
    assert finding.code == "weak_principal_distance"
    assert finding.figures == pytest.approx({"percent": 6.1})
    assert plausibility(replace(stated, stated_sigma_c=0.001 * 3673.03)) == ()


def test_malformed_matrices() -> None:
    for spoilt in (np.eye(7), np.full((8, 8), np.nan), 2 * np.eye(8), np.triu(np.ones((8, 8)))):
        assert correlation_findings(NAMES, spoilt, 0.005)[0].code == "correlation_malformed"


@given(st.integers(2, 9), st.integers(0, 10_000))
def test_no_true_matrix_is_refused_even_rounded(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    samples = rng.normal(size=(n, n + 3))
    covariance = samples @ samples.T
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    names = tuple(f"p{i}" for i in range(n))
    assert correlation_findings(names, correlation, 0.0) == []
    assert correlation_findings(names, np.round(correlation, 2), 0.005) == []


def test_folding_of_the_observed_direction() -> None:
    """Ideal = measured less displacement: it folds where 3 K1 r^2 passes 1."""
    record = CalibrationRecord("px", {"c": 1000.0, "K1": 1e-6}, {}, size_px=(1200, 900))
    figures = {f.code: f.figures for f in plausibility(record)}["distortion_folds"]
    assert figures["radius"] == pytest.approx(np.sqrt(1 / 3e-6), rel=1e-3)
    negative = replace(record, values={"c": 1000.0, "K1": -1e-6})
    assert plausibility(negative) == ()
