"""What an import warns of, and that damage does not fill the memory."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

from acquire.importing.importer import import_recordings
from drivers import nmea

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def test_times_beyond_the_table_of_leap_seconds_are_warned_of(acquire: Acquire, tmp_path: Path) -> None:
    for year, warned in ((2025, False), (2031, True)):
        source = tmp_path / f"{year}.nmea"
        source.write_bytes(nmea.encode(f"GPZDA,090000.00,01,05,{year},00,00") * 3)
        done = acquire("import", source, "-o", tmp_path / "out.mcap", "--json")
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
