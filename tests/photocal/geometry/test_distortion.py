"""Distortion of sets of points: inverses of each other, agreement with the ray, the radial curve."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.geometry.camera import AFFINITIES, AFFINITY_MATRICES, Affinity, AffinityForm, Model, camera
from photocal.geometry.distortion import distorted, projected, radial_profile, undistorted
from tests.photocal import networks, oracle

BROWN: tuple[Model, ...] = ("brown-observed", "brown-ideal")
KINDS = [(m, a, f) for m in BROWN for a in AFFINITIES for f in AFFINITY_MATRICES]


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_there_and_back(kind: tuple[Model, Affinity, AffinityForm]) -> None:
    own = networks.lens(model=kind[0], affinity=kind[1], affinity_form=kind[2], B1=0.01, B2=-0.02, K4=1e-12)
    grid = np.stack(np.meshgrid(np.linspace(-12, 12, 9), np.linspace(-8, 8, 7)), -1).reshape(-1, 2)
    assert undistorted(own, distorted(own, grid)) == pytest.approx(grid, abs=1e-11)
    assert distorted(own, undistorted(own, grid)) == pytest.approx(grid, abs=1e-11)


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_projected_points_have_no_residual(kind: tuple[Model, Affinity, AffinityForm]) -> None:
    own = networks.lens(model=kind[0], affinity=kind[1], affinity_form=kind[2], B1=0.01, B2=-0.02)
    q = np.random.default_rng(1).uniform([-5, -4, -12], [5, 4, -9], (50, 3))
    residual = oracle.residual(own, own.values, projected(own, q).T, q.T)
    assert np.array(residual) == pytest.approx(0, abs=1e-11)


def test_points_behind_the_camera_are_not_seen() -> None:
    seen = projected(networks.lens(), np.array([[1.0, 1.0, 10.0], [1.0, 1.0, -10.0], [0.0, 0.0, 0.0]]))
    assert np.isnan(seen).any(axis=1).tolist() == [True, False, True]


def test_where_the_polynomial_folds_there_is_no_image() -> None:
    # x - K1 x^3 with K1 = 1e-2 never exceeds 3.85: nothing is recorded further out.
    own = camera("a", "brown-observed", "mm", (9, 9), (1, 1), {"c": 20.0, "K1": 1e-2})
    seen = distorted(own, np.array([[1.0, 0.0], [5.0, 0.0]]))
    assert np.isnan(seen).any(axis=1).tolist() == [False, True]


def test_radial_curve_by_hand() -> None:
    own = networks.lens(K1=1e-3, K2=2e-5, K3=0.0, B1=0.3)
    assert radial_profile(own, np.array([0.0, 1.0, 10.0])) == pytest.approx([0, 1e-3 + 2e-5, 1 + 2.0])
    fisheye = camera("a", "equidistant", "px", (9, 9), (1, 1), {"c": 100.0, "x0": 3.0, "K1": -0.02})
    assert radial_profile(fisheye, np.array([0.0, 200.0])) == pytest.approx([0, 100 * -0.02 * 2.0**3])
