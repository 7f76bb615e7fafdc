"""One thing that a person must look at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["warning", "consequence", "note"]
_NOTES = ("not-separated", "not-determined", "no-control", "sigmas-too-large")


@dataclass(frozen=True)
class Doubt:
    """One thing that a person must look at.

    Attributes
    ----------
    stage : str
        Which found it.
    code : str
        Its name, for programs.
    text : str
        What was found, with its figures.
    consequence : bool
        Whether it shows only that something is wrong, and other warnings say what.
    """

    stage: str
    code: str
    text: str
    consequence: bool = False

    @property
    def kind(self) -> Kind:
        """Whether it tells a fault, what follows from faults that are told, or a limit of the flight."""
        if self.code in _NOTES:
            return "note"
        return "consequence" if self.consequence else "warning"

    def as_json(self) -> dict[str, str]:
        """Give it as a JSON value."""
        return {"kind": self.kind, "stage": self.stage, "code": self.code, "text": self.text}
