"""What `acquire` prints in Portuguese: each text has its pair, each sentence that a record holds is known."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from string import Formatter
from types import ModuleType

import pytest

import acquire
from acquire.channels import mounting, summary
from acquire.commands.texts import texts
from acquire.importing import importer
from acquire.recording import preflight, recorder
from acquire.transports import ntrip, sources
from photocal.base import time_scales
from photocal.base.sentences import read_texts
from tests.sources import template

Acquire = Callable[..., subprocess.CompletedProcess[str]]

PORTUGUESE = texts("pt-BR")
ENGLISH_OWN, PORTUGUESE_OWN = (read_texts("acquire.commands", "said", one) for one in ("en", "pt-BR"))
# What stands in the place of values in a sentence.
VALUE = "7"
# Names and signs of places for values: what is left of a text are its words.
PLACE = r"\{\w+:?|[|}]"


def fields(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name is not None}


def python(package: ModuleType) -> Iterator[str]:
    for path in Path(str(package.__file__)).parent.rglob("*.py"):
        yield path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "place",
    [
        ("acquire.commands", "said"),
        *((package, "help") for package in ("photocal.base", "acquire.commands", "photocal.commands")),
    ],
)
def test_same_keys_and_same_places_for_values(place: tuple[str, str]) -> None:
    english, portuguese = (read_texts(*place, one) for one in ("en", "pt-BR"))
    assert english.keys() == portuguese.keys()
    for key, text in english.items():
        assert fields(text) == fields(portuguese[key]), key
        assert portuguese[key].strip(), key


def test_every_text_is_used_and_every_used_text_is_there() -> None:
    source = "".join(python(acquire))
    sections = {key.partition(".")[0] for key in ENGLISH_OWN}
    keys = {key for key in ENGLISH_OWN if not key.startswith(("stored.", "number."))}
    assert set(re.findall(r'\bsay\(\s*"([a-z_]+\.[a-z_]+)"', source)) <= keys
    quoted = set(re.findall(r"[\"']([a-z_]+\.[a-z_]+)[\"']", source))
    assert len({key for key in quoted if key.partition(".")[0] in sections}) > 30
    # Heads of a table, and how exposures are seen.
    made = {"info.type", "info.frames", "info.rate_hz", "info.longest_gap_s"}
    made |= {f"info.seen_{key}" for key in summary._SEEN}
    groups = ("fix", "pictures", "links")
    made |= {f"monitor.{key}" for key in (*groups, *(f"no_{one}" for one in groups), "rest")}
    # How an alarm ended.
    made |= {"monitor.cured", "monitor.landed"}
    assert keys - quoted == made - quoted


def sample(node: ast.expr) -> str | None:
    """A sentence as it may read; None for what is put together elsewhere."""
    if isinstance(node, ast.JoinedStr):
        return template(node, VALUE)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def literals(node: ast.AST) -> Iterator[str]:
    """Every text within a piece of code but its docstrings; parts of a text with values are none."""
    parts = {id(part) for one in ast.walk(node) if isinstance(one, ast.JoinedStr) for part in one.values}
    docstrings = {id(one.value) for one in ast.walk(node) if isinstance(one, ast.Expr)}
    for one in ast.walk(node):
        if isinstance(one, ast.expr) and id(one) not in parts | docstrings and (text := sample(one)):
            yield text


def of_function(module: ModuleType, *names: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.FunctionDef) and node.name in names:
            yield from literals(node)


def of_calls(module: ModuleType, *names: str) -> Iterator[str]:
    """Texts in the arguments of calls."""
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in names:
            for argument in node.args:
                yield from literals(argument)


def sentences() -> Iterator[str]:
    """Every sentence that these commands print and that was made in English."""
    yield from of_function(summary, "_of_damage", "_lacks_for_ppk", "_blind", "verdict_on")
    yield from (f"only 7 of 10 pictures {lacks}" for lacks in summary._LACKS.values())
    yield from (f"the host clock ran 4.6 times {way} than the autopilot's: times of receipt are not flight "
                "times, use the autopilot's times; host minus autopilot clock from +1.00 s to +2.00 s"
                for way in ("slower", "faster"))  # fmt: skip
    yield from mounting.THINGS
    yield from of_function(importer, "_derivation", "_other_date")
    yield from (importer.HOST_TIME, *(form.name for form in importer.FORMATS), "event list")
    yield from ("running time of the autopilot, tied to UTC by 7 times of its GNSS receiver",)
    yield from of_function(time_scales, "expiry_warning")
    yield from of_calls(preflight, "_check", "Check")
    yield from of_calls(recorder, "put", "tell")
    yield from of_calls(sources, "LinkLostError")
    yield from (text for text in of_function(sources, "_of_port") if " " in text and "Errno" not in text)
    yield from of_calls(ntrip, "LinkLostError")


def test_every_sentence_is_known() -> None:
    said = [text for text in sentences() if " " in text and re.search("[a-z]{2}", text)]
    assert len(said) > 50
    assert [text for text in said if PORTUGUESE.stored(text) == text] == []


def test_every_stored_sentence_is_made_somewhere() -> None:
    """A pattern that no module makes translates nothing."""
    every = "\n".join(
        [*(text for source in python(acquire) for text in literals(ast.parse(source))), *sentences()]
    )
    for key, text in ENGLISH_OWN.items():
        if key.startswith("stored.") and key != "stored.alarm":
            parts = [part.strip(" :;,") for part in re.split(r"\{\w+\}", text)]
            assert all(part in every for part in parts if part), key


def test_counts_are_singular_and_plural_and_decimals_have_a_comma() -> None:
    assert PORTUGUESE.stored("rover: 1 bytes belong to no valid frame") == (
        "rover: 1 byte não pertence a nenhuma mensagem válida"
    )
    assert PORTUGUESE.stored("only 8 of 10 pictures have a time mark") == (
        "com marca de tempo: só 8 de 10 imagens"
    )
    assert PORTUGUESE.stored("this computer -0.25 s against the device") == (
        "este computador -0,25 s em relação ao equipamento"
    )
    # Of an alarm: the link, what happened, and why.
    lost = "rover is lost: the caster refuses user and password"
    assert PORTUGUESE.stored(lost) == "rover perdido: o caster recusa usuário e senha"
    assert texts("en").stored(lost) == lost
    # A name of a link ends at the first blank, whatever has colons behind it.
    found = "vehicle has an autopilot: system 1, component 1"
    assert PORTUGUESE.stored(found) == "vehicle tem um piloto automático: sistema 1, componente 1"
    # Why the system refused.
    assert PORTUGUESE.stored("rover is lost: address already in use") == (
        "rover perdido: já está em uso por outro programa"
    )
    # A reason of a device stays as it is told.
    assert PORTUGUESE.stored("rover is not configured: NAK") == "rover não está configurado: NAK"


def words(line: str) -> set[str]:
    return set(re.findall(r"[a-z]{3,}", line.lower()))


def foreign(*names: str) -> set[str]:
    """Words that only English has; names of files, messages, parameters and links are those of both."""
    ours, theirs = (
        {word for text in texts(language).messages.values() for word in words(re.sub(PLACE, " ", text))}
        for language in ("en", "pt-BR")
    )
    return ours - theirs - {"vehicle", "synthetic", "flight", *names}


def test_no_line_of_info_is_english(acquire: Acquire, demo_flight: bytes, tmp_path: Path) -> None:
    recording, log = tmp_path / "voo.tlog", tmp_path / "voo.mcap"
    recording.write_bytes(demo_flight)
    imported = acquire("import", recording, "-o", log, "--lang", "pt-BR")
    assert (imported.returncode, imported.stderr) == (0, "")
    assert "registro de telemetria MAVLink" in imported.stdout
    english, portuguese = (acquire("info", log, "--lang", one).stdout.splitlines() for one in ("en", "pt-BR"))
    assert len(english) == len(portuguese) > 12
    assert {"frames", "bytes", "the"} & foreign() == {"frames", "the"}
    told = [line for line in portuguese if "SHA-256" not in line and str(log) not in line]
    assert [line for line in told if words(line) & foreign()] == []
    assert portuguese[0] == "veredito: completo"


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_heads_of_a_table_stand_above_its_figures(
    acquire: Acquire, demo_flight: bytes, tmp_path: Path, language: str
) -> None:
    recording, log = tmp_path / "voo.tlog", tmp_path / "voo.mcap"
    recording.write_bytes(demo_flight)
    acquire("import", recording, "-o", log)
    lines = acquire("info", log, "--types", "--lang", language).stdout.splitlines()
    head = next(n for n, line in enumerate(lines) if line.split()[:1] == [texts(language)("info.type")])
    # Each column ends below its head.
    heads = [texts(language)(f"info.{key}") for key in ("frames", "rate_hz", "longest_gap_s")]
    ends = [lines[head].index(one) + len(one) for one in heads]
    for line in lines[head + 1 : head + 4]:
        assert all(line[end - 1].isdigit() and line[end : end + 1] in ("", " ") for end in ends), line


@pytest.mark.parametrize("asked", [["--lang", "pt-BR"], []])
def test_a_refusal_is_said_in_the_language(
    acquire: Acquire, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[str]
) -> None:
    for name in ("LC_ALL", "LC_MESSAGES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("LANG", "en_US.UTF-8" if asked else "pt_BR.UTF-8")
    log = tmp_path / "voo.mcap"
    log.write_bytes(b"")
    done = acquire("info", log, *asked)
    assert done.returncode == 4
    assert done.stderr == (
        f"erro: {log}: está vazio; indique um arquivo .mcap, ou importe antes a gravação\n"
    )
    # Programs are told in English.
    if not asked:
        assert acquire("info", log, "--json").stderr.startswith(f"error: {log}: is empty")


def test_a_check_names_what_is_bad(acquire: Acquire, tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(
        '[recording]\noutput = "logs"\nleast_free_mb = 0\n'
        '[[link]]\nname = "base"\nprotocol = "rtcm3"\nurl = "serial:/dev/not-there"\n'
    )
    done = acquire("check", path, "--seconds", 0.3, "--lang", "pt-BR")
    assert done.returncode == 10
    port, disk = done.stdout.splitlines()
    assert port == "ERRO  base: porta: perdido: não existe esta porta: o equipamento está conectado?"
    assert re.fullmatch(r"ok    disco logs: \d+,\d GB livres", disk)
    assert done.stderr == f"erro: {path}: não está pronto: base: porta; corrija isso antes do voo\n"
