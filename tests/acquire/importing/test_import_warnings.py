"""What an import warns of, and that damage does not fill the memory."""

from __future__ import annotations

import datetime as dt
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from acquire.importing.importer import import_recordings
from drivers import nmea

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def test_times_beyond_the_table_of_leap_seconds_are_warned_of(acquire: Acquire, tmp_path: Path) -> None:
    for year, warned in ((2025, False), (2031, True)):
        source = tmp_path / f"{year}.nmea"
        source.write_bytes(nmea.encode(f"GPZDA,090000.00,01,05,{year},00,00") * 3)
        done = acquire("import", source, "-o", tmp_path / f"{year}.mcap", "--json")
        assert done.returncode == 0
        assert ("leap seconds" in done.stderr) == warned
        assert bool(json.loads(done.stdout)["links"][0]["warning"]) == warned


def test_damage_records_are_bounded(tmp_path: Path) -> None:
    source = tmp_path / "rover.nmea"
    sentence = nmea.encode("GPZDA,090000.00,01,05,2025,00,00")
    source.write_bytes((sentence + b"damage") * 1000)
    (result,) = import_recordings([], [source], tmp_path / "out.mcap", lambda _: None)
    assert result.tally.damage_runs == 1000
    assert result.tally.damage_bytes == 6000
    assert result.tally.damage == [[n * (len(sentence) + 6) + len(sentence), 6] for n in range(200)]


def test_a_date_that_is_given_completes_times_of_day(acquire: Acquire, tmp_path: Path) -> None:
    """Two minutes around midnight at the end of the day that is given."""
    source, log = tmp_path / "rover.nmea", tmp_path / "out.mcap"
    times = ("235900.00", "235959.00", "000001.00", "000100.00")
    sentences = [nmea.encode(f"GPGGA,{t},4730.0,N,00830.0,E,1,08,1.0,400.0,M,47.0,M,,") for t in times]
    source.write_bytes(b"".join(sentences))
    done = acquire("import", source, "--date", "2024-02-29", "-o", log)
    assert done.returncode == 0, done.stderr
    with log.open("rb") as stream:
        found = [m.log_time for _, _, m in make_reader(stream).iter_messages(topics=["/rover/raw"])]
    before, after = dt.datetime(2024, 2, 29, 23, 59, tzinfo=dt.UTC), dt.datetime(2024, 3, 1, tzinfo=dt.UTC)
    moments = [before, before.replace(second=59), after.replace(second=1), after.replace(minute=1)]
    assert found == [int(moment.timestamp()) * 1_000_000_000 for moment in moments]
    assert "the date as it was given" in done.stdout


@pytest.mark.parametrize(
    ("date", "told"), [("2025-05-01", False), ("2025-05-02", True), ("2024-05-01", True)]
)
def test_a_date_that_the_recording_contradicts_is_said(
    acquire: Acquire, tmp_path: Path, date: str, told: bool
) -> None:
    source = tmp_path / "rover.nmea"
    source.write_bytes(nmea.encode("GPZDA,090000.00,01,05,2025,00,00") * 3)
    done = acquire("import", source, "--date", date, "-o", tmp_path / "out.mcap")
    assert done.returncode == 0
    said = "warning: rover: the recording states its own date, 2025-05-01: the one of --date is not used"
    assert (said in done.stderr) == told


def test_a_date_that_is_none_is_refused(acquire: Acquire, tmp_path: Path) -> None:
    (tmp_path / "rover.nmea").write_bytes(nmea.encode("GPZDA,090000.00,01,05,2025,00,00"))
    done = acquire("import", tmp_path / "rover.nmea", "--date", "01.05.2025", "-o", tmp_path / "out.mcap")
    assert done.returncode == 5
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out.mcap").exists()
