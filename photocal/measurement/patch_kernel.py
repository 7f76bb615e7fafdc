"""Least squares matching of many small patches with one image, compiled."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats
from photocal.base.compiled import allocating, compiled, inlined, summing

Floats32 = NDArray[np.float32]

# Offset of the place and affinity of the surroundings.
_UNKNOWNS = 6
# A patch without contrast (length of its grey values) or with edges in one direction only has no place.
_FLAT, _STRAIGHT = 1e-3, 1e-6


class Patch(NamedTuple):
    """A patch made ready: half its side, its grey values, their derivatives and inverse normal matrix."""

    half: int
    template: Floats
    jacobian: Floats
    inverse: Floats


@allocating
def match_patches(
    patches: Floats32,
    image: Floats32,
    place: Floats,
    affinity: Floats,
    farthest: float,
    matched: Floats,
    likeness: Floats,
    covariance: Floats,
) -> None:
    """Match each patch with the image from a start value: offset, affinity, contrast and brightness.

    Gauss-Newton with the patch's own derivatives, so that the normal matrix is made once (inverse
    compositional: Baker and Matthews 2004, section 3.2; least squares matching: Ackermann 1984, Gruen 1985).
    """
    count, side, _ = patches.shape
    size = (side - 2) ** 2
    template, jacobian = np.empty(size), np.empty((_UNKNOWNS, size))
    inverse = np.empty((_UNKNOWNS, 2 * _UNKNOWNS))
    patch = Patch(side // 2, template, jacobian, inverse)
    state, sums, result = np.empty(_UNKNOWNS), np.empty(3 + _UNKNOWNS), np.empty(2)
    for k in range(count):
        matched[k, 0], matched[k, 1], likeness[k] = np.nan, np.nan, 0.0
        length = _prepare(patches[k], template, jacobian)
        if length < _FLAT or not _inverted(jacobian, inverse):
            continue
        state[0], state[1] = place[k, 0], place[k, 1]
        state[2], state[3] = affinity[k, 0, 0], affinity[k, 0, 1]
        state[4], state[5] = affinity[k, 1, 0], affinity[k, 1, 1]
        _settle(image, patch, length, farthest, sums, state, result)
        if not result[0] > 0:
            continue
        likeness[k] = result[0]
        matched[k, 0], matched[k, 1] = state[0], state[1]
        variance = result[1] / (size - _UNKNOWNS - 2)
        xx, yy = variance * inverse[0, _UNKNOWNS], variance * inverse[1, _UNKNOWNS + 1]
        xy = variance * inverse[0, _UNKNOWNS + 1]
        a, b, d, e = state[2], state[3], state[4], state[5]
        covariance[k, 0, 0] = a * a * xx + 2 * a * b * xy + b * b * yy
        covariance[k, 1, 1] = d * d * xx + 2 * d * e * xy + e * e * yy
        covariance[k, 0, 1] = a * d * xx + (a * e + b * d) * xy + b * e * yy
        covariance[k, 1, 0] = covariance[k, 0, 1]


@summing
def _prepare(patch: Floats32, template: Floats, jacobian: Floats) -> float:
    """Fill the template and its derivatives to offset and affinity; return its length.

    Brightness and contrast are eliminated: all are made orthogonal to them.
    """
    inner = len(patch) - 2
    size, middle = inner * inner, 0.5 * (inner - 1)
    for r in range(inner):
        y, row = r - middle, r * inner
        for c in range(inner):
            x, n = c - middle, row + c
            gx = 0.5 * (patch[r + 1, c + 2] - patch[r + 1, c])
            gy = 0.5 * (patch[r + 2, c + 1] - patch[r, c + 1])
            template[n] = patch[r + 1, c + 1]
            jacobian[0, n], jacobian[1, n] = gx, gy
            jacobian[2, n], jacobian[3, n] = gx * x, gx * y
            jacobian[4, n], jacobian[5, n] = gy * x, gy * y
    mean = 0.0
    for m in range(size):
        mean += template[m]
    mean /= size
    squares = 0.0
    for m in range(size):
        template[m] -= mean
        squares += template[m] * template[m]
    for j in range(_UNKNOWNS):
        mean, product = 0.0, 0.0
        for m in range(size):
            mean += jacobian[j, m]
            product += jacobian[j, m] * template[m]
        mean /= size
        part = product / squares if squares > 0.0 else 0.0
        for m in range(size):
            jacobian[j, m] -= mean + part * template[m]
    return math.sqrt(squares)


@summing
def _inverted(jacobian: Floats, inverse: Floats) -> bool:
    """Put the inverse of the normal matrix into the right half (Gauss, Jordan); tell whether there is one."""
    for i in range(_UNKNOWNS):
        for j in range(i, _UNKNOWNS):
            total = 0.0
            for m in range(jacobian.shape[1]):
                total += jacobian[i, m] * jacobian[j, m]
            inverse[i, j] = inverse[j, i] = total
        for j in range(_UNKNOWNS):
            inverse[i, _UNKNOWNS + j] = 1.0 if i == j else 0.0
    xx, xy, yy = inverse[0, 0], inverse[0, 1], inverse[1, 1]
    if not xx * yy - xy * xy > _STRAIGHT * (xx + yy) ** 2:
        return False
    for i in range(_UNKNOWNS):
        pivot = inverse[i, i]
        if not pivot > 0.0:
            return False
        for j in range(2 * _UNKNOWNS):
            inverse[i, j] /= pivot
        for k in range(_UNKNOWNS):
            if k != i:
                part = inverse[k, i]
                for j in range(2 * _UNKNOWNS):
                    inverse[k, j] -= part * inverse[i, j]
    return True


@compiled
def _settle(
    image: Floats32,
    patch: Patch,
    length: float,
    farthest: float,
    sums: Floats,
    state: Floats,
    result: Floats,
) -> None:
    """Improve place and affinity; give likeness and squares of the misfit, 0 if it does not settle.

    length: of the template.
    """
    x, y = state[0], state[1]
    result[0], result[1] = 0.0, 0.0
    settled = False
    iterations = 20
    settled_px = 0.01
    for _ in range(iterations):
        if not _summed(image, patch, state, sums):
            return
        power = sums[1] - sums[0] * sums[0] / len(patch.template)
        if power < _FLAT * _FLAT:
            return
        scale = length / math.sqrt(power)
        # One look more than steps, so that likeness and misfit belong to the last place.
        if settled:
            like = sums[2] / (length * math.sqrt(power))
            # Of two vectors of this length that enclose this cosine, which rounding may put above 1.
            result[0], result[1] = like, 2.0 * length * length * max(0.0, 1.0 - like)
            return
        moved = _composed(state, patch.inverse, sums, scale)
        if moved < 0 or (state[0] - x) ** 2 + (state[1] - y) ** 2 > farthest**2:
            return
        settled = moved < settled_px**2


@summing
def _summed(image: Floats32, patch: Patch, state: Floats, sums: Floats) -> bool:
    """Fill the sums of the image's values under the patch; false where it reaches outside.

    These are: of themselves, of their squares, of products with the template and with its derivatives. All of
    the patch is orthogonal to a constant, and its derivatives to the template: more is not needed for a step.
    """
    half, template, jacobian, _ = patch
    height, width = image.shape
    px, py, a, b, d, e = state[0], state[1], state[2], state[3], state[4], state[5]
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(d) + abs(e))
    if not (px >= reach_x and py >= reach_y and px + reach_x < width - 1 and py + reach_y < height - 1):
        return False
    # Small numbers keep the digits of the contrast.
    usual = image[int(py), int(px)]
    inner = 2 * half - 1
    plain, squares, likeness = 0.0, 0.0, 0.0
    s, t, u, v, w, z = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for r in range(inner):
        left, top, row = 1.0 - half, r + 1.0 - half, r * inner
        x0, y0 = px + a * left + b * top, py + d * left + e * top
        for c in range(inner):
            x, y, n = x0 + a * c, y0 + d * c, row + c
            i, j = np.int32(x), np.int32(y)
            fx, fy = np.float32(x - i), np.float32(y - j)
            upper = image[j, i] + fx * (image[j, i + 1] - image[j, i])
            lower = image[j + 1, i] + fx * (image[j + 1, i + 1] - image[j + 1, i])
            grey = np.float64(upper + fy * (lower - upper) - usual)
            plain += grey
            squares += grey * grey
            likeness += grey * template[n]
            s += grey * jacobian[0, n]
            t += grey * jacobian[1, n]
            u += grey * jacobian[2, n]
            v += grey * jacobian[3, n]
            w += grey * jacobian[4, n]
            z += grey * jacobian[5, n]
    sums[0], sums[1], sums[2] = plain, squares, likeness
    sums[3], sums[4], sums[5], sums[6], sums[7], sums[8] = s, t, u, v, w, z
    return True


@inlined
def _solved(inverse: Floats, sums: Floats, scale: float, i: int) -> float:
    total = 0.0
    for j in range(_UNKNOWNS):
        total += inverse[i, _UNKNOWNS + j] * sums[3 + j]
    return scale * total


@compiled
def _composed(state: Floats, inverse: Floats, sums: Floats, scale: float) -> float:
    """Put the inverse of the patch's small change before the image's; return the square of the move.

    scale: factor of the image's values that gives them the contrast of the patch.
    """
    s, t = 1 + _solved(inverse, sums, scale, 2), _solved(inverse, sums, scale, 3)
    p, q = _solved(inverse, sums, scale, 4), 1 + _solved(inverse, sums, scale, 5)
    area = s * q - t * p
    # A step that shrinks the patch more than this has gone astray.
    least_area = 0.2
    if not area > least_area:
        return -1.0
    a, b, d, e = state[2], state[3], state[4], state[5]
    state[2], state[3] = (a * q - b * p) / area, (b * s - a * t) / area
    state[4], state[5] = (d * q - e * p) / area, (e * s - d * t) / area
    u, v = _solved(inverse, sums, scale, 0), _solved(inverse, sums, scale, 1)
    x, y = state[2] * u + state[3] * v, state[4] * u + state[5] * v
    state[0] -= x
    state[1] -= y
    return float(x * x + y * y)
