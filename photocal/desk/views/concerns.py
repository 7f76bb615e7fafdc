"""What findings are about: the images, points, observations and parameters that they name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from photocal.desk.views.shown import Shown
from photocal.findings.finding import Finding
from photocal.findings.texts import PARAMETERS as PARAMETER_FIGURES
from photocal.findings.texts import Catalogue, plain, remedy_text, sentence
from photocal.findings.verdict import VerdictLine, every_line, headline, line_text
from photocal.geometry.camera import PARAMETERS
from photocal.run.summary import project_findings, project_verdict

# "P5 (a.jpg)" as marks are named, and "P5 / a.jpg" as what was left out.
_MARK = re.compile(r"^(?P<point>.+?)(?: \((?P<image>.+)\)| / (?P<other>.+))$")
_KINDS = {"refused": "bad", "grave": "bad", "doubtful": "warn", "consequence": "warn", "note": "note"}


def findings(shown: Shown, say: Catalogue) -> dict[str, Any]:
    """All findings, grouped and worst first, each with its remedy and what it concerns; the verdict above."""
    found = project_findings(shown.work)
    verdict = project_verdict(shown.work)
    lines = every_line(found, len(shown.images))
    alike = _of_lines(found)
    return {
        "paragraph": "" if verdict is None else headline(verdict, say),
        "outcome": None if verdict is None else verdict.outcome.code,
        "lines": [_line(line, alike, shown, say) for line in lines],
    }


def _of_lines(found: Iterable[Finding]) -> Mapping[tuple[str, str], list[Finding]]:
    """Findings of one code and cause, as they are one line where they are many."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in found:
        groups.setdefault((finding.code, finding.cause), []).append(finding)
    return groups


def _line(
    line: VerdictLine, alike: Mapping[tuple[str, str], list[Finding]], shown: Shown, say: Catalogue
) -> dict[str, Any]:
    worst = line.worst
    told = alike.get((worst.code, worst.cause), [worst]) if line.subjects else [worst]
    remedy = remedy_text(worst, say)
    text = line_text(line, say)
    return {
        "code": worst.code,
        "severity": worst.severity,
        "kind": _KINDS.get(worst.severity, "note"),
        "text": text.removesuffix(remedy).rstrip() if remedy else text,
        "remedy": remedy,
        "details": [sentence(finding, say, plain) for finding in told],
        "stage": worst.stage,
        "concerns": concerns(told, shown),
    }


def concerns(found: Iterable[Finding], shown: Shown) -> dict[str, list[Any]]:
    """Images, points, observations (image, point) and parameters (camera, name) that findings name."""
    images, points, marks, parameters = (dict[Any, None]() for _ in range(4))
    for finding in found:
        pair = finding.figures.get("image"), finding.figures.get("point", finding.subject)
        if all(isinstance(part, str) and part for part in pair):
            marks[pair] = None
        for key, name in _names(finding):
            match = _MARK.match(name)
            if match and (match["image"] or match["other"]) in shown.image_rows:
                marks[match["image"] or match["other"], match["point"]] = None
            elif name in shown.image_rows:
                images[name] = None
            elif key not in PARAMETER_FIGURES and _is_point(name, shown):
                points[name] = None
            elif (parameter := _parameter(name, finding, shown)) is not None:
                parameters[parameter] = None
    # An observation is seen through its point, in its picture.
    for image, point in marks:
        images |= dict.fromkeys([image] if image in shown.image_rows else [])
        points |= dict.fromkeys([point] if _is_point(point, shown) else [])
    return {
        "images": list(images),
        "points": list(points),
        "observations": [list(mark) for mark in marks],
        "parameters": [list(parameter) for parameter in parameters],
    }


def _names(finding: Finding) -> Iterator[tuple[str, str]]:
    """What a finding names, with the key of the figure; none for its subject."""
    yield "", finding.subject
    for key, value in finding.figures.items():
        yield from ((key, str(each)) for each in ([value] if isinstance(value, str) else _listed(value)))


def _listed(value: Any) -> Iterable[Any]:
    return value if isinstance(value, tuple | list) else ()


def _is_point(name: str, shown: Shown) -> bool:
    return name in shown.point_rows or name in shown.surveyed


def _parameter(name: str, finding: Finding, shown: Shown) -> tuple[str, str] | None:
    """A parameter of a camera: named with it, as "cam K1", beside it, or of the only camera."""
    camera, _, last = name.rpartition(" ")
    last = last if last in PARAMETERS else ""
    camera = camera or str(finding.figures.get("camera", "")) or next(iter(shown.result.cameras))
    return (camera, last) if last and camera in shown.result.cameras else None
