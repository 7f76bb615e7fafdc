"""From a block to the network that is adjusted: units, axes, origin, start values, and what is missing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.lasers import LaserDistances
from photocal.adjustment.mounting import Positions
from photocal.adjustment.network import (
    ExteriorOrientations,
    Network,
    Points,
    Rays,
    Relations,
    covariance_matrices,
    point_weights,
)
from photocal.adjustment.readout import Readout
from photocal.adjustment.rig import LATER
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.block.model import Block
from photocal.block.motion import motion_of
from photocal.block.rig import rig_of
from photocal.geometry.camera import Camera, among, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import slopes_of
from photocal.geometry.frames import LocalFrame, ReferenceFrame, ShiftedFrame, reference_frame, require_geoid
from photocal.geometry.oriented_images import OrientedImages, local_poses
from photocal.geometry.refraction import apparent_rise
from photocal.geometry.resection import intersect, ray_residuals
from photocal.geometry.rotation import matrix_from_angles


def straightened(network: Network, refraction: float, *, curved: bool) -> Network:
    """Give the image observations as straight rays over a plane earth would have made them.

    The start orientation is near enough: what it is wrong by changes these small corrections in proportion.
    """
    rays, exposures = network.rays, network.exposures
    images = OrientedImages(network.image_names, network.cameras, exposures.camera, exposures.started)
    points = network.points.values[rays.point]
    risen = points.copy()
    risen[:, 2] += apparent_rise(points - images.station[rays.image], refraction, curved=curved)
    shift = images.project(rays.image, risen) - images.project(rays.image, points)
    pitch = np.array([camera.pitch for camera in network.cameras])[exposures.camera[rays.image]]
    plane = rays.plane - np.nan_to_num(shift * pitch * [1.0, -1.0])
    return replace(network, rays=replace(rays, plane=plane))


# Start coordinates are impossible where a ray misses them by this many principal distances, and by this many
# times what rays usually miss: attitudes of a flight may be degrees off, those of all images alike.
_ASTRAY, _UNLIKE = 0.25, 8.0
# Heights of positions with at least the first sigma may refer to another surface, m; heights with at most the
# second were measured by GNSS, from the ellipsoid.
OTHER_SURFACE_M, ELLIPSOIDAL_M = 50.0, 1.0


def with_start_values(
    block: Block,
    exposures: ExteriorOrientations,
    rays: Rays,
    points: Floats,
    known: Floats,
    relations: Relations,
    surveyed: Flags,
) -> tuple[ExteriorOrientations, Floats]:
    """Fill what is missing among the start values."""
    values = exposures.values
    if np.isnan(values).any():
        # The search needs computer vision: blocks that are complete do not wait for it.
        from photocal.adjustment.start.values import start_values

        # Coordinates of check and tie points may be wrong without anybody having noticed, and so may those
        # of control points that have no sigma: these serve only where nothing else does.
        directions = np.trace(known, axis1=1, axis2=2)
        for surveyed in (directions > 2.5, directions > 0.5):
            trusted = points if block.datum == "free" else np.where(surveyed[:, None], points, np.nan)
            oriented, placed, lost = start_values(
                block.cameras, exposures.camera, values, trusted, rays, relations, free=block.datum == "free"
            )
            if not len(lost):
                break
        if len(lost):
            some = ", ".join(block.images.names[i] for i in lost[:5])
            raise IllPosedError(
                f"no start values for {len(lost)} image(s) ({some}): too few points connect them",
                "give X, Y, Z, omega, phi, kappa roughly, or measure more common points",
                where="images.csv",
            )
        exposures = replace(exposures, values=oriented)
        points = np.where(np.isnan(points), placed, points)
        # The directions in which a control point is free start where its rays meet.
        partly = (directions > 0.5) & (directions < 2.5) & np.isfinite(placed).all(axis=1)
        open_ones = np.eye(3) - known[partly]
        away = (placed - points)[partly]
        points[partly] += np.einsum("nab,nb->na", open_ones, away)
    exposures = _above_control(block.cameras, exposures, rays, points, known)
    return exposures, _intersected(block.cameras, exposures, rays, points, known, surveyed)


def _above_control(
    cameras: tuple[Camera, ...], exposures: ExteriorOrientations, rays: Rays, points: Floats, known: Floats
) -> ExteriorOrientations:
    """Start elsewhere where cameras that are not held see most of the control behind them.

    Heights of positions and of control then refer to different surfaces: all start values are shifted alike,
    to where the rays of control meet it. Observed values stay.
    """
    moves = (exposures.sigma[:, 3:] != 0.0).all(axis=1)
    seen = rays.rows((np.trace(known, axis1=1, axis2=2) > 2.5)[rays.point])
    if not moves.all() or 2 * _from_behind(exposures, seen, points).sum() <= len(seen.image):
        return exposures
    rotation = matrix_from_angles(exposures.values[:, :3])[seen.image]
    centre = exposures.values[seen.image, 3:]
    slopes = slopes_of(cameras, exposures.camera[seen.image], seen.plane)
    meeting = intersect(seen.point, len(points), centre, rotation, slopes, np.ones(len(slopes)))
    met = np.isfinite(meeting).all(axis=1)
    if not met.any():
        return exposures
    start = exposures.values.copy()
    start[:, 3:] += np.median((points - meeting)[met], axis=0)
    shifted = replace(exposures, start=start)
    return exposures if _from_behind(shifted, seen, points).any() else shifted


def _intersected(
    cameras: tuple[Camera, ...],
    exposures: ExteriorOrientations,
    rays: Rays,
    points: Floats,
    known: Floats,
    surveyed: Flags,
) -> Floats:
    """Fill the coordinates of points that have none, or impossible ones, by intersecting their rays.

    Tie points that a camera sees behind itself are such: other programs leave them there.
    """
    missing = np.asarray(np.isnan(points).any(axis=1))
    behind = behind_cameras(exposures, rays, points) & ~surveyed & ~missing
    some = (missing | surveyed | behind)[rays.point]
    if not some.any():
        return points
    rays = rays.rows(some)
    camera = exposures.camera[rays.image]
    slopes = slopes_of(cameras, camera, rays.plane)
    rotation = matrix_from_angles(exposures.started[:, :3])[rays.image]
    centre = exposures.started[rays.image, 3:]
    start = intersect(rays.point, len(points), centre, rotation, slopes, np.ones(len(slopes)))
    miss = ray_residuals(rotation, centre, points[rays.point], slopes)
    # Nobody has used the coordinates of a check point before: a typing error there is unnoticed.
    of_surveyed = miss[(surveyed & ~missing)[rays.point]]
    usual = float(np.median(of_surveyed)) if len(of_surveyed) else 0.0
    least = np.full(len(points), np.inf)
    np.fmin.at(least, rays.point, miss)
    unused = surveyed & ~missing & ~known.any(axis=(1, 2))
    impossible = behind | (unused & (least > max(_ASTRAY, _UNLIKE * usual)))
    points = np.where((impossible & np.isfinite(start).all(axis=1))[:, None], start, points)
    lost = np.flatnonzero(missing & np.isnan(start).any(axis=1))
    if len(lost):
        raise IllPosedError(
            f"the rays of {len(lost)} point(s) without coordinates are parallel",
            "give these points start coordinates, or rays from different places",
            where="points.csv",
        )
    return np.where(missing[:, None], start, points)


def behind_cameras(exposures: ExteriorOrientations, rays: Rays, points: Floats) -> Flags:
    """Points that lie behind a camera that sees them, (points,)."""
    behind = _from_behind(exposures, rays, points)
    return np.bincount(rays.point[behind], minlength=len(points)) > 0


def _from_behind(exposures: ExteriorOrientations, rays: Rays, points: Floats) -> Flags:
    """Rays that come from a point behind the camera, (rays,)."""
    axis = matrix_from_angles(exposures.started[:, :3])[rays.image, 2]
    away = points[rays.point] - exposures.started[rays.image, 3:]
    return np.asarray(np.einsum("ni,ni->n", axis, away) >= 0.0)


@dataclass(frozen=True)
class NetworkOfBlock:
    """A network and how its arrays correspond to those of its block.

    points (m,): the block's points that are in the network: those with rays.
    rays (n,): the block's observation of each ray.
    frame: from the block's coordinates to those of the network.
    readouts: of shutters that roll, or were tested.
    """

    network: Network
    points: Integers
    rays: Integers
    frame: ReferenceFrame | ShiftedFrame
    readouts: tuple[Readout, ...] = ()


def assemble(block: Block) -> NetworkOfBlock:
    """Make the network of a block.

    raises ConfigurationError: for a frame or a datum that cannot be adjusted in.
    raises InputMalformedError: for points with too few rays.
    raises IllPosedError: when nothing fixes the datum or an image.
    """
    rays_of_point = np.bincount(block.observations.point, minlength=len(block.points.names))
    _require_rays(block, rays_of_point)
    _require_datum(block, rays_of_point)
    if len(block.positions.image) or (block.images.sigma[:, 5] < ELLIPSOIDAL_M).any():
        require_geoid(block.frame, block.height)
    used = np.flatnonzero(rays_of_point)
    position = np.full(len(rays_of_point), -1)
    position[used] = np.arange(len(used))
    order = np.argsort(position[block.observations.point], kind="stable")
    frame = block_frame(block)
    exposures = ExteriorOrientations(
        block.images.camera,
        local_poses(frame, block.images.values),
        block.images.sigma,
        time=block.images.time,
        temperature=block.images.temperature,
    )
    plane, sigma = observed_plane(block)
    rays = Rays(
        block.observations.image[order], position[block.observations.point[order]], plane[order], sigma[order]
    )
    # A free network takes coordinates as start values only.
    control = block.points.of_role("control")[used] & (block.datum == "control")
    prior = np.where(control[:, None], block.points.sigma[used], np.inf)
    held, weight = point_weights(prior)
    if block.points.cross is not None:
        linked = control & block.points.cross[used].any(axis=1)
        matrices = covariance_matrices(prior[linked], block.points.cross[used][linked])
        weight[linked] = np.linalg.inv(matrices)
    weighted = weight.any(axis=(1, 2))
    if weighted.any():
        back = np.linalg.inv(frame.derivative(block.points.values[used][weighted]))
        weight[weighted] = np.swapaxes(back, 1, 2) @ weight[weighted] @ back
    names = tuple(block.points.names[j] for j in used)
    relations = _relations(block, position)
    directions = np.zeros(weight.shape)
    directions[control] = _known_directions(weight[control], held[control])
    exposures, values = with_start_values(
        block,
        exposures,
        rays,
        frame.to_local(block.points.values[used]),
        directions,
        relations,
        ~block.points.of_role("tie")[used],
    )
    positions, cameras = local_positions(block.positions, frame), block.cameras
    later = any(head.values[LATER] or head.sigma[LATER] for head in block.heads)
    if later or any(camera.shutter != "global" for camera in block.cameras):
        turn = np.nan_to_num(frame.derivative(block.images.values[:, 3:]))
        motion, motion_sigma, known = motion_of(block, exposures.started[:, 3:], positions, turn)
        exposures = replace(exposures, motion=motion, motion_sigma=motion_sigma)
        # Where nothing is known of the flight a readout scales nothing: it cannot be an unknown.
        flown = [known[block.images.camera == k].any() for k in range(len(cameras))]
        cameras = tuple(
            c if seen else replace(c, estimated=c.estimated & ~among("readout"), shutter="global")
            for c, seen in zip(cameras, flown, strict=True)
        )
    rig = rig_of(
        block.heads,
        [camera.id for camera in cameras],
        block.images.camera,
        block.images.exposure,
        matrix_from_angles(exposures.started[:, :3]),
        exposures.started[:, 3:],
        exposures.motion_sigma,
    )
    network = Network(
        cameras,
        exposures,
        Points(values, held, weight),
        rays,
        block.images.names,
        names,
        relations,
        _datum_points(block, position),
        positions,
        block.attitudes,
        block.mounting,
        rig,
        _lasers(block, position),
    )
    if block.refraction or block.curvature:
        network = straightened(network, block.refraction or 0.0, curved=block.curvature)
    return NetworkOfBlock(network, used, order, frame)


def block_frame(block: Block) -> ReferenceFrame | ShiftedFrame:
    """Frame of a block, with the middle of its images and points as local origin.

    raises ConfigurationError: for an unknown system or heights of a kind that does not fit it.
    """
    return frame_of(block.frame, block.height, block.images.values[:, 3:], block.points.values)


def frame_of(system: str, height: str, *places: Floats) -> ReferenceFrame | ShiftedFrame:
    """Frame of a system with the middle of places as local origin, errors as of `block_frame`."""
    every = np.vstack(places)
    if np.isnan(every).all():
        return ShiftedFrame(np.zeros(3))
    if system == "local":
        return ShiftedFrame(np.asarray(np.round(np.nanmean(every, axis=0)), dtype=np.float64))
    return reference_frame(system, height, np.asarray(np.nanmean(every, axis=0)))


def local_positions(positions: Positions, frame: LocalFrame) -> Positions:
    """Give positions, with their covariances and velocities, in the local frame."""
    if not len(positions.image):
        return positions
    turn = frame.derivative(positions.values)
    covariance = turn @ positions.covariance @ np.swapaxes(turn, 1, 2)
    velocity = np.einsum("nab,nb->na", turn, positions.velocity)
    local = frame.to_local(positions.values)
    return replace(positions, values=local, covariance=covariance, velocity=velocity)


def positions_at(block: Block, frame: LocalFrame, names: Sequence[str]) -> Positions:
    """Give the observed positions of those of these images that have one, in the local frame."""
    place = {name: k for k, name in enumerate(names)}
    image = np.array([place.get(name, -1) for name in block.images.names], dtype=np.int64)
    rows = np.flatnonzero(image[block.positions.image] >= 0)
    observed = local_positions(block.positions.rows(rows), frame)
    return replace(observed, image=image[observed.image])


def _known_directions(weight: Floats, held: Flags) -> Floats:
    """Projections onto the directions in which coordinates are held or weighted, shape (n, 3, 3)."""
    size, vectors = np.linalg.eigh(weight)
    known = size > 1e-12 * np.maximum(size[:, -1:], np.finfo(float).tiny)
    of_weights = np.einsum("nab,nb,ncb->nac", vectors, known.astype(float), vectors)
    return np.asarray(np.where((held[:, :, None] & np.eye(3, dtype=np.bool_)), 1.0, of_weights))


def observed_plane(block: Block) -> tuple[Floats, Floats]:
    """Observations and their sigmas in the image plane, in the unit of each camera.

    returns plane, sigma (n, 2): x right, y up, from the middle of the image.
    """
    observations = block.observations
    camera = block.images.camera[observations.image]
    size = np.array([c.size_px for c in block.cameras], dtype=float)[camera]
    pitch = np.array([c.pitch for c in block.cameras])[camera]
    scale = plane_per_unit(block)[camera]
    if observations.axes == "pixel":
        return pixel_to_plane(size, pitch, observations.values * scale / pitch), observations.sigma * scale
    return observations.values * scale, observations.sigma * scale


def observed_pixels(block: Block) -> Floats:
    """Columns and rows of the observations, px, shape (n, 2)."""
    seen, camera = block.observations, block.images.camera[block.observations.image]
    per_px = (np.array([c.pitch for c in block.cameras]) / plane_per_unit(block))[camera]
    if seen.axes == "pixel":
        return np.asarray(seen.values / per_px)
    size = np.array([c.size_px for c in block.cameras], dtype=float)[camera]
    return plane_to_pixel(size, per_px, seen.values)


def plane_per_unit(block: Block) -> Floats:
    """Image plane units of each camera per unit of the observations, shape (cameras, 2).

    raises ConfigurationError: for observations in mm of a camera in px.
    """
    scales = []
    for camera in block.cameras:
        if block.observations.unit == "px":
            scales.append(camera.pitch)
        elif camera.unit == "mm":
            scales.append((1.0, 1.0))
        else:
            raise ConfigurationError(
                f"observations are in mm, but camera {camera.id} is in px",
                "give the camera in mm with its pixel pitch",
                where="block.toml",
            )
    return np.array(scales)


def _relations(block: Block, position: Integers) -> Relations:
    """Observations between points, with the points' places in the network."""
    _require_seen(block, position, block.relations.points, "has a distance, an angle or the like")
    return block.relations.moved(position)


