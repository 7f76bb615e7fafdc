"""Kernels of the orthophoto: from ground points to image points, and grey values there."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import allocating, inlined
from photocal.geometry.lens import LINE, Scratch, kernel_scratch, recorded
from photocal.geometry.shutter import shaken

NEAREST, BILINEAR, CUBIC = 0, 1, 2


class LensTables(NamedTuple):
    """Cameras as the kernels take them.

    limit (cameras,): largest distance of an ideal image point from the principal point that the camera can
        record.
    """

    values: Floats
    optics: Floats
    pitch: Floats
    size: Floats
    limit: Floats


class Poses(NamedTuple):
    """Camera, pose and movement during the readout of each image, see `OrientedImages`."""

    camera: Integers
    rotation: Floats
    station: Floats
    movement: Floats


# Range of the grey values to write, and whether they are whole numbers.
GreyRange = tuple[float, float, bool]


@inlined
def move(
    lenses: LensTables, poses: Poses, m: int, u: float, v: float, w: float, room: Scratch, place: Floats
) -> None:
    """Move a place to where a rolling shutter records the point: the line tells the pose, that the line."""
    optics, rotation, movement, k = lenses.optics, poses.rotation, poses.movement, poses.camera[m]
    x, y, z = movement[m, 0], movement[m, 1], movement[m, 2]
    a = rotation[m, 0, 0] * x + rotation[m, 0, 1] * y + rotation[m, 0, 2] * z
    b = rotation[m, 1, 0] * x + rotation[m, 1, 1] * y + rotation[m, 1, 2] * z
    c = rotation[m, 2, 0] * x + rotation[m, 2, 1] * y + rotation[m, 2, 2] * z
    # From a line to the pose and back: each time a hundredth of the change is left, or less.
    lines = 4
    for _ in range(lines):
        s = optics[k, LINE] * place[0] + optics[k, LINE + 1] * place[1]
        s = min(max(s, -1.0), 1.0)
        p, q, r = u - s * a, v - s * b, w - s * c
        x, y, z = s * movement[m, 3], s * movement[m, 4], s * movement[m, 5]
        if movement.shape[1] > 6:
            e, f, g, _, _, _ = shaken(movement, m, 6, s)
            x, y, z = x + e, y + f, z + g
        # The turn by its series to the second power: it is of hundredths of a radian.
        e, f, g = y * r - z * q, z * p - x * r, x * q - y * p
        p, q, r = p + e + (y * g - z * f) / 2, q + f + (z * e - x * g) / 2, r + g + (x * f - y * e) / 2
        if not recorded(lenses.values, optics, k, p, q, r, room, place):
            return


@allocating
def look_up(
    ground: Floats, lenses: LensTables, poses: Poses, candidates: Integers, places: Floats, chosen: Integers
) -> None:
    """For every ground point choose the image with the best nadir and find the place in it.

    places (2, n): receive column and row; chosen (n,) the image, -1 for none.
    """
    optics, pitch, size = lenses.optics, lenses.pitch, lenses.size
    rotation, station = poses.rotation, poses.station
    room = kernel_scratch(0)
    place = np.zeros(2)
    count = len(candidates)
    score = np.zeros(count)
    for p in range(len(ground)):
        chosen[p] = -1
        x, y, z = ground[p, 0], ground[p, 1], ground[p, 2]
        if not np.isfinite(z):
            continue
        for n in range(count):
            m = candidates[n]
            gx, gy, gz = x - station[m, 0], y - station[m, 1], station[m, 2] - z
            # Squared tangent of the angle off the nadir; images from below see nothing.
            score[n] = (gx * gx + gy * gy) / (gz * gz) if gz > 0.0 else np.inf
        for _ in range(count):
            n = int(np.argmin(score))
            if score[n] == np.inf:
                break
            score[n] = np.inf
            m = candidates[n]
            k = poses.camera[m]
            gx, gy, gz = x - station[m, 0], y - station[m, 1], z - station[m, 2]
            u = rotation[m, 0, 0] * gx + rotation[m, 0, 1] * gy + rotation[m, 0, 2] * gz
            v = rotation[m, 1, 0] * gx + rotation[m, 1, 1] * gy + rotation[m, 1, 2] * gz
            w = rotation[m, 2, 0] * gx + rotation[m, 2, 1] * gy + rotation[m, 2, 2] * gz
            reach = lenses.limit[k] / lenses.values[k, 0]
            # Beyond its limit a polynomial may fold what it does not see into the image.
            if w >= 0.0 or u * u + v * v > reach * reach * w * w:
                continue
            if not recorded(lenses.values, optics, k, u, v, w, room, place):
                continue
            if optics[k, LINE] != 0.0 or optics[k, LINE + 1] != 0.0:
                move(lenses, poses, m, u, v, w, room, place)
            c = place[0] / pitch[k, 0] + (size[k, 0] - 1.0) / 2.0
            r = (size[k, 1] - 1.0) / 2.0 - place[1] / pitch[k, 1]
            if -0.5 <= c < size[k, 0] - 0.5 and -0.5 <= r < size[k, 1] - 0.5:
                places[0, p], places[1, p], chosen[p] = c, r, m
                break


@inlined
def _weights(method: int, t: float, weight: Floats) -> None:
    """Weights of the four neighbours at -1, 0, 1, 2 of a place t in [0, 1)."""
    if method == CUBIC:
        # Keys (1981) with a = -0.75, as OpenCV has it.
        a = -0.75
        weight[0] = ((a * (t + 1.0) - 5.0 * a) * (t + 1.0) + 8.0 * a) * (t + 1.0) - 4.0 * a
        weight[1] = ((a + 2.0) * t - (a + 3.0)) * t * t + 1.0
        s = 1.0 - t
        weight[2] = ((a + 2.0) * s - (a + 3.0)) * s * s + 1.0
        weight[3] = 1.0 - weight[0] - weight[1] - weight[2]
    else:
        weight[0], weight[1], weight[2], weight[3] = 0.0, 1.0 - t, t, 0.0


@allocating
def resample(
    image: NDArray[Any],
    which: int,
    method: int,
    places: Floats,
    chosen: Integers,
    limits: GreyRange,
    pixels: NDArray[Any],
) -> None:
    """Take the grey values of one image for the points that chose it."""
    lowest, highest, whole = limits
    rows, columns, bands = image.shape
    across, down = np.zeros(4), np.zeros(4)
    for p in range(len(chosen)):
        if chosen[p] != which:
            continue
        c, r = places[0, p], places[1, p]
        if method == NEAREST:
            j = min(max(int(np.floor(c + 0.5)), 0), columns - 1)
            i = min(max(int(np.floor(r + 0.5)), 0), rows - 1)
            for b in range(bands):
                value = float(image[i, j, b])
                pixels[b, p] = min(max(value, lowest), highest)
            continue
        j, i = int(np.floor(c)), int(np.floor(r))
        _weights(method, c - j, across)
        _weights(method, r - i, down)
        first, last = (0, 4) if method == CUBIC else (1, 3)
        for b in range(bands):
            value = 0.0
            for n in range(first, last):
                line = min(max(i + n - 1, 0), rows - 1)
                along = 0.0
                for m in range(first, last):
                    along += across[m] * float(image[line, min(max(j + m - 1, 0), columns - 1), b])
                value += down[n] * along
            if whole:
                value = np.floor(value + 0.5)
            pixels[b, p] = min(max(value, lowest), highest)
