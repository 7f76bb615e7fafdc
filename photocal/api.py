"""The public face of photocal for Python: `import photocal` offers what stands here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from photocal.adjustment.network import RELATIONS, Related, Relations
from photocal.base.errors import ConfigurationError
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.geometry.camera import Camera, camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.results.folder import read_result, write_result
from photocal.results.result import Result

if TYPE_CHECKING:
    from photocal.analysis.outcome import Outcome
    from photocal.georeferencing.comparison import BlockCheck

__all__ = [
    "Block", "Camera", "Images", "ObjectPoints", "Observations", "OrientedImages", "Result", "adjust",
    "analyse", "block_of_arrays", "camera", "check", "read_block", "read_cameras", "read_log", "read_result",
    "with_relations", "write_block", "write_cameras", "write_result",
]  # fmt: skip

# What a calibration estimates unless it is told otherwise.
USUAL = ("c", "x0", "y0", "K1", "K2", "P1", "P2")


def read_block(path: str | Path) -> Block:
    """Read a block folder, or the set-up file of another program (DBAT, COLMAP, Metashape, OPF ...).

    raises PhotocalError: for what cannot be read, with file and line.
    """
    from photocal.exchange.formats import read_any_block

    return read_any_block(Path(path))


def write_block(path: str | Path, block: Block) -> None:
    """Write a block folder; what `read_block` reads of it is equal, but for the fingerprints of its files.

    Parameters
    ----------
    path
        Folder; tables of an earlier block in it are replaced.
    block
        Numbers are written with all their digits, angles as degrees.

    Raises
    ------
    PhotocalError
        When the folder cannot be written, or the block has what no block folder can hold.
    """
    from photocal.block.writer import write_block as write

    write(Path(path), block)


def read_cameras(path: str | Path) -> tuple[Camera, ...]:
    """Read a file of cameras: `[[camera]]` entries as in `block.toml`, with sigmas and correlations.

    Parameters
    ----------
    path
        TOML file, as `photocal compare` takes it and `write_cameras` writes it.

    Raises
    ------
    PhotocalError
        For a key or a value that cannot be, with file and camera.
    """
    from photocal.analysis.stability.camera_file import read_camera_file

    return read_camera_file(Path(path)).calibrations


def write_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Write cameras as `[[camera]]` entries of a TOML file, adjusted ones with sigmas and correlations.

    Parameters
    ----------
    path
        File that takes the place of an older one, whole or not at all.
    cameras
        Such as ``result.cameras.values()``; each has a name of its own.

    Raises
    ------
    PhotocalError
        When the file cannot be written.
    """
    from photocal.base.codec import toml_text
    from photocal.base.files import output_file
    from photocal.block.camera_setup import camera_keys

    entries = [camera_keys(one).model_dump(exclude_defaults=True) for one in cameras]
    with output_file(Path(path)) as aside:
        aside.write_text(toml_text({"camera": entries}), encoding="utf-8", newline="\n")


