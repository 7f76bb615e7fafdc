"""The words of the monitor's page: both languages have all, and every sentence that the monitor says."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Iterator
from importlib import resources
from types import ModuleType

import pytest

from acquire.monitor import reducer, traffic, view_model
from acquire.recording import alarms, device_line, dialogues, files, link_session, reader, recorder
from tests.sources import template

_HERE = resources.files("acquire.monitor")
TEXTS: dict[str, list[str]] = json.loads(_HERE.joinpath("texts.json").read_text(encoding="utf-8"))
SCRIPTS = ("figures.js", "alarms.js", "map.js", "monitor.js")
# The argument of a call that a person reads.
_SAYING = {"Word": 0, "Alarm": 2, "raised": 3, "tell": 1}
# What stands in the place of values in a sentence.
_VALUE = "7"


def patterns() -> list[re.Pattern[str]]:
    """The English sentences as the page reads them."""
    known = [english for key, (english, _) in TEXTS.items() if key.startswith("told.")]
    return [re.compile(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>.+?)", re.escape(text))) for text in known]


def is_said(text: str, known: list[re.Pattern[str]]) -> bool:
    """Whether the page says a sentence in its language, what stands in places of sentences included."""
    for one in known:
        if found := one.fullmatch(text):
            inner = [part for name, part in found.groupdict().items() if name.startswith("said")]
            if all(part == _VALUE or is_said(part, known) for part in inner):
                return True
    return False


def sample(node: ast.expr) -> str | None:
    """A sentence as it may read; None for what is put together elsewhere."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if not isinstance(node, ast.JoinedStr):
        return None
    return template(node, _VALUE)


def sentences(module: ModuleType) -> Iterator[str]:
    """What a module says to the person at the laptop: arguments of calls, and pairs of level and words."""
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        said: list[ast.expr] = []
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            at = _SAYING.get(name, len(node.args))
            said = node.args[at : at + 1]
            # Notes and alarms of a dialogue are lists of words.
            listed = getattr(getattr(node.func, "value", None), "id", "")
            if name == "append" and listed in ("notes", "alarms"):
                said = node.args
        elif isinstance(node, ast.Tuple) and len(node.elts) == 2 and isinstance(node.elts[0], ast.Constant):
            said = [node.elts[1]] if node.elts[0].value in _KINDS else []
            said = [one for one in said if getattr(one, "value", "") not in _KINDS]
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "text":
            said = [node.value]
        yield from (text for text in map(sample, said) if text)


# Sentences that are put together of several parts, each as it may read.
_COMPOSED = {
    "7: 77": ("rover: lost for 5 s", "vehicle: no fix, and 1 more"),
    "7 for 7 s": ("no data for 5 s", "lost for 5 s"),
    "77 7": ("no feedback for picture 7", "no feedback for pictures 7-9", "did not report time marks 7, 9"),
    "7 7 while it was written, recording continues in 7": (
        "a.mcap was deleted while it was written, recording continues in b.mcap",
        "a.mcap was moved to c.mcap while it was written, recording continues in b.mcap",
    ),
    "7, recording continues in 7": (
        "a.mcap can no longer be written (no space left), recording continues in b.mcap",
    ),
}
_KINDS = ("note", "warn", "bad", "file_gone", "disk_full", "disk_slow", "disk_low")


def test_each_text_is_there_in_both_languages_with_the_same_values() -> None:
    for key, pair in TEXTS.items():
        assert len(pair) == 2, key
        assert all(pair), key
        english, portuguese = (sorted(re.findall(r"\{\w+\}", text)) for text in pair)
        assert english == portuguese, key


def test_every_text_of_the_page_is_in_the_catalogue() -> None:
    page = _HERE.joinpath("monitor.html").read_text(encoding="utf-8")
    keys = set(re.findall(r'data-(?:say|label|title)="([^"]+)"', page))
    for script in SCRIPTS:
        keys |= set(re.findall(r'\bsay\("([^"]+)"', _HERE.joinpath(script).read_text(encoding="utf-8")))
    assert len(keys) > 40
    assert keys <= TEXTS.keys()
    # What stands in the page before the catalogue has come is its English.
    for key, text in re.findall(r'data-say="([^"]+)"[^>]*>([^<]+)<', page):
        assert text in TEXTS[key], key


@pytest.mark.parametrize(
    "module",
    [view_model, reducer, traffic, alarms, files, reader, recorder, dialogues, device_line, link_session],
    ids=lambda module: module.__name__.rpartition(".")[2],
)
def test_every_sentence_of_the_monitor_is_known(module: ModuleType) -> None:
    known = patterns()
    found = [text for one in sentences(module) for text in _COMPOSED.get(one, (one,))]
    unknown = [text for text in found if not is_said(text, known)]
    assert unknown == [], unknown


def test_every_fix_has_a_name_in_both_languages() -> None:
    english = {pair[0] for key, pair in TEXTS.items() if key.startswith("told.")}
    assert set(traffic.NAMES.values()) <= english
