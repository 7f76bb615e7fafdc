"""Wrong calls, progress and answers of `acquire`: every text has its Portuguese, nothing is cut."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import acquire as package
from acquire.commands.simulate import FAULTS
from tests.acquire.commands.test_languages import literals, python

Acquire = Callable[..., subprocess.CompletedProcess[str]]

OVERWRITTEN = "existe, e pode ser uma gravação; indique outra saída, ou apague-a antes"
MISSING = "não pode ser lido (o arquivo ou a pasta não existe); verifique o nome e as permissões"
FLIGHT = ["simulate", "flight", "small", "-o", "x"]


def test_the_option_asks_for_the_language_of_the_help(acquire: Acquire) -> None:
    assert "\nOpções:\n" in acquire("info", "--help", "--lang", "pt-BR").stdout
    assert "\nOptions:\n" in acquire("info", "--help", "--lang", "en").stdout
    for called in (["--help", "--lang", "pt-BR"], ["--lang", "pt-BR", "--help"]):
        assert "\nComandos:\n" in acquire(*called).stdout
    # What is to be typed keeps its point.
    assert "[padrão: 1.0; x>=0]" in acquire("replay", "--help", "--lang", "pt-BR").stdout


@pytest.mark.parametrize(
    ("called", "said"),
    [
        (["inf"], "o comando 'inf' não existe. Seria 'info'?"),
        (["info"], "falta o argumento 'VOO.mcap'."),
        (["info", "a.mcap", "b.mcap"], "argumentos a mais (b.mcap)"),
        (["info", "a.mcap", "--bogus"], "a opção --bogus não existe"),
        (["replay", "a.mcap"], "falta a opção '--to'."),
        (["replay", "a.mcap", "--to"], "a opção '--to' precisa de um valor."),
        (
            ["replay", "a.mcap", "--to", "pty", "--speed", "-1"],
            "valor inválido para '--speed': deve ser maior ou igual a 0",
        ),
        (
            ["replay", "a.mcap", "--to", "pty", "--speed", "x"],
            "valor inválido para '--speed': deve ser um número",
        ),
        (
            ["simulate", "flight", "small", "-o", "x", "--seed", "x"],
            "valor inválido para '--seed': deve ser um número inteiro",
        ),
    ],
)
def test_a_wrong_call_is_told_in_the_language(
    acquire: Acquire, monkeypatch: pytest.MonkeyPatch, called: list[str], said: str
) -> None:
    monkeypatch.setenv("LC_ALL", "pt_BR.UTF-8")
    done = acquire(*called)
    *usage, error = done.stderr.splitlines()
    assert (done.returncode, done.stdout, error) == (2, "", f"Erro: {said}")
    # The parser knows of a missing value before it knows the command.
    if usage:
        assert usage[0].startswith("Uso: ")
        assert re.fullmatch(r"'.* -h' mostra a ajuda\.", usage[1])


def in_bodies(source: str) -> Iterator[str]:
    """Sentences in the bodies of functions: no docstrings, no help of options, no refusals."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            apart = {
                id(part)
                for one in ast.walk(function)
                if isinstance(one, ast.Raise | ast.arguments | ast.Expr) and _is_beside(one)
                for part in ast.walk(one)
            }
            for one in ast.walk(function):
                if isinstance(one, ast.Constant) and isinstance(one.value, str) and id(one) not in apart:
                    yield one.value


def _is_beside(node: ast.AST) -> bool:
    return not isinstance(node, ast.Expr) or isinstance(node.value, ast.Constant)


def test_no_command_says_what_is_not_in_the_catalogue() -> None:
    """Keys, names of keys and formats have no blank between words; styles and commands are no texts."""
    folder = Path(str(package.__file__)).parent
    paths = [*sorted((folder / "commands").glob("*.py")), folder / "monitor" / "terminal.py"]
    every = [text for path in paths for text in in_bodies(path.read_text(encoding="utf-8"))]
    assert len(every) > 200
    sentences = {text for text in every if re.search(r"[a-z]{3,}\W* \W*[a-z]{2,}", text)}
    assert {text for text in sentences if "bold" not in text} == {"last words", "acquire record "}


