"""Work in a copy of this process: its results, its failures, and how it ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.ledger import NamedAdjustment, because, enter, enter_again, ledger
from photocal.base.arrays import Floats
from photocal.base.beside import Beside, Told, beside
from photocal.base.compiled import each_piece

copies = pytest.mark.skipif(
    sys.platform != "linux" or (os.cpu_count() or 1) < 2, reason="no copies of a process here"
)


def squares(told: Told) -> tuple[int, Floats]:
    """Process and result of work on all threads."""
    found = np.zeros(50)

    def work(piece: int) -> None:
        found[piece] = piece**2

    each_piece(len(found), work)
    told(0.5)
    told(0.5)
    return os.getpid(), found


@copies
def test_the_copy_works_with_threads_of_its_own() -> None:
    each_piece(4, lambda _: None)
    shares = list[float]()
    with beside():
        begun = Beside(squares)
        process, found = begun.result(shares.append)
    assert process != os.getpid()
    assert np.array_equal(found, np.arange(50) ** 2)
    assert shares == [0.5, 0.5]


@copies
def test_a_copy_that_waits_for_ever_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lock that a thread held when the process was copied is released by nobody in the copy."""
    monkeypatch.setattr("photocal.base.beside._PATIENCE_S", 0.2)
    lock, here = threading.Lock(), os.getpid()

    def work(_: Told) -> int:
        with lock:
            return os.getpid()

    with beside():
        with lock:
            begun = Beside(work)
        assert begun.result(lambda _: None) == here


def test_without_copies_the_work_is_done_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with beside():
        assert Beside(squares).result(lambda _: None)[0] == os.getpid()
    monkeypatch.undo()
    # Nobody would end a copy.
    assert Beside(squares).result(lambda _: None)[0] == os.getpid()


def test_a_thread_of_a_server_copies_nothing() -> None:
    with beside(), ThreadPoolExecutor(1) as others:
        assert (
            others.submit(copy_context().run, lambda: Beside(squares).result(lambda _: None)[0]).result()
            == os.getpid()
        )


def test_what_fails_fails_here() -> None:
    def failing(_: Told) -> None:
        raise ValueError(str(os.getpid()))

    with beside():
        begun = Beside(failing)
        with pytest.raises(ValueError, match=str(os.getpid())):
            begun.result(lambda _: None)


@copies
def test_work_whose_copy_is_killed_is_done_here(tmp_path: Path) -> None:
    here = os.getpid()

    def work(_: Told) -> int:
        if os.getpid() != here:
            (tmp_path / "begun").write_text(str(os.getpid()))
            time.sleep(60)
        return os.getpid()

    with beside():
        begun = Beside(work)
        while not (tmp_path / "begun").exists() or not (tmp_path / "begun").read_text():
            time.sleep(0.01)
        os.kill(int((tmp_path / "begun").read_text()), signal.SIGKILL)
        assert begun.result(lambda _: None) == here


@copies
def test_no_copy_lives_on(tmp_path: Path) -> None:
    def work(_: Told) -> None:
        (tmp_path / "begun").write_text(str(os.getpid()))
        time.sleep(60)

    with beside():
        Beside(work)
        while not (tmp_path / "begun").exists() or not (tmp_path / "begun").read_text():
            time.sleep(0.01)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "begun").read_text()), 0)


@copies
def test_adjustments_of_a_copy_are_entered_once() -> None:
    def work(_: Told) -> tuple[NamedAdjustment, ...]:
        with ledger() as made, because("a test"):
            enter(3, 20, 5)
        return tuple(made)

    for copied in (True, False):
        with ledger() as entries:
            if copied:
                with beside():
                    enter_again(Beside(work).result(lambda _: None))
            else:
                enter_again(Beside(work).result(lambda _: None))
        assert entries == [NamedAdjustment("a test", 3, 20, 5)]
