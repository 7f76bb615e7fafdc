"""Calibrations of several flights: their cameras for a comparison, and those of one used in another."""

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from photocal.analysis.stability.repeatability import Occasion, Repeatability, repeatability
from photocal.base.checked_toml import parse_toml
from photocal.base.errors import ConfigurationError, InputNotFoundError, PhotocalError
from photocal.block.project import read_project
from photocal.block.results.folder import CARRIED, RESULT, cameras_of_json, heads_of_json, read_result
from photocal.block.results.result import AdjustedHead
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.report.certificate_metadata import given_particulars
from photocal.report.issue import NAME, read_record

if TYPE_CHECKING:
    from photocal.analysis.stability.camera_file import CameraFile

_STAGE, _BLOCK = "calibration", "block"


@dataclass(frozen=True)
class Calibrated:
    """A flight whose camera was calibrated.

    day, temperature_c: of the calibration, where a certificate says them.
    camera_temperature_c: of lens or sensor, by the pictures; median.
    """

    name: str
    block: Path
    cameras: dict[str, Camera]
    day: dt.date | None = None
    temperature_c: float | None = None
    camera_temperature_c: float | None = None
    heads: tuple[AdjustedHead, ...] = ()


@dataclass(frozen=True)
class Use:
    """Camera and mounting of one flight used for direct georeferencing of another.

    of, used_in: names of the flights; the same for the calibration on the job.
    rmse_m, predicted_m: X, Y, Z; the prediction contains the survey's own sigma.
    ratio: errors over prediction: 1 when they are as large as predicted.
    """

    of: str
    used_in: str
    points: int
    rmse_m: tuple[float, ...]
    predicted_m: tuple[float, ...]
    ratio: float


