"""A result beside its block: as a block, as other programs take it, and the residuals of its positions.

Cameras, orientations and points of the block are the adjusted ones, with their standard deviations; its
observations are those that took part, in pixels.
"""

from dataclasses import replace

import numpy as np

from photocal.adjustment.mounting import antennas, body_to_camera
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.network import frame_of, positions_at
from photocal.block.results.result import Result, common_values
from photocal.geometry.camera import among, plane_to_pixel
from photocal.geometry.frames import LocalFrame


def adjusted_block(result: Result) -> tuple[Block, Floats]:
    """Take what other programs know out of a result: a block, and the residuals of its observations, px.

    Others hold one pose for all lines: image coordinates of a rolling shutter become those at the pose of
    the middle line.

    raises ConfigurationError: for a lens that varies from image to image or with the distance.
    """
    for camera in result.cameras.values():
        if camera.photo_variant or camera.focus_m:
            what = (
                f"{', '.join(camera.photo_variant)} from image to image"
                if camera.photo_variant
                else "distortion with the distance"
            )
            raise ConfigurationError(
                f"camera {camera.id} varies its {what}: formats of other programs allow one lens only",
                "adjust with a lens that does not vary, then export that run",
            )
    images, points, rays = result.images, result.points, result.residuals.accepted
    place = {name: j for j, name in enumerate(points.names)}
    point = np.array([place.get(name, -1) for name in rays.point_names], dtype=np.int64)[rays.point]
    camera_of = images.camera[rays.image]
    size = np.array([camera.size_px for camera in images.cameras], dtype=float)[camera_of]
    pitch = np.array([camera.pitch for camera in images.cameras])[camera_of]
    per_px = pitch if result.block.observation_unit == "mm" else np.ones_like(pitch)
    residuals = rays.residual / per_px
    pixels = rays.measured / per_px
    if result.block.observation_axes == "photo":
        pixels, residuals = plane_to_pixel(size, per_px, rays.measured), residuals * [1.0, -1.0]
    if images.movement is not None:
        frame = frame_of(result.block.frame, result.block.height, images.station, points.values)
        moving, seen = images.in_local(frame), frame.to_local(points.values)[point]
        still = replace(moving, movement=None)
        pixels = pixels + still.project(rays.image, seen) - moving.project(rays.image, seen)
    # Cameras as they are when the effect of their readouts is taken off the observations.
    estimated = (camera.estimated & ~among("readout") for camera in images.cameras)
    cameras = tuple(
        replace(camera.changed(readout=0.0), estimated=free, shutter="global")
        for camera, free in zip(images.cameras, estimated, strict=True)
    )
    role = np.array([ROLES.index(word) for word in points.role], dtype=np.int64)
    block = result.block
    return Block(
        block.name,
        block.frame,
        block.height,
        "free" if block.datum == "free" else "control",
        cameras,
        Images(images.names, images.camera, images.values, images.sigma),
        ObjectPoints(points.names, points.values, points.sigma, role),
        Observations("px", "pixel", rays.image, point, pixels, np.ones(pixels.shape)),
    ), residuals


def position_residuals(block: Block, result: Result, frame: LocalFrame) -> tuple[Floats, Floats, Integers]:
    """Adjusted minus observed positions of the antenna, east, north, up, m, of each adjusted image.

    returns residual, sigma (images, 3): NaN without an observed position; sigma as it was stated.
    returns strip (images,): 0 where no strip is known.
    """
    images = result.images.in_local(frame)
    residual, sigma = np.full((2, len(images), 3), np.nan)
    strip = np.zeros(len(images), dtype=np.int64)
    if result.mounting is None or block.heads:
        return residual, sigma, strip
    observed = positions_at(block, frame, images.names)
    values = common_values(result.mounting, block.mounting.values)
    matrix = body_to_camera(block.mounting, values)
    computed = antennas(observed, matrix, values, images.rotation, images.station)
    residual[observed.image] = computed - observed.values
    sigma[observed.image] = np.sqrt(np.diagonal(observed.covariance, axis1=1, axis2=2))
    strip[observed.image] = observed.strip
    return residual, sigma, strip
