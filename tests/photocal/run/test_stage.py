"""Stages: whole or not there, made again exactly when something that they depend on has changed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from photocal.base.errors import InputNotFoundError, OutputError
from photocal.base.progress import Progress
from photocal.run.stage import (
    Digests,
    Stage,
    alone,
    foreseen,
    made_in,
    update_stage,
)
from tests.photocal.run.toy_stages import sequence


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Any]:
    yield lambda _: None


class Shouting:
    """A stage that writes its input in capitals and counts how often."""

    def __init__(self, folder: Path) -> None:
        self.made = 0
        self.work = folder / "work"
        self.source = folder / "input.txt"
        self.source.write_text("one", encoding="utf-8")
        self.stage = Stage("shout", "shouting", self.make, {"text": self.source}, {"times": 1})

    def make(self, out: Path, _: Progress) -> None:
        self.made += 1
        (out / "loud.txt").write_text(self.source.read_text(encoding="utf-8").upper(), encoding="utf-8")

    def bring(self, stage: Stage | None = None, *, again: bool = False) -> bool:
        digests = Digests(self.work / "digests.json")
        return update_stage(stage or self.stage, self.work, digests, quiet, again=again).kept


@pytest.fixture
def shouting(tmp_path: Path) -> Shouting:
    return Shouting(tmp_path)


def test_nothing_changed_nothing_made(shouting: Shouting) -> None:
    assert not shouting.bring()
    assert shouting.bring()
    # The same content under a new time is no change.
    shouting.source.write_text("one", encoding="utf-8")
    assert shouting.bring()
    assert shouting.made == 1


def test_content_settings_and_request_make_it_again(shouting: Shouting) -> None:
    shouting.bring()
    shouting.source.write_text("two", encoding="utf-8")
    assert not shouting.bring()
    assert (shouting.work / "shout" / "loud.txt").read_text(encoding="utf-8") == "TWO"
    assert not shouting.bring(replace(shouting.stage, settings={"times": 2}))
    assert not shouting.bring(replace(shouting.stage, settings={"times": 2}), again=True)
    assert shouting.made == 4


def test_a_changed_result_is_set_aside(shouting: Shouting) -> None:
    shouting.bring()
    loud = shouting.work / "shout" / "loud.txt"
    loud.write_text("FORGED", encoding="utf-8")
    result = update_stage(shouting.stage, shouting.work, Digests(shouting.work / "digests.json"), quiet)
    assert loud.read_text(encoding="utf-8") == "ONE"
    assert loud.with_name("loud.kept-1.txt").read_text(encoding="utf-8") == "FORGED"
    assert "kept as loud.kept-1.txt" in result.foreign[0]


def test_what_others_put_there_stays_and_is_named(shouting: Shouting) -> None:
    shouting.bring()
    signed = shouting.work / "shout" / "loud-signed.txt"
    signed.write_text("signed", encoding="utf-8")
    shouting.source.write_text("two", encoding="utf-8")
    result = update_stage(shouting.stage, shouting.work, Digests(shouting.work / "digests.json"), quiet)
    assert signed.read_text(encoding="utf-8") == "signed"
    assert result.foreign == ("loud-signed.txt does not belong to this run and stays",)


def test_random_edits_end_as_a_run_from_nothing(tmp_path: Path) -> None:
    for seed in range(24):
        assert sequence(tmp_path / str(seed), seed) == []


def test_a_later_stage_follows_the_results_of_the_earlier(shouting: Shouting) -> None:
    shouting.bring()
    later = Stage("later", "", lambda out, _: (out / "x").touch(), after=(made_in(shouting.work) / "shout",))
    assert not shouting.bring(later)
    # Made again with the same result: what follows is kept.
    shouting.bring(again=True)
    assert shouting.bring(later)
    shouting.source.write_text("two", encoding="utf-8")
    shouting.bring()
    assert not shouting.bring(later)


def test_what_will_be_made_is_foreseen(shouting: Shouting, tmp_path: Path) -> None:
    first = shouting.stage
    later = Stage("later", "", lambda *_: None, after=(made_in(shouting.work) / first.name,))
    other = Stage("other", "", lambda *_: None, {"input": shouting.source})
    apart = Stage("apart", "", lambda *_: None)
    whole = (first, later, other, apart)
    assert foreseen(whole, shouting.work, Digests(shouting.work / "d")) == {s.name for s in whole}
    for stage in whole:
        update_stage(stage, shouting.work, Digests(shouting.work / "d"), quiet)
    assert foreseen(whole, shouting.work, Digests(shouting.work / "d")) == set()
    assert foreseen(whole, shouting.work, Digests(shouting.work / "d"), "other") == {"other"}
    shouting.source.write_text("changed", encoding="utf-8")
    assert foreseen(whole, shouting.work, Digests(shouting.work / "d")) == {first.name, "later", "other"}
    shouting.source.unlink()
    assert foreseen(whole, shouting.work, Digests(shouting.work / "d")) == {first.name, "later", "other"}


def test_a_failing_stage_leaves_the_old_result(shouting: Shouting) -> None:
    shouting.bring()

    def fail(out: Path, _: Progress) -> None:
        (out / "half").touch()
        raise OutputError("broken")

    with pytest.raises(OutputError):
        shouting.bring(replace(shouting.stage, make=fail), again=True)
    assert sorted(p.name for p in made_in(shouting.work).iterdir() if p.is_dir()) == ["shout"]
    assert shouting.bring()


def test_a_missing_input_is_named(shouting: Shouting) -> None:
    shouting.source.unlink()
    with pytest.raises(InputNotFoundError, match="text does not exist"):
        shouting.bring()


def test_who_has_not_imported_the_recordings_is_told_how(shouting: Shouting, tmp_path: Path) -> None:
    """A simulated flight, and the files of any receiver, come as recordings; a project names their log."""
    unmade = replace(shouting.stage, inputs={"log 1": tmp_path / "flight.mcap"})
    with pytest.raises(InputNotFoundError, match="log 1 does not exist") as refused:
        shouting.bring(unmade)
    assert "acquire import RECORDINGS -o flight.mcap" in refused.value.remedy


_SLOW = """
import sys, time
from pathlib import Path
from tests.photocal.run.test_stage import quiet
from photocal.run.stage import Digests
from photocal.run.stage import Stage, update_stage