def is_camera_file(path: Path) -> bool:
    """Whether a path is a file of `[[camera]]` entries, not a run folder, a work folder or a project."""
    if path.is_dir() or path.name == NAME:
        return False
    try:
        return "project" not in parse_toml(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        # What is wrong with it is said by its reader.
        return True


def read_calibrated(paths: Sequence[Path]) -> tuple[Calibrated, ...]:
    """Find the calibrations of certificates, run folders, work folders and projects.

    raises InputNotFoundError: when there is no calibration, or fewer than two.
    raises ConfigurationError: when two are the same, such as a run and its own certificate.
    """
    flights: list[Calibrated] = []
    for path in paths:
        flight = _calibrated(path)
        if same := next((other for other in flights if _same(flight.cameras, other.cameras)), None):
            raise ConfigurationError(
                f"is the same calibration as {same.name}", "name that of another flight", where=path
            )
        taken = sum(flight.name == other.name for other in flights)
        flights.append(replace(flight, name=f"{flight.name} ({path})") if taken else flight)
    if len(flights) < 2:
        raise InputNotFoundError("one calibration cannot be compared", "name two or more runs or projects")
    return tuple(flights)


def _same(ours: dict[str, Camera], theirs: dict[str, Camera]) -> bool:
    """Whether an adjustment has given both, to its last digit."""
    return ours.keys() == theirs.keys() and all(
        camera.sigma is not None
        and (sigma := theirs[name].sigma) is not None
        and camera.sigma.any()
        and np.array_equal(camera.values, theirs[name].values)
        and np.array_equal(camera.sigma, sigma)
        for name, camera in ours.items()
    )


def _calibrated(path: Path) -> Calibrated:
    name = path.resolve().name
    if path.name == NAME or (path / NAME).is_file():
        return _certified(path)
    if path.is_file():
        project = read_project(path)
        name, path = project.name, project.output
    run = path / _STAGE if (path / _STAGE / RESULT).is_file() else path
    if not (run / RESULT).is_file():
        raise InputNotFoundError(
            f"has no {RESULT}", "run `photocal run` or `photocal adjust` first", where=path
        )
    result = read_result(run)
    source = result.block.source
    block = run / source if source else path / _BLOCK
    return Calibrated(name, block, result.cameras, heads=result.heads)


def _certified(path: Path) -> Calibrated:
    """A calibration as its certificate has it: on the day of measurement, or else of the issue."""
    content, folder = read_record(path)
    given = given_particulars(content["particulars"], content["date"])
    return Calibrated(
        f"{content['number']}",
        folder / CARRIED,
        cameras_of_json(content["result"]["cameras"], folder / NAME),
        given.laboratory.measured or given.date,
        given.conditions.temperature_c,
        given.conditions.camera_temperature_c,
        heads_of_json(content["result"].get("heads", []), folder / NAME),
    )


def cameras_of(flights: Sequence[Calibrated]) -> "CameraFile":
    """Give the calibrated cameras to the comparison, with sigmas and correlations.

    raises ConfigurationError: when a result cannot be compared.
    """
    from photocal.analysis.stability.camera_file import CameraFile, Comparison

    calibrations = tuple(
        replace(camera, id=f"{flight.name} {name}" if len(flight.cameras) > 1 else flight.name)
        for flight in flights
        for name, camera in flight.cameras.items()
    )
    return CameraFile(calibrations, (), Comparison())


def repeated(flights: Sequence[Calibrated]) -> dict[str, tuple[Repeatability, ...]]:
    """Judge how each camera repeats from flight to flight: those of one name are one."""
    alone = all(len(flight.cameras) == 1 for flight in flights)
    # Of the camera where all tell it: the air says less, and the two are not compared.
    own = all(flight.camera_temperature_c is not None for flight in flights)
    occasions: dict[str, list[Occasion]] = {}
    for flight in flights:
        for name, camera in flight.cameras.items():
            warm = flight.camera_temperature_c if own else flight.temperature_c
            occasions.setdefault("camera" if alone else name, []).append((camera, flight.day, warm))
    return {name: repeats for name, series in occasions.items() if (repeats := repeatability(series))}


def exchanged(flights: Sequence[Calibrated], done: Callable[[], None] = lambda: None) -> tuple[Use, ...]:
    """Georeference every flight directly with the calibration of every one, judged at its check points.

    raises PhotocalError: when a flight has no positions, attitudes or check points.
    """
    from photocal.analysis.georeferencing.comparison import differences
    from photocal.analysis.georeferencing.methods import of_method
    from photocal.block.folder import read_block
    from photocal.run.georeferencing import calibrated_on_the_job

    prepared = [calibrated_on_the_job(read_block(flight.block)) for flight in flights]
    uses = []
    for i, giver in enumerate(flights):
        for j, taker in enumerate(flights):
            block, calibration = prepared[j][0], prepared[i][1]
            # What the giver's positions had in common stays with them.
            carried = calibration if i == j else calibration.on_flight(block.mounting)
            try:
                check = differences(block, of_method(block, "direct", calibration=carried), "check")
            except PhotocalError as refusal:
                raise type(refusal)(f"{taker.name}: {refusal.what}", remedy=refusal.remedy) from refusal
            if not check.names:
                raise ConfigurationError(f"{taker.name} has no check points", "give points the role check")
            variance = np.diagonal(check.covariance, axis1=1, axis2=2)
            uses.append(
                Use(
                    giver.name,
                    taker.name,
                    len(check.names),
                    tuple(check.rmse.tolist()),
                    tuple(np.sqrt(variance.mean(axis=0)).tolist()),
                    check.ratio,
                )
            )
            done()
    return tuple(uses)


def uses_text(uses: Sequence[Use], say: Catalogue) -> str:
    """Write them for people: one line for each pair."""
    lines = [say("compared.uses")]
    for use in uses:
        cells = ", ".join(
            f"{1e3 * r:.0f}/{1e3 * p:.0f}" for r, p in zip(use.rmse_m, use.predicted_m, strict=True)
        )
        where = say("compared.itself") if use.of == use.used_in else use.used_in
        of = {"of": use.of, "used_in": where, "points": use.points}
        lines.append(say.told("compared.use", **of, cells=cells, ratio=use.ratio))
    return "\n".join(lines)
