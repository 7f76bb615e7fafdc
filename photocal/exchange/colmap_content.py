"""What a COLMAP model holds, as its files have it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats, Integers
from drivers.errors import InputMalformedError

# Name and parameters of each model by COLMAP's number.
MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fx", "fy", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k1")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    5: ("OPENCV_FISHEYE", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    6: ("FULL_OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    8: ("SIMPLE_RADIAL_FISHEYE", ("f", "cx", "cy", "k1")),
    9: ("RADIAL_FISHEYE", ("f", "cx", "cy", "k1", "k2")),
}
NUMBERS = {name: number for number, (name, _) in MODELS.items()}
LARGEST_KEY = 1 << 62
# Key of a mark that belongs to no point.
NO_POINT = -1


@dataclass(frozen=True)
class Lens:
    """One camera."""

    key: int
    model: str
    size_px: tuple[int, int]
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class Shot:
    """One image.

    quaternion, translation: from object to camera axes.
    lens: key of its camera.
    marks (n, 2).
    points (n,): keys of the points, or `NO_POINT`.
    """

    key: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int
    name: str
    marks: Floats
    points: Integers


@dataclass(frozen=True)
class Content:
    """A whole model.

    keys (n,): of the points.
    xyz (n, 3).
    errors (n,): mean reprojection error of each point, px.
    tracks (rays, 2): image key and position of the mark in that image, for each point.
    """

    lenses: tuple[Lens, ...]
    shots: tuple[Shot, ...]
    keys: Integers
    xyz: Floats
    errors: Floats
    tracks: tuple[Integers, ...]


# Number, place, reprojection error and track of a point.
Point = tuple[int, Sequence[float], float, Integers]


def content_of(lenses: Iterable[Lens], shots: Iterable[Shot], points: Iterable[Point]) -> Content:
    """Put a model together."""
    rows = list(points)
    return Content(
        tuple(lenses),
        tuple(shots),
        np.array([key for key, _, _, _ in rows], dtype=np.int64),
        np.array([xyz for _, xyz, _, _ in rows], dtype=float).reshape(-1, 3),
        np.array([error for _, _, error, _ in rows], dtype=float),
        tuple(track for _, _, _, track in rows),
    )


def key_of(value: float, place: object) -> int:
    """Check a number that names something."""
    if not -1 <= value < LARGEST_KEY or value % 1:
        raise InputMalformedError(f"the number {value:g} names nothing", where=place, remedy="is it damaged?")
    return int(value)


def unknown_model(name: object, place: object) -> InputMalformedError:
    """Complaint about a camera model that we have no equivalent of."""
    known = ", ".join(known for known, _ in MODELS.values())
    return InputMalformedError(
        f"camera model {name} has no equivalent", where=place, remedy=f"convert it to one of {known}"
    )
