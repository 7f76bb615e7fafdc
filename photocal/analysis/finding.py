"""One thing that a check found: what, how grave, about what, with its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["refused", "doubtful", "note"]
Figure = float | str | tuple[str, ...]


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
    """One thing that a check found. Its words, in whatever language, are the reports' (`photocal.report`).

    Attributes
    ----------
    code : str
        What it is; the key of its text.
    severity : {"refused", "doubtful", "note"}
        Refused: the figure cannot be right. Doubtful: it contradicts another, or an error is large. Note: the
        reader should know.
    subject : str
        Parameter, pair, camera or image that is concerned.
    figures : mapping
        The figures behind it, with the unit in the name where it is not said by another; names of
        parameters as text.
    clauses : tuple of str
        Codes of what else is to be said, in order.
    size : Size or None
        Of an error that was found.
    """

    code: str
    severity: Severity
    subject: str
    figures: Mapping[str, Figure] = field(default_factory=dict)
    clauses: tuple[str, ...] = ()
    size: Size | None = None

    @property
    def small(self) -> bool:
        """Whether it may be left as it is."""
        return self.severity == "note"
