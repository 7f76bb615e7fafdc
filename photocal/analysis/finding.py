"""One thing that a check found: what, how grave, about what, with its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["refused", "doubtful", "note"]


@dataclass(frozen=True)
class Finding:
    """One thing that a check found.

    Attributes
    ----------
    code : str
        What it is; the key of its text.
    severity : {"refused", "doubtful", "note"}
        Refused: the figure cannot be right. Doubtful: it contradicts another. Note: the reader should know.
    subject : str
        Parameter or pair that is concerned.
    figures : mapping
        The figures behind it, with the unit in the name.
    """

    code: str
    severity: Severity
    subject: str
    figures: Mapping[str, float] = field(default_factory=dict)
