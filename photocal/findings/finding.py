"""One thing that a check found: what, how grave, about what, with its figures; catalogues have the words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

# Refused: the figure cannot be right. Grave: what the client uses is wrong. Doubtful: it contradicts
# another, or an error is large. Consequence: it follows from others that say what is wrong. Note: the reader
# should know. Passed and untested: what was looked at in vain, and what could not be looked at.
Severity = Literal["refused", "grave", "doubtful", "consequence", "note", "passed", "untested"]
Figure = float | str | tuple[str, ...] | None


@dataclass(frozen=True)
class Size:
    """How large an error is and what it does.

    Attributes
    ----------
    figure : float
        Its figure.
    unit : str
        Unit of the figure.
    sigma : float or None
        Standard deviation of the figure (a priori).
    c : float or None
        By how much c was wrong because of it, in the unit of the camera.
    ground_m : float or None
        What that c makes of heights at the distance of this block, m.
    px : float or None
        Largest displacement in the image, px.
    """

    figure: float
    unit: str
    sigma: float | None = None
    c: float | None = None
    ground_m: float | None = None
    px: float | None = None


@dataclass(frozen=True)
class Finding:
    """One thing that a check found; `texts` says it, `hypotheses` knows what it means.

    Attributes
    ----------
    code : str
        What it is; the key of its text, and of its remedy where there is one.
    severity : str
        See above.
    subject : str
        Parameter, pair, camera, image or point that is concerned.
    figures : mapping
        The figures behind it (a `Figure` where a text says it), SI where the name has no unit; names of
        points and images as tuples, terms by their codes; None is no number.
    clauses : tuple of str
        Codes of what else is to be said, in order.
    size : Size or None
        Of an error that was found.
    cause, remedy : str
        Codes of why, and of what to do where it is not the remedy of the code itself.
    stage : str
        Stage of the processing that found it.
    """

    code: str
    severity: Severity
    subject: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    clauses: tuple[str, ...] = ()
    size: Size | None = None
    cause: str = ""
    remedy: str = ""
    stage: str = ""

    @property
    def small(self) -> bool:
        """Whether it may be left as it is."""
        return self.severity in ("note", "passed", "untested")


def untested(code: str, cause: str, figures: Mapping[str, Any] | None = None) -> Finding:
    """Give what could not be looked at, and why not."""
    return Finding(code, "untested", figures=figures or {}, cause=cause)
