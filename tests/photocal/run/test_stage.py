"""Stages: whole or not there, made again exactly when something that they depend on has changed."""

from __future__ import annotations

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

from drivers.errors import InputNotFoundError, OutputError
from photocal.run.digests import Digests
from photocal.run.folders import alone
from photocal.run.stage import Progress, Stage, bring


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
        return bring(stage or self.stage, self.work, digests, quiet, again=again).kept


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


def test_a_changed_result_is_not_kept(shouting: Shouting) -> None:
    shouting.bring()
    (shouting.work / "shout" / "loud.txt").write_text("FORGED", encoding="utf-8")
    assert not shouting.bring()
    assert (shouting.work / "shout" / "loud.txt").read_text(encoding="utf-8") == "ONE"


def test_a_later_stage_follows_the_results_of_the_earlier(shouting: Shouting) -> None:
    shouting.bring()
    later = Stage("later", "", lambda out, _: (out / "x").touch(), after=(shouting.work / "shout",))
    assert not shouting.bring(later)
    # Made again with the same result: what follows is kept.
    shouting.bring(again=True)
    assert shouting.bring(later)
    shouting.source.write_text("two", encoding="utf-8")
    shouting.bring()
    assert not shouting.bring(later)


def test_a_failing_stage_leaves_the_old_result(shouting: Shouting) -> None:
    shouting.bring()

    def fail(out: Path, _: Progress) -> None:
        (out / "half").touch()
        raise OutputError("broken")

    with pytest.raises(OutputError):
        shouting.bring(replace(shouting.stage, make=fail), again=True)
    assert sorted(p.name for p in shouting.work.iterdir() if p.is_dir()) == ["shout"]
    assert shouting.bring()


def test_a_missing_input_is_named(shouting: Shouting) -> None:
    shouting.source.unlink()
    with pytest.raises(InputNotFoundError, match="text does not exist"):
        shouting.bring()


_SLOW = """
import sys, time
from pathlib import Path
from tests.photocal.run.test_stage import quiet
from photocal.run.digests import Digests
from photocal.run.stage import Stage, bring

def make(out, _):
    (out / "half").write_text("half")
    Path(sys.argv[1], "begun").touch()
    time.sleep(600)

work = Path(sys.argv[1]) / "work"
bring(Stage("shout", "", make), work, Digests(work / "digests.json"), quiet)
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
    assert len(list(shouting.work.glob(".shout.*"))) == 1
    assert not shouting.bring()
    assert not list(shouting.work.glob(".shout.*"))
    assert sorted(p.name for p in (shouting.work / "shout").iterdir()) == ["loud.txt", "stage.json"]


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with (
        alone(tmp_path / "work"),
        pytest.raises(OutputError, match="another run is working"),
        alone(tmp_path / "work"),
    ):
        raise AssertionError("two runs in one folder")
    with alone(tmp_path / "work"):
        pass


def test_digests_are_remembered_by_size_and_time(tmp_path: Path) -> None:
    path, memory = tmp_path / "a", tmp_path / "memory.json"
    path.write_text("first", encoding="utf-8")
    os.utime(path, (1, 1))
    before = Digests(memory)
    digest = before.of_file(path)
    before.keep()
    path.write_text("other", encoding="utf-8")
    os.utime(path, (1, 1))
    # Same size and time, and old: the memory answers. This is what makes large folders fast.
    assert Digests(memory).of_file(path) == digest
    path.write_text("other", encoding="utf-8")
    assert Digests(memory).of_file(path) != digest
