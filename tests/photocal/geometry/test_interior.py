"""Interior orientation against photo 1 of the DCS460, fits by numpy, scipy and OpenCV, constructed frames."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from photocal.base.errors import IllPosedError
from photocal.geometry.interior import Transformation, interior_orientation

DCS460 = Path(__file__).parents[2] / "reference" / "dcs460"
CORNERS = np.array([[-13.8, 9.2], [13.8, 9.2], [13.8, -9.2], [-13.8, -9.2]])
KINDS: tuple[Transformation, ...] = ("conformal", "affine", "projective")


def table(name: str) -> list[dict[str, str]]:
    with (DCS460 / name).open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def photo1() -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Corners and points of the first reading in 1/100 px, and the printed means of three in mm."""
    rows = [
        (r["kind"], r["id"], np.array([float(r["col_centipx"]), float(r["row_centipx"])]))
        for r in table("photo01_reading_1a_machine.csv")
    ]
    corners = np.array([xy for kind, _, xy in rows if kind == "fiducial"])
    points = {name: xy for kind, name, xy in rows if kind == "point"}
    mean = {r["point"]: np.array([float(r["x_mm"]), float(r["y_mm"])]) for r in table("photo01_mean_mm.csv")}
    return corners, points, mean


@pytest.mark.parametrize("kind", ["affine", "projective"])
def test_photo_1_from_machine_readings(kind: Transformation) -> None:
    """One reading against the printed means of three: 1.6 and 1.9 um; point 27 is a slip of the reader."""
    corners, points, mean = photo1()
    frame = interior_orientation(corners, CORNERS, kind)
    names = [name for name in points if name in mean and name != "27"]
    assert len(names) == 37
    found = frame.applied(np.array([points[name] for name in names]))
    rms = np.sqrt(np.mean((found - np.array([mean[name] for name in names])) ** 2, axis=0)) * 1000
    assert rms.round(1).tolist() == [1.6, 1.9]
    slip = frame.applied(points["27"][None])[0] - mean["27"]
    assert np.linalg.norm(slip) == pytest.approx(1.4, abs=0.1)


def test_photo_1_corners() -> None:
    """The frame's corners form a rectangle to the last digit of the readings."""
    corners, _, _ = photo1()
    frame = interior_orientation(corners, CORNERS, "affine")
    assert frame.redundancy == 2
    assert frame.sigma0 < 1e-3
    # 27.6 mm over 306 005 hundredths of a pixel and 18.4 mm over 203 607 (the digest's own formula).
    assert frame.matrix[0, 0] == pytest.approx(27.6 / 306005, rel=1e-9)
    assert frame.matrix[1, 1] == pytest.approx(18.4 / 203607, rel=1e-9)
    # Its pixels are not square, which a conformal transformation shows in its residuals.
    conformal = interior_orientation(corners, CORNERS, "conformal")
    assert conformal.sigma0 > 5e-3
    assert np.abs(conformal.residuals).max() < 0.02


@pytest.fixture
def marks() -> tuple[np.ndarray, np.ndarray]:
    """Eight marks, read with some error in another system."""
    rng = np.random.default_rng(4)
    known = np.array([[x, y] for x in (-50.0, 0.0, 50.0) for y in (-40.0, 0.0, 40.0) if x or y])
    homography = np.array([[31.0, 4.0, 900.0], [3.5, -30.0, 700.0], [1e-4, -2e-4, 1.0]])
    moved = known @ homography[:, :2].T + homography[:, 2]
    return moved[:, :2] / moved[:, 2:] + rng.normal(0, 0.1, known.shape), known


def test_affine_against_numpy(marks: tuple[np.ndarray, np.ndarray]) -> None:
    readings, known = marks
    design = np.column_stack([readings, np.ones(8)])
    coefficients, squares, _, _ = np.linalg.lstsq(design, known, rcond=None)
    found = interior_orientation(readings, known, "affine")
    assert found.applied(readings) == pytest.approx(design @ coefficients, abs=1e-9)
    assert found.residuals == pytest.approx(design @ coefficients - known, abs=1e-9)
    assert found.redundancy == 10
    assert found.sigma0 == pytest.approx(np.sqrt(squares.sum() / 10))


