"""COLMAP models: cameras, images and points3D, as text or binary.

Pixels: x right, y down, the centre of the upper-left pixel is (0.5, 0.5), half a pixel more than ours. The
distortion is added to the normalised projection (`brown-ideal`), camera axes x right, y down, z forward; an
image has the rotation (quaternion w, x, y, z) and translation from object to camera axes. Written with the
model FULL_OPENCV, whose k4, k5, k6 are zero but for a `rational` lens, or OPENCV_FISHEYE. Source: COLMAP
documentation, "Output format" and "Camera models".
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.colmap_files import (
    MODELS,
    NO_POINT,
    NUMBERS,
    Content,
    Lens,
    Shot,
    read_binary_model,
    read_text_model,
    write_binary_model,
    write_text_model,
)
from photocal.exchange.parts import whole_numbers
from photocal.exchange.pinhole import (
    LARGEST,
    Pinhole,
    from_pinhole,
    from_vision,
    quaternion_from_rotation,
    rotation_from_quaternion,
    to_pinhole,
    to_vision,
)
from photocal.exchange.reconstruction import Choices, Reconstruction, vision_block
from photocal.exchange.rigs import of_colmap
from photocal.geometry.camera import PARAMETERS, Camera, Model
from photocal.geometry.conversion import Conversion

FILES = ("cameras", "images", "points3D")

# What COLMAP has of other lenses.
_OTHERS: dict[Model, tuple[str, ...]] = {
    "rational": ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2"),
    "equidistant": ("K1", "K2", "K3", "K4"),
}
# Which of our parameters each of COLMAP's makes free.
_FREES = {f"k{n}": (f"K{n}",) for n in range(1, 7)} | {"p1": ("P1", "P2"), "fx": ("B1",)}


def read_colmap(folder: Path) -> Reconstruction:
    """Read a model folder; binary files where there are any."""
    binary = (folder / "cameras.bin").exists()
    content = read_binary_model(folder) if binary else read_text_model(folder)
    cameras = {lens.key: _camera(lens, folder) for lens in content.lenses}
    order = {key: k for k, key in enumerate(cameras)}
    position = {key: k for k, key in enumerate(content.keys.tolist())}
    if len(position) < len(content.keys) or len(cameras) < len(content.lenses):
        raise InputMalformedError("has two points or cameras of the same number", where=folder)
    for shot in content.shots:
        lost = [key for key in shot.points.tolist() if key != NO_POINT and key not in position]
        if shot.lens not in order or lost:
            what = f"point {lost[0]}" if lost else f"camera {shot.lens}"
            raise InputMalformedError(f"image {shot.name} has the unknown {what}", where=folder)
    seen = [shot.points != NO_POINT for shot in content.shots]
    uses = list(zip(content.shots, seen, strict=True))
    quaternions = np.array([shot.quaternion for shot in content.shots]).reshape(-1, 4)
    # The largest part of a unit quaternion lies between 1/2 and 1.
    crooked = np.flatnonzero(np.abs(np.abs(quaternions).max(axis=1, initial=0) - 0.75) > 0.251)
    if len(crooked):
        name = content.shots[crooked[0]].name
        raise InputMalformedError(f"the quaternion of image {name} has not the length 1", where=folder)
    rotation = rotation_from_quaternion(quaternions)
    translation = np.array([shot.translation for shot in content.shots]).reshape(-1, 3)
    if not max(np.abs(translation).max(initial=0), np.abs(content.xyz).max(initial=0)) < LARGEST:
        raise InputMalformedError("has coordinates beyond 1e9 m", where=folder, remedy="is it damaged?")
    given = Reconstruction(
        tuple(cameras.values()),
        tuple(shot.name for shot in content.shots),
        np.array([order[shot.lens] for shot in content.shots], dtype=np.int64),
        from_vision(rotation, translation),
        tuple(str(key) for key in position),
        content.xyz,
        np.repeat(np.arange(len(seen)), [int(use.sum()) for use in seen]),
        np.array([position[key] for shot, use in uses for key in shot.points[use].tolist()], dtype=np.int64),
        np.vstack([np.empty((0, 2)), *(shot.marks[use] for shot, use in uses)]) - 0.5,
    )
    return of_colmap(given, folder, {shot.key: shot.name for shot in content.shots})


def write_colmap(
    folder: Path, given: Reconstruction, _: Choices | None = None, *, binary: bool = False
) -> tuple[Conversion, ...]:
    """Write a model folder."""
    made = [to_pinhole(own, "COLMAP", _OTHERS) for own in given.cameras]
    lenses = [
        Lens(k, _written(pinhole), pinhole.size_px, _parameters(pinhole))
        for k, (pinhole, _) in enumerate(made, start=1)
    ]
    rotation, translation = to_vision(given.poses)
    quaternion = quaternion_from_rotation(rotation)
    keys = np.array([int(name) for name in whole_numbers(given.point_names)], dtype=np.int64)
    order = np.argsort(given.image, kind="stable")
    bounds = np.searchsorted(given.image[order], np.arange(len(given.image_names) + 1))
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order)) - bounds[given.image[order]]
    shots = []
    for k, name in enumerate(given.image_names):
        own = order[bounds[k] : bounds[k + 1]]
        pose = tuple(quaternion[k].tolist()), tuple(translation[k].tolist())
        marks = given.pixels[own] + 0.5
        shots.append(Shot(k + 1, *pose, int(given.image_camera[k]) + 1, name, marks, keys[given.point[own]]))
    by_point = np.argsort(given.point, kind="stable")
    tracks = np.split(
        np.column_stack([given.image + 1, place])[by_point],
        np.searchsorted(given.point[by_point], np.arange(1, len(keys))),
    )
    content = Content(tuple(lenses), tuple(shots), keys, given.xyz, _errors(given), tuple(tracks))
    (write_binary_model if binary else write_text_model)(folder, content)
    return tuple(conversion for _, conversion in made)


def _parameters(pinhole: Pinhole) -> tuple[float, ...]:
    """Parameters of the model; the principal point half a pixel further."""
    names = MODELS[NUMBERS[_written(pinhole)]][1]
    return tuple(getattr(pinhole, name) + (0.5 if name in ("cx", "cy") else 0.0) for name in names)


def _written(pinhole: Pinhole) -> str:
    return "OPENCV_FISHEYE" if pinhole.fisheye else "FULL_OPENCV"


def _errors(given: Reconstruction) -> Floats:
    """Mean length of each point's residuals, px; -1 when not known."""
    count = np.bincount(given.point, minlength=len(given.point_names))
    total = np.bincount(given.point, np.hypot(*given.residuals_px.T), minlength=len(count))
    return np.asarray(np.where((count > 0) & np.isfinite(total), total / np.maximum(count, 1), -1.0))


