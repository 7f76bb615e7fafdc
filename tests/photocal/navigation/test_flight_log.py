"""A flight log is read once, by name, and each message decoded in one place."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import photocal
from acquire.importing.importer import import_recordings
from acquire.log.reader import LogReader
from drivers.frames import Wire
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.errors import InputNotFoundError
from photocal.navigation.exposure_run import ExposureChoices, run_exposures
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk_inputs import Sources
from tests.telemetry import telemetry_log

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    source = folder / "vehicle.tlog"
    source.write_bytes(telemetry_log(ardupilotmega()))
    import_recordings([], [source], folder / "flight.mcap", lambda _: None)
    return folder / "flight.mcap"


def test_the_exposures_open_the_log_once(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: Counter[str] = Counter()
    plain = Path.open

    def counted(path: Path, *arguments: Any, **options: Any) -> Any:
        opened[path.name] += 1
        return plain(path, *arguments, **options)

    monkeypatch.setattr(Path, "open", counted)
    run = run_exposures(ExposureChoices(Sources(FlightLog((log,)))), tmp_path)
    assert len(run.exposures.images) > 5
    assert opened[log.name] == 1


def test_only_what_is_asked_for_is_taken_out_of_the_log(log: Path) -> None:
    everything = {part.channel.topic for chunk in LogReader(log).chunks() for part in chunk}
    asked = {"/camera/exposure"}
    reader = LogReader(log, wanted=lambda channel: channel.topic in asked)
    assert {part.channel.topic for chunk in reader.chunks() for part in chunk} == asked < everything
    flight = FlightLog((log,))
    raw = [payload for _, part in flight.raw(Wire.MAVLINK) for payload in part.payloads]
    parts = [part for chunk in LogReader(log).chunks() for part in chunk]
    assert raw == [p for part in parts if part.channel.topic == "/vehicle/raw" for p in part.payloads]
    assert len(list(flight.topic("/camera/exposure"))) > 0


def test_a_flight_log_is_tables_of_its_topics(log: Path) -> None:
    flight = FlightLog.read(str(log))
    assert repr(flight) == f"FlightLog of 1 file(s): {log}"
    once, twice = flight.tables(), FlightLog.read([log, log]).tables("/camera/exposure")
    rows = len(photocal.read_log(log)["/camera/exposure"]["log_ns"])
    assert once["/camera/exposure"].num_rows == rows > 0
    assert twice["/camera/exposure"].num_rows == 2 * rows
    assert list(twice) == ["/camera/exposure"]
    with pytest.raises(InputNotFoundError, match="does not exist"):
        FlightLog.read(log.with_name("none.mcap"))
    assert repr(FlightLog()) == "FlightLog without files"


def test_time_marks_are_decoded_in_one_place() -> None:
    """The fields of TIM-TM2 are named by the table of the decoder and by who makes them, by nobody else."""
    naming = set()
    for package in ("acquire", "drivers", "photocal"):
        for path in sorted((ROOT / package).rglob("*.py")):
            texts = {n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)}
            if texts & {"towMsR", "towSubMsR", "towMs", "wnR"}:
                naming.add(path.relative_to(ROOT).as_posix())
    assert naming <= {"drivers/ubx/decode.py", "acquire/simulate/gnss/streams.py"}
