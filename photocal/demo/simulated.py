"""`make demo`: a simulated flight recorded over real ports, processed, and compared with its truth."""

import csv
import datetime as dt
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from photocal.base.errors import DeviceError
from photocal.base.operating_system import CHILD_FLAGS, interrupt
from photocal.base.progress_bars import progress
from photocal.block.results.folder import read_result
from photocal.block.results.result import Result

_WITHIN = 3.0
_ACQUIRE = (sys.executable, "-c", "from acquire.commands.cli import main; main()")


@dataclass(frozen=True)
class ComparedQuantity:
    """One quantity.

    true, estimate, sigma: truth, estimate and its standard deviation.
    limit: largest deviation in standard deviations at which they agree.
    """

    name: str
    unit: str
    true: float
    estimate: float
    sigma: float
    limit: float = _WITHIN

    @property
    def deviation(self) -> float:
        """Estimate less truth in standard deviations."""
        return (self.estimate - self.true) / self.sigma

    @property
    def agrees(self) -> bool:
        """Whether the truth lies within the limit."""
        return abs(self.deviation) <= self.limit


def against_truth(truth: Path, work: Path) -> tuple[ComparedQuantity, ...]:
    """Compare a run with the truth of its flight."""
    true = json.loads((truth / "truth.json").read_text(encoding="utf-8"))
    result = read_result(work / "calibration")
    check = json.loads((work / "georeferencing" / "check.json").read_text(encoding="utf-8"))
    rows = [*_camera(true, result), *_mounting(true, result)]
    if (truth / "exposures.csv").is_file() and (work / "ppk").is_dir():
        rows += _positions(truth, work)
    return (*rows, *_check_points(check))


def _camera(true: dict[str, Any], result: Result) -> Iterator[ComparedQuantity]:
    camera = result.cameras[true["camera"]["id"]]
    for name in camera.free:
        rolls = name == "readout"
        value = float(true["rig"]["readout_s"] if rolls else true["camera"][camera.unit].get(name, 0.0))
        unit = "s" if rolls else camera.unit if name in ("c", "x0", "y0") else ""
        yield ComparedQuantity(name, unit, value, camera.value(name), camera.sigma_of(name))


def _mounting(true: dict[str, Any], result: Result) -> Iterator[ComparedQuantity]:
    rig, mounting = true["rig"], result.mounting or {}
    truths = [*rig["camera_to_antenna_m"], *rig["boresight_deg"], rig["time_offset_s"]]
    units = ["m"] * 3 + ["deg"] * 3 + ["s"]
    names = [f"{part}_{axis}" for part in ("lever_arm", "boresight") for axis in "xyz"]
    for name, value, unit in zip((*names, "time_offset"), truths, units, strict=True):
        parameter = mounting[name]
        if parameter.estimated:
            yield ComparedQuantity(name.replace("_", " "), unit, value, parameter.value, parameter.sigma)


def _positions(truth: Path, work: Path) -> Iterator[ComparedQuantity]:
    """Antenna positions at the events by PPK: root mean square of their errors against 3 cm."""
    true = {row["image"]: row for row in _rows(truth / "exposures.csv")}
    rows = _rows(work / "block" / "positions.csv")
    for axis, key, word in (
        ("X", "antenna_E", "east"),
        ("Y", "antenna_N", "north"),
        ("Z", "antenna_h", "height"),
    ):
        squares = [(float(row[axis]) - float(true[row["image"]][key])) ** 2 for row in rows]
        rms = math.sqrt(sum(squares) / len(squares))
        yield ComparedQuantity(f"antenna positions, rms {word}", "m", 0.0, rms, 0.03, 1.0)


def _check_points(check: dict[str, Any]) -> Iterator[ComparedQuantity]:
    """Check points by each method: the root of the mean of d' C^-1 d / 3 is 1 when the prediction holds."""
    for name, method in check["methods"].items():
        count = method["check"]["n"]
        ratio = method["check"]["errors_over_prediction"]
        if count and ratio is not None:
            # Points of one flight share errors: their mean square varies as that of one point at most.
            yield ComparedQuantity(f"{name}, check errors/prediction", "", 1.0, ratio, 1.0 / math.sqrt(6.0))


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def table(rows: tuple[ComparedQuantity, ...]) -> str:
    """Write the comparison for people."""
    lines = [f"{'':<36}{'truth':>13}{'found':>13}{'sigma':>11}{'deviation':>11}"]
    for row in rows:
        mark = "" if row.agrees else "  <--"
        cells = f"{_number(row.true):>13}{_number(row.estimate):>13}{_number(row.sigma):>11}"
        name = f"{row.name} {row.unit}".rstrip()
        lines.append(f"{name:<36}{cells}{row.deviation:>11.2f}{mark}")
    return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.3e}" if value and abs(value) < 1e-3 else f"{value:.5f}"