def _lasers(block: Block, position: Integers) -> LaserDistances:
    """Laser distances, with the points' places in the network."""
    _require_seen(block, position, block.lasers.points, "is a corner of a laser distance")
    return replace(block.lasers, corners=position[block.lasers.corners])


def _require_seen(block: Block, position: Integers, named: Integers, what: str) -> None:
    """Refuse observations of points that no image shows."""
    lost = named[position[named] < 0]
    if len(lost):
        name = block.points.names[lost[0]]
        raise InputMalformedError(
            f"point {name} {what} but has no ray",
            "measure it in the images or remove the observation",
            where=f"point {name}",
        )


def _datum_points(block: Block, position: Integers) -> Integers | None:
    """Points that carry a free datum, as places in the network."""
    if block.datum == "control":
        return None
    known = {name: int(position[j]) for j, name in enumerate(block.points.names)}
    for name in block.datum_points:
        if known.get(name, -1) < 0:
            raise ConfigurationError(
                f"datum point {name} is not observed", "correct the list of datum points", where="block.toml"
            )
    return np.array([known[name] for name in block.datum_points], dtype=np.int64)


def _require_rays(block: Block, rays_of_point: Integers) -> None:
    alone = np.flatnonzero((rays_of_point == 1) & ~block.points.of_role("control"))
    if len(alone):
        name = block.points.names[alone[0]]
        role = "check" if block.points.of_role("check")[alone[0]] else "tie"
        raise InputMalformedError(
            f"{role} point {name} has one ray" + (f", as {len(alone) - 1} more" if len(alone) > 1 else ""),
            "measure it in a second image or remove it",
            where=f"point {name}",
        )
    images = len(block.images.names)
    weak = 2 * np.bincount(block.observations.image, minlength=images)
    for observed in (block.positions.image, block.attitudes.image):
        weak += 3 * np.bincount(observed, minlength=images)
    on_frame = np.array([camera.id in {head.camera for head in block.heads} for camera in block.cameras])
    exposure = np.where(on_frame[block.images.camera], np.array(block.images.exposure, dtype=object), "")
    _, which, count = np.unique(exposure.astype(str), return_inverse=True, return_counts=True)
    # The others of an exposure hold a head.
    weak += 6 * ((exposure != "") & (count[which] > 1))
    free = np.sum(np.isinf(block.images.sigma), axis=1)
    for image in np.flatnonzero(weak < free):
        name = block.images.names[image]
        raise IllPosedError(
            f"it has {weak[image]} observed value(s) for {free[image]} unknown(s)",
            "measure more points in it, give its exterior orientation a sigma, or remove it",
            where=f"image {name}",
        )


def _require_datum(block: Block, rays_of_point: Integers) -> None:
    control = block.points.of_role("control") & (rays_of_point > 0)
    carried = np.sum(np.isfinite(block.points.sigma[control])) + np.sum(np.isfinite(block.images.sigma))
    carried += block.positions.values.size
    if block.datum == "control" and carried == 0:
        raise IllPosedError(
            "nothing fixes the datum: no control point and no exposure has a sigma",
            "add control points or weighted positions",
            where="block.toml",
        )
