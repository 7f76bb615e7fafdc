"""The distortion curve against published figures and against drawn samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.geometry.camera import camera
from photocal.report.sensor import farthest_corner, radial_profile
from photocal.report.stored_analysis import AnalysedRun
from tests.photocal import oracle


@pytest.mark.shared
def test_published_displacements(published_run: AnalysedRun) -> None:
    """The study gives -0.24 mm at 10 mm and -0.090 mm at 7 mm."""
    profile = radial_profile(published_run.result.cameras["dcs460"], np.array([7.0, 10.0]))
    assert profile[:, 1] == pytest.approx([-0.090, -0.24], abs=5e-4)


@pytest.mark.shared
def test_sigma_of_the_curve_is_the_scatter_of_samples(published_run: AnalysedRun) -> None:
    camera = published_run.result.cameras["dcs460"]
    names = ["K1", "K2", "K3"]
    rng = np.random.default_rng(5)
    mean = [camera.value(name) for name in names]
    factors = np.array([camera.sigma_of(name) for name in names])
    scaled = camera.covariance_of(names) / np.outer(factors, factors)
    samples = mean + rng.multivariate_normal(np.zeros(3), scaled, 40000, method="eigh") * factors
    radius = np.array([5.0, 10.0, 15.0])
    curves = samples @ np.array([radius**3, radius**5, radius**7])
    assert radial_profile(camera, radius)[:, 2] == pytest.approx(curves.std(axis=0), rel=0.02)


@pytest.mark.shared
def test_farthest_corner(published_run: AnalysedRun) -> None:
    """Half of 27.6 mm by 18.4 mm, and the principal point 0.2201 mm left of the middle, 0.1772 above."""
    corner = farthest_corner(published_run.result.cameras["dcs460"])
    assert corner == pytest.approx(np.hypot(13.8 + 0.2201, 9.2 + 0.1772), abs=1e-4)


def test_balanced_curve_crosses_zero_at_its_radius(invented_run: AnalysedRun) -> None:
    camera = replace(invented_run.result.cameras["l1"], reference_radius=1500.0)
    _, displacement, sigma, _ = radial_profile(camera, np.array([0.0, 1500.0, 2000.0])).T
    assert displacement[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert displacement[2] > 0.0
    assert sigma[1] == 0.0


def test_curve_is_that_of_the_camera_equations() -> None:
    """Points in all directions displaced by the camera model: their radial mean, and the largest rest."""
    given = {"c": 3412.5, "K1": 1e-9, "K2": -2e-16, "K4": 1e-30, "P1": 3e-7, "P2": -2e-7, "P3": 1e-8}
    own = camera("a", "brown-ideal", "px", (4000, 3000), (1.0, 1.0), given, reference_radius=900.0)
    for radius in (500.0, 1500.0, 2400.0):
        turn = np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)
        along = np.column_stack([np.cos(turn), np.sin(turn)])
        d = np.column_stack(oracle.polynomial(own.values, 900.0, *(radius * along).T))
        ((_, displacement, _, largest),) = radial_profile(own, np.array([radius]))
        assert displacement == pytest.approx(np.mean(np.sum(d * along, axis=1)), rel=1e-9)
        decentring = d - displacement * along
        assert largest == pytest.approx(np.hypot(*decentring.T).max(), rel=1e-5)