def _camera(lens: Lens, place: object) -> Camera:
    names = MODELS[NUMBERS[lens.model]][1]
    if len(lens.parameters) != len(names):
        raise InputMalformedError(
            f"camera {lens.key} has {len(lens.parameters)} parameters where {lens.model} has {len(names)}",
            where=place,
        )
    value = dict(zip(names, lens.parameters, strict=True))
    f = value.get("f", 0.0)
    pinhole = Pinhole(
        lens.size_px,
        value.get("fx", f),
        value.get("fy", f),
        value["cx"] - 0.5,
        value["cy"] - 0.5,
        **{k: value.get(k, 0.0) for k in ("k1", "k2", "k3", "p1", "p2", "k4", "k5", "k6")},
        fisheye=lens.model.endswith("FISHEYE"),
    )
    own = from_pinhole(pinhole, str(lens.key), place)
    free = {"c", "x0", "y0"}.union(*(ours for theirs, ours in _FREES.items() if theirs in value))
    # Without k4 to k6 a FULL_OPENCV lens is Brown's, whose K4 is another.
    free &= set(own.lens.names) - ({"K4"} if own.model == "brown-ideal" else set())
    return replace(own, estimated=np.array([parameter in free for parameter in PARAMETERS]))


def export_binary(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """cameras.bin, images.bin, points3D.bin."""
    return write_colmap(folder, given, binary=True)


def read_model_block(path: Path) -> Block:
    """Read a COLMAP model."""
    given = read_colmap(path.parent)
    suffix = ".bin" if (path.parent / "cameras.bin").exists() else ".txt"
    return vision_block(path.parent.name, given, [path.with_name(name + suffix) for name in FILES])
