"""What of an adopted block is left out before it is adjusted, and how it is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.block.model import Block
from photocal.block.rig import Head
from photocal.exchange.foreign_project import ForeignProject
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles
from photocal.run.adopt_rays import LEAST_PARALLAX_PX, without_gross_rays, without_weak_parts
from tests.photocal.exchange.conftest import reconstruction_of, to_adjust, vision_camera, with_roles

APART_M = 0.05


def beside(block: Block, apart_m: float, points: int) -> Block:
    """Add an image beside the first, and points that only these two see."""
    camera, first = block.cameras[0], block.images.values[0]
    second = first + np.array([0, 0, 0, apart_m, 0, 0])
    ground = np.column_stack([np.linspace(-5, 5, points), np.linspace(4, -6, points), np.full(points, 3.0)])
    ground[:, :2] += first[3:5]
    at = len(block.points.names)
    seen = block.observations
    for image, pose in ((0, first), (len(block.images.names), second)):
        inside = (ground - pose[3:]) @ matrix_from_angles(pose[:3]).T
        pixels = plane_to_pixel(camera.size_px, camera.pitch, projected(camera, inside))
        seen = seen.plus(np.full(points, image), at + np.arange(points), pixels, np.ones_like(pixels))
    images = block.images
    images = replace(
        images,
        names=(*images.names, "beside.jpg"),
        camera=np.append(images.camera, 0),
        values=np.vstack([images.values, second]),
        sigma=np.vstack([images.sigma, images.sigma[:1]]),
        exposure=(),
    )
    names = tuple(f"near {k}" for k in range(points))
    return replace(block, images=images, points=block.points.with_ties(names, ground), observations=seen)


def own() -> Block:
    made = reconstruction_of((vision_camera(),))
    return to_adjust(with_roles(made, "tie"), "own", 0.4)


@pytest.mark.parametrize(("apart_m", "left"), [(APART_M, 0), (100 * APART_M, 7)])
def test_points_without_parallax_are_left_out(apart_m: float, left: int) -> None:
    """Five centimetres at a height of 100 m are 2 px, five metres 180."""
    block = beside(own(), apart_m, 7)
    count = np.bincount(block.observations.image)[-1]
    assert count == 7
    given = without_weak_parts(ForeignProject("Own", block))
    near = [name for name in given.block.points.names if name.startswith("near")]
    assert len(near) == left
    told = f"7 points have a parallax below {LEAST_PARALLAX_PX:g} px: left out"
    assert (told in given.remarks) == (left == 0)


def test_a_head_without_rays_is_named_and_leaves_its_frame() -> None:
    made = reconstruction_of((vision_camera(), replace(vision_camera(), id="blind")))
    block = to_adjust(with_roles(made, "tie"), "own", 0.4)
    none = np.zeros(7)
    heads = tuple(Head(camera.id, block.cameras[0].id, np.zeros(3), none, none) for camera in block.cameras)
    seen = block.observations
    blind = block.images.camera[seen.image] == 1
    # Three rays in each of its images.
    first = np.array([blind[k] and np.sum(seen.image[:k] == seen.image[k]) >= 3 for k in range(len(blind))])
    block = replace(block, heads=heads, observations=seen.rows(~first))
    given = without_weak_parts(ForeignProject("Own", block))
    assert [camera.id for camera in given.block.cameras] == [block.cameras[0].id]
    assert not given.block.heads
    assert "no image of camera blind has 4 rays: the camera is left out" in given.remarks
    assert any("3 images have fewer than 4 rays: left out" in remark for remark in given.remarks)


def test_positions_of_images_that_stay_are_kept() -> None:
    """An image goes, and so does one that its points held: the positions of the others stay theirs."""
    block = own()
    seen = block.observations
    place = np.arange(3.0 * len(block.images.names)).reshape(-1, 3)
    few = np.flatnonzero(seen.image == 2)[3:]
    keep = np.ones(len(seen.image), dtype=np.bool_)
    keep[few] = False
    given = ForeignProject("Own", replace(block, observations=seen.rows(keep)), place, place + 1)
    left = without_weak_parts(given)
    assert block.images.names[2] not in left.block.images.names
    order = [block.images.names.index(name) for name in left.block.images.names]
    np.testing.assert_array_equal(left.position, place[order])
    np.testing.assert_array_equal(left.position_sigma, place[order] + 1)


def test_a_project_without_marks_of_control_is_judged_by_its_ties_alone(tmp_path: Path) -> None:
    """A warning of numpy about them stood on the screen."""
    given = without_gross_rays(ForeignProject("Own", own()), tmp_path)
    assert given.block.points.names == own().points.names
