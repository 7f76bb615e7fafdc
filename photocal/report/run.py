"""The results of an adjustment as `photocal adjust` left them in a folder, read and checked."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.report.tables import read_table

Floats = NDArray[np.float64]

SCHEMA = "photocal.adjustment/1"
RESULT = "result.json"
COVARIANCE = "covariance.parquet"
AGAIN = "run `photocal adjust` again"


@dataclass(frozen=True)
class Software:
    """The program that made the results."""

    name: str
    version: str


@dataclass(frozen=True)
class BlockFacts:
    """What the adjusted block said of itself: its name, frame, heights, datum and observation unit."""

    name: str
    frame: str
    datum: str
    observation_unit: Literal["mm", "px"]
    observation_axes: Literal["pixel", "photo"]
    height: str = ""


@dataclass(frozen=True)
class InputFile:
    """One file that the adjustment read: path within the block folder, SHA-256 and size in bytes."""

    path: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class GlobalTest:
    """Two-sided chi-squared test of the variance of unit weight."""

    probability: float
    lower: float
    upper: float
    accepted: bool
    p_value: float


@dataclass(frozen=True)
class Group:
    """One kind of observations and its part of the weighted sum of squares."""

    name: str
    observations: int
    chi_squared: float
    redundancy: float


@dataclass(frozen=True)
class Parameter:
    """Value, a priori scaled standard deviation and that of a prior value, in the camera's unit."""

    value: float
    sigma: float
    estimated: bool
    prior_sigma: float | None = None


@dataclass(frozen=True)
class Correlation:
    """Correlation matrix of the estimated camera parameters, in the order of `names`."""

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class CameraResult:
    """Interior orientation of one camera after the adjustment; unit and signs as in the block."""

    model: Literal["brown-observed", "brown-ideal"]
    unit: Literal["mm", "px"]
    size_px: tuple[int, int]
    parameters: dict[str, Parameter]
    correlation: Correlation
    pitch_mm: tuple[float, float] | None = None
    reference_radius: float = 0.0
    affinity: str = "additive"
    affinity_form: str = "fraser"

    def value(self, name: str) -> float:
        """Value of a parameter; 0 for one that the model does not have."""
        return self.parameters[name].value if name in self.parameters else 0.0

    @property
    def pitch(self) -> tuple[float, float]:
        """Size of a pixel in x and y, in the unit of the camera."""
        return (1.0, 1.0) if self.unit == "px" or self.pitch_mm is None else self.pitch_mm


@dataclass(frozen=True)
class ImageRms:
    """Root mean square of the residuals of one image, in the unit of the observations."""

    image: str
    rays: int
    rms_x: float
    rms_y: float


@dataclass(frozen=True)
class ImageSummary:
    """Number of images and the residuals of each."""

    n: int
    rms: tuple[ImageRms, ...]


@dataclass(frozen=True)
class CheckPoint:
    """Adjusted minus surveyed coordinates of a check point; standard deviations of the adjusted ones, m."""

    point: str
    dx: float
    dy: float
    dz: float
    sx: float
    sy: float
    sz: float


@dataclass(frozen=True)
class CheckSummary:
    """Check points and their root mean square differences, m (none without points)."""

    n: int
    rmse_m: dict[str, float | None]
    points: tuple[CheckPoint, ...] = ()


@dataclass(frozen=True)
class Result:
    """The content of `result.json`; without redundancy there is no variance factor and no test."""

    schema: str
    software: Software
    block: BlockFacts
    inputs: tuple[InputFile, ...]
    converged: bool
    iterations: int
    observations: int
    unknowns: int
    degrees_of_freedom: int
    chi_squared: float
    sigma0_squared: float | None
    global_test: GlobalTest | None
    groups: tuple[Group, ...]
    cameras: dict[str, CameraResult]
    images: ImageSummary
    checks: CheckSummary


@dataclass(frozen=True)
class Exposures:
    """Adjusted exterior orientations of n images.

    Attributes
    ----------
    image, camera : tuple of str
        Names, in the order of the rows.
    position_m, position_sigma_m : ndarray, shape (n, 3)
        Projection centres X, Y, Z and their standard deviations.
    angles_deg, angles_sigma_deg : ndarray, shape (n, 3)
        omega, phi, kappa and their standard deviations.
    """

    image: tuple[str, ...]
    camera: tuple[str, ...]
    position_m: Floats
    position_sigma_m: Floats
    angles_deg: Floats
    angles_sigma_deg: Floats


