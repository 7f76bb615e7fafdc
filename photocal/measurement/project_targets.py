"""All targets of a project: coded ones wherever they are, uncoded ones where the exposures predict them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivers.errors import ConfigurationError
from photocal.block.model import ObjectPoints
from photocal.exchange.parts import Mark
from photocal.findings.finding import Finding
from photocal.measurement.coded_targets import find_coded_targets
from photocal.measurement.orientation import Orientation
from photocal.measurement.oriented_ties import Progress
from photocal.measurement.plain_targets import find_plain_targets
from photocal.measurement.refine import Source
from photocal.project import Project
from photocal.tasks.workers import Workers


@dataclass(frozen=True)
class Targets:
    """Targets that were found in the images of a project.

    strangers: codes without a name.
    record: how many were sought and found, and what was refused.
    """

    marks: tuple[Mark, ...]
    strangers: tuple[str, ...]
    record: dict[str, Any]
    findings: tuple[Finding, ...]


def targets_of_project(
    project: Project,
    sources: Sequence[Source],
    exposures: Orientation | None,
    control: ObjectPoints,
    workers: Workers,
    progress: Progress,
) -> Targets:
    """Find the targets of a project."""
    given = project.control
    marks: list[Mark] = []
    strangers: list[str] = []
    findings: list[Finding] = []
    record: dict[str, Any] = {"coded": 0}
    _require_points(project, control)
    for coded in given.coded_targets:
        with progress("looking for coded targets", len(sources)) as done:
            found, unnamed = find_coded_targets(sources, coded.dictionary, coded.names, workers, done)
        marks += found
        strangers += unnamed
    record["coded"] = len(marks)
    kinds = ", ".join(dict.fromkeys(own.kind for own in given.plain_targets))
    if given.plain_targets and exposures is None:
        findings.append(Finding("targets-not-sought", "doubtful", kinds))
    elif exposures is not None and given.plain_targets:
        with progress("looking for targets", len(sources)) as done:
            plain = find_plain_targets(sources, exposures, control, given.plain_targets, workers, done)
        marks += plain.marks
        record["plain"] = {
            "predicted": plain.sought,
            "found": len(plain.marks),
            "ambiguous": list(plain.ambiguous),
            "too_small": list(plain.too_small),
        }
        findings += [Finding("target-ambiguous", "doubtful", refusal) for refusal in plain.ambiguous]
        findings += [Finding("target-too-small", "doubtful", refusal) for refusal in plain.too_small]
        if plain.sought and not plain.marks:
            findings.append(Finding("no-target-found", "doubtful", kinds, {"n": float(plain.sought)}))
    return Targets(tuple(marks), tuple(strangers), record, tuple(findings))


def _require_points(project: Project, control: ObjectPoints) -> None:
    table = project.control.points
    for own in project.control.plain_targets:
        for name in own.points:
            if name not in control.names:
                raise ConfigurationError(
                    f"targets ({own.kind}) name point {name}, "
                    f"which {'[control] without points' if table is None else table.name} lacks",
                    where=project.path,
                    remedy="correct the name or add the point",
                )
