"""The texts of a language; findings in its words, and as JSON values with those words."""

import datetime as dt
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from photocal.base.arrays import as_plain
from photocal.base.codec import from_plain
from photocal.base.console import printable
from photocal.base.errors import InputMalformedError
from photocal.base.extensions import HYPOTHESES, brought
from photocal.base.sentences import LANGUAGES as LANGUAGES
from photocal.base.sentences import Texts, read_texts
from photocal.base.sentences import spoken as spoken
from photocal.findings.digits import MINUS, Number, as_given, fixed, measured, significant, symbol
from photocal.findings.finding import Finding

# Their sections may add to each other, their keys are all different.
CATALOGUES = ("findings", "report", "analysis", "verdict", "terminal", "new", "commands")


@dataclass(frozen=True)
class Words:
    """Texts that an installed package brings: by language, then by key, such as "finding.CODE"."""

    words: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, eq=False)
class Catalogue(Texts):
    """All texts of one language, with numbers as reports print them."""

    def told(self, key: str, **values: object) -> str:
        """Give one text for a terminal: decimals with the mark of the language, and a plain minus sign."""
        figures = {k: Number(v, self.mark) if isinstance(v, float) else v for k, v in values.items()}
        return self(key, **figures).replace(MINUS, "-")

    def fixed(self, value: float, decimals: int) -> str:
        """Print a number as `digits.fixed` does; so do the others."""
        return fixed(value, decimals, self.mark)

    def significant(self, value: float, digits: int) -> str:
        """See `digits.significant`."""
        return significant(value, digits, self.mark)

    def as_given(self, value: float) -> str:
        """See `digits.as_given`."""
        return as_given(value, self.mark)

    def measured(self, value: float, sigma: float) -> tuple[str, str, int]:
        """See `digits.measured`."""
        return measured(value, sigma, self.mark)

    def term(self, name: str) -> str:
        """Give a term in this language; what is none stands as it is."""
        return self.messages.get(f"term.{name}", name)

    def date(self, day: dt.date) -> str:
        """Write a date in words."""
        month = self.messages["date.months"].split()[day.month - 1]
        return self("date.form", day=day.day, month=month, year=day.year)


@cache
def catalogue(language: str) -> Catalogue:
    """Read the texts of a language; raises ConfigurationError for a language that there is none of."""
    messages = read_texts("photocal.base", "refusals", language)
    for name in CATALOGUES:
        messages |= read_texts("photocal.findings", name, language)
    for added in brought(HYPOTHESES, Words).values():
        messages = {**added.words.get(language, added.words.get("en", {})), **messages}
    english = messages if language == "en" else catalogue("en").messages
    return Catalogue(language, messages["number.decimal_mark"], messages, english)


# Figures that name parameters of the camera model.
PARAMETERS = ("parameter", "names", "removed", "crowd")
# Figures that are terms of the catalogue, by their codes; what it does not have stands as it is.
TERMS = (
    "method", "role", "axis", "axes", "terms", "side", "sign", "product", "precision_class", "accuracy_class",
    "same", "minor", "source", "codes",
)  # fmt: skip
# Figures that are phrases of the catalogue with what is put into them, "code first second".
# "shares" are terms with a number: "time-offset 0.12".
PHRASES = {"alike": "candidate", "slips": "slip", "changes": "change"}
PHRASES |= {"lever": "lever", "exchanged": "lever"}
# A parameter of the camera model in a subject; names of points and images have digits, too.
_TERM = re.compile(r"\b(?:[KPB][1-4]|[xy]0)\b")


def plain(parameter: str) -> str:
    """Write a parameter as programs do, "K1"."""
    return parameter


# What a person who asks whether a block is usable need not read: statistics, and that something is small.
_DETAILS = frozenset(
    ("up_to", "small", "as_adjusted", "once_corrected", "unseen", "by_redundancy", "by_rms", "shifts_c")
)


def finding_text(finding: Finding, say: Catalogue, name: Callable[[str], str] = symbol) -> str:
    """Say a finding in words: what was found, and what to do.

    raises InputMalformedError: when a figure is missing that the words need: the finding was stored by
        another version.
    """
    return f"{sentence(finding, say, name)} {remedy_text(finding, say, name)}".rstrip()


def sentence(
    finding: Finding, say: Catalogue, name: Callable[[str], str] = symbol, *, brief: bool = False
) -> str:
    """Say what was found; errors as of `finding_text`.

    brief: without the statistics that stand behind it.
    """
    figures = _figures(finding, say, name)
    head = _head(finding)
    if brief and f"brief.{finding.code}" in say.messages:
        head = f"brief.{finding.code}"
    told = [c for c in finding.clauses if not (brief and (c in _DETAILS or head.startswith("brief.")))]
    try:
        text = say(head, **figures)
        text += "".join(say(f"clause.{clause}", **figures) for clause in told)
        if finding.cause and finding.severity != "untested":
            text += say("join.cause") + say(f"cause.{finding.cause}", **figures)
    except KeyError as missing:
        raise _of_another_version(finding, missing) from None
    text = text if text.endswith((".", "?")) else f"{text}."
    # Symbols and names keep their case at the head of a sentence; words do not.
    first = say.messages[head].partition("}")[0]
    if first[1:] in TERMS or (first == "{subject" and f"subject.{finding.subject}" in say.messages):
        text = text[0].upper() + text[1:]
    return text