@dataclass(frozen=True)
class Points:
    """Adjusted object points: role, coordinates and standard deviations (m, shape (n, 3)), number of rays."""

    point: tuple[str, ...]
    role: tuple[str, ...]
    position_m: Floats
    sigma_m: Floats
    rays: Floats


@dataclass(frozen=True)
class Residuals:
    """Image residuals (computed minus measured) in the unit and axes of the observations, shape (n, 2) each.

    Attributes
    ----------
    image, point : tuple of str
        Which ray each row is.
    measured, residual : ndarray, shape (n, 2)
        Measured coordinates and residuals.
    redundancy, standardised : ndarray, shape (n, 2)
        Redundancy numbers (0 to 1) and standardised residuals; nan where no other observation checks one.
    """

    image: tuple[str, ...]
    point: tuple[str, ...]
    measured: Floats
    residual: Floats
    redundancy: Floats
    standardised: Floats


@dataclass(frozen=True)
class Run:
    """Everything that a certificate says about an adjustment.

    Attributes
    ----------
    result : Result
        Figures of the whole adjustment and of the cameras.
    exposures : Exposures
        Exterior orientations.
    points : Points
        Object points.
    residuals : Residuals
        Image residuals.
    files : tuple of InputFile
        The files of the folder themselves, with their SHA-256.
    """

    result: Result
    exposures: Exposures
    points: Points
    residuals: Residuals
    files: tuple[InputFile, ...]


def read_run(folder: Path) -> Run:
    """Read the folder that `photocal adjust` wrote.

    Parameters
    ----------
    folder : Path
        The folder with result.json, images.csv, points.csv and residuals.csv.

    Returns
    -------
    Run
        The checked content.

    Raises
    ------
    InputNotFoundError
        When the folder or one of its files is missing or empty.
    InputMalformedError
        When a file is of another schema, cut, not a number where one must stand, or contradicts another.
    """
    if not folder.exists():
        raise InputNotFoundError(
            "no such folder", where=folder, remedy="give the folder that `photocal adjust` wrote"
        )
    if not folder.is_dir():
        raise InputNotFoundError(
            "is a file, a folder was expected", where=folder, remedy="give the folder of the run"
        )
    result = _result(folder / RESULT)
    exposures = _exposures(folder / "images.csv")
    points = _points(folder / "points.csv")
    table = folder / "residuals.parquet"
    table = table if table.is_file() else folder / "residuals.csv"
    residuals = _residuals(table)
    names = [RESULT, "images.csv", "points.csv", table.name]
    if (folder / COVARIANCE).is_file():
        names.append(COVARIANCE)
    run = Run(result, exposures, points, residuals, tuple(_fingerprint(folder / name) for name in names))
    _agree(run, folder)
    return run


def _result(path: Path) -> Result:
    from pydantic import TypeAdapter, ValidationError

    text = _text(path)
    try:
        figures = json.loads(text, parse_constant=_not_a_number)
    except json.JSONDecodeError as broken:
        raise InputMalformedError(
            f"is not complete JSON ({broken.msg})", where=f"{path}, line {broken.lineno}", remedy=AGAIN
        ) from None
    except ValueError as broken:
        raise InputMalformedError(str(broken), where=path, remedy=AGAIN) from None
    _known_schema(figures, path)
    try:
        return TypeAdapter(Result).validate_json(text, strict=True)
    except ValidationError as refusal:
        first = refusal.errors()[0]
        place = ".".join(str(step) for step in first["loc"])
        raise InputMalformedError(f"{place}: {first['msg']}", where=path, remedy=AGAIN) from None


def _text(path: Path) -> str:
    if not path.is_file():
        raise InputNotFoundError(
            "no such file", where=path, remedy="give the folder that `photocal adjust` wrote"
        )
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as broken:
        raise InputMalformedError(
            "is not UTF-8 text", where=f"{path}, byte {broken.start}", remedy=AGAIN
        ) from None
    if not text.strip():
        raise InputNotFoundError("the file is empty", where=path, remedy=AGAIN)
    return text


