"""The public face of photocal for Python: `import photocal` offers what stands here."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from photocal.adjustment.network import RELATIONS, Related, Relations
from photocal.base.errors import ConfigurationError
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.results.result import Result
from photocal.geometry.camera import Camera, camera
from photocal.geometry.oriented_images import OrientedImages

if TYPE_CHECKING:
    from photocal.analysis.accuracy.assessment import Assessment
    from photocal.analysis.accuracy.discrepancies import Discrepancies
    from photocal.analysis.accuracy.options import JudgementOptions
    from photocal.analysis.estimates import FTest, Proposal
    from photocal.analysis.georeferencing.comparison import BlockCheck
    from photocal.analysis.outcome import Outcome
    from photocal.analysis.stability.compared import Compared
    from photocal.api.judging import analyse, assess, check, compare, components, significance
    from photocal.base.errors import (
        DeviceError,
        IllPosedError,
        InputMalformedError,
        InputNotFoundError,
        NotConvergedError,
        OutputError,
        PhotocalError,
        ProgramMissingError,
    )
    from photocal.block.project import Project
    from photocal.findings.finding import Finding
    from photocal.findings.listed import Findings
    from photocal.measurement.measurement_record import MeasuredBlock
    from photocal.measurement.options import MeasureOptions
    from photocal.navigation.exposures import Exposures
    from photocal.navigation.flight_log import FlightLog
    from photocal.navigation.options import ExposureOptions, PpkOptions, ReceiverOptions
    from photocal.navigation.steps import exposures, ppk
    from photocal.navigation.trajectory import Trajectory
    from photocal.planning.area import area_from_corners, read_area
    from photocal.planning.flight import FlightRequest
    from photocal.planning.network_file import plan_network
    from photocal.planning.options import FlightOptions, LimitOptions, MissionOptions, PrecisionOptions
    from photocal.planning.plan import Plan, plan, simulate_flights
    from photocal.products.contours import contours
    from photocal.products.options import ContourOptions, OrthoOptions, VolumeOptions
    from photocal.products.ortho import ortho
    from photocal.products.volume import volume
    from photocal.report.options import CertificateOptions
    from photocal.run.certify import certificate
    from photocal.run.stage import StageResult

__all__ = [
    "Assessment", "Block", "BlockCheck", "Camera", "CertificateOptions", "Compared", "ConfigurationError",
    "ContourOptions", "DeviceError", "Discrepancies", "ExposureOptions", "Exposures", "FTest", "Finding",
    "Findings", "FlightLog", "FlightOptions", "FlightRequest", "IllPosedError", "Images",
    "InputMalformedError", "InputNotFoundError", "JudgementOptions", "LimitOptions", "MeasureOptions",
    "MeasuredBlock", "MissionOptions", "NotConvergedError", "ObjectPoints", "Observations",
    "OrientedImages", "OrthoOptions", "Outcome", "OutputError", "PhotocalError", "Plan", "PpkOptions",
    "PrecisionOptions", "ProgramMissingError", "Project", "Proposal", "ReceiverOptions", "Result",
    "StageResult", "Trajectory", "VolumeOptions", "adjust", "analyse", "area_from_corners", "assess",
    "block_of_arrays", "camera", "certificate", "check", "compare", "components", "contours", "exposures",
    "measure", "ortho", "plan", "plan_network", "ppk", "read_area", "read_block", "read_cameras",
    "read_log", "read_result", "run_project", "significance", "simulate_flights", "volume",
    "with_relations", "write_block", "write_cameras", "write_result",
]  # fmt: skip

# What a calibration estimates by default.
USUAL = ("c", "x0", "y0", "K1", "K2", "P1", "P2")


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_elsewhere()[name]), name)


@cache
def _elsewhere() -> dict[str, str]:
    """Modules of the names that are imported above for checkers of types: here they are loaded when used."""
    return {
        name.name: part.module
        for block in ast.parse(Path(__file__).read_bytes()).body
        if isinstance(block, ast.If)
        for part in block.body
        if isinstance(part, ast.ImportFrom) and part.module
        for name in part.names
    }


def read_block(path: str | Path) -> Block:
    """Read a block folder, or the set-up file of another program.

    Parameters
    ----------
    path
        Folder with `block.toml`, or a set-up file or folder of DBAT, COLMAP, Metashape, OPF and others
        (docs/exchange.md lists them); the format is recognised by the content.

    Returns
    -------
    Block
        Cameras, images, points and observations as they were given.

    Raises
    ------
    InputNotFoundError
        When there is nothing of that name.
    InputMalformedError, ConfigurationError
        When a file is malformed; the message gives file and line.

    Examples
    --------
    >>> import photocal
    >>> photocal.read_block("photocal/demo/dcs460").name
    'Kodak DCS460, published observations'
    """
    from photocal.exchange.formats import read_any_block

    return read_any_block(Path(path))


def write_block(path: str | Path, block: Block) -> None:
    """Write a block folder; `read_block` gives an equal block, except for the hashes of its files.

    Parameters
    ----------
    path
        Folder; tables of an earlier block in it are replaced.
    block
        Numbers are written with all their digits, angles as degrees.

    Raises
    ------
    PhotocalError
        When the folder cannot be written, or the block has data that a block folder cannot store.

    Examples
    --------
    >>> import photocal
    >>> photocal.write_block("copy", block)
    >>> photocal.read_block("copy").points.names == block.points.names
    True
    """
    from photocal.block.writer import write_block as write

    write(Path(path), block)


def read_cameras(path: str | Path) -> tuple[Camera, ...]:
    """Read a file of cameras: `[[camera]]` entries as in `block.toml`, with sigmas and correlations.

    Parameters
    ----------
    path
        TOML file, as `photocal compare` takes it and `write_cameras` writes it.

    Returns
    -------
    tuple of Camera
        In the order of the file.

    Raises
    ------
    PhotocalError
        For an unknown key or an invalid value; the message names file and camera.

    Examples
    --------
    >>> import photocal
    >>> [camera.id for camera in photocal.read_cameras("cameras.toml")]
    ['dcs460']
    """
    from photocal.analysis.stability.camera_file import read_camera_file

    return read_camera_file(Path(path)).calibrations


def write_cameras(path: str | Path, cameras: Sequence[Camera]) -> None:
    """Write cameras as `[[camera]]` entries of a TOML file, adjusted ones with sigmas and correlations.

    Parameters
    ----------
    path
        File to write; it replaces an older one only when it is complete.
    cameras
        Such as ``result.cameras.values()``; each has a name of its own.

    Raises
    ------
    PhotocalError
        When the file cannot be written.

    Examples
    --------
    >>> import photocal
    >>> photocal.write_cameras("cameras.toml", [result.camera()])
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
    lens: Camera | tuple[int, int],
    *,
    sigma_px: float,
    sigma_m: float | None,
    point_names: Sequence[str] = (),
    image_names: Sequence[str] = (),
    check: Sequence[str] = (),
) -> Block:
    """Make a block from two arrays: object coordinates of points and their image coordinates.

    Parameters
    ----------
    object_points
        X, Y, Z of the points in a local frame, m, shape (n, 3); an array or a DataFrame.
    image_points
        Column and row of each point in each image, px, shape (m, n, 2); the centre of the upper-left pixel is
        (0, 0); NaN where an image does not show a point.
    lens
        The camera; or the size of its images, width and height, px: then c, x0, y0, K1, K2, P1, P2 are
        estimated from a start value of c of 1.2 times the longer side.
    sigma_px
        Standard deviation of an image coordinate, px.
    sigma_m
        Standard deviation of the coordinates of control points, m. None makes tie points of all of them: a
        free network, whose datum is the mean of their coordinates.
    point_names
        Names of the points; 1, 2, 3 ... where not given.
    image_names
        Names of the images; 1, 2, 3 ... where not given.
    check
        Names of points not used as control, which are compared with the result.

    Returns
    -------
    Block
        To be adjusted; the adjustment finds the orientations of the images.

    Raises
    ------
    ConfigurationError
        When the shapes of the arrays do not match.

    Examples
    --------
    >>> import numpy as np, photocal
    >>> points, pixels = np.zeros((4, 3)), np.zeros((2, 4, 2))
    >>> made = photocal.block_of_arrays(points, pixels, (4000, 3000), sigma_px=0.3, sigma_m=0.001)
    >>> len(made.observations.image)
    8
    """
    points, pixels = np.array(object_points, dtype=float), np.array(image_points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or pixels.ndim != 3 or pixels.shape[1:] != (len(points), 2):
        raise ConfigurationError(
            f"object_points has shape {points.shape}, image_points {pixels.shape}",
            "give shapes (n, 3) and (m, n, 2), with NaN where an image does not show a point",
        )
    count = len(pixels)
    if not isinstance(lens, Camera):
        start = {"c": 1.2 * max(lens)}
        lens = camera("camera", "brown-ideal", "px", lens, (1.0, 1.0), start, estimate=USUAL)
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

    Parameters
    ----------
    block
        Block to add to; it is not changed.
    kind
        "distance", "height_difference", "azimuth", "vertical_angle", "horizontal_angle" (at, from, to),
        "line" (from, to, and a point of it, which deviates by the value 0), or a kind of your own.
    rows
        Names of two points, or three, then value and standard deviation: m, or radians for angles; tuples, or
        a DataFrame with these columns in this order.
    related
        For a kind of your own: from the differences (n, 3) of the points, second less first, m, the values
        (n,) and their derivatives (n, 3) with respect to the second point.

    Returns
    -------
    Block
        The block with these observations.

    Raises
    ------
    ConfigurationError
        For an unknown kind without a function, an unknown point, or another number of cells.

    Examples
    --------
    >>> import photocal
    >>> first, second = block.points.names[:2]
    >>> scaled = photocal.with_relations(block, "distance", [(first, second, 1.2345, 0.0001)])
    >>> len(scaled.relations.values) - len(block.relations.values)
    1
    """
    if hasattr(rows, "itertuples"):
        rows = rows.itertuples(index=False, name=None)
    old = block.relations
    if related is not None and kind not in old.names:
        old = replace(old, further=(*old.further, (kind, related)))
    if kind not in old.names:
        raise ConfigurationError(
            f"{kind!r} is not a known kind of observation",
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

    The whole covariance is rigorous; nothing is scaled by the variance factor unless the global test rejects
    the stated standard deviations, and then both figures are given.

    Parameters
    ----------
    block
        Observations, start values and datum. What has no start value is found by resection and intersection.
    snooping
        Search for gross errors one by one: "w" with the standard deviations as they were given (Baarda),
        "tau" with those that the residuals show (Pope); None keeps all observations.
    components
        Estimate the standard deviation of each group of observations and adjust with those.

    Returns
    -------
    Result
        Adjusted cameras, images (rad, m), points (m) and residuals, tests and check points; `print` shows
        what matters, `result.plot` draws it.

    Raises
    ------
    IllPosedError
        When the observations do not determine the unknowns; the message names them.
    NotConvergedError
        When the iteration ends without reaching the minimum.
    ConfigurationError
        When the block contradicts itself.

    References
    ----------
    B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon: Bundle adjustment - a modern synthesis. Vision
    Algorithms 1999. W. Baarda: A testing procedure for use in geodetic networks. Delft 1968.

    Examples
    --------
    >>> import photocal
    >>> result = photocal.adjust(block)
    >>> result.converged
    True
    >>> camera = result.camera()
    >>> bool(0 < camera.sigma_of("c") < 0.01 * camera.value("c"))
    True
    """
    from photocal.block.options import Wanted
    from photocal.block.results.adjusted import adjust_network

    return adjust_network(block, snooping, Wanted(components=components))


def measure(images: str | Path, *, options: MeasureOptions | None = None) -> MeasuredBlock:
    """Measure images: tie points, marked control, boards or coded targets, as a block to be adjusted.

    Parameters
    ----------
    images
        Folder of the images, or a `project.toml`.
    options
        Control, board or field of targets, focal length (mm) or principal distance (px).

    Returns
    -------
    Measured
        The block, and the record of what was measured and left out.

    Raises
    ------
    ConfigurationError
        For options that contradict each other.
    InputNotFoundError, InputMalformedError
        For images or tables that cannot be read.
    IllPosedError
        When the images cannot be oriented.

    Examples
    --------
    >>> import photocal
    >>> board = photocal.MeasureOptions(board="10x7", square_m=0.03)
    >>> photocal.measure("boards", options=board).block.images.names
    ('view1.png', 'view2.png', 'view3.png', 'view4.png')
    """
    from photocal.base.progress_bars import progress
    from photocal.block.project import read_project
    from photocal.measurement.options import MeasureOptions
    from photocal.measurement.picture_block import measure as measured

    path = Path(images)
    return measured(
        read_project(path) if path.suffix == ".toml" else path, options or MeasureOptions(), progress
    )


def run_project(
    project: str | Path, *, until: str | None = None, again: str | None = None, rehash: bool = False
) -> tuple[StageResult, ...]:
    """Bring all stages of a project up to date.

    They are PPK, exposures, image points, calibration, check, analysis and certificate. A stage is kept while
    neither its inputs nor the code that it runs change.

    Parameters
    ----------
    project
        `project.toml`, or the folder that has it.
    until
        Last stage to run; all where not given.
    again
        Stage to run again although nothing has changed.
    rehash
        Hash all files again, even if their sizes and times are unchanged.

    Returns
    -------
    tuple of StageResult
        The result of each stage.

    Raises
    ------
    PhotocalError
        The error of the first stage that fails; stages that do not need it are still run.

    Examples
    --------
    >>> import photocal
    >>> [stage.name for stage in photocal.run_project("flight", until="exposures")]
    ['ppk', 'exposures']
    """
    import datetime as dt

    from photocal.base.progress import quiet
    from photocal.base.progress_bars import one_bar
    from photocal.block.project import read_project
    from photocal.run.campaign import run_project as brought_up_to_date

    today = dt.datetime.now().astimezone().date()
    return brought_up_to_date(read_project(Path(project)), today, quiet, until, again, rehash, bar=one_bar())


def read_result(folder: str | Path) -> Result:
    """Read the result of an adjustment.

    Parameters
    ----------
    folder
        Folder that `photocal adjust` or `write_result` wrote.

    Returns
    -------
    Result
        As it was when it was written.

    Raises
    ------
    InputNotFoundError
        When the folder or one of its files is missing or empty.
    InputMalformedError
        When a file has another schema, is truncated, has a text in place of a number, or contradicts another
        file.

    Examples
    --------
    >>> import photocal
    >>> photocal.read_result("run").converged
    True
    """
    from photocal.block.results.folder import read_result as read

    return read(Path(folder))


def write_result(folder: str | Path, result: Result) -> None:
    """Write `result.json` and its tables.

    Parameters
    ----------
    folder
        Folder to write, made where it is missing; an interrupted write leaves no incomplete result.
    result
        The result of an adjustment.

    Raises
    ------
    OutputError
        When the folder cannot be written.

    Examples
    --------
    >>> import photocal
    >>> photocal.write_result("run", result)
    """
    result.write(folder)


def read_log(path: str | Path, topics: Sequence[str] = ()) -> dict[str, dict[str, NDArray[Any]]]:
    """Read a flight log into arrays, one for each field of each topic.

    Parameters
    ----------
    path
        An MCAP file that `acquire record` or `acquire import` wrote.
    topics
        Topics to read; all whose messages have fields where not given.

    Returns
    -------
    dict
        By topic and field, arrays of shape (n,); `log_ns` and `publish_ns` are nanoseconds since 1970.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        For a file that is missing or no flight log.

    Examples
    --------
    >>> import photocal
    >>> fixes = photocal.read_log("flight/flight.mcap")["/gnss/rover/fix"]
    >>> len(fixes["altitude"]) == len(fixes["log_ns"])
    True
    """
    from acquire.log.reader import arrays_of_log

    return arrays_of_log(Path(path), frozenset(topics))
