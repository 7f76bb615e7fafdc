"""Progress where nobody sees a bar."""

from __future__ import annotations

import re

import pytest

from photocal.base import progress_bars


def test_a_file_gets_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress_bars, "LINE_EVERY_S", 0.0)
    with progress_bars.progress("matching", 4) as advance:
        advance(1)
        advance(3)
    with progress_bars.progress("listening", None) as advance:
        advance(1)
    lines = capsys.readouterr().err.splitlines()
    assert [re.sub(r"\d+ s", "N s", line) for line in lines] == [
        "matching: 25%, N s left",
        "matching: 100%, N s left",
        "listening: N s",
    ]
    monkeypatch.undo()
    with progress_bars.progress("short", 2) as advance:
        advance(1)
    assert capsys.readouterr().err == ""
