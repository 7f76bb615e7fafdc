"""Findings are the same when they are written and read again, whatever is concerned and named."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.base.codec import same
from photocal.base.errors import InputMalformedError
from photocal.findings.finding import Finding, Size
from photocal.findings.listed import Findings
from photocal.findings.texts import catalogue, finding_text
from photocal.hypotheses.faults import FAULTS

name = st.one_of(
    st.sampled_from(("IMG 001.jpg", "a,b", 'say "x"', "two\nlines", "-x", "é ü 日本", "007", "NaN", "")),
    st.text(st.characters(codec="utf-8"), max_size=8),
)
number = st.floats(allow_nan=False, allow_infinity=False)


@cache
def told_without_figures() -> tuple[str, ...]:
    def has_words(code: str) -> bool:
        try:
            return bool(finding_text(Finding(code, "doubtful"), catalogue("en")))
        except InputMalformedError:
            return False

    return tuple(fault.code for fault in FAULTS if has_words(fault.code))


@st.composite
def a_finding(draw: Callable[[st.SearchStrategy[Any]], Any]) -> Finding:
    keys = st.text("abcxyz_", min_size=1, max_size=6)
    figure = st.one_of(number, name, st.lists(name, max_size=3).map(tuple), st.none())
    size = st.builds(Size, number, st.sampled_from(["px", "mm"]), st.none() | number, st.none() | number)
    return Finding(
        draw(st.sampled_from(told_without_figures())),
        draw(st.sampled_from(["refused", "grave", "doubtful", "consequence", "note"])),
        draw(name),
        draw(st.dictionaries(keys.map(lambda key: f"zz{key}"), figure, max_size=3)),
        size=draw(st.none() | size),
        stage=draw(name),
    )


@settings(max_examples=100, deadline=None)
@given(listed=st.lists(a_finding(), max_size=4).map(tuple))
def test_what_is_read_again_is_equal(listed: tuple[Finding, ...]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "found.json"
        Findings(listed).write(path)
        assert same(Findings.read(path), Findings(listed))
        assert Findings(listed).to_arrow()["subject"].to_pylist() == [one.subject for one in listed]


def test_what_a_person_sees(tmp_path: Path) -> None:
    assert len(told_without_figures()) > 3
    assert repr(Findings()) == "no findings"
    code = told_without_figures()[0]
    assert repr(Findings((Finding(code, "grave"),))).startswith(f"grave: {code}: ")
    (tmp_path / "old.json").write_text(json.dumps({"findings": [{"code": 3}]}))
    with pytest.raises(InputMalformedError, match="another version"):
        Findings.read(tmp_path / "old.json")
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(InputMalformedError):
        Findings.read(tmp_path / "list.json")
    (tmp_path / "none.json").write_text("{}")
    assert len(Findings.read(tmp_path / "none.json")) == 0
