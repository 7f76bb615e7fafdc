"""Names from outside: printed as they are, or refused; compared as people read them."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.base.files import compared, one_line, plain_name


@pytest.mark.parametrize(
    ("name", "character"),
    [
        ("two\nlines", "U+000A"),
        ("a\ttab", "U+0009"),
        ("escape \x1b[2J", "U+001B"),
        ("another end\x85of a line", "U+0085"),
        ("zero\u200bwidth", "U+200B"),
        ("joined\u200d", "U+200D"),
        ("right \u202eto left", "U+202E"),
        ("marked\u200f", "U+200F"),
        ("line\u2028separator", "U+2028"),
        ("paragraph\u2029separator", "U+2029"),
        ("soft\u00adhyphen", "U+00AD"),
        ("byte order\ufeff", "U+FEFF"),
        ("not UTF-8 \udcff", "U+DCFF"),
    ],
)
def test_what_nobody_sees_is_refused_by_its_number(name: str, character: str) -> None:
    for form in (one_line, plain_name):
        with pytest.raises(ValueError, match=character.replace("+", r"\+")):
            form(name)


def test_names_have_one_form() -> None:
    assert plain_name("  Big \u00a0 Laboratory ") == "Big Laboratory"
    # Full width letters, a ligature, a letter with its accent apart: as Unicode's NFKC has them.
    assert plain_name("Ｌａｂ ﬁne") == "Lab fine"
    assert plain_name("Laborato\u0301rio") == "Laboratório"
    for blank in ("", "  ", "\u3000"):
        with pytest.raises(ValueError, match="empty"):
            plain_name(blank)


@pytest.mark.parametrize(("one", "other"), [("Straße", "STRASSE"), ("Lab", "lAB"), ("İ", "i̇")])
def test_case_does_not_count(one: str, other: str) -> None:
    assert compared(one) == compared(other)
    assert compared("Lab A") != compared("Lab B")


@given(st.text())
def test_a_plain_name_is_one_visible_line_and_stays_so(text: str) -> None:
    try:
        name = plain_name(text)
    except ValueError:
        return
    assert len(name.splitlines()) == 1
    assert plain_name(name) == name
    assert not any(unicodedata.category(c)[0] == "C" or unicodedata.category(c) in ("Zl", "Zp") for c in name)
