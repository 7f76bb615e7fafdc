"""Attitudes at instants."""

from __future__ import annotations

import numpy as np

from photocal.navigation.attitude import AttitudeTrack, at_instants, from_angles
from photocal.navigation.time import GpsTime


def test_stated_sigmas_leave_the_rotations_alone() -> None:
    angles = np.radians([[1.0, -2.0, 40.0], [3.0, -4.0, 44.0], [5.0, -2.0, 48.0]])
    stamps = np.array([0, 1_000_000_000, 2_000_000_000], np.int64) + 1_434_031_277_000_000_000
    track = AttitudeTrack(GpsTime(stamps), from_angles(angles, None).rotation)
    at = GpsTime(stamps[:2])
    stated = at_instants(track, at, np.radians([0.3, 0.3, 0.6]))
    np.testing.assert_allclose(stated.angles, angles[:2], atol=1e-12)
    np.testing.assert_allclose(stated.rotation, at_instants(track, at, None).rotation)
    assert (np.linalg.eigvalsh(stated.covariance) > 0).all()