def _not_a_number(constant: str) -> float:
    raise ValueError(f"contains {constant} where a number must stand")


def _known_schema(figures: Any, path: Path) -> None:
    schema = figures.get("schema") if isinstance(figures, dict) else None
    if schema != SCHEMA:
        raise InputMalformedError(
            f"schema is {schema!r}, {SCHEMA!r} was expected",
            where=path,
            remedy="adjust with this version of photocal",
        )


def _exposures(path: Path) -> Exposures:
    table = read_table(
        path,
        ("image", "camera"),
        ("X", "Y", "Z", "omega", "phi", "kappa", "sX", "sY", "sZ", "so", "sp", "sk"),
    )
    n = table.numbers
    return Exposures(table.texts["image"], table.texts["camera"], n[:, 0:3], n[:, 6:9], n[:, 3:6], n[:, 9:12])


def _points(path: Path) -> Points:
    table = read_table(path, ("point", "role"), ("X", "Y", "Z", "sX", "sY", "sZ", "rays"))
    n = table.numbers
    return Points(table.texts["point"], table.texts["role"], n[:, 0:3], n[:, 3:6], n[:, 6])


def _residuals(path: Path) -> Residuals:
    table = read_table(
        path, ("image", "point"), ("x", "y", "vx", "vy", "rx", "ry", "wx", "wy"), ("rx", "ry", "wx", "wy")
    )
    n = table.numbers
    return Residuals(table.texts["image"], table.texts["point"], n[:, 0:2], n[:, 2:4], n[:, 4:6], n[:, 6:8])


def _fingerprint(path: Path) -> InputFile:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return InputFile(path.name, digest, path.stat().st_size)


def _agree(run: Run, folder: Path) -> None:
    """Refuse tables that contradict each other: most often one of them was cut or belongs to another run."""
    result = run.result
    _same_count(folder / "images.csv", len(run.exposures.image), result.images.n, "images")
    image = [group.observations for group in result.groups if group.name == "image"]
    if image:
        _same_count(folder / "residuals.csv", 2 * len(run.residuals.image), image[0], "image observations")
    if stray := sorted(set(run.residuals.image) - set(run.exposures.image)):
        raise InputMalformedError(
            f"image {stray[0]} is not in images.csv", where=folder / "residuals.csv", remedy=AGAIN
        )
    if stray := sorted(set(run.exposures.camera) - set(result.cameras)):
        raise InputMalformedError(
            f"camera {stray[0]} is not in result.json", where=folder / "images.csv", remedy=AGAIN
        )
    for name, camera in result.cameras.items():
        _sound_camera(name, camera, folder / RESULT)


def _same_count(path: Path, found: int, expected: int, what: str) -> None:
    if found != expected:
        raise InputMalformedError(
            f"has {found} {what}, result.json says {expected}",
            where=path,
            remedy=f"the table was cut; {AGAIN}",
        )


def _sound_camera(name: str, camera: CameraResult, path: Path) -> None:
    n = len(camera.correlation.names)
    where = f"{path}, camera {name}"
    if "c" not in camera.parameters or not camera.parameters["c"].value > 0.0:
        raise InputMalformedError("has no positive principal distance c", where=where, remedy=AGAIN)
    if camera.unit == "mm" and (camera.pitch_mm is None or not min(camera.pitch_mm) > 0.0):
        raise InputMalformedError(
            "has no positive pixel pitch", where=where, remedy="give pitch_mm in block.toml"
        )
    if len(camera.correlation.matrix) != n or any(len(row) != n for row in camera.correlation.matrix):
        raise InputMalformedError(f"correlation matrix is not {n} by {n}", where=where, remedy=AGAIN)
    estimated = [key for key, parameter in camera.parameters.items() if parameter.estimated]
    if sorted(estimated) != sorted(camera.correlation.names):
        raise InputMalformedError(
            "correlation names differ from the estimated parameters", where=where, remedy=AGAIN
        )
    for key, parameter in camera.parameters.items():
        if not (math.isfinite(parameter.sigma) and parameter.sigma >= 0.0):
            raise InputMalformedError(f"sigma of {key} is negative", where=where, remedy=AGAIN)
