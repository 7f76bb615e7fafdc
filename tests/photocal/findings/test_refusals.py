"""What commands refuse, in both languages: the English sentences are those of the modules."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import photocal
from photocal.base import checked_toml, errors, files, text_tables
from photocal.findings.texts import catalogue
from photocal.run import output_place, project_checks

PACKAGE = Path(photocal.__file__).parent
ENGLISH = {key: text for key, text in catalogue("en").messages.items() if key.startswith("refusal.")}
PORTUGUESE = catalogue("pt-BR")
# What the program that ends says before all, and a sentence of pydantic's.
OF_OTHERS = {"refusal.console.error", "refusal.project.input-should-be"}
# Put together of words that stand apart in their modules.
PUT_TOGETHER = {
    f"refusal.{key}"
    for key in (
        "measurements.has-no-exposure-as-more",
        "project_checks.photocal-fetch-grids-brings-it-without",
        "project_checks.name-a-compound-system",
        "network.tie-has-one-ray-as-more",
        "rank.singular",
        "rank.nearly-singular",
        "certificate.is-not-a-day",
        "rows.ground-point-is-not-a-number",
    )
}


def blank(text: str) -> str:
    """A sentence with empty places for its values."""
    return re.sub(r"\{[^{}]*\}", "{}", text)


def pieces(path: Path) -> set[str]:
    """Every text of a module; values of texts are empty places."""
    found = set[str]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            parts = (part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
            found.add("".join(map(str, parts)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def test_every_sentence_is_one_of_the_modules() -> None:
    """A sentence that was changed in its module would stay English, unseen."""
    source = set[str]().union(*map(pieces, PACKAGE.rglob("*.py")))
    every = "\n".join(source)
    for key, text in ENGLISH.items():
        if key in OF_OTHERS | PUT_TOGETHER or blank(text) in source:
            continue
        assert all(part.strip() in every for part in blank(text).split("{}") if part.strip()), key


@pytest.mark.parametrize(
    "module",
    [errors, files, checked_toml, text_tables, output_place, project_checks],
    ids=lambda m: m.__name__,
)
def test_what_a_beginner_meets_first_is_known_in_portuguese(module: object) -> None:
    """Every refusal of these modules: of files, tables, the project file, and of inputs beside each other."""
    path = Path(str(module.__file__))  # type: ignore[attr-defined]
    known = {blank(text) for text in ENGLISH.values()}
    ours = "|".join(name for name, made in vars(errors).items() if isinstance(made, type))
    refusing = re.compile(rf"(?:{ours}|refused|wrong)$")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not refusing.match(ast.unparse(node.func)):
            continue
        for given in node.args[:2]:
            said = ast.unparse(given)
            if isinstance(given, ast.Constant):
                assert given.value in known, said
            elif isinstance(given, ast.JoinedStr):
                parts = (str(p.value) if isinstance(p, ast.Constant) else "{}" for p in given.values)
                template = "".join(parts)
                words = re.search("[a-z]{3}", template.replace("{}", ""))
                inlined = any(
                    re.fullmatch(re.escape(template).replace(r"\{\}", ".*"), text) for text in known
                )
                assert not words or inlined, said


SYSTEM = "p.toml: crs = 'EPSG:4326' (WGS 84)"
SINGULAR = (
    "the network is singular (rank defect 7): nothing fixes the datum (rotation); "
    "the observations do not separate c; "
    "add control points, weighted positions or prior sigmas, or hold what cannot be determined"
)
SINGULAR_PT = (
    "a rede é singular (defeito de posto 7): nada fixa o datum (rotation); "
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
