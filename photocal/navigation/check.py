"""One check of a summary: what was compared, what came out, and what it means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["passed", "failed", "not possible"]


@dataclass(frozen=True)
class Check:
    """A check.

    Parameters
    ----------
    code : str
        Short name, the same in every run, for example ``time-offset``.
    verdict : str
        ``passed``, ``failed`` or ``not possible`` with what this flight has.
    compared : str
        What was held against what.
    text : str
        What came out, in a sentence.
    figures : dict
        The numbers behind it.
    """

    code: str
    verdict: Verdict
    compared: str
    text: str
    figures: dict[str, Any]


def findings(checks: list[Check]) -> list[dict[str, str]]:
    """Return the failed checks as warnings."""
    return [{"code": c.code, "text": c.text} for c in checks if c.verdict == "failed"]