def block_of_arrays(
    object_points: ArrayLike,
    image_points: ArrayLike,
    size_px: tuple[int, int],
    *,
    sigma_px: float,
    sigma_m: float | None,
    lens: Camera | None = None,
    point_names: Sequence[str] = (),
    image_names: Sequence[str] = (),
    check: Sequence[str] = (),
) -> Block:
    """Make a block of two arrays: where points are, and where images show them."""
    points, pixels = np.array(object_points, dtype=float), np.array(image_points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or pixels.ndim != 3 or pixels.shape[1:] != (len(points), 2):
        raise ConfigurationError(
            f"object_points has shape {points.shape}, image_points {pixels.shape}",
            "give shapes (n, 3) and (m, n, 2), with NaN where an image does not show a point",
        )
    count = len(pixels)
    start = {"c": 1.2 * max(size_px)}
    lens = lens or camera("camera", "brown-ideal", "px", size_px, (1.0, 1.0), start, estimate=USUAL)
    image, point = np.nonzero(np.isfinite(pixels).all(axis=2))
    names = tuple(point_names) or tuple(str(k + 1) for k in range(len(points)))
    roles = ["check" if name in set(check) else "tie" if sigma_m is None else "control" for name in names]
    role = np.array([ROLES.index(name) for name in roles], dtype=np.int64)
    known = np.full(points.shape, np.inf)
    known[role == ROLES.index("control")] = np.inf if sigma_m is None else sigma_m
    return Block(
        "arrays",
        "local",
        "",
        "free" if sigma_m is None else "control",
        (lens,),
        Images(
            tuple(image_names) or tuple(str(k + 1) for k in range(count)), np.zeros(count, dtype=np.int64)
        ),
        ObjectPoints(names, points, known, role),
        Observations("px", "pixel", image, point, pixels[image, point], np.full((len(image), 2), sigma_px)),
    )


def with_relations(
    block: Block, kind: str, rows: Iterable[tuple[Any, ...]], related: Related | None = None
) -> Block:
    """Add observations between points: scale bars, height differences, angles, lines, your own kinds.

    kind: "distance", "height_difference", "azimuth", "vertical_angle", "horizontal_angle" (at, from, to),
        "line" (from, to, and a point of it, which deviates by the value 0), or a kind of your own.
    rows: two points, or three, value and standard deviation: m, radians for angles.
    related: for a kind of your own: from the differences (n, 3) of the points, second less first, the values
        (n,) and their derivatives (n, 3) with respect to the second point.
    """
    old = block.relations
    if related is not None and kind not in old.names:
        old = replace(old, further=(*old.further, (kind, related)))
    if kind not in old.names:
        raise ConfigurationError(
            f"{kind!r} is no kind of observation that is known",
            f"use {', '.join(old.names)}, or give a function of your own",
        )
    given, number = list(rows), {name: k for k, name in enumerate(block.points.names)}
    for name in (name for row in given for name in row[:-2]):
        if name not in number:
            raise ConfigurationError(f"point {name} is not in the block", "correct the name", where=kind)
    count = len(RELATIONS.get(kind, ("from", "to")))
    if any(len(row) != count + 2 for row in given):
        raise ConfigurationError(
            f"an observation of the kind {kind} has another number of cells",
            f"give {count} points, value and standard deviation",
        )
    ends = np.array([[number[name] for name in row[:-2]] for row in given], dtype=np.int64).reshape(-1, count)
    figures = np.array([row[-2:] for row in given], dtype=float).reshape(-1, 2)
    third = ends[:, 2] if count == 3 else np.full(len(given), -1)
    kinds, (values, sigma) = np.full(len(given), old.names.index(kind)), figures.T
    return replace(block, relations=old.plus(Relations(kinds, ends[:, 0], ends[:, 1], values, sigma, third)))


def adjust(block: Block, *, snooping: Literal["w", "tau"] | None = None, components: bool = False) -> Result:
    """Adjust a block by least squares: cameras, orientations and points with their covariances.

    raises PhotocalError: for a block that does not determine its unknowns, or an adjustment that does not
        converge.
    """
    from photocal.results.adjusted import adjust_network
    from photocal.results.more_tables import Wanted

    return adjust_network(block, snooping, Wanted(components=components))


def analyse(
    block: Block, result: Result | None = None, *, alpha: float = 0.10, threshold: float = 0.8
) -> Outcome:
    """Look for what an adjustment hides: systematic errors, insignificant and correlated parameters."""
    from photocal.analysis.analyse_run import checks_of
    from photocal.analysis.outcome import analyse_network
    from photocal.block.network import assemble
    from photocal.results.adjusted import network_of

    assembly = assemble(block) if result is None else network_of(block, result)
    return analyse_network(assembly.network, checks_of(block, assembly), alpha, threshold)


def check(block: Block, *, standards: Sequence[str] = (), scale: float | None = None) -> BlockCheck:
    """Georeference a block three ways (direct, integrated, indirect) and judge it at its check points.

    standards: such as "decree-89817", "pec-pcd", "asprs-2024", or paths of TOML files.
    scale: denominator of the map scale to judge at.
    """
    from photocal.accuracy.standard import Question, load_standard
    from photocal.georeferencing.comparison import check_block

    chosen = tuple(load_standard(name) for name in standards)
    return check_block(block, chosen, Question(scale_denominator=scale))


def read_log(path: str | Path, topics: Sequence[str] = ()) -> dict[str, dict[str, NDArray[Any]]]:
    """Read a flight log into arrays, one for each field of each topic."""
    from acquire.log.arrays import arrays_of_log

    return arrays_of_log(Path(path), frozenset(topics))