def remedy_text(finding: Finding, say: Catalogue, name: Callable[[str], str] = symbol) -> str:
    """Say what to do about a finding; empty where nothing can be done, errors as of `finding_text`."""
    advice = f"remedy.{finding.remedy or finding.code}"
    if finding.severity in ("passed", "untested") or not (finding.remedy or advice in say.messages):
        return ""
    try:
        return say(advice, **_figures(finding, say, name))
    except KeyError as missing:
        raise _of_another_version(finding, missing) from None


def _figures(finding: Finding, say: Catalogue, name: Callable[[str], str]) -> dict[str, object]:
    """The figures of a finding in words, and its subject."""
    figures = {key: _figure(key, value, say, name) for key, value in finding.figures.items()}
    key = f"subject.{finding.subject}"
    of_camera = _TERM.sub(lambda term: name(term[0]), printable(finding.subject))
    return {**figures, "subject": say(key) if key in say.messages else of_camera}


def subject_text(finding: Finding, subject: str, say: Catalogue) -> str:
    """Write a subject of findings that are like this one: groups of observations and methods have terms."""
    key = next((key for key in ("group", "method") if finding.figures.get(key) == finding.subject), "")
    return str(_figure(key, subject, say, plain))


def _of_another_version(finding: Finding, missing: KeyError) -> InputMalformedError:
    return InputMalformedError(
        f"finding {finding.code} lacks {missing}: it was stored by another version of photocal",
        "run `photocal analyse` again, or `photocal run` for a project",
    )


def finding_json(finding: Finding, say: Catalogue) -> dict[str, Any]:
    """Give a finding as a JSON value; `Finding` can be validated from it."""
    return {**as_plain(finding), "text": finding_text(finding, say, plain)}


def identity(finding: Finding) -> str:
    """Everything of a finding but its words: the same before and after it was stored."""
    return json.dumps(as_plain(finding), sort_keys=True)


def as_record(findings: Iterable[Finding]) -> dict[str, Any]:
    """Give findings for a record: as JSON values, and as English sentences."""
    listed, say = tuple(findings), catalogue("en")
    return {
        "findings": [finding_json(finding, say) for finding in listed],
        "warnings": [finding_text(finding, say, plain) for finding in listed if not finding.small],
    }


def findings_of(content: object, where: object) -> tuple[Finding, ...]:
    """Read back a list of what `finding_json` gave.

    raises InputMalformedError: when it was stored by another version.
    """
    try:
        found: tuple[Finding, ...] = from_plain(tuple[Finding, ...], content or ())
    except ValueError as refusal:
        raise InputMalformedError(
            f"its findings were stored by another version of photocal ({refusal})",
            "run the stage again",
            where=where,
        ) from None
    return found


def need_words(code: str, figures: Mapping[str, float], say: Catalogue) -> dict[str, str]:
    """Say what a method of calibration asks for."""
    numbers = {key: Number(value, say.mark) for key, value in figures.items()}
    parts = ("name", "found", "needed", "advice")
    return {part: say(f"requirement.{code}.{part}", **numbers) for part in parts}


def _head(finding: Finding) -> str:
    if finding.severity == "untested":
        return f"untested.{finding.cause}"
    return f"{'passed' if finding.severity == 'passed' else 'finding'}.{finding.code}"


def _figure(key: str, value: Any, say: Catalogue, name: Callable[[str], str]) -> object:
    if key == "group":
        # A kind of observation of one's own has the name that it was given.
        return say.messages.get(f"group.{value}", printable(str(value)))
    if isinstance(value, str):
        value = printable(value)
        return say.term(value) if key in TERMS else name(value) if key in PARAMETERS else value
    if not isinstance(value, tuple | list):
        return Number(math.nan if value is None else float(value), say.mark)
    # Points and pictures have the names that somebody gave them.
    texts = [printable(str(element)) for element in value]
    if key in PHRASES:
        joint = ", " if PHRASES[key] == "lever" else say("join.and")
        return joint.join(_phrase(PHRASES[key], text, say, name) for text in texts)
    if key in TERMS:
        terms = [say.term(text) for text in texts]
        return say("join.and").join([", ".join(terms[:-1]), *terms[-1:]] if terms[1:] else terms)
    if key in PARAMETERS:
        return " ".join(name(text) for text in texts)
    if key == "shares":
        shares = (text.rpartition(" ") for text in texts)
        return ", ".join(f"{say.term(code)} {float(part):.0%}" for code, _, part in shares)
    if key in ("numbers", "stated", "difference"):
        return ", ".join(_number(text, say) for text in texts)
    # Longer lists of points and images end with a number.
    named = 8
    more = say("join.more", count=len(texts) - named) if len(texts) > named else ""
    return ", ".join(texts[:named]) + more


def _number(text: str, say: Catalogue) -> str:
    """A number that was written with its digits, "+1.80 +- 0.02"."""
    return re.sub(r"(?<=\d)\.(?=\d)", say.mark, text).replace("+-", "±")


def _phrase(section: str, text: str, say: Catalogue, name: Callable[[str], str]) -> str:
    """Say a phrase, "radial K3" or "exchanged forward right"."""
    code, *parts = text.split(" ")
    values = (name(part) if section == "candidate" else _number(say.term(part), say) for part in parts)
    return say.messages[f"{section}.{code}"].format(*values)
