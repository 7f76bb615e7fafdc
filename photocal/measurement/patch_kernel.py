"""Least squares matching of many small patches with one image, compiled."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats
from photocal.base.compiled import allocating, compiled, inlined

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
    template, sample = np.empty(size), np.empty(size)
    jacobian, inverse = np.empty((size, _UNKNOWNS)), np.empty((_UNKNOWNS, 2 * _UNKNOWNS))
    patch = Patch(side // 2, template, jacobian, inverse)
    state, step, result = np.empty(_UNKNOWNS), np.empty(_UNKNOWNS), np.empty(2)
    for k in range(count):
        matched[k, 0], matched[k, 1], likeness[k] = np.nan, np.nan, 0.0
        length = _prepare(patches[k], template, jacobian)
        if length < _FLAT or not _inverted(jacobian, inverse):
            continue
        state[0], state[1] = place[k, 0], place[k, 1]
        state[2], state[3] = affinity[k, 0, 0], affinity[k, 0, 1]
        state[4], state[5] = affinity[k, 1, 0], affinity[k, 1, 1]
        _settle(image, patch, length, farthest, sample, state, step, result)
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


@compiled
def _prepare(patch: Floats32, template: Floats, jacobian: Floats) -> float:
    """Fill the template and its derivatives to offset and affinity; return its length.

    Brightness and contrast are eliminated: all are made orthogonal to them.
    """
    side = len(patch)
    half = side // 2
    n = 0
    for r in range(1, side - 1):
        for c in range(1, side - 1):
            gx = 0.5 * (patch[r, c + 1] - patch[r, c - 1])
            gy = 0.5 * (patch[r + 1, c] - patch[r - 1, c])
            x, y = float(c - half), float(r - half)
            template[n] = patch[r, c]
            jacobian[n, 0], jacobian[n, 1] = gx, gy
            jacobian[n, 2], jacobian[n, 3] = gx * x, gx * y
            jacobian[n, 4], jacobian[n, 5] = gy * x, gy * y
            n += 1
    mean = 0.0
    for m in range(n):
        mean += template[m]
    mean /= n
    squares = 0.0
    for m in range(n):
        template[m] -= mean
        squares += template[m] * template[m]
    for j in range(_UNKNOWNS):
        mean, product = 0.0, 0.0
        for m in range(n):
            mean += jacobian[m, j]
            product += jacobian[m, j] * template[m]
        mean /= n
        part = product / squares if squares > 0.0 else 0.0
        for m in range(n):
            jacobian[m, j] -= mean + part * template[m]
    return math.sqrt(squares)


@compiled
def _inverted(jacobian: Floats, inverse: Floats) -> bool:
    """Put the inverse of the normal matrix into the right half (Gauss, Jordan); tell whether there is one."""
    # The sums of a row grow side by side: each waits only for itself.
    for i in range(_UNKNOWNS):
        a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(len(jacobian)):
            slope = jacobian[m, i]
            a += slope * jacobian[m, 0]
            b += slope * jacobian[m, 1]
            c += slope * jacobian[m, 2]
            d += slope * jacobian[m, 3]
            e += slope * jacobian[m, 4]
            f += slope * jacobian[m, 5]
        inverse[i, 0], inverse[i, 1], inverse[i, 2] = a, b, c
        inverse[i, 3], inverse[i, 4], inverse[i, 5] = d, e, f
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
    sample: Floats,
    state: Floats,
    step: Floats,
    result: Floats,
) -> None:
    """Improve place and affinity; give likeness and squares of the misfit, 0 if it does not settle.

    length: of the template.
    """
    half, template, jacobian, inverse = patch
    x, y = state[0], state[1]
    result[0], result[1] = 0.0, 0.0
    settled = False
    iterations = 20
    settled_px = 0.01
    for _ in range(iterations):
        power = _sampled(image, half, state, sample)
        if power < _FLAT * _FLAT:
            return
        scale = length / math.sqrt(power)
        squares, product = 0.0, 0.0
        a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(len(sample)):
            product += sample[m] * template[m]
            miss = sample[m] * scale - template[m]
            squares += miss * miss
            a += jacobian[m, 0] * miss
            b += jacobian[m, 1] * miss
            c += jacobian[m, 2] * miss
            d += jacobian[m, 3] * miss
            e += jacobian[m, 4] * miss
            f += jacobian[m, 5] * miss
        step[0], step[1], step[2], step[3], step[4], step[5] = a, b, c, d, e, f
        # One look more than steps, so that likeness and misfit belong to the last place.
        if settled:
            result[0], result[1] = product / (length * math.sqrt(power)), squares
            return
        moved = _composed(state, inverse, step)
        if moved < 0 or (state[0] - x) ** 2 + (state[1] - y) ** 2 > farthest**2:
            return
        settled = moved < settled_px**2


@compiled
def _sampled(image: Floats32, half: int, state: Floats, sample: Floats) -> float:
    """Fill the image's values under the patch, less their mean; return their squares, -1 outside."""
    height, width = image.shape
    px, py, a, b, d, e = state[0], state[1], state[2], state[3], state[4], state[5]
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(d) + abs(e))
    if not (px >= reach_x and py >= reach_y and px + reach_x < width - 1 and py + reach_y < height - 1):
        return -1.0
    n, mean = 0, 0.0
    for r in range(1 - half, half):
        for c in range(1 - half, half):
            x, y = px + a * c + b * r, py + d * c + e * r
            i, j = int(x), int(y)
            fx, fy = x - i, y - j
            top = image[j, i] + fx * (image[j, i + 1] - image[j, i])
            low = image[j + 1, i] + fx * (image[j + 1, i + 1] - image[j + 1, i])
            sample[n] = top + fy * (low - top)
            mean += sample[n]
            n += 1
    mean /= n
    power = 0.0
    for m in range(n):
        sample[m] -= mean
        power += sample[m] * sample[m]
    return power


@inlined
def _solved(inverse: Floats, right: Floats, i: int) -> float:
    total = 0.0
    for j in range(_UNKNOWNS):
        total += inverse[i, _UNKNOWNS + j] * right[j]
    return total


@compiled
def _composed(state: Floats, inverse: Floats, right: Floats) -> float:
    """Put the inverse of the patch's small change before the image's; return the square of the move."""
    s, t = 1 + _solved(inverse, right, 2), _solved(inverse, right, 3)
    p, q = _solved(inverse, right, 4), 1 + _solved(inverse, right, 5)
    area = s * q - t * p
    # A step that shrinks the patch more than this has gone astray.
    least_area = 0.2
    if not area > least_area:
        return -1.0
    a, b, d, e = state[2], state[3], state[4], state[5]
    state[2], state[3] = (a * q - b * p) / area, (b * s - a * t) / area
    state[4], state[5] = (d * q - e * p) / area, (e * s - d * t) / area
    u, v = _solved(inverse, right, 0), _solved(inverse, right, 1)
    x, y = state[2] * u + state[3] * v, state[4] * u + state[5] * v
    state[0] -= x
    state[1] -= y
    return float(x * x + y * y)


def compile_kernels() -> None:
    """Match one patch with the picture it was cut from, at setup: no measurement waits for the compiler."""
    row, column = np.mgrid[:15, :15].astype(np.float32)
    picture = np.sin(row) * np.cos(0.7 * column)
    patches = np.ascontiguousarray(picture[None, 2:13, 2:13])
    matched, likeness, covariance = np.empty((1, 2)), np.empty(1), np.zeros((1, 2, 2))
    match_patches(patches, picture, np.full((1, 2), 7.0), np.eye(2)[None], 1.0, matched, likeness, covariance)
