"""A result as a block, as other programs take it.

Its cameras, orientations and points are the adjusted ones, with their standard deviations; its observations
are those that took part, in pixels.
"""

from dataclasses import replace

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.network import frame_of
from photocal.block.results.result import Result
from photocal.geometry.camera import among, plane_to_pixel


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
