"""What programs pass around: cameras, oriented images, points and measurements; read from a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.block.model import ROLES, Block, InputFile, ObjectPoints, Observations
from photocal.block.table import read_table
from photocal.exchange.json_source import read_json
from photocal.exchange.parts import images
from photocal.geometry.camera import PARAMETERS, Camera, camera, plane_to_pixel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SCHEMA = "photocal.adjustment/"


@dataclass(frozen=True)
class Reconstruction:
    """Oriented images and the points that they see.

    Attributes
    ----------
    image_camera : ndarray of int, shape (images,)
        Index into the cameras; -1 when a file does not say.
    poses : ndarray, shape (images, 6)
        omega, phi, kappa in radians, X, Y, Z in m.
    xyz : ndarray, shape (points, 3)
        m.
    image, point : ndarray of int, shape (rays,)
    pixels : ndarray, shape (rays, 2)
        Column and row as measured; the centre of the upper-left pixel is (0, 0).
    roles : tuple of str
        control, check or tie for each point; empty when not known.
    pose_sigma, xyz_sigma, residuals_px
        Like `poses` (radians, m), `xyz` and `pixels`; residuals computed minus measured. Empty when unknown.
    frame, height : str
        "local", or a coordinate reference system with the kind of its heights, as in a block folder.
    """

    cameras: tuple[Camera, ...]
    image_names: tuple[str, ...]
    image_camera: Integers
    poses: Floats
    point_names: tuple[str, ...]
    xyz: Floats
    image: Integers
    point: Integers
    pixels: Floats
    roles: tuple[str, ...] = ()
    pose_sigma: Floats = field(default_factory=lambda: np.empty((0, 6)))
    xyz_sigma: Floats = field(default_factory=lambda: np.empty((0, 3)))
    residuals_px: Floats = field(default_factory=lambda: np.empty((0, 2)))
    frame: str = "local"
    height: str = ""
    name: str = "block"


def as_block(given: Reconstruction, name: str, sigma_px: float, inputs: tuple[InputFile, ...]) -> Block:
    """Make a block of a reconstruction: orientations and points as start values."""
    count = len(given.point_names)
    roles = given.roles or ("tie",) * count
    role = np.array([ROLES.index(own) for own in roles], dtype=np.int64)
    sigma = np.full((count, 3), np.inf)
    surveyed = (role != ROLES.index("tie")) & np.isfinite(given.xyz).all(axis=1)
    if len(given.xyz_sigma):
        known = surveyed & np.isfinite(given.xyz_sigma).all(axis=1)
        sigma[known] = given.xyz_sigma[known]
    # What is called control without a standard deviation holds nothing.
    bare = (role == ROLES.index("control")) & ~np.isfinite(sigma).all(axis=1)
    role[bare] = ROLES.index("tie")
    return Block(
        name,
        given.frame,
        given.height,
        "control" if (role == ROLES.index("control")).any() else "free",
        (),
        given.cameras,
        images(given.image_names, given.image_camera.tolist(), given.poses),
        ObjectPoints(given.point_names, given.xyz, sigma, role),
        Observations(
            "px", "pixel", given.image, given.point, given.pixels, np.full(given.pixels.shape, sigma_px)
        ),
        inputs,
    )


def of_block(block: Block) -> Reconstruction:
    """Take what other programs know out of a block, the inverse of `as_block`."""
    given, own = block.observations, block.images.camera[block.observations.image]
    pitch = np.array([camera.pitch for camera in block.cameras])[own]
    size = np.array([camera.size_px for camera in block.cameras], dtype=float)[own]
    values = given.values
    if given.axes == "photo":
        values = plane_to_pixel(size, pitch if given.unit == "mm" else np.ones_like(pitch), values)
    elif given.unit == "mm":
        values = values / pitch
    return Reconstruction(
        block.cameras,
        block.images.names,
        block.images.camera,
        block.images.values,
        block.points.names,
        block.points.values,
        given.image,
        given.point,
        values,
        tuple(ROLES[k] for k in block.points.role),
        xyz_sigma=np.where(np.isfinite(block.points.sigma), block.points.sigma, np.nan),
        frame=block.frame,
        height=block.height,
        name=block.name,
    )


def read_run(folder: Path) -> Reconstruction:
    """Read what `photocal adjust` wrote.

    Parameters
    ----------
    folder : Path
        Run folder.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        When it is no complete run folder.
    """
    if not folder.is_dir():
        raise InputNotFoundError(
            "is no folder", where=folder, remedy="name the folder that photocal adjust wrote"
        )
    place = folder / "result.json"
    result = read_json(place)
    if not str(result.get("schema", "")).startswith(_SCHEMA):
        raise InputMalformedError("is not the result of an adjustment", where=place)
    try:
        cameras = tuple(_camera(name, keys) for name, keys in result["cameras"].items())
        block = result["block"]
        unit = block["observation_unit"], block["observation_axes"]
        frame, height, title = (str(block[key]) for key in ("frame", "height", "name"))
    except (KeyError, TypeError, AttributeError, ValueError) as failure:
        raise InputMalformedError(
            f"lacks {failure}", where=place, remedy="adjust the block again"
        ) from failure
    pose_columns = ("X", "Y", "Z", "omega", "phi", "kappa")
    table = read_table(
        folder / "images.csv", ("image", "camera", *pose_columns), ("sX", "sY", "sZ", "so", "sp", "sk")
    )
    image_names = table.unique_names("image")
    which, camera_names = table.names("camera")
    known = {own.id: k for k, own in enumerate(cameras)}
    lost = [name for name in camera_names if name not in known]
    if lost:
        raise InputMalformedError(
            f"names camera {lost[0]}, which is not in result.json",
            where=folder / "images.csv",
            remedy="adjust the block again",
        )
    image_camera = np.array([known[name] for name in camera_names], dtype=np.int64)[which]
    poses = _pose_columns(table, pose_columns[3:] + pose_columns[:3])
    pose_sigma = _pose_columns(table, ("so", "sp", "sk", "sX", "sY", "sZ"))
    points = read_table(folder / "points.csv", ("point", "role", "X", "Y", "Z"), ("sX", "sY", "sZ", "rays"))
    point_names = points.unique_names("point")
    role, role_names = points.names("role")
    rays = _residual_table(folder)
    image = _rows(rays, "image", image_names)
    point = _rows(rays, "point", point_names)
    values = np.column_stack([rays.numbers("x"), rays.numbers("y")])
    residuals = np.column_stack([rays.numbers("vx"), rays.numbers("vy")])
    size = np.array([own.size_px for own in cameras], dtype=float)[image_camera[image]]
    pitch = np.array([own.pitch for own in cameras])[image_camera[image]]
    if unit == ("px", "photo"):
        pitch = np.ones_like(pitch)
    if unit[0] == "mm":
        residuals = residuals / pitch
    if unit[1] == "photo":
        values, residuals = plane_to_pixel(size, pitch, values), residuals * [1.0, -1.0]
    elif unit[0] == "mm":
        values = values / pitch
    return Reconstruction(
        cameras,
        image_names,
        image_camera,
        poses,
        point_names,
        np.column_stack([points.numbers(axis) for axis in "XYZ"]),
        image,
        point,
        values,
        tuple(role_names[k] for k in role),
        pose_sigma,
        np.column_stack([points.numbers("s" + axis, empty=np.nan) for axis in "XYZ"]),
        residuals,
        frame,
        height,
        title,
    )


def cameras_alone(cameras: Sequence[Camera]) -> Reconstruction:
    """What a file of cameras holds: no images, no points."""
    none = np.empty(0, dtype=np.int64)
    return Reconstruction(
        tuple(cameras), (), none, np.empty((0, 6)), (), np.empty((0, 3)), none, none, np.empty((0, 2))
    )


def orientations_alone(names: Sequence[str], poses: Floats) -> Reconstruction:
    """What a table of exterior orientations holds: images of unknown cameras."""
    nothing = cameras_alone(())
    return replace(
        nothing, image_names=tuple(names), image_camera=np.full(len(names), -1, dtype=np.int64), poses=poses
    )


def _camera(name: str, keys: dict[str, Any]) -> Camera:
    # Runs of older versions do not have these keys; their cameras did not vary.
    varied, focus_m = keys.get("photo_variant") or (), keys.get("focus_m")
    if varied or focus_m:
        what = f"{', '.join(varied)} from image to image" if varied else "distortion with the distance"
        raise ConfigurationError(
            f"camera {name} varies its {what}: other programs' formats hold one lens for all",
            remedy="adjust with a lens that does not vary, then export that run",
        )
    parameters = {key: float(keys["parameters"][key]["value"]) for key in PARAMETERS}
    return camera(
        name,
        keys["model"],
        keys["unit"],
        (int(keys["size_px"][0]), int(keys["size_px"][1])),
        (1.0, 1.0) if keys["unit"] == "px" else (float(keys["pitch_mm"][0]), float(keys["pitch_mm"][1])),
        parameters,
        reference_radius=float(keys["reference_radius"]),
        affinity=keys["affinity"],
        affinity_form=keys["affinity_form"],
    )


def _pose_columns(table: Any, columns: tuple[str, ...]) -> Floats:
    values = np.column_stack([table.numbers(column, empty=np.nan) for column in columns])
    values[:, :3] = np.radians(values[:, :3])
    return values


def _residual_table(folder: Path) -> Any:
    long = folder / "residuals.parquet"
    path = long if long.exists() else folder / "residuals.csv"
    return read_table(path, ("image", "point", "x", "y", "vx", "vy"), ("rx", "ry", "wx", "wy"))


def _rows(table: Any, column: str, names: tuple[str, ...]) -> Integers:
    index, found = table.names(column)
    position = {name: k for k, name in enumerate(names)}
    missing = [name for name in found if name not in position]
    if missing:
        raise InputMalformedError(
            f"{column} {missing[0]} is in no other table", where=table.path, remedy="adjust the block again"
        )
    return np.asarray(np.array([position[name] for name in found], dtype=np.int64)[index])
