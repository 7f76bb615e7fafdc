"""Sentences that records have in English are said in the language of a run: each that code makes is known."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import photocal
from photocal.exchange import bingo, micmac, parts, pix4d_project, quality_report
from photocal.findings.texts import catalogue
from photocal.run import adopt, adopt_rays
from tests.sources import template

PACKAGE = Path(photocal.__file__).parent
PORTUGUESE = catalogue("pt-BR")
STORED = {key: text for key, text in catalogue("en").messages.items() if key.startswith("stored.")}
# What stands in the place of values in a sentence.
VALUE = "7"
UNSAID = (
    "control of g.txt, in X, which does not state the reference of its heights; "
    "without accuracies: 1 and 2 m assumed"
)
# Sentences that are put together of several parts.
COMPOSED = (
    "control in plane",
    "control in height",
    "positions in plane",
    "positions in height",
    "rms reprojection error of tie points",
    "mean reprojection error of tie points",
    "rms of control points, X",
    "rms of check points, Y",
    "rms of positions, Z",
    "control of gcp_list.txt, in EPSG:31982; without accuracies: 0.02 and 0.03 m assumed",
    UNSAID,
    "planimetry, class A, 1:1000",
    "heights, class A, 1:1000",
    "spot heights and elevation models, class A, 1:1000",
    "contours, class A, 1:1000",
    "DewarpData of its maker",
    "plane, stated",
    "height, stated",
    "plane, earlier test",
    "height, earlier test",
    "t.tif: 90 points, 160 triangles, 7 of them level within one contour (summits and hollows are cut off)",
    "findings of exposures: none stated",
    "findings of measurements: none stated",
    "findings of exposures: position-scatter",
    "findings of measurements: image-left-out",
    "findings of ppk: none stated",
    "findings of ppk: ppk-not-fixed",
    "revoked on 2026-01-01 (lost)",
)


def sample(node: ast.expr) -> str | None:
    """A sentence as it may read; None for what is put together elsewhere."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if not isinstance(node, ast.JoinedStr):
        return None
    return template(node, VALUE)


def literals() -> Iterator[str]:
    """Every text of the product's modules, and of the standards."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.expr) and (text := sample(node)):
                yield text


def known(text: str) -> bool:
    return PORTUGUESE.stored(text) != text


def test_every_stored_sentence_is_made_somewhere() -> None:
    """A pattern that no module makes translates nothing."""
    patterns = {key: re.sub(r"\\\{\w+\\\}", "(.+?)", re.escape(text)) for key, text in STORED.items()}
    made = {*literals(), *COMPOSED}
    unmade = [key for key, pattern in patterns.items() if not any(re.fullmatch(pattern, one) for one in made)]
    assert unmade == []


def test_composed_sentences_are_known() -> None:
    assert [text for text in COMPOSED if not known(text)] == []
    products = set()
    for path in PACKAGE.rglob("standards/*.toml"):
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("table", ())
        products |= {table["product"] for table in tables if "product" in table}
    assert len(products) == 4
    assert [product for product in products if not known(f"{product}, class A, 1:1000")] == []


def remarks(module: object) -> Iterator[str]:
    """What a module adds to lists of remarks."""
    lists = ("remarks", "told", "refusals")
    for node in ast.walk(ast.parse(inspect.getsource(module))):  # type: ignore[arg-type]
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "append":
            if getattr(getattr(node.func, "value", None), "id", "") in lists:
                yield from filter(None, map(sample, node.args))
        elif isinstance(node, ast.Assign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(getattr(target, "id", "") in (*lists, "remark") for target in targets):
                inner = (one for one in ast.walk(node.value) if isinstance(one, ast.JoinedStr | ast.Constant))
                of_values = {
                    id(part)
                    for one in ast.walk(node.value)
                    if isinstance(one, ast.JoinedStr)
                    for part in ast.walk(one)
                    if part is not one
                }
                yield from filter(None, (sample(one) for one in inner if id(one) not in of_values))


@pytest.mark.parametrize(
    "module",
    [adopt, adopt_rays, bingo, micmac, parts, pix4d_project, quality_report],
    ids=lambda module: module.__name__.rpartition(".")[2],
)
def test_every_remark_of_an_adopted_project_is_known(module: object) -> None:
    whole = [text for text in remarks(module) if len(text.split()) > 3]
    # Parts of sentences that `COMPOSED` has.
    whole = [text for text in whole if not text.startswith((", which", "control of 7", "; without"))]
    assert whole
    assert [text for text in whole if not known(text)] == []


def test_numbers_of_a_stored_sentence_have_the_decimal_mark() -> None:
    said = PORTUGUESE.stored("3 control points have no accuracy: 0.02 and 0.05 m assumed")
    assert said == "3 pontos de apoio não têm precisão declarada: supostos 0,02 e 0,05 m"
    # A name is no number.
    assert "v1.2.p4d" in PORTUGUESE.stored("report v1.2.p4d cannot be read: is cut")
    assert catalogue("en").stored("anything else") == "anything else"
    assert PORTUGUESE.stored("anything else") == "anything else"
