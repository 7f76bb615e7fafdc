"""`make demo`: a simulated flight recorded over real ports, processed, and compared with its truth."""

from __future__ import annotations

import datetime as dt
import shutil
import subprocess
import sys
import time
from pathlib import Path

import typer

from acquire.console import progress
from acquire.operating_system import CHILD_FLAGS, interrupt
from drivers.errors import DeviceError
from photocal.demo.truth import against_truth, table

_ACQUIRE = (sys.executable, "-c", "from acquire.cli import main; main()")
_START_S = 300.0
_STOP_S = 300.0


def simulated(plan: Path, output: Path, seed: int | None, speed: float) -> None:
    """Simulate, record, process, compare."""
    began = time.monotonic()
    flight = output / "flight"
    shutil.rmtree(flight, ignore_errors=True)
    say("The flight is SIMULATED: terrain, vehicle, camera, satellites and wires are computed, truth aside.")
    fly(plan, flight, seed)
    say(f"flown in {time.monotonic() - began:.1f} s: pictures, and what goes over the wires")
    record(flight, speed)
    say(f"recorded at {speed:g} times real time by `acquire record`: {flight / 'site' / 'flight.mcap'}")
    figures = process(flight / "site" / "project.toml")
    say("")
    say(figures)
    rows = against_truth(flight / "truth", flight / "site" / "work")
    say("\nFound against the truth, which the processing never saw:\n")
    say(table(rows))
    lost = [row.name for row in rows if not row.agrees]
    verdict = f"beyond the limits: {', '.join(lost)}" if lost else "all within three standard deviations"
    say(f"\n{verdict}")
    say(f"Done in {time.monotonic() - began:.1f} s.")


def say(text: str) -> None:
    """Tell a person."""
    typer.echo(text)


def fly(plan: Path, flight: Path, seed: int | None) -> None:
    """Simulate the flight into its folder."""
    from acquire.outputs import output_folder
    from acquire.simulate.world.configuration import read_configuration
    from acquire.simulate.world.site import simulate_flight

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
            limit = time.monotonic() + _START_S
            while not settings.exists():
                _require(devices, limit, "the simulated devices did not start")
                time.sleep(0.05)
            writer = [*_ACQUIRE, "record", str(settings)]
            with _started(writer) as log:
                try:
                    _, said = devices.communicate()
                    _succeeded(devices, said)
                finally:
                    interrupt(log)
                    _, said = log.communicate(timeout=_STOP_S)
                _succeeded(log, said)
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
        _, said = process.communicate()
        raise DeviceError(f"{what} ({said.strip()})", remedy="run `acquire simulate serve` by hand")


def _succeeded(process: subprocess.Popen[str], said: str) -> None:
    if process.returncode != 0:
        raise DeviceError(f"the recording failed ({said.strip()})", remedy="look at free ports and disk")


def process(project: Path) -> str:
    """Run a project and return its summary."""
    from photocal.run.campaign import run_one
    from photocal.run.summary import summary_text

    day = dt.datetime.now().astimezone().date()
    return summary_text(run_one(project, day, progress=progress))
