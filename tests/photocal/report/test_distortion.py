"""The distortion curve against published figures and against drawn samples."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.report.distortion import covariance, farthest_corner, radial_profile
from photocal.report.run import Run


@pytest.mark.shared
def test_published_displacements(published_run: Run) -> None:
    """The study gives -0.24 mm at 10 mm and -0.090 mm at 7 mm."""
    profile = radial_profile(published_run.result.cameras["dcs460"], np.array([7.0, 10.0]))
    assert profile.displacement == pytest.approx([-0.090, -0.24], abs=5e-4)


@pytest.mark.shared
def test_sigma_of_the_curve_is_the_scatter_of_samples(published_run: Run) -> None:
    camera = published_run.result.cameras["dcs460"]
    names = ["K1", "K2", "K3"]
    rng = np.random.default_rng(5)
    mean = [camera.value(name) for name in names]
    factors = np.array([camera.parameters[name].sigma for name in names])
    scaled = covariance(camera, names) / np.outer(factors, factors)
    samples = mean + rng.multivariate_normal(np.zeros(3), scaled, 40000, method="eigh") * factors
    radius = np.array([5.0, 10.0, 15.0])
    curves = samples @ np.array([radius**3, radius**5, radius**7])
    assert radial_profile(camera, radius).sigma == pytest.approx(curves.std(axis=0), rel=0.02)


@pytest.mark.shared
def test_farthest_corner(published_run: Run) -> None:
    """Half of 27.6 mm by 18.4 mm, and the principal point 0.2201 mm left of the middle, 0.1772 above."""
    corner = farthest_corner(published_run.result.cameras["dcs460"])
    assert corner == pytest.approx(np.hypot(13.8 + 0.2201, 9.2 + 0.1772), abs=1e-4)


def test_balanced_curve_crosses_zero_at_its_radius(invented_run: Run) -> None:
    from dataclasses import replace

    camera = replace(invented_run.result.cameras["l1"], reference_radius=1500.0)
    profile = radial_profile(camera, np.array([0.0, 1500.0, 2000.0]))
    assert profile.displacement[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert profile.displacement[2] > 0.0
    assert profile.sigma[1] == 0.0
