"""Rotations from object to camera axes, M = R3(kappa) R2(phi) R1(omega), and to the body axes of a vehicle.

Body axes are forward, right, down; the object frame is X east, Y north, Z up.
"""

import numpy as np

from photocal.base.arrays import Floats

# Camera axes (x right, y up in the image, z backwards) of a camera that looks down, the upper edge of its
# image forward, in terms of body axes (forward, right, down).
NADIR = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# East, north, up to north, east, down.
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# The series of a turn this small, in radians, is its first term: the quotients would lose their digits.
_TINY = 1e-4


def matrix_from_angles(angles: Floats) -> Floats:
    """Rotation matrices from object to camera axes.

    angles (..., 3): omega, phi, kappa in radians.
    returns (..., 3, 3): M = R3(kappa) R2(phi) R1(omega), passive (Kraus 2007, eq. 2.1-13 transposed).
    """
    so, sp, sk = np.sin(angles).T
    co, cp, ck = np.cos(angles).T
    columns = [
        [cp * ck, -cp * sk, sp],
        [co * sk + so * sp * ck, co * ck - so * sp * sk, -so * cp],
        [so * sk - co * sp * ck, so * ck + co * sp * sk, co * cp],
    ]
    # Turned over as a whole, as in `skew`.
    return np.array(columns, dtype=float).T


def turned_left(angle: Floats | float) -> Floats:
    """Rotation matrices (..., 3, 3) to axes that are turned left about the third one, by radians."""
    return matrix_from_angles(np.multiply.outer(angle, [0.0, 0.0, 1.0]))


def angles_from_matrix(matrix: Floats) -> Floats:
    """Angles of rotation matrices, the inverse of `matrix_from_angles`.

    matrix (..., 3, 3): rotations from object to camera axes.
    returns (..., 3): omega and kappa in (-pi, pi], phi in [-pi/2, pi/2], radians. At phi = +-90 degrees only
        the sum or difference of omega and kappa is defined; omega is then 0.
    """
    m31, m32, m33 = matrix[..., 2, 0], matrix[..., 2, 1], matrix[..., 2, 2]
    cos_phi = np.hypot(m32, m33)
    locked = cos_phi < 1e-12
    omega = np.where(locked, 0.0, np.arctan2(-m32, m33))
    kappa = np.where(
        locked,
        np.arctan2(matrix[..., 0, 1], matrix[..., 1, 1]),
        np.arctan2(-matrix[..., 1, 0], matrix[..., 0, 0]),
    )
    return np.stack([omega, np.arctan2(m31, cos_phi), kappa], axis=-1)


def turn_per_angle(angles: Floats) -> Floats:
    """Derivative of the small turn t, in camera axes, with respect to omega, phi and kappa.

    The turned matrix is (I + [t]x) M. With M a product of passive rotations, dM M' is
    -[e3]x d kappa - [R3 e2]x d phi - [R3 R2 e1]x d omega.

    angles (..., 3): omega, phi, kappa in radians.
    returns (..., 3, 3): columns: the turn per radian of omega, phi, kappa. Singular at phi = +-90 degrees.
    """
    sp, sk = np.sin(angles[..., 1]), np.sin(angles[..., 2])
    cp, ck = np.cos(angles[..., 1]), np.cos(angles[..., 2])
    zero, ones = np.zeros_like(sp), np.ones_like(sp)
    columns = [[-cp * ck, cp * sk, -sp], [-sk, -ck, zero], [zero, zero, -ones]]
    return np.moveaxis(np.array(columns, dtype=float), (0, 1), (-1, -2))


def turned(matrix: Floats, turn: Floats) -> Floats:
    """Apply turns to rotation matrices: exp([t]x) M, exactly orthogonal.

    matrix (n, 3, 3): rotations from object to camera axes.
    turn (n, 3): turn vectors in camera axes, radians.
    returns (n, 3, 3): the turned rotations.
    """
    angle = np.linalg.norm(turn, axis=-1)[:, None, None]
    cross = skew(turn)
    # sinc keeps both factors exact for the smallest turns: sin(a)/a and (1 - cos a)/a^2.
    exponential = np.eye(3) + np.sinc(angle / np.pi) * cross
    exponential = exponential + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (cross @ cross)
    product = exponential @ matrix
    # One Newton step towards the nearest orthogonal matrix keeps rounding from piling up.
    return np.asarray(product @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(product, -1, -2) @ product))


def skew(vector: Floats) -> Floats:
    """Cross product matrices of vectors (..., 3), shape (..., 3, 3)."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    # Turned over as a whole, so that the axes of the vectors come first again.
    return np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).T


def left_jacobian(turn: Floats) -> Floats:
    """J with exp([t + d]x) = exp([J d]x) exp([t]x) to first order, shape (..., 3, 3).

    J = I + (1 - cos a)/a^2 [t]x + (a - sin a)/a^3 [t]x^2 (Chirikjian 2012, eq. 10.86).
    """
    angle, safe = _lengths(turn)
    cross = skew(turn)
    second = np.where(angle > _TINY, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross + second * (cross @ cross))


def inverse_left_jacobian(turn: Floats) -> Floats:
    """Inverse of `left_jacobian` for turns of less than 2 pi, shape (..., 3, 3).

    I - [t]x / 2 + (1 - (a/2) cot(a/2))/a^2 [t]x^2 (Chirikjian 2012, eq. 10.86).
    """
    angle, safe = _lengths(turn)
    cross = skew(turn)
    second = np.where(angle > _TINY, (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2, 1.0 / 12.0)
    return np.asarray(np.eye(3) - 0.5 * cross + second * (cross @ cross))


def _lengths(turn: Floats) -> tuple[Floats, Floats]:
    """Angles of turns, (..., 1, 1), and the same with one radian in place of those that are hardly any."""
    angle = np.sqrt(np.sum(turn**2, axis=-1))[..., None, None]
    return angle, np.where(angle > _TINY, angle, 1.0)


def object_to_body(angles: Floats) -> tuple[Floats, Floats]:
    """Rotations from the object frame to body axes (aerospace sequence: yaw, pitch, roll).

    angles (n, 3): roll, pitch, yaw in radians; yaw from the Y axis (north) towards X (east).
    returns rotation (n, 3, 3).
    returns turn_per_angle (n, 3, 3): turn about the body axes, t with rotation' = exp(-[t]x) rotation, per
        radian of each angle.
    """
    sin, cos = np.sin(angles), np.cos(angles)
    (sr, sp, sy), (cr, cp, cy) = sin.T, cos.T
    zero, ones = np.zeros_like(sr), np.ones_like(sr)
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    from_ned = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    columns = [[ones, zero, zero], [zero, cr, -sr], [-sp, sr * cp, cr * cp]]
    return from_ned @ TO_NED, np.moveaxis(np.array(columns), (0, 1), (-1, -2))
