"""From the centre of an ellipse to the image of the circle's centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def ellipse_conic(centre: Floats, semi_axes: Floats, direction: float) -> Floats:
    """Matrix of an ellipse: points with (x, y, 1) Q (x, y, 1)' = 0.

    Parameters
    ----------
    centre, semi_axes : ndarray, shape (2,)
    direction : float
        Of the first axis, from x towards y, radians.

    Returns
    -------
    ndarray, shape (3, 3)
    """
    turn = np.array([[np.cos(direction), np.sin(direction)], [-np.sin(direction), np.cos(direction)]])
    form = turn.T @ np.diag(1 / np.asarray(semi_axes, dtype=float) ** 2) @ turn
    beside = -form @ centre
    return np.block([[form, beside[:, None]], [beside[None, :], np.array([[centre @ form @ centre - 1]])]])


def circle_centre(conic: Floats, vanishing_line: Floats) -> Floats:
    """Image of a circle's centre, from its ellipse and the orientation of its plane.

    The centre is the pole of the line at infinity of the circle's plane; in the image that is the pole of
    the plane's vanishing line with respect to the ellipse (Hartley and Zisserman 2004, section 2.8).

    Parameters
    ----------
    conic : ndarray, shape (3, 3)
    vanishing_line : ndarray, shape (3,)
        Coefficients of l x + m y + n = 0 in the same coordinates. For undistorted coordinates (x, y) over
        the principal distance, camera axes x right, y up, z backwards, and the plane's normal N in these
        axes, it is (N_x, N_y, -N_z).

    Returns
    -------
    ndarray, shape (2,)
    """
    pole = np.linalg.solve(conic, vanishing_line)
    return np.asarray(pole[:2] / pole[2])


def ring_centre(inner: Floats, outer: Floats) -> Floats:
    """Image of the centre of two concentric circles, from their ellipses alone.

    Two concentric circles have their centre and the line at infinity in common as pole and polar; so the
    centre is the eigenvector of inner^-1 outer whose eigenvalue stands alone (Kim, Gurdjos and Kweon 2005).

    Parameters
    ----------
    inner, outer : ndarray, shape (3, 3)
        Matrices of the ellipses.

    Returns
    -------
    ndarray, shape (2,)
    """
    values, vectors = np.linalg.eig(np.linalg.solve(inner, outer))
    values = values.real
    gaps = [min(abs(values[k] - values[j]) for j in range(3) if j != k) for k in range(3)]
    centre = vectors[:, int(np.argmax(gaps))].real
    return np.asarray(centre[:2] / centre[2])
