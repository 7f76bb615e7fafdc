"""Work that comes back to the process that did it before, whatever dies on the way."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from photocal.base.errors import ProgramMissingError
from photocal.base.homes import homes
from photocal.base.workers import Cluster

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


@dataclass(frozen=True)
class Errand:
    """A number, and a file whose absence kills the process that is sent, or "" for none."""

    number: int
    unless: str = ""


def process(errand: Errand) -> tuple[int, int]:
    if errand.unless and not Path(errand.unless).exists():
        Path(errand.unless).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return errand.number, os.getpid()


def always_dies(errand: Errand) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return errand.number


def number(errand: Errand) -> int:
    return errand.number


def test_this_process_is_home_to_all() -> None:
    with homes(1) as opened:
        assert list(opened.each(process, [Errand(3), Errand(4)], number)) == [
            (3, os.getpid()),
            (4, os.getpid()),
        ]


def test_each_home_has_its_process_and_another_when_that_died(tmp_path: Path) -> None:
    with homes(2) as opened:
        first = dict(opened.each(process, map(Errand, range(6)), number))
        assert list(first) == list(range(6))
        assert len(set(first.values())) == 2
        assert dict(opened.each(process, map(Errand, range(6)), number)) == first
        killing = [Errand(n, str(tmp_path / "dead") if n == 2 else "") for n in range(6)]
        after = dict(opened.each(process, killing, number))
        assert {n for n in range(6) if after[n] == first[n]} >= {1, 3, 5}
        assert after[4] != first[4]
        assert dict(opened.each(process, map(Errand, range(6)), number))[4] == after[4]


def test_work_that_always_kills_is_given_up() -> None:
    with homes(2) as opened, pytest.raises(ProgramMissingError, match="died again and again"):
        list(opened.each(always_dies, [Errand(0)], number))


def test_workers_of_a_cluster_are_homes(two_workers: Any, tmp_path: Path) -> None:
    with homes(Cluster(two_workers.scheduler_address)) as opened:
        first = dict(opened.each(process, map(Errand, range(6)), number))
        assert len(set(first.values())) == 2
        assert dict(opened.each(process, map(Errand, range(6)), number)) == first
        killing = [Errand(n, str(tmp_path / "dead") if n == 3 else "") for n in range(6)]
        after = dict(opened.each(process, killing, number))
        assert list(after) == list(range(6))
        assert all(after[n] == first[n] for n in (0, 2, 4))


def test_failures_arrive_as_they_are(two_workers: Any) -> None:
    for workers in (2, Cluster(two_workers.scheduler_address)):
        with homes(workers) as opened, pytest.raises(ZeroDivisionError):
            list(opened.each(divided_by_nothing, [Errand(1)], number))


def divided_by_nothing(errand: Errand) -> float:
    return errand.number / 0
