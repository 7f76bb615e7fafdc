"""Both languages say the same things."""

from __future__ import annotations

import datetime as dt
import re
from pathlib import Path
from string import Formatter

import pytest

import photocal
from photocal.base.errors import ConfigurationError
from photocal.findings.texts import LANGUAGES, catalogue

OF_FINDINGS = {"finding", "passed", "untested", "clause", "cause", "remedy", "term", "slip", "change"}
OF_FINDINGS |= {"candidate", "lever"}


def fields(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name is not None}


def test_same_keys_and_same_places_for_values() -> None:
    english, portuguese = (catalogue(language).messages for language in LANGUAGES)
    assert english.keys() == portuguese.keys()
    for key, text in english.items():
        assert fields(text) == fields(portuguese[key]), key
        assert portuguese[key].strip(), key


def test_a_refusal_has_each_place_once() -> None:
    """Refusals are found again by their patterns, in which a place has one name."""
    for key, text in catalogue("en").messages.items():
        names = [name for _, name, _, _ in Formatter().parse(text) if name is not None]
        assert not key.startswith("refusal.") or len(names) == len(set(names)), key


def test_every_text_is_used() -> None:
    """A key that no module names is a text that nobody will see."""
    source = "".join(p.read_text(encoding="utf-8") for p in Path(photocal.__file__).parent.rglob("*.py"))
    used = set(re.findall(r'["\x27]([a-z0-9_]+\.[a-zA-Z0-9_.]+)["\x27]', source))
    made = {m.split("{")[0] for m in re.findall(r'f"([a-z0-9_]+\.[^"]*\{[^"]*)"', source)}
    used |= {f"{key}_heads" for key in re.findall(r'told_table\(\s*"([a-z_.]+)"', source)}
    # Heads of tables are data: `columns(say, "section", "key<", "key [unit]")`, and those of `said_table`.
    tables = set(re.findall(r'(?:columns|said_table)\(\s*say, "(\w+)', source))
    tables |= {key.partition(".")[0] for key in used if ".table" in key}
    heads = set(re.findall(r'"([a-z0-9_]+)[<=]?(?: \[[^"]*\])?"', source))
    root = Path(photocal.__file__).parent
    source += "".join(p.read_text(encoding="utf-8") for p in root.rglob("standards/*.toml"))
    quoted = set(re.findall(r'"([A-Za-z0-9_-]+)[" ]', source))
    for key in catalogue("en").messages:
        section, _, code = key.partition(".")
        if section in OF_FINDINGS:
            assert code in quoted or " " in code, key
            continue
        # Sentences of records and refusals have tests of their own, `test_stored` and `test_refusals`.
        if section in ("stored", "refusal", "refusal_word"):
            continue
        if section in tables and code in heads:
            continue
        assert key in used or any(key.startswith(prefix) for prefix in made), key


def test_dates_in_words() -> None:
    day = dt.date(2026, 3, 5)
    assert catalogue("en").date(day) == "5 March 2026"
    assert catalogue("pt-BR").date(day) == "5 de março de 2026"


def test_unknown_language_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="choose one of en, pt-BR"):
        catalogue("de")