def simulated(plan: Path, output: Path, seed: int | None, speed: float) -> None:
    """Simulate, record, process, compare."""
    from photocal.run.campaign import run_one
    from photocal.run.summary import summary_text

    began = time.monotonic()
    flight = output / "flight"
    shutil.rmtree(flight, ignore_errors=True)
    typer.echo(
        "The flight is SIMULATED: terrain, vehicle, camera, satellites and links. Its truth is in truth/."
    )
    fly(plan, flight, seed)
    typer.echo(f"flown in {time.monotonic() - began:.1f} s: pictures, and the data of the links")
    record(flight, speed)
    typer.echo(
        f"recorded at {speed:g} times real time by `acquire record`: {flight / 'site' / 'flight.mcap'}"
    )
    day = dt.datetime.now().astimezone().date()
    figures = run_one(flight / "site" / "project.toml", day, progress=progress)
    typer.echo(f"\n{summary_text(figures)}")
    rows = against_truth(flight / "truth", flight / "site" / "work")
    typer.echo("\nFound against the truth, which the processing never saw:\n")
    typer.echo(table(rows))
    lost = [row.name for row in rows if not row.agrees]
    verdict = f"beyond the limits: {', '.join(lost)}" if lost else "all within three standard deviations"
    typer.echo(f"\n{verdict}")
    typer.echo(f"Done in {time.monotonic() - began:.1f} s.")


def fly(plan: Path, flight: Path, seed: int | None) -> None:
    """Simulate the flight into its folder."""
    from acquire.simulate.world.configuration import read_configuration
    from acquire.simulate.world.site import simulate_flight
    from photocal.base.files import output_folder

    given = read_configuration(plan, {} if seed is None else {"seed": seed})
    with progress("simulating", 1.0) as advance, output_folder(flight) as aside:
        simulate_flight(given, aside, advance)


def record(flight: Path, speed: float) -> None:
    """Let the devices speak on real ports and record them with the commands of the field.

    raises DeviceError: when the devices or the recorder fail.
    """
    settings = flight / "site" / "record.toml"
    serve = [*_ACQUIRE, "simulate", "serve", str(flight), "--speed", str(speed), "--linger", "1"]
    with _started(serve) as devices:
        try:
            start_s = 300.0
            limit = time.monotonic() + start_s
            while not settings.exists():
                _require(devices, limit, "the simulated devices did not start")
                time.sleep(0.05)
            writer = [*_ACQUIRE, "record", str(settings)]
            with _started(writer) as log:
                try:
                    _, errors = devices.communicate()
                    _succeeded(devices, errors)
                finally:
                    interrupt(log)
                    stop_s = 300.0
                    _, errors = log.communicate(timeout=stop_s)
                _succeeded(log, errors)
        finally:
            devices.kill()
    recorded = sorted((flight / "site" / "recording").glob("*.mcap"))
    if len(recorded) != 1:
        raise DeviceError(f"{len(recorded)} flight logs were recorded, one was expected", where=flight)
    recorded[0].replace(flight / "site" / "flight.mcap")


def _started(command: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(  # noqa: S603 - our own command
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, creationflags=CHILD_FLAGS
    )


def _require(process: subprocess.Popen[str], limit: float, what: str) -> None:
    if process.poll() is not None or time.monotonic() > limit:
        process.kill()
        _, errors = process.communicate()
        raise DeviceError(f"{what} ({errors.strip()})", "run `acquire simulate serve` by hand")


def _succeeded(process: subprocess.Popen[str], errors: str) -> None:
    if process.returncode != 0:
        raise DeviceError(f"the recording failed ({errors.strip()})", "check free ports and disk space")
