"""Similarity of calibrations against Tables 13 to 16 of the Canon ELPH study and against simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.analysis.estimates import from_sigmas
from photocal.analysis.stability.camera_file import CameraFile, brown_from_pix4d, read_camera_file
from photocal.analysis.stability.comparison import CalibrationPair, compare, follow, likeness, sentences
from photocal.analysis.stability.methods import (
    IdealImage,
    Method,
    ResectionGround,
    figure,
    fitted_pose,
    methods,
    sensor_grid,
    view,
)
from photocal.base.errors import (
    IllPosedError,
)
from photocal.findings.texts import catalogue
from photocal.geometry.camera import PARAMETERS, Camera, camera
from photocal.geometry.distortion import distorted
from photocal.geometry.rotation import matrix_from_angles

Rows = list[dict[str, str]]
STUDY = Path(__file__).parents[3] / "configs/studies/canon-elph/calibrations.toml"


@pytest.fixture(scope="module")
def study() -> CameraFile:
    return read_camera_file(STUDY)


@pytest.fixture(scope="module")
def pairs(study: CameraFile) -> tuple[CalibrationPair, ...]:
    """The seven calibrations without their sigmas."""
    bare = tuple(replace(one, sigma=None) for one in study.calibrations)
    pixels = sensor_grid((4608, 3456), 100.0)
    chosen = methods(
        len(pixels), study.comparison.terrain, study.comparison.terrains_each, study.comparison.seed
    )
    return compare(bare, pixels, chosen, np.random.default_rng(1))


def value(pairs: tuple[CalibrationPair, ...], first: str, second: str, method: str, definition: str) -> float:
    (pair,) = [one for one in pairs if (one.first, one.second) == (first, second)]
    return next(f.value_px for f in pair.figures if (f.method, f.definition) == (method, definition))


def test_the_grid_is_the_study_s() -> None:
    grid = sensor_grid((4608, 3456))
    assert len(grid) == 1610
    assert grid.min(axis=0).tolist() == [50.0, 50.0]
    assert grid.max(axis=0).tolist() == [4550.0, 3450.0]


@pytest.mark.parametrize(
    ("table", "method", "definition", "tolerance"),
    [
        ("table13_zrot_rmse", "ZROT", "mean distance", 0.025),
        ("table14_rot_sigma0", "ROT", "one principal distance", 0.010),
        ("table15_spr_relief100_sigma0", "SPR", "relief 100 m", 0.025),
        ("table16_spr_relief20_sigma0", "SPR", "relief 20 m", 0.015),
    ],
)
def test_printed_tables(
    canon: Callable[[str], Rows],
    pairs: tuple[CalibrationPair, ...],
    table: str,
    method: str,
    definition: str,
    tolerance: float,
) -> None:
    rows = canon(table)
    assert len(rows) == 21
    for row in rows:
        printed = float(list(row.values())[2])
        found = value(pairs, row["set_a"], row["set_b"], method, definition)
        if (row["set_a"], row["set_b"]) == ("1", "2"):
            assert abs(found - printed) > 0.2
        else:
            assert found == pytest.approx(printed, abs=tolerance)


@pytest.mark.parametrize(
    ("column", "method", "definition"),
    [
        ("mis_mean_px", "MIS", "mean distance"),
        ("mis_rms_px", "MIS", "root mean square"),
        ("zrot_mean_px", "ZROT", "mean distance"),
        ("zrot_rms_px", "ZROT", "root mean square"),
        ("rot_sigma0_px_common_f", "ROT", "one principal distance"),
        ("rot_sigma0_px_eq19_two_f", "ROT", "two principal distances"),
    ],
)
def test_both_definitions_agree_with_a_second_computation(
    canon: Callable[[str], Rows],
    pairs: tuple[CalibrationPair, ...],
    column: str,
    method: str,
    definition: str,
) -> None:
    for row in canon("derived_similarity_recomputed"):
        found = value(pairs, row["set_a"], row["set_b"], method, definition)
        assert found == pytest.approx(float(row[column]), abs=6e-5)


def test_pair_1_2_does_not_follow_from_its_parameters(
    study: CameraFile, pairs: tuple[CalibrationPair, ...]
) -> None:
    followed = follow(study.published, pairs)
    assert len(followed) == 84
    broken = [one for one in followed if not one.follows]
    assert [(one.first, one.second) for one in broken] == [("1", "2")] * 4
    words = sentences(pairs, study.comparison.thresholds_px, followed, catalogue("en"))
    assert sum(word.startswith("Pair 1-2: the printed") for word in words) == 4


@pytest.mark.parametrize(
    ("method", "definition", "tight", "loose"),
    # The classification by the printed values, with 1-2 as its parameters give it.
    [
        ("ZROT", "mean distance", "", ""),
        ("ROT", "one principal distance", "1-2", "3-7"),
        ("SPR", "relief 100 m", "1-2", "1-3 2-3 3-7"),
        ("SPR", "relief 20 m", "1-2 1-7 2-7 3-6", "1-3 1-6 2-3 2-6 3-5 3-7 5-6 6-7"),
    ],
)
def test_thresholds(
    study: CameraFile,
    pairs: tuple[CalibrationPair, ...],
    method: str,
    definition: str,
    tight: str,
    loose: str,
) -> None:
    by_limit: dict[float | None, list[str]] = {}
    for pair in pairs:
        (kind,) = [f for f in pair.figures if (f.method, f.definition) == (method, definition)]
        by_limit.setdefault(likeness(kind, study.comparison.thresholds_px), []).append(
            f"{pair.first}-{pair.second}"
        )
    assert " ".join(by_limit.get(0.33, [])) == tight
    assert " ".join(by_limit.get(0.5, [])) == loose


def test_manufacturer_values_of_box_1(canon: Callable[[str], Rows]) -> None:
    given_ = {row["parameter"]: float(row["value"]) for row in canon("box01_manufacturer_parameters")}
    pitch = (6.17219 / 4608, 4.62914 / 3456)
    made = brown_from_pix4d("maker", (4608, 3456), pitch, given_)
    assert made.model == "brown-ideal"
    expected = {
        "c": 4.38311, "x0": 0.0683, "y0": 0.0383, "K1": -2.13e-3, "K2": 1.03e-4, "K3": -2.66e-6,
        "P1": 8.7e-4, "P2": 5.6e-4,
    }  # fmt: skip
    for name, number in expected.items():
        assert made.value(name) == pytest.approx(number, rel=0.01)
    # The equations of Pix4D themselves, in its own axes: y down from the upper left corner of the sensor.
    x, y = np.array([-0.5, 0.1, 0.6]), np.array([0.3, -0.4, 0.45])
    r2 = x * x + y * y
    radial = 1 + given_["R1"] * r2 + given_["R2"] * r2**2 + given_["R3"] * r2**3
    t1, t2, f = given_["T1"], given_["T2"], given_["f"]
    u = f * (x * radial + 2 * t1 * x * y + t2 * (r2 + 2 * x * x)) + given_["Px"]
    v = f * (y * radial + 2 * t2 * x * y + t1 * (r2 + 2 * y * y)) + given_["Py"]
    plane = distorted(made, f * np.column_stack([x, -y]))
    np.testing.assert_allclose(plane[:, 0], u - 6.17219 / 2, atol=1e-12)
    np.testing.assert_allclose(plane[:, 1], 4.62914 / 2 - v, atol=1e-12)


def simple(name: str = "a", **parameters: float) -> Camera:
    values = {"c": 3500.0, "x0": 5.0, "y0": -3.0, "K1": -8e-9, "K2": 1e-16, **parameters}
    return camera(name, "brown-observed", "px", (4000, 3000), (1.0, 1.0), values)


GRID = sensor_grid((4000, 3000), 250.0)
CHOSEN = methods(len(GRID), (ResectionGround(height_m=250.0, relief_m=100.0),), 2, 5)


def test_a_camera_is_like_itself() -> None:
    (pair,) = compare((simple("a"), simple("b")), GRID, CHOSEN, np.random.default_rng(1))
    assert max(figure.value_px for figure in pair.figures) < 1e-8


@settings(max_examples=20)
@given(st.floats(-3e-3, 3e-3), st.floats(-3e-3, 3e-3), st.floats(-1e-2, 1e-2))
def test_rotation_and_resection_do_not_see_a_turned_bundle(omega: float, phi: float, kappa: float) -> None:
    """A bundle turned about its centre is the same bundle: the closed form of what ROT and SPR free."""
    first = view(simple(), GRID)
    rays = np.column_stack([first.ideal, np.full(len(GRID), -first.c)])
    rays = rays @ matrix_from_angles(np.array([omega, phi, kappa])).T
    second = IdealImage(-first.c * rays[:, :2] / rays[:, 2:], first.c)
    for method in CHOSEN:
        pose, _ = fitted_pose(method, method.misfits[0], first, second)
        left = float(figure(method, method.misfits[0](first, second, pose)))
        if method.name in ("ROT", "SPR"):
            assert left < 1e-6
        elif max(abs(omega), abs(phi), abs(kappa)) > 1e-6:
            assert left > 1e-4


def test_only_resection_hides_a_different_principal_distance_over_flat_ground() -> None:
    flat = methods(len(GRID), (ResectionGround(height_m=250.0, relief_m=0.0),), 1, 5)
    (pair,) = compare((simple("a"), simple("b", c=3510.0)), GRID, flat, np.random.default_rng(1))
    found = {(f.method, f.definition): f.value_px for f in pair.figures}
    assert found["SPR", "relief 0 m"] < 1e-6
    assert found["ZROT", "mean distance"] > 2.0
    assert found["ROT", "two principal distances"] > 1.0


def uncertain(made: Camera, shift: np.ndarray[Any, np.dtype[np.float64]] | None = None) -> Camera:
    names = ("c", "x0", "y0", "K1", "K2")
    sigmas = [1.0, 0.6, 0.5, 3e-10, 1e-17]
    r = np.eye(5)
    r[3, 4] = r[4, 3] = -0.9
    known = from_sigmas(names, [made.value(name) for name in names], sigmas, r)
    if shift is not None:
        values = made.values.copy()
        values[[0, 1, 2, 3, 4]] += np.linalg.cholesky(known.covariance) @ shift
        made = made.with_values(values)
    spread, correlation = np.zeros(len(PARAMETERS)), np.eye(len(PARAMETERS))
    spread[:5], correlation[:5, :5] = sigmas, r
    estimated = spread > 0.0
    return replace(made, estimated=estimated, sigma=spread, correlation=correlation)


def test_different_beyond_noise_keeps_its_level() -> None:
    """Two noisy calibrations of one camera differ beyond their noise in about 5 of 100 cases."""
    generator = np.random.default_rng(8)
    chosen = tuple(m for m in CHOSEN if m.source != "equations")
    alarms = np.zeros(len(chosen))
    trials = 80
    for _ in range(trials):
        a, b = (uncertain(simple(name), generator.standard_normal(5)) for name in "ab")
        (pair,) = compare((a, b), GRID, chosen, generator, draws=300)
        alarms += [bool(f.different) for f in pair.figures]
    # 5 % of 80 is 4 with a standard deviation of 1.9.
    assert np.all(alarms <= 4 + 4 * 1.9)
    assert alarms.sum() >= 1


def test_the_sigma_of_a_figure_is_its_scatter() -> None:
    """Propagated uncertainty against calibrations drawn and compared anew."""
    generator = np.random.default_rng(9)
    other = simple("b", x0=25.0, c=3520.0, K1=-9.5e-9)
    (pair,) = compare((uncertain(simple("a")), uncertain(other)), GRID, CHOSEN, generator, draws=4000)
    drawn = []
    for _ in range(150):
        a = replace(uncertain(simple("a"), generator.standard_normal(5)), sigma=None)
        b = replace(uncertain(other, generator.standard_normal(5)), sigma=None)
        (again,) = compare((a, b), GRID, CHOSEN, generator)
        drawn.append([f.value_px for f in again.figures])
    scatter = np.std(np.array(drawn), axis=0)
    propagated = np.array([f.sigma_px for f in pair.figures], dtype=np.float64)
    assert all(f.different for f in pair.figures)
    # 150 draws know a standard deviation to 6 %.
    np.testing.assert_allclose(propagated, scatter, rtol=0.25)


def test_a_distortion_that_folds_is_refused() -> None:
    folded = replace(simple("b", K1=-1e-6), model="brown-ideal")
    with pytest.raises(IllPosedError, match="camera b: the distortion folds within the image"):
        compare((simple("a"), folded), GRID, CHOSEN, np.random.default_rng(1))


def test_methods_are_described(study: CameraFile) -> None:
    chosen: tuple[Method, ...] = methods(10, study.comparison.terrain, 5, 1)
    assert [(m.name, m.source) for m in chosen] == [
        ("MIS", "equations"), ("MIS", "tables"), ("ZROT", "equations"), ("ZROT", "tables"),
        ("ROT", "equations"), ("ROT", "tables"), ("SPR", "both"), ("SPR", "both"),
    ]  # fmt: skip
    assert [len(m.misfits) for m in chosen] == [1, 1, 1, 1, 1, 1, 5, 5]
