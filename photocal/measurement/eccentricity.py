"""How level ground is bent in an image: what takes a target's middle out of the middle of its picture.

The centre of the ellipse that shows a circle is not where the circle's centre is seen: perspective and
distortion move it by a part of the target's size squared. To the second order an offset d in the image
belongs to the offset A^-1 (d + b(d, d)) on the ground, with A the affine part and b the bend that is found
here. A picture that is drawn with this bend has its centre where the target has its own (for perspective
alone this is the correction of Ahn, Warnecke and Kotowski 1999, up to the third order).
"""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted

# Far enough for digits, near enough for the third order not to matter.
_STEP_PX = 8.0
_AROUND = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])


def ground_bend(camera: Camera, rotation: Floats, pixel: Floats) -> Floats:
    """Bend of level ground about a place in an image."""
    ideal = undistorted(camera, pixel_to_plane(camera.size_px, camera.pitch, pixel + _AROUND))
    ray = np.column_stack([ideal, np.full(len(ideal), -camera.value("c"))]) @ rotation
    ground = ray[:, :2] / ray[:, 2:]
    by_pixel = np.column_stack([ground[1] - ground[2], ground[3] - ground[4]]) / (2 * _STEP_PX)
    second = np.empty((2, 2, 2))
    second[:, 0, 0], second[:, 1, 1] = (ground[k] - 2 * ground[0] + ground[k + 1] for k in (1, 3))
    second[:, 0, 1] = second[:, 1, 0] = (ground[5] + ground[6] - ground[7] - ground[8]) / 4
    return np.asarray(np.tensordot(np.linalg.inv(by_pixel), second, 1) / (2 * _STEP_PX**2))
