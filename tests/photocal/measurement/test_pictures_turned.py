"""Pictures that were turned by half a turn afterwards, told by the directions recorded with them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats
from photocal.geometry.rotation import angles_from_matrix
from photocal.measurement.tie_orientation import pictures_turned

COUNT = 18
NAMES = tuple(f"{k}.jpg" for k in range(COUNT))


def flown(seed: int, pitch_deg: float) -> Floats:
    """Roll, pitch and yaw over strips to and fro, the vehicle turning with them."""
    yaw = np.where(np.arange(COUNT) // 6 % 2 == 0, 45.0, -135.0)
    angles = np.column_stack([np.zeros(COUNT), np.full(COUNT, pitch_deg), yaw])
    return np.radians(angles + np.random.default_rng(seed).normal(0, 3, angles.shape))


def stored(gimbal: Floats, turned: tuple[int, ...], mount_deg: float = 0.0) -> Floats:
    """Exterior orientations of the pictures as they are stored, the camera turned in its mount."""
    body = Rotation.from_euler("ZYX", gimbal[:, ::-1]).as_matrix()
    # At zero the camera looks north. Its axes, right, up and back, in forward, right, down.
    axes = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    east_north_up = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    rotation = axes @ np.swapaxes(body, 1, 2) @ east_north_up
    rotation = Rotation.from_euler("z", mount_deg, degrees=True).as_matrix() @ rotation
    rotation[list(turned)] = np.diag([-1.0, -1.0, 1.0]) @ rotation[list(turned)]
    return np.hstack([angles_from_matrix(rotation), np.zeros((COUNT, 3))])


@pytest.mark.parametrize("mount_deg", [0.0, 90.0])
@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0])
@pytest.mark.parametrize("turned", [(), (6, 7, 8, 9, 10, 11), (3,)])
def test_what_was_turned_is_named_and_nothing_else(
    turned: tuple[int, ...], pitch_deg: float, mount_deg: float
) -> None:
    for seed in range(10):
        gimbal = flown(seed, pitch_deg)
        found = pictures_turned(NAMES, stored(gimbal, turned, mount_deg), gimbal)
        assert [one.figures["images"] for one in found] == [tuple(NAMES[k] for k in turned)] * bool(turned)


def test_a_record_that_is_none_of_the_pictures_says_nothing() -> None:
    rng = np.random.default_rng(1)
    for seed in range(50):
        gimbal = flown(seed, -90.0)
        poses = stored(gimbal, (3,))
        gimbal[:, 2] = rng.uniform(-np.pi, np.pi, COUNT)
        assert pictures_turned(NAMES, poses, gimbal) == []
        assert pictures_turned(NAMES, poses, np.full_like(gimbal, np.nan)) == []


def test_beyond_the_nadir_a_roll_of_half_a_turn_is_the_same_direction() -> None:
    gimbal = flown(4, -88.0)
    poses = stored(gimbal, ())
    other = np.column_stack([gimbal[:, 0] + np.pi, -np.pi - gimbal[:, 1], gimbal[:, 2] + np.pi])
    assert np.allclose(stored(other, ())[:, :3], poses[:, :3], atol=1e-9), "the same turn, written otherwise"
    gimbal[:5] = other[:5]
    assert pictures_turned(NAMES, poses, gimbal) == []
