"""Recorded attitudes against the rotations of images that an adjustment of tie points oriented."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Floats, Integers
from photocal.findings.finding import Finding, untested
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.similarity import similarity
from photocal.navigation.exposures import Exposures, orientations
from photocal.navigation.rig import Rig
from photocal.navigation.rotation_check import ROUGH_DEG, PairRotation, least_turn, places_of, stored_turns

_LEAST = 6
_SIGMAS = 3.0


def compare_with_oriented(exposures: Exposures, oriented: OrientedImages, rig: Rig) -> list[PairRotation]:
    """Compare relative rotations of every image and its follower; the frame of the block does not matter.

    An adjustment of many images knows rotations better than two images over flat ground do, whose tilt and
    shift can hardly be told apart.
    """
    recorded = orientations(exposures, rig).rotation
    place = places_of(exposures)
    rows = _common(exposures, oriented)
    found = []
    for a, b in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        measured = oriented.rotation[b] @ oriented.rotation[a].T
        turns, angle = least_turn(measured, recorded[b] @ recorded[a].T)
        ways = (
            rotation[a] @ _direction(where[b] - where[a])
            for rotation, where in ((oriented.rotation, oriented.station), (recorded, place))
        )
        along = float(next(ways) @ next(ways))
        found.append(PairRotation(a, b, 0, turns, angle, along))
    return found


def boresight_check(exposures: Exposures, oriented: OrientedImages, rig: Rig) -> Finding:
    """Return the constant turn between recorded attitudes and the camera as a check.

    The block is turned into east, north, up by its positions (a similarity); the median of what is left is
    taken about each camera axis, images that are stored turned taken upright.
    """
    rows = _common(exposures, oriented)
    place = places_of(exposures)
    if len(rows) < _LEAST or not np.isfinite(place[rows]).all():
        return untested("boresight", "few-rotations", {"n": float(len(rows)), "needed": float(_LEAST)})
    aligned = similarity(oriented.station[rows], place[rows])
    if aligned is None:
        return untested("boresight", "on-one-line")
    quarter = stored_turns(compare_with_oriented(exposures, oriented, rig))
    turned = Rotation.from_rotvec([[0, 0, np.pi / 2 * quarter.get(row, 0)] for row in rows.tolist()])
    upright = turned.as_matrix() @ aligned.applied_to_rotations(oriented.rotation[rows])
    recorded = orientations(exposures, rig).rotation[rows]
    turn = Rotation.from_matrix(upright @ np.swapaxes(recorded, 1, 2)).as_rotvec()
    value = np.median(turn, axis=0)
    spread = 1.4826 * np.median(np.abs(turn - value), axis=0)
    # The median of n normal values has pi / 2 times the variance of their mean; neighbours err alike.
    sigma = spread * np.sqrt(np.pi / 2 / len(rows) * _inflation(turn - value))
    told = np.radians(ROUGH_DEG) if rig.angle_sigma is None else float(np.max(rig.angle_sigma))
    limit = _SIGMAS * np.sqrt(sigma**2 + rig.boresight_sigma**2 + told**2)
    figures: dict[str, Any] = {
        "images": len(rows),
        "turn_deg": np.degrees(value).tolist(),
        "sigma_deg": np.degrees(sigma).tolist(),
        "scatter_deg": np.degrees(spread).tolist(),
    }
    turns = zip(np.degrees(value), np.degrees(sigma), "xyz", strict=True)
    figures["numbers"] = tuple(f"{axis} {v:+.2f} +- {s:.2f}" for v, s, axis in turns)
    if (np.abs(value) > limit).any():
        return Finding("boresight", "grave", figures=figures, clauses=("turned-by",))
    return Finding("boresight", "passed", figures=figures)


def _common(exposures: Exposures, oriented: OrientedImages) -> Integers:
    known = exposures.attitude.known & np.isfinite(oriented.rotation).all(axis=(1, 2))
    return np.flatnonzero(known)


def _direction(way: Floats) -> Floats:
    return np.asarray(way / np.linalg.norm(way))


def _inflation(error: Floats) -> Floats:
    """Return (1 + r) / (1 - r) with the correlation r of neighbours, for each column."""
    squares = np.maximum(np.sum(error**2, axis=0), 1e-300)
    r = np.clip(np.sum(error[1:] * error[:-1], axis=0) / squares, 0.0, 0.9)
    return np.asarray((1 + r) / (1 - r))
