"""Help of both programs in Portuguese: every text has its pair, nothing is English, cut or too wide."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from acquire.commands.cli import app as acquire_app
from photocal.base.sentences import help_texts, read_texts
from photocal.commands.cli import app as photocal_app
from tests.docs.command_pages import Command, commands
from tests.photocal.commands.test_help_and_language import HEAVY
from tests.programs import called

APPS = {"acquire": acquire_app, "photocal": photocal_app}
both = pytest.mark.parametrize("program", APPS)


def own(program: str) -> list[Command]:
    return [one for one in commands() if one.name.split()[0] == program]


def helps(program: str) -> Iterator[str]:
    """Every text that a help has."""
    yield str(APPS[program].info.help)
    for one in own(program):
        for paragraph in one.command.help.split("\n\n"):
            yield " ".join(paragraph.split())
        yield from (parameter.help for parameter in one.command.params if not parameter.hidden)


def prose(text: str) -> str:
    """A text without commands, defaults and names of options and files, which are as they are."""
    return re.sub(r"`[^`]*`|\[(?:padrão|variável)[^]]*\]|--[\w-]+|[\w.-]*[._/]\w+", " ", text)


def words(text: str) -> set[str]:
    return set(re.findall(r"(?<![^\W_])[^\W\d_]{3,}", prose(text).lower()))


def english(program: str) -> set[str]:
    """Words that only the English texts of a help have, and no command's name."""
    texts = help_texts(f"{program}.commands", "pt-BR")
    ours, theirs = (
        {word for text in messages.values() for word in words(text)}
        for messages in (texts.english, texts.messages)
    )
    return ours - theirs - {word for one in own(program) for word in words(one.name)}


@both
def test_every_help_text_has_its_portuguese(program: str) -> None:
    every, texts = set(helps(program)), help_texts(f"{program}.commands", "pt-BR")
    assert len(every) > 60
    assert [text for text in every if texts.helped(text) == text] == []


@both
def test_every_portuguese_help_text_is_of_a_command(program: str) -> None:
    """A text that was changed in its command would stay English, unseen."""
    every = "\n".join(helps(program))
    placeholders = {
        word for one in own(program) for p in one.command.params for word in str(p.metavar).split()
    }
    for key, text in read_texts(f"{program}.commands", "help", "en").items():
        if key.startswith("help.name."):
            assert text in placeholders, key
        else:
            assert all(part in every for part in re.split(r"\{\w+\}", text)), key


@both
@pytest.mark.parametrize("width", [60, 80])
def test_no_help_is_english_too_wide_or_cut(
    program: str, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    monkeypatch.setenv("LC_ALL", "pt_BR.UTF-8")
    monkeypatch.setenv("COLUMNS", str(width))
    foreign, wrong = english(program), []
    assert len(foreign) > 100
    for call in ([], *(one.name.split()[1:] for one in own(program))):
        printed = called(program, *call, "--help")
        assert printed.returncode == 0
        assert printed.stdout.startswith("Uso: ")
        wide = [line for line in printed.stdout.splitlines() if len(line) > width]
        # An option of an example that is cut in two cannot be copied.
        cut = re.findall(r"--[\w-]*-$", printed.stdout, re.MULTILINE)
        if told := words(printed.stdout) & foreign or wide or cut:
            wrong.append((call, told))
    assert wrong == []


@both
@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_no_help_names_a_type_of_the_code(program: str, language: str) -> None:
    for one in own(program):
        printed = called(program, *one.name.split()[1:], "--help", "--lang", language).stdout
        assert re.findall(r"<[a-zA-Z][^>=]*>", printed) == [], one.name


def test_a_help_says_kinds_of_values_in_words() -> None:
    printed = called("photocal", "ortho", "--help", "--lang", "en").stdout
    for said in (
        "--images PATH ",
        "--image TEXT ",
        "--cell NUMBER ",
        "--workers INTEGER ",
        "\n  BLOCK  Block",
    ):
        assert said in printed


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (["adjus"], "o comando 'adjus' não existe. Seria 'adjust'?"),
        (["adjust", "-o", "x"], "falta o argumento 'BLOCO'."),
        (["adjust", "x"], "falta a opção '-o' / '--output'."),
        (
            ["adjust", "x", "-o", "y", "--ellipses", "z"],
            "valor inválido para '--ellipses': deve ser um número",
        ),
        (["debrief", "x", "--workers", "-1"], "valor inválido para '--workers': deve ser maior ou igual a 0"),
    ],
)
def test_a_wrong_call_of_photocal_is_told_in_the_language(call: list[str], said: str) -> None:
    done = called("photocal", *call, "--lang", "pt-BR")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1] == f"Erro: {said}"


def test_the_option_asks_for_the_language_of_the_help_of_photocal() -> None:
    assert "\nOpções:\n" in called("photocal", "keys", "--help", "--lang", "pt-BR").stdout
    assert "\nOptions:\n" in called("photocal", "keys", "--help", "--lang", "en").stdout
    for call in (["--help", "--lang", "pt-BR"], ["--lang", "pt-BR", "--help"]):
        assert "\nComandos:\n" in called("photocal", *call).stdout


@both
def test_help_in_portuguese_imports_nothing_heavy(program: str) -> None:
    code = (
        f"import sys\nfrom {program}.commands.cli import main\nsys.argv[1:] = ['--help', '--lang', 'pt-BR']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.startswith("Uso: ")
    assert told.splitlines()[-1] == "[]"
