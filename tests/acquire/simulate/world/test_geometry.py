"""The forward models against OpenCV, pyproj, differences and closed forms."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from acquire.simulate.world import configuration
from acquire.simulate.world.exposures import TO_OPENCV, Pose, antenna_at, antenna_velocity, omega_phi_kappa
from acquire.simulate.world.motion import GRAVITY_M_S2, body_of
from acquire.simulate.world.observations import row_time, seen, seen_rolling
from acquire.simulate.world.place import Place
from acquire.simulate.world.site import grid_to_local
from acquire.simulate.world.terrain import make_terrain
from acquire.simulate.world.world import World


def test_projection_is_that_of_opencv(world: World) -> None:
    camera, pose = world.camera, world.exposures.pose
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-25, 25, (400, 2)), rng.uniform(-4, 4, 400)])
    number = len(world.exposures) // 2
    points[:, :2] += pose.centre_m[number, :2]
    place = seen(points, Pose(pose.centre_m[number], pose.rotation[number]), camera)
    turn = TO_OPENCV @ pose.rotation[number]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
    expected = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], -turn @ pose.centre_m[number], matrix, lens)[
        0
    ]
    inside = camera.sees(place)
    assert inside.sum() > 100
    assert np.abs(place - expected.reshape(-1, 2))[inside].max() < 1e-8


def test_directions_undo_the_projection(world: World) -> None:
    camera = world.camera
    rows, columns = np.meshgrid(np.linspace(0, camera.height, 30), np.linspace(0, camera.width, 40))
    pixels = np.stack([columns, rows], axis=-1)
    assert np.abs(camera.project(camera.directions(pixels)) - pixels).max() < 1e-9


def test_a_zoom_leaves_the_distortion_in_the_image_plane(world: World) -> None:
    before, after = (c.certificate_terms("mm") for c in (world.camera, world.camera.zoomed(1.004)))
    assert after["c"] == pytest.approx(1.004 * before["c"])
    # Radial terms are added to the projection: in the image plane they grow with the scale alone.
    for name, power in (("K1", 2), ("K2", 4), ("K3", 6)):
        radius = 5.0
        assert after[name] * radius**power == pytest.approx(before[name] * radius**power)
    for name in ("x0", "y0", "P1", "P2", "B1"):
        assert after[name] == pytest.approx(before[name])


def test_angles_make_the_rotation(world: World) -> None:
    omega, phi, kappa = omega_phi_kappa(world.exposures.pose.rotation).T
    for number, matrix in enumerate(world.exposures.pose.rotation):
        r1 = cv2.Rodrigues(np.array([-omega[number], 0.0, 0.0]))[0]
        r2 = cv2.Rodrigues(np.array([0.0, -phi[number], 0.0]))[0]
        r3 = cv2.Rodrigues(np.array([0.0, 0.0, -kappa[number]]))[0]
        assert np.abs(r3 @ r2 @ r1 - matrix).max() < 1e-12


def test_rays_meet_the_ground(world: World) -> None:
    rng = np.random.default_rng(2)
    pose, camera = world.exposures.pose, world.camera
    pixels = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (500, 2))
    rays = camera.directions(pixels) @ TO_OPENCV @ pose.rotation[5]
    ground = world.terrain.intersect(np.broadcast_to(pose.centre_m[5], rays.shape), rays)
    assert np.abs(ground[:, 2] - world.terrain.height(ground[:, 0], ground[:, 1])).max() < 1e-6
    back = seen(ground, Pose(pose.centre_m[5], pose.rotation[5]), camera)
    assert np.abs(back - pixels).max() < 1e-6


def test_rays_meet_what_stands_before_the_rest() -> None:
    """Steep hills, oblique rays: no place of a ray above where it ends lies under the ground."""
    rough = make_terrain(
        configuration.TerrainKeys(relief_m=12.0, longest_m=60.0), 150.0, np.random.default_rng(4)
    )
    rng = np.random.default_rng(5)
    start = np.column_stack([rng.uniform(-40, 40, (400, 2)), np.full(400, 60.0)])
    rays = np.column_stack([rng.uniform(-1, 1, (400, 2)), np.full(400, -1.0)])
    ground = rough.intersect(start, rays)
    assert np.abs(ground[:, 2] - rough.height(ground[:, 0], ground[:, 1])).max() < 1e-6
    ends = (start[:, 2] - ground[:, 2]) / -rays[:, 2]
    along = np.linspace(0, 0.995, 2000)[:, None, None] * ends[:, None]
    places = start + along * rays
    clear = places[..., 2] - rough.height(places[..., 0], places[..., 1])
    # A crest thinner than a metre may be passed through.
    assert np.mean((clear < -0.05).any(axis=0)) < 0.01


def test_relief_is_as_asked_and_flat_ground_is_flat() -> None:
    rough = make_terrain(configuration.TerrainKeys(relief_m=5.0), 100.0, np.random.default_rng(3))
    heights = rough.height(*np.meshgrid(np.arange(-100, 101, 2.0), np.arange(-100, 101, 2.0)))
    assert heights.std() == pytest.approx(5.0, rel=0.3)
    flat = make_terrain(configuration.TerrainKeys(relief_m=0.0), 100.0, np.random.default_rng(3))
    assert np.abs(flat.coefficients).max() == 0


def test_the_frame_is_that_of_pyproj(world: World) -> None:
    place = world.place
    points = np.array([[0.0, 0.0, 0.0], [120.0, -80.0, 55.0], [-300.0, 900.0, -20.0]])
    pipeline = (
        f"+proj=topocentric +ellps=GRS80 +lat_0={place.latitude_deg} "
        f"+lon_0={place.longitude_deg} +h_0={place.height_m}"
    )
    to_local = Transformer.from_pipeline(pipeline)
    local = np.column_stack(to_local.transform(*place.to_geocentric(points).T))
    assert np.abs(local - points).max() < 1e-6
    there = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    longitude, latitude, height = np.array(there.transform(*place.to_geocentric(points).T))
    ours = place.to_geodetic(points)
    assert np.abs(np.degrees(ours[:, :2]) - np.column_stack([latitude, longitude])).max() < 1e-9
    # WGS 84 and GRS 80 differ by 0.1 mm at the poles.
    assert np.abs(ours[:, 2] - height).max() < 2e-4
    across = Transformer.from_crs(CRS("EPSG:4674"), CRS("EPSG:31982"), always_xy=True)
    east, north = across.transform(longitude, latitude)
    assert np.abs(place.to_projected(points)[:, :2] - np.column_stack([east, north])).max() < 1e-3


def test_grid_axes_against_differences_of_the_projection() -> None:
    place = Place(
        latitude_deg=-25.4,
        longitude_deg=-49.2,
        height_m=900.0,
        crs="EPSG:31982",
        start_utc=dt.datetime(2025, 6, 15, tzinfo=dt.UTC),
    )
    points = np.array([[0.0, 0.0, 0.0], [400.0, 300.0, 50.0]])
    axes = grid_to_local(place, points)
    for k, column in enumerate(np.moveaxis(axes, 2, 0)):
        moved = place.to_projected(points + 5.0 * column) - place.to_projected(points)
        expected = np.zeros(3)
        expected[k] = 5.0
        # The scale of the projection is not one.
        assert np.abs(moved - expected).max() < 4e-3, k
        assert np.abs(np.delete(moved, k, axis=1)).max() < 2e-5, k


def test_velocity_and_acceleration_are_derivatives(world: World) -> None:
    time = np.linspace(5.0, world.motion.duration_s - 5, 900)
    step = 1e-4
    for value, slope in (
        (world.motion.position, partial(world.motion.position, derivative=1)),
        (partial(world.motion.position, derivative=1), partial(world.motion.position, derivative=2)),
    ):
        numeric = (value(time + step) - value(time - step)) / (2 * step)
        assert np.abs(numeric - slope(time)).max() < 1e-5
    # Curvature is continuous: the acceleration has no jump between two milliseconds.
    fine = np.arange(60.0, 120.0, 1e-3)
    assert np.abs(np.diff(world.motion.position(fine, 2), axis=0)).max() < 0.05


def test_the_vehicle_stands_still_on_the_ground_and_leans_in_the_air(world: World) -> None:
    ground = np.linspace(0, 30, 50)
    assert np.ptp(world.motion.position(ground), axis=0).max() < 1e-9
    assert np.ptp(world.motion.angles(ground), axis=0).max() < 1e-9
    air = np.linspace(60, world.motion.duration_s - 60, 2000)
    lean = np.degrees(np.abs(world.motion.angles(air)[:, :2]).max())
    assert 5 < lean < 40
    assert np.linalg.norm(world.motion.position(air, 2), axis=1).max() < GRAVITY_M_S2


def test_body_axes_follow_the_aerospace_sequence() -> None:
    # Heading east, nose up by 10 degrees: forward is east and up; right is south.
    body = body_of(np.radians([[0.0, 10.0, 90.0]]))[0]
    assert body[0] == pytest.approx([np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))])
    assert body[1] == pytest.approx([0.0, -1.0, 0.0])
    # Roll to the right lowers the right side.
    assert body_of(np.radians([[20.0, 0.0, 0.0]]))[0, 1, 2] < 0


def test_the_antenna_sits_where_the_lever_arm_says(world: World) -> None:
    time = world.exposures.middle_s
    pose = world.exposures.pose
    to_body = world.rig.body_to_camera.T @ pose.rotation
    arm = np.squeeze(to_body @ (antenna_at(world.motion, world.rig, time) - pose.centre_m)[..., None], -1)
    assert np.abs(arm - world.rig.camera_to_antenna_m).max() < 1e-9
    step = 1e-5
    numeric = (
        antenna_at(world.motion, world.rig, time + step) - antenna_at(world.motion, world.rig, time - step)
    ) / (2 * step)
    assert np.abs(numeric - antenna_velocity(world.motion, world.rig, time)).max() < 2e-3


def test_a_rolling_shutter_sees_each_row_at_its_own_time(world: World) -> None:
    number, readout = 4, 0.03
    points = world.targets.centre_m
    place = seen_rolling(points, world.exposures, number, world.motion, world.rig, readout)
    inside = np.flatnonzero(world.camera.sees(place))
    assert len(inside) > 2
    for row in inside.tolist():
        moment = row_time(world.exposures, number, place[row : row + 1, 1], readout)
        still = replace(
            world.exposures,
            pose=_pose_at(world, moment),
        )
        alone = seen_rolling(points[row : row + 1], still, 0, world.motion, world.rig, 0.0)
        assert np.abs(alone - place[row]).max() < 1e-4
    rigid = seen_rolling(points, world.exposures, number, world.motion, world.rig, 0.0)
    assert 0.05 < np.abs(rigid - place)[inside].max() < 30


def _pose_at(world: World, moment: NDArray[np.float64]) -> Pose:
    from acquire.simulate.world.exposures import pose_at

    return pose_at(world.motion, world.rig, moment)