def test_conformal_against_scipy(marks: tuple[np.ndarray, np.ndarray]) -> None:
    """Rows count downwards: the reflection is found, then four parameters."""
    readings, known = marks
    z, target = readings[:, 0] - 1j * readings[:, 1], known[:, 0] + 1j * known[:, 1]
    design = np.column_stack([z, np.ones(8)])
    expected = design @ np.linalg.lstsq(design, target, rcond=None)[0]
    found = interior_orientation(readings, known, "conformal")
    assert np.linalg.det(found.matrix[:2, :2]) < 0
    assert found.applied(readings) == pytest.approx(np.column_stack([expected.real, expected.imag]), abs=1e-9)
    assert found.sigma0 == pytest.approx(np.sqrt(np.sum(np.abs(expected - target) ** 2) / 12))


def test_projective_against_scipy_and_opencv(marks: tuple[np.ndarray, np.ndarray]) -> None:
    readings, known = marks

    def miss(h: np.ndarray) -> np.ndarray:
        m = np.append(h, 1.0).reshape(3, 3)
        moved = readings @ m[:, :2].T + m[:, 2]
        return np.asarray((moved[:, :2] / moved[:, 2:] - known).ravel())

    start, _ = cv2.findHomography(readings, known)
    fit = least_squares(miss, start.ravel()[:8], x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = interior_orientation(readings, known, "projective")
    assert found.residuals == pytest.approx(fit.fun.reshape(-1, 2), abs=1e-6)
    assert found.redundancy == 8
    assert found.sigma0 == pytest.approx(np.sqrt(np.sum(fit.fun**2) / 8), rel=1e-6)


@given(
    st.floats(-np.pi, np.pi),
    st.floats(1e-3, 1e3),
    st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    st.booleans(),
)
def test_a_similarity_is_found_by_all(
    angle: float, scale: float, shift: tuple[float, float], mirrored: bool
) -> None:
    """Exact readings of any unit, origin, rotation and handedness: every kind gives the frame back."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    readings = scale * CORNERS @ turn * [1.0, -1.0 if mirrored else 1.0] + shift
    for kind in KINDS:
        found = interior_orientation(readings, CORNERS, kind)
        assert (np.linalg.det(found.matrix[:2, :2]) < 0) == mirrored
        limit = 1e-9 * (1 + max(map(abs, shift)) / scale)
        assert np.abs(found.applied(readings) - CORNERS).max() < limit
        assert np.abs(found.residuals).max() < limit


def test_without_redundancy() -> None:
    found = interior_orientation(CORNERS[:3] * 100, CORNERS[:3], "affine")
    assert found.redundancy == 0
    assert np.isnan(found.sigma0)


@pytest.mark.parametrize(("kind", "marks_read"), [("conformal", 1), ("affine", 2), ("projective", 3)])
def test_too_few_marks(kind: Transformation, marks_read: int) -> None:
    with pytest.raises(IllPosedError, match=f"marks A.*{marks_read} mark.* do not determine a {kind}"):
        interior_orientation(CORNERS[:marks_read], CORNERS[:marks_read], kind, names="ABC"[:marks_read])


@pytest.mark.parametrize("kind", ["affine", "projective"])
def test_marks_in_a_line(kind: Transformation) -> None:
    line = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [5.0, 5.0]])
    with pytest.raises(IllPosedError, match="lie in a line"):
        interior_orientation(line, CORNERS, kind)
    with pytest.raises(IllPosedError, match="coincide"):
        interior_orientation(np.ones((4, 2)), CORNERS, kind)


def test_three_in_a_line_do_not_make_a_projectivity() -> None:
    marks = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 3.0]])
    with pytest.raises(IllPosedError, match="three of the four"):
        interior_orientation(marks, marks, "projective")
