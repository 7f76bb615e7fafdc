"""Collinearity, distortion and rotations, written from the documented conventions.

Rotation M = R3(kappa) R2(phi) R1(omega) from object to camera axes (x right, y up, z backwards). Image plane
in px from the middle of the format; `brown-ideal`: x = x0 + p + d(p) with p = -c (u, v) / w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SIZE = (4000, 3000)
# Camera axes (right, up in the image, backwards) of a camera that looks down, in terms of the body's
# (forward, right, down); north-east-down in terms of east-north-up.
LOOKS_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Lens:
    """A camera in px; `y_scale` and `shear` are those of the pixels: y (1 + y_scale), x + shear y."""

    c: float = 3650.0
    x0: float = 12.0
    y0: float = -8.0
    K1: float = -8e-9
    K2: float = 6e-16
    K3: float = 0.0
    K4: float = 0.0
    P1: float = 0.0
    P2: float = 0.0
    y_scale: float = 0.0
    shear: float = 0.0


def rodrigues(vectors: Floats) -> Floats:
    """Rotation matrices of rotation vectors, (n, 3) to (n, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle > 0.0, angle, 1.0)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, rest = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))


def body_axes(roll_pitch_yaw: Floats) -> Floats:
    """East-north-up to body axes from roll, pitch, yaw (rad), (n, 3) to (n, 3, 3)."""
    roll, pitch, yaw = roll_pitch_yaw.T
    one, zero = np.ones_like(roll), np.zeros_like(roll)
    about_x = [[one, zero, zero], [zero, np.cos(roll), np.sin(roll)], [zero, -np.sin(roll), np.cos(roll)]]
    about_y = [
        [np.cos(pitch), zero, -np.sin(pitch)],
        [zero, one, zero],
        [np.sin(pitch), zero, np.cos(pitch)],
    ]
    about_z = [[np.cos(yaw), np.sin(yaw), zero], [-np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]]
    x, y, z = (np.array(part).transpose(2, 0, 1) for part in (about_x, about_y, about_z))
    return np.asarray(x @ y @ z @ TO_NED)


def omega_phi_kappa(rotation: Floats) -> Floats:
    """Angles (rad) of M = R3(kappa) R2(phi) R1(omega), (n, 3, 3) to (n, 3)."""
    m = rotation
    omega = np.arctan2(-m[:, 2, 1], m[:, 2, 2])
    phi = np.arcsin(np.clip(m[:, 2, 0], -1.0, 1.0))
    return np.column_stack([omega, phi, np.arctan2(-m[:, 1, 0], m[:, 0, 0])])


def pixels(
    lens: Lens, rotation: Floats, centre: Floats, points: Floats, scale: Floats | float = 1.0
) -> Floats:
    """Column and row of each point in the image with its pose; NaN behind the camera.

    scale (n,): of the principal distance, image by image.
    """
    u, v, w = np.einsum("nij,nj->in", rotation, points - centre)
    w = np.where(w < 0.0, w, np.nan)
    x, y = -lens.c * scale * u / w, -lens.c * scale * v / w
    r2 = x * x + y * y
    radial = r2 * (lens.K1 + r2 * (lens.K2 + r2 * (lens.K3 + r2 * lens.K4)))
    dx = x * radial + lens.P1 * (r2 + 2.0 * x * x) + 2.0 * lens.P2 * x * y
    dy = y * radial + lens.P2 * (r2 + 2.0 * y * y) + 2.0 * lens.P1 * x * y
    across, up = lens.x0 + x + dx + lens.shear * y, lens.y0 + y + dy + lens.y_scale * y
    return np.column_stack([across + (SIZE[0] - 1) / 2.0, (SIZE[1] - 1) / 2.0 - up])
