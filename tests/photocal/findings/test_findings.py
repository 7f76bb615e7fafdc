"""Findings: every one has its words in both languages, and they come back from JSON as they were."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import photocal
from photocal.base.errors import InputMalformedError
from photocal.findings.digits import Number
from photocal.findings.finding import Finding
from photocal.findings.texts import (
    PHRASES,
    Catalogue,
    catalogue,
    finding_json,
    finding_text,
    findings_of,
    identity,
)
from photocal.hypotheses.faults import FAULTS

ENGLISH, PORTUGUESE = catalogue("en"), catalogue("pt-BR")
ROOM = Path(photocal.__file__).parent
VERDICTS = {"not-usable", "usable-with-reservations", "usable", "fly-again", "flight-to-look-at"}
# Found by another program, or put together from two words.
CODES = {"finding", "clause", "cause", "remedy", "passed", "untested"}


def made() -> Iterator[tuple[str, str]]:
    """Severity (or nothing) and code of every finding that the sources make with its code spelled out."""
    for path in ROOM.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) > 1:
                first, second = node.args[:2]
                if node.func.id == "Finding" and isinstance(first, ast.Constant):
                    severity = second.value if isinstance(second, ast.Constant) else ""
                    yield str(severity), str(first.value)
                if node.func.id == "untested" and isinstance(second, ast.Constant):
                    yield "untested", str(second.value)


def test_every_finding_has_its_text() -> None:
    found = sorted(set(made()))
    assert len(found) > 70
    for severity, code in found:
        section = severity if severity in ("passed", "untested") else "finding"
        assert f"{section}.{code}" in ENGLISH.messages, code


def test_every_reason_of_a_verdict_has_a_name() -> None:
    for severity, code in sorted(set(made())):
        if severity not in ("passed", "untested", "note") and not code.startswith("pca-"):
            assert f"term.{code}" in ENGLISH.messages or code in VERDICTS, code


def test_every_fault_has_its_texts() -> None:
    for one in FAULTS:
        assert f"finding.{one.code}" in ENGLISH.messages
        assert f"term.{one.code}" in ENGLISH.messages
        others = {other.code for other in FAULTS}
        assert {*one.imitates, *one.contains, *filter(None, [one.kind_of])} <= {*others, "*"}
        assert set(one.symptoms) <= {key.removeprefix("finding.") for key in ENGLISH.messages}


def every_finding(say: Catalogue) -> list[Finding]:
    """One finding of each code, with a figure for every place of its texts and with all their clauses."""
    places = {
        name: 1.25
        for key, text in say.messages.items()
        if key.partition(".")[0] in CODES
        for _, name, _, _ in Formatter().parse(text)
        if name
    }
    figures: dict[str, object] = {**places, "camera": "C1", "unit": "mm", "group": "image"}
    for name in PHRASES:
        figures[name] = ()
    codes = [key.removeprefix("finding.") for key in say.messages if key.startswith("finding.")]
    return [Finding(code, "doubtful", "Q", figures) for code in codes]


def fragments(say: Catalogue) -> set[str]:
    """What a text says between its figures, where that is more than two words."""
    parts = {p for text in say.messages.values() for p in re.split(r"\{[^}]*\}", text)}
    return {p.strip(" .,;:") for p in parts if len(p.split()) > 2}


def test_portuguese_has_no_english() -> None:
    english = fragments(ENGLISH) - fragments(PORTUGUESE)
    assert len(english) > 300
    for finding in every_finding(PORTUGUESE):
        text = finding_text(finding, PORTUGUESE)
        assert not [part for part in english if part in text], text
        assert finding_text(finding, ENGLISH) != text
    for key, text in PORTUGUESE.messages.items():
        assert not [part for part in english if part in text], key


def test_a_finding_comes_back_from_json() -> None:
    figures = {"numbers": ("+1.80 +- 0.02",), "same": ("lever-arm", "datum-shift"), "lost": float("nan")}
    finding = Finding("time-offset", "grave", figures=figures, clauses=("correction", "same"), stage="check")
    text = json.dumps([finding_json(finding, PORTUGUESE)], allow_nan=False)
    (back,) = findings_of(json.loads(text), "check.json")
    assert finding_text(back, PORTUGUESE) == finding_text(finding, PORTUGUESE)
    assert "+1,80 ± 0,02" in finding_text(back, PORTUGUESE)
    assert (back.code, back.severity, back.stage) == ("time-offset", "grave", "check")
    assert back.figures["lost"] is None
    assert identity(back) == identity(finding)


def test_a_finding_of_another_version_says_what_to_do() -> None:
    with pytest.raises(InputMalformedError, match="another version"):
        finding_text(Finding("small-sample", "note"), ENGLISH)


def test_numbers_have_the_mark_of_the_language() -> None:
    assert f"{Number(1.5, ','):.2f}" == "1,50"


def test_digits_in_names_of_points_are_no_indices() -> None:
    say = catalogue("en")
    control = Finding("image", "note", "GCP07", {"name": "GCP07", "relative": 2.0, "px": 1.0}, ("amount",))
    assert "GCP07" in finding_text(control, say)
    assert "K₁" in finding_text(Finding("not_significant", "note", "K1", {"t": 0.3}), say)


def test_names_of_points_and_pictures_write_no_line_of_their_own() -> None:
    """A name with a line break would stand in a summary as a line of the program."""
    name = "p9\nverdict   usable; nothing was found\x1b[2K"
    for finding in (
        Finding("check-outside-prediction", "doubtful", "direct", {"method": "direct", "points": (name,)}),
        Finding("mark-off", "doubtful", name, {"point": name, "image": "a", "px": 3.0, "sigmas": 9.0}),
        Finding("no-coordinates", "doubtful", name),
    ):
        text = finding_text(finding, catalogue("en"))
        assert "p9·verdict" in text
        assert len(text.splitlines()) == 1
        assert "\x1b" not in text
