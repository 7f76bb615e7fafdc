"""Body axes of a vehicle (forward, right, down) in the object frame (X east, Y north, Z up)."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats

# East, north, up to north, east, down.
_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def object_to_body(angles: Floats) -> tuple[Floats, Floats]:
    """Rotations from the object frame to body axes (aerospace sequence: yaw, pitch, roll).

    angles (n, 3): roll, pitch, yaw in radians; yaw from the Y axis (north) towards X (east).

    Returns
    -------
    rotation : ndarray, shape (n, 3, 3)
    turn_per_angle : ndarray, shape (n, 3, 3)
        Turn about the body axes, t with rotation' = exp(-[t]x) rotation, per radian of each angle.
    """
    sin, cos = np.sin(angles), np.cos(angles)
    (sr, sp, sy), (cr, cp, cy) = sin.T, cos.T
    zero, one = np.zeros_like(sr), np.ones_like(sr)
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    from_ned = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    columns = [[one, zero, zero], [zero, cr, -sr], [-sp, sr * cp, cr * cp]]
    return from_ned @ _TO_NED, np.moveaxis(np.array(columns), (0, 1), (-1, -2))
