"""The first adjustment on a machine compiles on two cores."""

from __future__ import annotations

import subprocess
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import pytest

from photocal.base import compiled
from photocal.base.operating_system import lock


def test_every_room_with_kernels_decides_over_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled code is that of today's sources: a change of any kernel gives it another folder."""
    kernels = [path for path in compiled.PACKAGE.rglob("*.py") if b"\n@compiled" in path.read_bytes()]
    assert len(kernels) > 10
    rooms = {path.relative_to(compiled.PACKAGE).parts[0] for path in kernels}
    for room in rooms:
        (tmp_path / room).mkdir()
        (tmp_path / room / "kernel.py").write_text("from photocal.base.compiled import compiled\n")
    monkeypatch.setattr(compiled, "PACKAGE", tmp_path)
    before = compiled.fingerprint()
    for room in rooms:
        (tmp_path / room / "kernel.py").write_text("from photocal.base.compiled import compiled  # changed\n")
        assert compiled.fingerprint() != before, room
        before = compiled.fingerprint()


def test_what_comes_last_is_compiled_beside_where_nothing_was_compiled_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Queue[list[str]]()

    def begin(command: list[str], **_: Any) -> None:
        begun.put(command)

    monkeypatch.setattr(compiled, "FOLDER", tmp_path)
    monkeypatch.setattr(subprocess, "run", begin)
    compiled.compile_ahead()
    # What is begun is a program that runs: its names exist.
    command = begun.get(timeout=60)
    compile(command[2], "part", "exec")
    module, _, function = command[2].partition("; ")[0].split()[1].rpartition(".")
    assert hasattr(__import__(f"{module}.{function}", fromlist=["part"]), command[2].split("part.")[1][:-2])
    # Commands that begin meanwhile leave it to that process.
    with (tmp_path / compiled.AHEAD).open("ab+") as taken:
        assert lock(taken)
        compiled.compile_ahead()
        with pytest.raises(Empty):
            begun.get(timeout=0.2)
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "one.nbi").touch()
    compiled.compile_ahead()
    with pytest.raises(Empty):
        begun.get(timeout=0.2)
