"""What commands refuse, in both languages: the English sentences are those of the modules."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import acquire
import photocal
from photocal.base import errors
from photocal.findings.texts import catalogue
from tests.photocal.findings.refusals import Refusal, refusals_of
from tests.sources import template

PACKAGES = tuple(Path(str(package.__file__)).parent for package in (photocal, acquire))
ENGLISH = {key: text for key, text in catalogue("en").messages.items() if key.startswith("refusal.")}
PORTUGUESE = catalogue("pt-BR")
# What the program that ends says before all, and a sentence of pydantic's.
OF_OTHERS = {"refusal.console.error", "refusal.project.input-should-be"}
# Why a system refuses.
OF_SYSTEMS = "refusal.system."
# Put together of words that stand apart in their modules.
PUT_TOGETHER = {
    f"refusal.{key}"
    for key in (
        "measurements.has-no-exposure-as-more",
        "project_checks.photocal-fetch-grids-brings-it-without",
        "project_checks.name-a-compound-system",
        "network.tie-has-one-ray-as-more",
        "network.point-has-one-ray-as-more",
        "source.is-written-with-a-decimal-comma",
        "rank.singular",
        "rank.nearly-singular",
        "certificate.is-not-a-day",
        "rows.ground-point-is-not-a-number",
    )
}

# Said in the catalogue with the words that stand in its places; and of programmers to each other.
ELSEWHERE = {
    "the network is {} (rank defect {}): {}",
    "{} = {} is not {}",
    "crs = {}{}",
    "photocal fetch-grids {} installs it; without it: crs = {} and {}",
    "{} needs more than {} bits of {}",
    "{} cells in one message, {} are allowed",
    "{} does not fit {} bits",
    "{} bits instead of 190",
}


def blank(text: str) -> str:
    """A sentence with empty places for its values."""
    return re.sub(r"\{[^{}]*\}", "{}", text)


def written(package: Path) -> Iterator[Refusal]:
    """The refusals of all modules of a package."""
    for path in sorted(package.rglob("*.py")):
        file = path.relative_to(package.parent).as_posix()
        yield from refusals_of(path.read_text(encoding="utf-8"), file)


def pieces(path: Path) -> set[str]:
    """Every text of a module; values of texts are empty places."""
    found = set[str]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            found.add(template(node))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def test_every_sentence_is_one_of_the_modules() -> None:
    """A sentence that was changed in its module would stay English, unseen."""
    files = (path for package in PACKAGES for path in package.rglob("*.py"))
    source = set[str]().union(*map(pieces, files))
    every = "\n".join(source)
    for key, text in ENGLISH.items():
        if key in OF_OTHERS | PUT_TOGETHER or key.startswith(OF_SYSTEMS) or blank(text) in source:
            continue
        assert all(part.strip() in every for part in blank(text).split("{}") if part.strip()), key


def test_every_refusal_of_the_code_is_known_in_portuguese() -> None:
    """Whoever writes a new one says it here in both languages."""
    known = {blank(text) for text in ENGLISH.values()} | ELSEWHERE
    every = [one for package in PACKAGES for one in written(package)]
    # Far fewer would mean that the search no longer sees them.
    assert len(every) > 1500
    missing = [f"{one.file}:{one.line}: {one.text}" for one in every if blank(one.text) not in known]
    assert missing == []


def test_the_list_of_refusals_sees_what_code_may_write() -> None:
    source = """
def make(path, name, what, remedy="look"):
    wrong = InputMalformedError.at(path)
    if name:
        raise wrong(f"has no {name!r}" if path else "has nothing", remedy=remedy)
    raise ConfigurationError(what, "correct" + f" {name}")

def use():
    make(1, 2, "is odd", "leave it")
    raise TypeError("of programmers")
"""
    assert {one.text for one in refusals_of(source, "m.py")} == {
        "has no {}", "has nothing", "look", "leave it", "is odd", "correct {}"
    }  # fmt: skip


SYSTEM = "p.toml: crs = 'EPSG:4326' (WGS 84)"
SINGULAR = (
    "the network is singular (rank defect 7): nothing fixes the datum (rotation); "
    "the observations do not separate c; "
    "add control points, weighted positions or prior sigmas, or hold what cannot be determined"
)
SINGULAR_PT = (
    "a rede é singular (deficiência de posto 7): nada fixa o datum (rotation); "
    "as observações não separam c; "
    "acrescente pontos de apoio, posições com peso ou desvios-padrão a priori, "
    "ou fixe o que não pode ser determinado"
)


@pytest.mark.parametrize(
    ("english", "portuguese"),
    [
        (
            "p.toml: project: crs = '?' is still to be filled in; correct the file",
            "p.toml: project: crs = '?' ainda está por preencher; corrija o arquivo",
        ),
        (
            f"{SYSTEM} is not a map system: degrees cannot be adjusted",
            f"{SYSTEM} não é um sistema de projeção: graus não podem ser ajustados",
        ),
        (SINGULAR, SINGULAR_PT),
        (
            "t.csv: X is 0.5 where other rows have decimal commas",
            "t.csv: X é 0,5 onde outras linhas têm vírgula decimal",
        ),
        (
            "dtm.tif: has ellipsoidal heights, not orthometric ones; correct the kind",
            "dtm.tif: tem altitudes elipsoidais, não ortométricas; corrija o tipo",
        ),
        # A refusal within a refusal, and a folder that has the name of a word.
        (
            "--sigma: '6' is not of the form E,N,U: metres; write it in this form",
            "--sigma: '6' não tem a forma E,N,U: metros; escreva-o nesta forma",
        ),
        ("images: has no image; it takes *.jpg", "images: não tem imagem; aceita *.jpg"),
        # Of two sentences that fit, the one with more words of its own.
        ("p.bin: has no tie points", "p.bin: não tem pontos de ligação"),
        # What is not known stays English as a whole.
        ("a thing that nobody knows; check the path", "a thing that nobody knows; check the path"),
    ],
)
def test_a_refusal_is_said_with_its_values(english: str, portuguese: str) -> None:
    assert PORTUGUESE.refused(english) == portuguese
    assert catalogue("en").refused(english) == english


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "error: nowhere/project.toml: does not exist; check the path"),
        (["--lang", "pt-BR"], "erro: nowhere/project.toml: não existe; verifique o caminho"),
        (["--lang=pt-BR"], "erro: nowhere/project.toml: não existe; verifique o caminho"),
    ],
)
def test_the_command_line_refuses_in_the_language_asked_for(
    tmp_path: Path, arguments: list[str], said: str
) -> None:
    command = [sys.executable, "-m", "photocal", "run", "nowhere/project.toml", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (errors.InputNotFoundError.exit_code, said)