def make(out, _):
    (out / "half").write_text("half")
    Path(sys.argv[1], "begun").touch()
    time.sleep(600)

work = Path(sys.argv[1]) / "work"
update_stage(Stage("shout", "", make), work, Digests(work / "digests.json"), quiet)
"""


def test_a_killed_run_leaves_no_half_stage(shouting: Shouting, tmp_path: Path) -> None:
    root = Path(__file__).parents[3]
    process = subprocess.Popen(
        [sys.executable, "-c", _SLOW, str(tmp_path)], cwd=root, env={**os.environ, "PYTHONPATH": str(root)}
    )
    limit = time.monotonic() + 300
    while not (tmp_path / "begun").exists() and time.monotonic() < limit:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (shouting.work / "shout").exists()
    assert len(list(made_in(shouting.work).glob(".shout.*"))) == 1
    assert not shouting.bring()
    assert not list(made_in(shouting.work).glob(".shout.*"))
    assert sorted(p.name for p in (shouting.work / "shout").iterdir()) == ["loud.txt"]


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with (
        alone(tmp_path / "work"),
        pytest.raises(OutputError, match=rf"another run is working in this folder: process {os.getpid()} "),
        alone(tmp_path / "work"),
    ):
        raise AssertionError("two runs in one folder")
    # What a run that was killed has left holds nobody up: the lock ended with it.
    (tmp_path / "work" / ".lock").write_text("process 1 on elsewhere\n")
    with alone(tmp_path / "work"):
        pass


def test_content_decides_whatever_size_and_time_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, memory = tmp_path / "a", tmp_path / "memory.json"
    path.write_text("point 5.0", encoding="utf-8")
    os.utime(path, (1, 1))
    before = Digests(memory)
    digest = before.of_file(path)
    before.keep()
    path.write_text("point 8.0", encoding="utf-8")
    os.utime(path, (1, 1))
    assert Digests(memory).of_file(path) != digest
    # Of large files the memory answers, which makes folders of pictures fast ...
    monkeypatch.setattr("photocal.run.stage._SMALL_BYTES", 4)
    monkeypatch.setattr("photocal.run.stage.time.time_ns", lambda: path.stat().st_ctime_ns + 10**11)
    large = Digests(memory)
    digest = large.of_file(path)
    large.keep()
    content = json.loads(memory.read_text(encoding="utf-8"))
    content[str(path)][-1] = "remembered"
    memory.write_text(json.dumps(content), encoding="utf-8")
    assert Digests(memory).of_file(path) == "remembered"
    # ... unless all is to be read again, or the file was changed and its times set back.
    assert Digests(memory, again=True).of_file(path) == digest
    path.write_text("point 9.0", encoding="utf-8")
    os.utime(path, (1, 1))
    assert Digests(memory).of_file(path) not in ("remembered", digest)


def test_a_work_folder_that_was_taken_away_stays_away(tmp_path: Path) -> None:
    digests = Digests(tmp_path / "work" / ".digests.json")
    digests.keep()
    assert not (tmp_path / "work").exists()
