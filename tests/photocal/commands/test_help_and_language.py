"""Lists of commands with whole summaries; findings and verdict at the terminal in the language asked for."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from acquire.cli import app as acquire_app
from photocal.cli import app as photocal_app
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_json, finding_text, plain, spoken
from photocal.findings.verdict import judge, verdict_json, verdict_text
from photocal.run.summary import summary, summary_text
from tests.docs.command_pages import commands

ENGLISH, PORTUGUESE = catalogue("en"), catalogue("pt-BR")
FOUND = Finding("no-control", "doubtful", stage="block")


@pytest.mark.parametrize(
    ("app", "program", "called"),
    [
        (acquire_app, "acquire", []),
        (acquire_app, "acquire simulate", ["simulate"]),
        (photocal_app, "photocal", []),
    ],
)
def test_no_summary_is_cut(app: object, program: str, called: list[str]) -> None:
    printed = CliRunner().invoke(app, [*called, "--help"])  # type: ignore[arg-type]
    shown = " ".join(printed.output.split())
    mine = [one for one in commands() if one.name.rpartition(" ")[0] == program]
    assert printed.exit_code == 0
    assert len(mine) >= 2
    assert [one.name for one in mine if one.summary not in shown] == []
    assert "..." not in printed.output.partition("Commands:")[2]


@pytest.mark.parametrize(
    ("asked", "environment", "language"),
    [
        ("", {}, "en"),
        ("", {"LANG": "pt_BR.UTF-8"}, "pt-BR"),
        ("", {"LANG": "de_DE.UTF-8"}, "en"),
        ("", {"LANG": "pt_BR.UTF-8", "LC_ALL": "C.UTF-8"}, "en"),
        ("en", {"LANG": "pt_BR.UTF-8"}, "en"),
        ("pt-BR", {"LANG": "en_US.UTF-8"}, "pt-BR"),
    ],
)
def test_the_option_counts_before_the_environment(
    monkeypatch: pytest.MonkeyPatch, asked: str, environment: dict[str, str], language: str
) -> None:
    for name in ("LC_ALL", "LC_MESSAGES", "LANG"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert spoken(asked) == language


def test_a_summary_is_said_in_both_languages(tmp_path: Path) -> None:
    verdict = judge([FOUND])
    figures = summary("field", tmp_path, ()) | {
        "warnings": [{"kind": "warning", **finding_json(FOUND, ENGLISH)}],
        "verdict": verdict_json(verdict, ENGLISH),
    }
    for say, other in ((ENGLISH, PORTUGUESE), (PORTUGUESE, ENGLISH)):
        text = summary_text(figures, say, details=True)
        for part in (*verdict_text(verdict, say), finding_text(FOUND, say, plain)):
            assert part in text
        for part in (*verdict_text(verdict, other), finding_text(FOUND, other, plain)):
            assert part not in text
    assert summary_text(figures, details=True) == summary_text(figures, ENGLISH, details=True)
