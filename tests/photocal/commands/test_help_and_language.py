"""Lists of commands with whole summaries; findings and verdict at the terminal in the language asked for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from acquire.commands.cli import app as acquire_app
from photocal.commands.cli import app as photocal_app
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_json, finding_text, plain, spoken
from photocal.findings.verdict import judge, verdict_json, verdict_text
from photocal.run.summary import summary, summary_text
from tests.docs.command_pages import Command, commands

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


@pytest.mark.parametrize("width", [80, 100])
def test_no_help_is_cut_or_wider_than_the_terminal(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    """Every text of every command stands there whole; three dots are those of arguments that repeat."""
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERMINAL_WIDTH", str(width))
    every, wrong = list(commands()), []
    for one in every:
        program, *called = one.name.split()
        app = acquire_app if program == "acquire" else photocal_app
        printed = CliRunner().invoke(app, [*called, "--help"])
        shown = "".join(printed.output.split())
        texts = [parameter.help for parameter in one.command.params if not parameter.hidden]
        whole = all("".join((text or "").split()) in shown for text in (one.summary, *texts))
        wide = [line for line in printed.output.splitlines() if len(line) > width]
        twice = "[[" in printed.output.partition("\n\n")[0]
        if printed.exit_code or not whole or wide or twice or "\N{HORIZONTAL ELLIPSIS}" in printed.output:
            wrong.append((one.name, whole, wide, twice))
    assert len(every) > 40
    assert wrong == []


# Each costs the help of a command more than a tenth of a second.
HEAVY = ("numpy", "scipy", "numba", "pyarrow", "matplotlib", "pydantic", "rich")
HELP_S = 0.25


@pytest.mark.parametrize("program", ["acquire", "photocal"])
def test_help_imports_nothing_heavy(program: str) -> None:
    asked = [[], *(one.name.split()[1:] for one in commands() if one.name.split()[0] == program)]
    code = (
        f"import sys\nfrom {program}.commands.cli import app\n"
        f"for words in {asked}:\n"
        "    try:\n        app([*words, '--help'])\n    except SystemExit:\n        pass\n"
        f"    own = [m for m in sys.modules if m.startswith('{program}.commands.')]\n"
        f"    if not words: print([m for m in own if m != '{program}.commands.cli'])\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert len(asked) > 8
    assert [line for line in told.splitlines() if line.startswith("[")] == ["[]", "[]"]


@pytest.mark.skipif(sys.platform == "win32", reason="os.wait4 is of POSIX")
@pytest.mark.parametrize(
    "words",
    ["acquire -h", "acquire record -h", "acquire simulate flight -h", "photocal -h", "photocal check -h"],
)
def test_help_takes_a_quarter_of_a_second(words: str, tmp_path: Path) -> None:
    # Processor time, since others may be at work; compiled files are kept, as where it is installed.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(tmp_path)
    taken = []
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-m", *words.split()], env=environment, stdout=subprocess.DEVNULL
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0
        taken.append(used.ru_utime + used.ru_stime)
    assert min(taken[1:]) < HELP_S


def test_the_version_is_told() -> None:
    from photocal.base.version import __version__

    for app in (acquire_app, photocal_app):
        assert CliRunner().invoke(app, ["--version"]).stdout == f"photocal {__version__}\n"


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


@pytest.mark.parametrize(
    "one", [one for one in commands() if "language" in {p.name for p in one.command.params}]
)
def test_a_language_without_texts_is_refused_first(one: Command, tmp_path: Path) -> None:
    """Before anything is read or written: of all that these calls name nothing exists."""
    program, *called = one.name.split()
    app = acquire_app if program == "acquire" else photocal_app
    given = [
        str(tmp_path / p.name) for p in one.command.params if p.required and p.param_type_name == "argument"
    ]
    refused = CliRunner().invoke(app, [*called, *given, "--lang", "fr"])
    assert "no texts in language 'fr'" in str(refused.exception)
    assert list(tmp_path.iterdir()) == []


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


TABLE = (
    "point,dE,dN,dh\na,0.031,-0.020,0.050\nb,-0.010,0.040,-0.030\nc,0.020,0.010,0.040\nd,0.001,-0.030,0.020\n"
)


@pytest.mark.parametrize(
    ("asked", "environment", "language"),
    [([], "en_US.UTF-8", "en"), ([], "pt_BR.UTF-8", "pt-BR"), (["--lang", "pt-BR"], "C.UTF-8", "pt-BR")],
)
def test_check_prints_its_tables_in_the_language(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, asked: list[str], environment: str, language: str
) -> None:
    for name in ("LC_ALL", "LC_MESSAGES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("LANG", environment)
    (tmp_path / "d.csv").write_text(TABLE, encoding="utf-8")
    printed = CliRunner().invoke(photocal_app, ["check", "--discrepancies", str(tmp_path / "d.csv"), *asked])
    assert printed.exit_code == 0
    say, other = (ENGLISH, PORTUGUESE) if language == "en" else (PORTUGUESE, ENGLISH)
    for key in ("assessed.points", "assessed.statistics", "assessed.tests"):
        assert say(key) in printed.stdout
        assert other(key) not in printed.stdout
    # Product minus reference, 0.031 m the other way round in the table.
    assert f"-0{say.mark}031" in printed.stdout


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ([], "all grids of EPSG:31982 are installed"),
        (["--lang", "pt-BR"], "todas as grades de EPSG:31982 estão instaladas"),
    ],
)
def test_fetch_grids_speaks_the_language(
    asked: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A system of the plane needs no grid."""
    for name in ("LC_ALL", "LC_MESSAGES", "LANG"):
        monkeypatch.delenv(name, raising=False)
    printed = CliRunner().invoke(photocal_app, ["fetch-grids", "EPSG:31982", "--dry-run", *asked])
    assert (printed.exit_code, printed.stdout.strip()) == (0, said)