def test_every_progress_is_said_in_the_language() -> None:
    titles = list[str]()
    for source in python(package):
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "progress":
                titles += list(literals(node.args[0]))
                assert isinstance(node.args[0], ast.Call)
                assert len(node.args) == 3
    assert {f"progress.{key}" for key in ("importing", "listening", "simulating", "flying")} == set(titles)


def test_progress_is_said_in_both_languages(
    acquire: Acquire, demo_flight: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("photocal.base.progress_bars.LINE_EVERY_S", 0.0)
    recording = tmp_path / "voo.tlog"
    recording.write_bytes(demo_flight)
    for language, form in (
        ("en", r"importing: 100%, \d+ s left"),
        ("pt-BR", r"importando: 100%, faltam \d+ s"),
    ):
        done = acquire("import", recording, "-o", tmp_path / f"{language}.mcap", "--lang", language)
        assert re.fullmatch(form, done.stderr.splitlines()[-1])


def test_simulated_flights_answer_in_the_language(acquire: Acquire, tmp_path: Path) -> None:
    log = tmp_path / "voo.tlog"
    done = acquire("simulate", "-o", log, "--lang", "pt-BR")
    size = log.stat().st_size
    assert done.stdout == f"gravado em {log}, {size} bytes: VOO SIMULADO, feito pelo photocal\n"
    folder = tmp_path / "voo"
    done = acquire("simulate", "flight", "small", "--level", "block", "-o", folder, "--lang", "pt-BR")
    assert done.stdout == (
        f"gravado em {folder}: 10 imagens, 4 pontos de apoio e 3 pontos de verificação, 62 s\n"
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are of POSIX")
@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_a_simulated_flight_tells_what_it_waits_for(tmp_path: Path, language: str) -> None:
    command = [sys.executable, "-m", "acquire", "simulate", "serve", "small", "--lang", language]
    with subprocess.Popen(
        [*command, "--record", str(tmp_path / "r.toml")],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stderr is not None
        told = process.stderr.readline()
        process.terminate()
    assert (
        told
        == {
            "en": "the flight begins when the recorder has connected\n",
            "pt-BR": "o voo começa quando o gravador se conectar\n",
        }[language]
    )


@pytest.mark.parametrize(
    ("called", "said"),
    [
        # Recordings and logs that would be lost.
        (["import", "a.tlog", "-o", "a.tlog"], f"a.tlog: {OVERWRITTEN}"),
        (["import", "--link", "v=a.tlog", "-o", "a.tlog"], f"a.tlog: {OVERWRITTEN}"),
        (["export", "a.mcap", "-o", "./a.mcap"], f"a.mcap: {OVERWRITTEN}"),
        (["recover", "a.mcap", "-o", "a.mcap"], f"a.mcap: {OVERWRITTEN}"),
        (["import", "a.mcap", "-o", "b.mcap"], "a.mcap: já é um registro de voo; acquire info o mostra"),
        (
            ["info", "none.mcap"],
            f"none.mcap: {MISSING}",
        ),
        (["--lang", "pt-BR", "info", "a.mcap"], "uma opção está antes do comando; ponha-a depois de info"),
        (["info", "a.mcap", "--lang", "xx"], "não há textos no idioma 'xx'; escolha entre en, pt-BR"),
        (
            ["simulate", "serve", "."],
            ".: não contém um voo simulado; indique uma pasta que `acquire simulate flight` fez",
        ),
        (
            [*FLIGHT, "--level", "all"],
            "'all' não é conhecido; escolha entre pictures, observations, block, card",
        ),
        (
            [*FLIGHT, "--fault", "zum"],
            f"'zum' não é conhecido; escolha entre {FAULTS.partition(': ')[2][:-1]}",
        ),
    ],
)
def test_a_slip_is_refused_and_nothing_is_overwritten(
    acquire: Acquire,
    demo_flight: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    called: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.tlog").write_bytes(demo_flight)
    assert acquire("import", "a.tlog", "-o", "a.mcap").returncode == 0
    log = Path("a.mcap").read_bytes()
    monkeypatch.setenv("LC_ALL", "pt_BR.UTF-8")
    done = acquire(*called)
    assert (done.stdout, done.stderr) == ("", f"erro: {said}\n")
    assert done.returncode in (3, 4, 5)
    assert (Path("a.tlog").read_bytes(), Path("a.mcap").read_bytes()) == (demo_flight, log)


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals are of POSIX")
@pytest.mark.parametrize("width", [60, 80])
def test_an_answer_goes_on_below_in_a_narrow_terminal(
    acquire: Acquire, demo_flight: bytes, tmp_path: Path, width: int
) -> None:
    import fcntl
    import pty
    import struct
    import termios

    recording, log = tmp_path / "a.tlog", tmp_path / "a.mcap"
    recording.write_bytes(demo_flight)
    assert acquire("import", recording, "-o", log).returncode == 0
    whole = acquire("info", log, "--types").stdout
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
    environment = {key: value for key, value in os.environ.items() if key != "COLUMNS"} | {
        "LC_ALL": "C.UTF-8"
    }
    command = [sys.executable, "-m", "acquire", "info", str(log), "--types"]
    with subprocess.Popen(command, stdout=theirs, env=environment) as process:
        os.close(theirs)
        shown = b""
        # At its end a terminal gives an error in place of no bytes.
        try:
            while piece := os.read(ours, 65536):
                shown += piece
        except OSError:
            pass
    os.close(ours)
    lines = shown.decode().split("\r\n")
    assert process.returncode == 0
    assert shown.decode().split() == whole.split()
    # Names of files and hashes stay whole.
    assert [line for line in lines if len(line) > width and len(line.split()) > 1] == []


def test_the_page_is_opened_in_the_language(acquire: Acquire, demo_flight: bytes, tmp_path: Path) -> None:
    recording, log = tmp_path / "a.tlog", tmp_path / "a.mcap"
    recording.write_bytes(demo_flight)
    assert acquire("import", recording, "-o", log).returncode == 0
    command = [sys.executable, "-m", "acquire", "monitor", str(log), "--page", "--address", "127.0.0.1:0"]
    with subprocess.Popen([*command, "--lang", "pt-BR"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = process.stdout.readline()
        process.terminate()
    assert re.fullmatch(r"abra http://127\.0\.0\.1:\d+/\?lang=pt-BR\n", told)


def test_a_log_without_data_is_not_told_as_well(
    acquire: Acquire, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "a.mcap"
    log.write_bytes(b"")
    assert acquire("monitor", log, "--lang", "en").stdout.startswith("· no data yet  a.mcap")
    assert acquire("monitor", log, "--lang", "pt-BR").stdout.startswith("· ainda sem dados  a.mcap")


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of another encoding are of POSIX")
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_signs_that_an_encoding_does_not_have_end_nothing(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    command = [sys.executable, "-m", "acquire", "monitor", str(tmp_path / "a.mcap"), "--lang", "pt-BR"]
    done = subprocess.run(
        command, env=dict(os.environ) | {"PYTHONIOENCODING": encoding}, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert "ainda sem dados" in done.stdout.decode(encoding)


@pytest.mark.skipif(sys.platform == "win32", reason="file descriptors are closed by a shell of POSIX")
def test_closed_streams_keep_the_exit_code(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    for redirection, code in ((">&-", 4), ("2>&-", 4), ("--help >&-", 0)):
        line = f"'{sys.executable}' -m acquire info '{tmp_path / 'a.mcap'}' {redirection}"
        assert subprocess.run(["sh", "-c", line], capture_output=True, check=False).returncode == code
