"""Findings of the analysis in words, in the language of a report."""

from __future__ import annotations

from collections.abc import Callable

from drivers.errors import InputMalformedError
from photocal.analysis.finding import Figure, Finding
from photocal.analysis.method import Requirement
from photocal.report.catalogue import Catalogue
from photocal.report.digits import Number, symbol

# Figures that name parameters of the camera model.
PARAMETERS = ("parameter", "names", "removed", "crowd")


def plain(parameter: str) -> str:
    """Write a parameter as programs do, "K1"."""
    return parameter


def finding_text(finding: Finding, say: Catalogue, name: Callable[[str], str] = symbol) -> str:
    """Say a finding in words.

    Parameters
    ----------
    finding : Finding
        The finding.
    say : Catalogue
        Language.
    name : callable
        How parameters are written: `symbol` or `plain`.

    Returns
    -------
    str
        One sentence or two.

    Raises
    ------
    InputMalformedError
        When a figure is missing that the words need: the finding was stored by another version.
    """
    figures = {key: _figure(key, value, say, name) for key, value in finding.figures.items()}
    key = f"subject.{finding.subject}"
    subject = say(key) if key in say.messages else name(finding.subject)
    try:
        text = say(f"finding.{finding.code}", subject=subject, **figures)
        text += "".join(say(f"clause.{clause}", **figures) for clause in finding.clauses)
    except KeyError as missing:
        raise InputMalformedError(
            f"finding {finding.code} lacks {missing}: it was stored by another version of photocal",
            remedy="run `photocal analyse` again",
        ) from None
    # Symbols keep their case at the head of a sentence; words do not.
    text = text[0].upper() + text[1:] if key in say.messages else text
    return text if text.endswith(".") else f"{text}."


def _figure(key: str, value: Figure, say: Catalogue, name: Callable[[str], str]) -> object:
    if isinstance(value, str):
        return name(value) if key in PARAMETERS else value
    if not isinstance(value, tuple):
        return Number(value, say.mark)
    if key == "alike":
        return say("join.and").join(_candidate(one, say, name) for one in value)
    return " ".join(name(one) for one in value)


def _candidate(text: str, say: Catalogue, name: Callable[[str], str]) -> str:
    """Say a hidden error that was not chosen, "radial K3"."""
    kind, _, parameter = text.partition(" ")
    return say(f"candidate.{kind}", parameter=name(parameter))


def need_words(need: Requirement, say: Catalogue) -> dict[str, str]:
    """Say what a method of calibration asks for."""
    figures = {key: Number(value, say.mark) for key, value in need.figures.items()}
    parts = ("name", "found", "needed", "advice")
    return {part: say(f"requirement.{need.code}.{part}", **figures) for part in parts}
