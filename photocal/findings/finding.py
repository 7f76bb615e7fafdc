"""One thing that a check found: what, how grave, about what, with its figures; catalogues have the words."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from photocal.base.policy import policy

# Refused: the figure cannot be right. Grave: what the client uses is wrong. Doubtful: it contradicts
# another, or an error is large. Consequence: it follows from others that say what is wrong. Note: the reader
# should know. Passed: tested, nothing found. Untested: could not be tested.
Severity = Literal["refused", "grave", "doubtful", "consequence", "note", "passed", "untested"]
Figure = float | str | tuple[str, ...] | None
# Limit of equivalence: a smaller error of the stated standard deviations is no finding, however sure it is.
FACTOR = 0.05


@dataclass(frozen=True)
class Size:
    """How large an error is and what it does.

    c: by how much c was wrong because of it, in the unit of the camera.
    ground_m: what that c makes of heights at the distance of this block, m.
    of_distance: the same as a share of the distance, where nothing gives the block a scale.
    """

    figure: float
    unit: str
    sigma: float | None = None
    c: float | None = None
    ground_m: float | None = None
    px: float | None = None
    of_distance: float | None = None


@dataclass(frozen=True)
class Finding:
    """One finding of a check; `texts` has its wording, `hypotheses` its meaning.

    Attributes
    ----------
    code
        Kind of the finding; key of its text, and of its remedy where there is one.
    subject
        Parameter, pair, camera, image or point that is concerned.
    figures
        Its figures (a `Figure` where a text shows it), SI where the name has no unit; names of points and
        images as tuples, terms by their codes; None where there is no number.
    clauses
        Codes of additional sentences, in order.
    cause, remedy
        Codes of the cause, and of the remedy where it differs from that of the finding.
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
        """Whether it needs no action."""
        return self.severity in ("note", "passed", "untested")


def untested(code: str, cause: str, figures: Mapping[str, Any] | None = None) -> Finding:
    """Give what could not be tested, and why not."""
    return Finding(code, "untested", figures=figures or {}, cause=cause)


def of_global_test(
    chi_squared: float, degrees_of_freedom: int, accepted: bool | None, *, estimated: bool = False
) -> Finding:
    """Give what the global test says of the stated standard deviations.

    accepted: its outcome; None without degrees of freedom, and of standard deviations that are assumed.
    """
    if degrees_of_freedom < 1:
        return untested("global-factor", "no-redundancy")
    factor = math.sqrt(chi_squared / degrees_of_freedom)
    figures = {"factor": factor, "limit": FACTOR}
    if estimated or accepted is None:
        return untested("global-factor", "sigmas-from-residuals", figures)
    if accepted or abs(factor - 1.0) <= FACTOR:
        return Finding("global-factor", "passed", figures=figures)
    # Beyond that the standard deviations say nothing of what is behind the misfit.
    severity: Severity = "grave" if factor > policy.worth_a_word else "doubtful"
    return Finding("global-factor", severity, figures=figures, remedy="scale-sigmas")
