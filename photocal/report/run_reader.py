"""The folder that `photocal adjust` left, read and checked."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.report.run import (
    ANALYSIS,
    RESULT,
    CameraResult,
    Exposures,
    InputFile,
    Points,
    Residuals,
    Result,
    Run,
)
from photocal.report.stored_analysis import StoredAnalysis
from photocal.report.tables import read_table

SCHEMA = "photocal.adjustment/1"
ANALYSIS_SCHEMA = "photocal.analysis/1"
COVARIANCE = "covariance.parquet"
AGAIN = "run `photocal adjust` again"

Kind = TypeVar("Kind")


def read_run(folder: Path) -> Run:
    """Read the folder that `photocal adjust` wrote, with what `photocal analyse` added.

    Parameters
    ----------
    folder : Path
        The folder with result.json, images.csv, points.csv and residuals.csv, perhaps analysis.json.

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
    run = read_adjustment(folder)
    if not (folder / ANALYSIS).is_file():
        return run
    return replace(run, files=(*run.files, _fingerprint(folder / ANALYSIS)), analysis=_analysis(folder))


def read_adjustment(folder: Path) -> Run:
    """Read the folder that `photocal adjust` wrote, whatever analysis lies in it."""
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
    return _json(path, Result, SCHEMA)


def _analysis(folder: Path) -> StoredAnalysis:
    """The analysis of this very run: one of an earlier run would say something else."""
    path = folder / ANALYSIS
    stored = _json(path, StoredAnalysis, ANALYSIS_SCHEMA)
    if stored.result_sha256 != _fingerprint(folder / RESULT).sha256:
        raise InputMalformedError(
            "belongs to another run: result.json has changed since",
            where=path,
            remedy="run `photocal analyse` again",
        )
    return stored


def _json(path: Path, kind: type[Kind], schema: str) -> Kind:
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
    _known_schema(figures, schema, path)
    try:
        return TypeAdapter(kind).validate_json(text, strict=True)
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


def _known_schema(figures: Any, expected: str, path: Path) -> None:
    schema = figures.get("schema") if isinstance(figures, dict) else None
    if schema != expected:
        raise InputMalformedError(
            f"schema is {schema!r}, {expected!r} was expected",
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
    """Residuals of the rays that took part: those of rejected ones are empty."""
    numbers = ("x", "y", "vx", "vy", "rx", "ry", "wx", "wy")
    table = read_table(path, ("image", "point"), numbers, numbers[2:])
    part = np.flatnonzero(np.isfinite(table.numbers[:, 2:4]).all(axis=1))
    n = table.numbers[part]
    image, point = (tuple(table.texts[name][k] for k in part) for name in ("image", "point"))
    return Residuals(image, point, n[:, 0:2], n[:, 2:4], n[:, 4:6], n[:, 6:8])


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
