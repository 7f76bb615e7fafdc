"""What was said of simulated flights, a row of plain cells each, and what that is worth against the truth."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from tests.independent.faults import Fault

# What follows of errors, what a block cannot tell, and what is said of samples: none of it is a cause.
NO_CAUSES = (
    *("check-outside-prediction", "control-outside-prediction", "prediction-too-good", "check-mean"),
    "global-test",
    *("global-factor", "method-refused", "not-separated", "not-determined", "no-check-points", "no-control"),
    "strips-without-control",
    *("coarse-positions", "c-on-positions", "heights-on-positions", "small-sample", "single-check-point"),
    *("bias", "outliers", "not-normal", "c-bias", "significance", "jackknife", "unexplained"),
)
RANK = ("refused", "grave", "doubtful", "consequence", "note", "passed", "untested")
HARSH = RANK[:3]


@dataclass(frozen=True)
class Told:
    """A finding: its code, severity, subject and cause, and what the flight cannot tell from it."""

    code: str
    severity: str
    subject: str = ""
    cause: str = ""
    rivals: str = ""

    @property
    def is_cause(self) -> bool:
        """Whether it names what is wrong, not what follows of it."""
        return self.code not in NO_CAUSES and self.severity not in ("passed", "untested")


@dataclass(frozen=True)
class Row:
    """A flight and what was said of it.

    check, analyse: findings of both commands, "severity code subject cause" each, separated by bars.
    damage: true error at the check points over the predicted one, worst axis, by the best method there is.
    p, p_mean: of the joint tests. biased: whether a mean is called biased.
    """

    kind: str
    name: str
    seed: int
    check_verdict: str
    analyse_verdict: str
    check: str
    analyse: str
    damage: float
    p: float
    p_mean: float
    biased: int
    sigma0_squared: float
    analyse_adjustments: int
    check_adjustments: int
    adjust_s: float
    analyse_s: float
    check_s: float

    def told(self, command: str) -> list[Told]:
        """Findings of "check" or "analyse", in their order."""
        return findings(getattr(self, command))

    def causes(self, command: str) -> list[Told]:
        """What a command names as causes, the gravest first."""
        named = [one for one in self.told(command) if one.is_cause]
        return sorted(named, key=lambda one: RANK.index(one.severity))


def cell(told: Iterable[Told]) -> str:
    """Write findings into one cell."""
    clean = ([text.replace(" ", "~").replace("|", "/") for text in astuple(one)] for one in told)
    return "|".join(
        " ".join((severity, code, subject or "-", cause or "-", *[rivals] * bool(rivals)))
        for code, severity, subject, cause, rivals in clean
    )


def findings(text: str) -> list[Told]:
    """Read findings from their cell."""
    listed = []
    for one in text.split("|") if text else []:
        severity, code, *about = one.split(" ")
        listed.append(
            Told(code, severity, *("" if text == "-" else text.replace("~", " ") for text in about))
        )
    return listed


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as CSV, numbers to three digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow([field.name for field in fields(Row)])
        for row in rows:
            out.writerow([f"{v:.3g}" if isinstance(v, float) else v for v in astuple(row)])


def read_rows(path: Path) -> list[Row]:
    """Read rows that were written."""
    kinds = {"int": int, "float": float, "str": str}
    with path.open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    return [Row(**{f.name: kinds[str(f.type)](row[f.name]) for f in fields(Row)}) for row in table]


def named_or_rival(fault: Fault, row: Row, command: str) -> bool:
    """Whether the first cause is the fault, or says that the flight cannot tell it from the fault."""
    named = row.causes(command)
    return named_first(fault, row, command) or bool(named and says_rival(fault, named[0]))


def says_rival(fault: Fault, told: Told) -> bool:
    """Whether a finding says that the flight cannot tell it from the fault: from its kind, or its points."""
    return bool({*fault.names, *fault.subjects} & set(told.rivals.split(",")))


def named_first(fault: Fault, row: Row, command: str) -> bool:
    """Whether the first cause is the fault, and everything that it concerns is named."""
    named = row.causes(command)
    if not fault.names:
        return not any(one.severity in HARSH for one in named)
    if not named or named[0].code not in fault.names:
        return False
    if not fault.subjects:
        return True
    words = {word for one in named if one.code in fault.names for word in _words(one.subject)}
    return bool(set(_words(named[0].subject)) & set(fault.subjects)) and set(fault.subjects) <= words


def accused(fault: Fault, row: Row, command: str, harsh: tuple[str, ...] = HARSH) -> list[Told]:
    """Give what is named although it is sound, and is no reservation with the fault as its rival."""
    return [
        one
        for one in row.causes(command)
        if one.severity in harsh
        and not (one.severity == "doubtful" and says_rival(fault, one))
        and (
            one.code not in fault.names
            or (fault.subjects and not set(_words(one.subject)) & set(fault.subjects))
        )
    ]


def _words(subject: str) -> list[str]:
    """Images and control points that a subject speaks of."""
    return re.findall(r"IMG_\d+|co\d+", subject)
