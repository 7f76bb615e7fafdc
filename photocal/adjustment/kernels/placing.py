"""Antenna positions and attitudes of images: derivatives and residuals, of unit weight."""

import math

from photocal.base.arrays import Floats
from photocal.base.compiled import compiled

# Columns of a position: pose, lever arm, boresight, time, shift and height scale of the flight, shift and
# drift of the strip; of an attitude: turn of the image, boresight. The residual stands behind them.
OF_POSITION, OF_ATTITUDE = 23, 6


@compiled
def position_rows(
    rotation: Floats,
    basis: Floats,
    root: Floats,
    matrix: Floats,
    by_boresight: Floats,
    arm: Floats,
    flown: Floats,
    rows: Floats,
) -> None:
    """Rows of antenna positions, see `mounting`.

    rotation, basis, root (n, 3, 3): of the images, as in `Values`; L^-1 of the covariance L L'.
    matrix, by_boresight (3, 3): from body to camera axes; turn of the camera by a unit of the boresight.
    arm (3,): from the projection centre to the antenna in camera axes, m.
    flown (n, 8): computed minus observed, velocity, height above the base, time in the strip.
    rows (n, 3, 24): receives the derivatives and the residuals.
    """
    for n in range(len(rows)):
        for k in range(3):
            l0, l1, l2 = root[n, k, 0], root[n, k, 1], root[n, k, 2]
            a0 = l0 * rotation[n, 0, 0] + l1 * rotation[n, 0, 1] + l2 * rotation[n, 0, 2]
            a1 = l0 * rotation[n, 1, 0] + l1 * rotation[n, 1, 1] + l2 * rotation[n, 1, 2]
            a2 = l0 * rotation[n, 2, 0] + l1 * rotation[n, 2, 1] + l2 * rotation[n, 2, 2]
            t0, t1, t2 = a1 * arm[2] - a2 * arm[1], a2 * arm[0] - a0 * arm[2], a0 * arm[1] - a1 * arm[0]
            for c in range(3):
                along = root[n, k, c]
                rows[n, k, c] = t0 * basis[n, 0, c] + t1 * basis[n, 1, c] + t2 * basis[n, 2, c]
                rows[n, k, 3 + c] = rows[n, k, 13 + c] = rows[n, k, 17 + c] = along
                rows[n, k, 6 + c] = a0 * matrix[0, c] + a1 * matrix[1, c] + a2 * matrix[2, c]
                turned = t0 * by_boresight[0, c] + t1 * by_boresight[1, c] + t2 * by_boresight[2, c]
                rows[n, k, 9 + c] = -turned
                rows[n, k, 20 + c] = along * flown[n, 7]
            rows[n, k, 12] = -(l0 * flown[n, 3] + l1 * flown[n, 4] + l2 * flown[n, 5])
            rows[n, k, 16] = l2 * flown[n, 6]
            rows[n, k, 23] = l0 * flown[n, 0] + l1 * flown[n, 1] + l2 * flown[n, 2]


@compiled
def attitude_rows(
    rotation: Floats,
    basis: Floats,
    root: Floats,
    matrix: Floats,
    by_boresight: Floats,
    observed: Floats,
    rows: Floats,
) -> None:
    """Rows of attitudes, whose residual r turns what the body says onto the image: M' r and M' J(r)^-1.

    observed (n, 3, 3): object to body axes; other parameters as in `position_rows`.
    rows (n, 3, 7): receives the derivatives and the residuals.

    The boresight turns the axes in which r is given, too: [r]x - J(-r)^-1 = -J(r)^-1.
    """
    for n in range(len(rows)):
        for a in range(3):
            for b in range(3):
                rows[n, a, b] = 0.0
                rows[n, a, 3 + b] = 0.0
                for k in range(3):
                    at = (
                        matrix[b, 0] * observed[n, 0, k]
                        + matrix[b, 1] * observed[n, 1, k]
                        + matrix[b, 2] * observed[n, 2, k]
                    )
                    rows[n, a, b] += rotation[n, a, k] * at
                    rows[n, a, 3 + b] += root[n, a, k] * matrix[b, k]
        # The quaternion by its largest element (Shepperd 1978), with a real part that is not negative.
        i = 0
        for k in range(1, 3):
            if rows[n, k, k] > rows[n, i, i]:
                i = k
        trace = rows[n, 0, 0] + rows[n, 1, 1] + rows[n, 2, 2]
        if trace > rows[n, i, i]:
            real = 0.5 * math.sqrt(1.0 + trace)
            r0 = 0.25 * (rows[n, 2, 1] - rows[n, 1, 2]) / real
            r1 = 0.25 * (rows[n, 0, 2] - rows[n, 2, 0]) / real
            r2 = 0.25 * (rows[n, 1, 0] - rows[n, 0, 1]) / real
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            most = 0.5 * math.sqrt(1.0 + 2.0 * rows[n, i, i] - trace)
            real = 0.25 * (rows[n, k, j] - rows[n, j, k]) / most
            sign = 1.0 if real >= 0.0 else -1.0
            real *= sign
            others = 0.25 * sign / most
            r0 = r1 = r2 = sign * most
            if i != 0:
                r0 = others * (rows[n, 0, i] + rows[n, i, 0])
            if i != 1:
                r1 = others * (rows[n, 1, i] + rows[n, i, 1])
            if i != 2:
                r2 = others * (rows[n, 2, i] + rows[n, i, 2])
        imaginary = math.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        angle = 2.0 * math.atan2(imaginary, real)
        scale = angle / imaginary if imaginary > 0.0 else 2.0
        r0, r1, r2 = scale * r0, scale * r1, scale * r2
        # See `rotation.inverse_left_jacobian`; 1e-4 rad on, the quotient has enough digits.
        second = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / (angle * angle) if angle > 1e-4 else 1.0 / 12.0
        for k in range(3):
            w0, w1, w2 = rows[n, k, 3], rows[n, k, 4], rows[n, k, 5]
            u0, u1, u2 = r1 * w2 - r2 * w1, r2 * w0 - r0 * w2, r0 * w1 - r1 * w0
            g0 = w0 + 0.5 * u0 + second * (r1 * u2 - r2 * u1)
            g1 = w1 + 0.5 * u1 + second * (r2 * u0 - r0 * u2)
            g2 = w2 + 0.5 * u2 + second * (r0 * u1 - r1 * u0)
            for c in range(3):
                rows[n, k, c] = g0 * basis[n, 0, c] + g1 * basis[n, 1, c] + g2 * basis[n, 2, c]
                turned = g0 * by_boresight[0, c] + g1 * by_boresight[1, c] + g2 * by_boresight[2, c]
                rows[n, k, 3 + c] = -turned
            rows[n, k, 6] = w0 * r0 + w1 * r1 + w2 * r2
