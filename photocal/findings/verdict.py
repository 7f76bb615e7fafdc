"""One verdict over all findings: two answers, what to do, and at most seven lines that say why.

The same words stand on the screen, in reports, on a certificate and in JSON.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import groupby
from typing import Any, Literal

from photocal.base.arrays import as_plain
from photocal.base.codec import from_plain
from photocal.base.console import printable
from photocal.base.errors import InputMalformedError
from photocal.findings.document import Paragraph, Remarks, Section
from photocal.findings.finding import FACTOR, Finding, Size
from photocal.findings.texts import Catalogue, finding_json, plain, remedy_text, sentence, subject_text

# May a block be mapped with, may a camera be carried to other flights. Not placed: the datum is inner
# constraints. Held: nothing of the camera was estimated. On positions: nothing else places the block, or
# tests where it lies. On heights: c cannot be separated from a shift of them. Except c: it was held, or is
# weak.
Answer = Literal[
    "yes", "on-positions", "on-heights", "except-c", "reserved", "no", "not-placed", "held", "unknown"
]
# Whoever reads more than that reads nothing; so many that are alike are one line, fewer each say their own.
MOST_LINES, ALIKE = 7, 3
# Causes that no camera can have estimated that was held because the block does not bear it.
_ESTIMATED = ("principal-distance", "principal-point")
# A block that positions alone place, and that nothing tests.
_UNTESTED = {"no-control", "no-check-points"}
# Whose c is weak.
_WEAK = ("weak_principal_distance", "weak_principal_distance_shape")
# What the flight itself leaves open.
_OPEN = ("not-separated", "not-determined")
# What each method of georeferencing shows of one matter.
_OF_METHODS = ("check-outside-prediction", "control-outside-prediction", "method-refused", "global-test")
# What each says in figures of its own: the worst is said, with the names of the others.
_BY_METHOD = ("check-mean", "prediction-too-good")
_ORDER = ("refused", "grave", "doubtful", "consequence")
_CONCERNS = tomllib.loads(resources.files(__package__).joinpath("concerns.toml").read_text(encoding="utf-8"))
_OF_CAMERA, _OF_BLOCK, _SHOWS = (frozenset(_CONCERNS[name]) for name in ("camera", "block", "shows"))
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)$")


@dataclass(frozen=True)
class VerdictLine:
    """One line of a verdict: the worst of findings that are alike.

    subjects: of all of them, the worst first; empty for a single one.
    sizes: the least and the largest of their figures.
    images: of the block; 0 where that is not known.
    """

    worst: Finding
    subjects: tuple[str, ...] = ()
    sizes: tuple[float, float] = (0.0, 0.0)
    images: int = 0


@dataclass(frozen=True)
class Verdict:
    """What may be done with a block and with its camera, and why.

    outcome: "usable", "usable-with-reservations" or "not-usable", with the codes that decided it.
    block, camera: whether it may be mapped with the block, and the camera be carried to other flights.
    lines: the findings that decide, the worst first, `MOST_LINES` at most.
    beyond, notes: how many further lines there would be, and notes.
    """

    outcome: Finding
    block: Answer = "unknown"
    camera: Answer = "unknown"
    lines: tuple[VerdictLine, ...] = ()
    beyond: int = 0
    notes: int = 0


def judge(
    findings: Iterable[Finding], images: int = 0, *, placed: bool = True, calibrated: bool = True
) -> Verdict:
    """Judge over all findings: what is grave withholds acceptance, what is doubtful is a reservation.

    images: of the block; 0 where that is not known.
    placed: whether the block has a datum, by control or positions.
    calibrated: whether anything of a camera was estimated.
    """
    listed = _once(findings)
    deciding = _deciding(listed)
    grave = [f for f in deciding if f.severity in ("refused", "grave")]
    decided = tuple(dict.fromkeys(f.code for f in grave or deciding))
    figures = {"n": float(len(grave or deciding)), "codes": decided, "limit": FACTOR}
    if grave:
        outcome = Finding("not-usable", "grave", figures=figures)
    elif deciding:
        outcome = Finding("usable-with-reservations", "doubtful", figures=figures)
    else:
        outcome = Finding("usable", "passed", figures=figures)
    lines = _lines(by_methods(deciding), images)
    return Verdict(
        outcome,
        _of_block(deciding, listed) if placed else "not-placed",
        _of_camera(deciding, listed) if calibrated else "held",
        lines[:MOST_LINES],
        max(0, len(lines) - MOST_LINES),
        sum(f.severity == "note" for f in listed),
    )


def held_and_contradicted(findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Name once what a block both contradicts and does not determine: advice to estimate it is useless."""
    of_held = {f.subject for f in findings if f.code == "camera-held"}
    contradicted = {
        camera
        for f in findings
        if f.code in _ESTIMATED
        for camera in of_held
        if f"[{camera}]" in str(f.figures.get("numbers"))
    }
    if not contradicted:
        return findings
    return tuple(
        replace(f, severity="consequence")
        if f.code == "camera-held" and f.subject in contradicted
        else replace(f, remedy="camera-held")
        if f.code in _ESTIMATED
        else f
        for f in findings
    )


def every_line(findings: Iterable[Finding], images: int = 0) -> tuple[VerdictLine, ...]:
    """Give all lines of a verdict, and behind them those of the notes, however many there are."""
    listed = _once(by_methods(tuple(findings)))
    notes = [finding for finding in listed if finding.severity == "note"]
    return (*_lines(_deciding(listed), images), *_lines(notes, images))


def _once(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple({(f.code, f.subject, f.cause): f for f in findings}.values())


def _deciding(findings: Iterable[Finding]) -> list[Finding]:
    return sorted((f for f in findings if f.severity in _ORDER), key=_place)


def _place(finding: Finding) -> tuple[int, int]:
    """Causes first, then what shows that something is gravely wrong, then what is wrong with single marks."""
    grave = finding.severity in ("refused", "grave")
    shows, single = finding.code in _SHOWS, finding.code in _OF_BLOCK
    rank = (1 if grave else 2) if shows else (2 if single and not grave else 0)
    return rank, _ORDER.index(finding.severity)


def _answer(deciding: Sequence[Finding], elsewhere: frozenset[str]) -> Answer:
    """What the findings say to one of the two questions, without those that concern the other alone."""
    bearing = [f for f in deciding if f.code not in elsewhere]
    if any(f.severity in ("refused", "grave") for f in bearing):
        return "no"
    return "reserved" if bearing else "yes"


def _of_block(deciding: Sequence[Finding], listed: Iterable[Finding]) -> Answer:
    """Whether the block is fit for mapping; the answer says if positions alone place it, untested."""
    answer, codes = _answer(deciding, _OF_CAMERA), {finding.code for finding in listed}
    return "on-positions" if answer == "yes" and codes >= _UNTESTED else answer


def _of_camera(deciding: Sequence[Finding], listed: Iterable[Finding]) -> Answer:
    """Whether other flights may use the camera; the answer says if not its c, or what determines c."""
    answer = _answer(deciding, _OF_BLOCK)
    if answer == "reserved" and any(map(_leaves_c_open, deciding)):
        return "except-c"
    terms = (f.figures.get("terms") for f in listed if f.code in _OPEN)
    of_heights = any(isinstance(of, list | tuple) and "c" in of for of in terms)
    return "on-heights" if answer == "yes" and of_heights else answer


def _leaves_c_open(finding: Finding) -> bool:
    """Whether a flight does not determine the principal distance: it is weak, or held as given."""
    names = finding.figures.get("names") if finding.code == "camera-held" else None
    return finding.code in _WEAK or (isinstance(names, list | tuple) and "c" in names)


def alike_findings(findings: Iterable[Finding]) -> dict[tuple[str, str], list[Finding]]:
    """Findings of one code and cause, as they are one line where they are many."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.code, finding.cause), []).append(finding)
    return groups


def _lines(deciding: Sequence[Finding], images: int) -> tuple[VerdictLine, ...]:
    """Findings of one code and one cause are one line, in the place of the worst."""
    lines = list[VerdictLine]()
    for alike in alike_findings(deciding).values():
        fewest = 2 if alike[0].code in _BY_METHOD else ALIKE
        together = len(alike) >= fewest and alike[0].code not in _OF_METHODS
        lines += [_line(part, images) for part in ([alike] if together else [[one] for one in alike])]
    return tuple(lines)


def _line(alike: Sequence[Finding], images: int) -> VerdictLine:
    first, *others = sorted(alike, key=lambda f: ((*_ORDER, "note").index(f.severity), -_effect(f.size)))
    if not others:
        return VerdictLine(first)
    sizes = [f.size.figure for f in alike if f.size is not None]
    ends = (min(sizes), max(sizes)) if sizes else (0.0, 0.0)
    return VerdictLine(first, tuple(f.subject for f in (first, *others)), ends, images)


def by_methods(findings: Sequence[Finding]) -> list[Finding]:
    """Say once, with all its methods, what more than one of them shows: points, or a refusal.

    Findings that this has made are among the given ones where a certificate tells them.
    """
    listed = list[Finding]()
    for finding in findings:
        alike = [f for f in findings if (f.code, f.severity) == (finding.code, finding.severity)]
        if finding.code not in _OF_METHODS or len(alike) == 1:
            listed.append(finding)
        elif finding is alike[0]:
            # Each method is refused for a reason of its own: `details` have them.
            shared = {key: figure for key, figure in finding.figures.items() if key != "reason"}
            methods = dict[str, dict[str, None]]()
            for each in alike:
                shows = each.figures["method"]
                for point in each.figures.get("points") or ("",):
                    known = methods.setdefault(str(point), {})
                    known |= dict.fromkeys([shows] if isinstance(shows, str) else shows)
            for of in dict.fromkeys(map(tuple, methods.values())):
                points = tuple(point for point, by in methods.items() if tuple(by) == of and point)
                figures = {**shared, "method": of, **({"points": points} if points else {})}
                listed.append(replace(finding, subject=", ".join(of), figures=figures))
    return listed


def _effect(size: Size | None) -> float:
    return 0.0 if size is None else abs(size.ground_m or size.px or size.figure)


def headline(verdict: Verdict, say: Catalogue) -> str:
    """Say in one paragraph whether the block may be mapped with, the camera be carried, and what to do."""
    answers = [say(f"judgement.block_{verdict.block}")] if verdict.block != "unknown" else []
    answers += [say(f"judgement.camera_{verdict.camera}")] if verdict.camera != "unknown" else []
    remedy = remedy_text(verdict.lines[0].worst, say) if verdict.lines else ""
    if remedy:
        answers.append(say("judgement.first", remedy=remedy))
    elif not verdict.lines:
        answers.append(say("judgement.prove" if verdict.block == "on-positions" else "judgement.nothing"))
    return " ".join(answers)


def line_text(line: VerdictLine, say: Catalogue) -> str:
    """Say one line: what, its effect in the user's unit, what to do."""
    return " ".join(filter(None, (_shown(line, say), remedy_text(line.worst, say))))


def _shown(line: VerdictLine, say: Catalogue) -> str:
    """Say what a line shows, and its effect in the user's unit."""
    text = _grouped(line, say) if line.subjects else sentence(line.worst, say, plain, brief=True)
    return " ".join(filter(None, (text, _effect_text(line.worst.size, say))))


def _grouped(line: VerdictLine, say: Catalogue) -> str:
    key = f"grouped.{line.worst.code}"
    names = [subject_text(line.worst, subject, say) for subject in line.subjects]
    if key not in say.messages:
        text = sentence(line.worst, say, plain, brief=True)
        return f"{text} {say('grouped.also', names=shortened(names[1:]))}"
    text = say(
        key,
        n=len(line.subjects),
        all=line.images or len(line.subjects),
        least=say.fixed(line.sizes[0], 1),
        most=say.fixed(line.sizes[1], 1),
        worst=printable(line.worst.subject),
        names=shortened(names),
    )
    runs = neighbours(line.subjects)
    return f"{text} {say('grouped.neighbours', runs=say('join.and').join(runs))}" if runs else text


def shortened(names: Sequence[str], most: int = 5) -> str:
    """Write the first few of many names, and how many more there are."""
    listed = ", ".join(map(printable, names[:most]))
    return listed if len(names) <= most else f"{listed}, +{len(names) - most}"


def neighbours(names: Sequence[str], least: int = 3) -> list[str]:
    """Find runs of at least so many names whose numbers follow each other, "a_0572 to a_0576"."""
    numbered = []
    for name in names:
        match = _NUMBERED.match(name)
        if match:
            numbered.append((match[1], match[3], int(match[2]), name))
    runs = []
    for _, run in groupby(enumerate(sorted(numbered)), key=lambda each: (*each[1][:2], each[1][2] - each[0])):
        found = [name for _, (_, _, _, name) in run]
        if len(found) >= least:
            runs.append(printable(f"{found[0]} … {found[-1]}"))
    return runs


def _effect_text(size: Size | None, say: Catalogue) -> str:
    """What an error does: on the ground, or in the image; nothing where that is not known."""
    if size is None:
        return ""
    if size.ground_m:
        return say("judgement.on_ground", amount=_length(abs(size.ground_m), say))
    if size.of_distance:
        return say("judgement.of_distance", share=say.significant(100.0 * size.of_distance, 2))
    if size.px:
        return say("judgement.in_image", px=say.significant(abs(size.px), 2))
    return ""


def _length(metres: float, say: Catalogue) -> str:
    """A length as a surveyor writes it: metres, centimetres, or less than a millimetre."""
    if metres >= 1.0:
        return f"{say.significant(metres, 3)} m"
    if metres >= 0.001:
        return f"{say.significant(100.0 * metres, 2)} cm"
    return f"< {say.fixed(0.1, 1)} cm"


def verdict_text(verdict: Verdict, say: Catalogue, beyond: str = "judgement.beyond") -> list[str]:
    """Say all of a verdict: the paragraph, which ends with the first remedy, then its lines.

    beyond: text that says where further findings are listed.
    """
    lines = [line_text(line, say) if k else _shown(line, say) for k, line in enumerate(verdict.lines)]
    if verdict.beyond:
        lines.append(say(beyond, n=verdict.beyond))
    return [headline(verdict, say), *lines]


def verdict_section(verdict: Verdict, say: Catalogue) -> Section:
    """Set a verdict as the first part of a report."""
    paragraph, *lines = verdict_text(verdict, say)
    pieces = (Paragraph(paragraph), Remarks(tuple(lines))) if lines else (Paragraph(paragraph),)
    return Section(say("judgement.section"), pieces)


def verdict_json(verdict: Verdict, say: Catalogue) -> dict[str, Any]:
    """Give a verdict as a JSON value: its outcome as a finding, the answers, and all of it in words."""
    stored = {key: part for key, part in as_plain(verdict).items() if key != "outcome"}
    paragraph, *said = verdict_text(verdict, say)
    return {**finding_json(verdict.outcome, say), **stored, "paragraph": paragraph, "said": said}


def read_verdict(content: Mapping[str, Any], where: object) -> Verdict:
    """Read back what `verdict_json` gave; of older files the outcome alone.

    raises InputMalformedError: when it was stored by another version.
    """
    try:
        outcome = from_plain(Finding, content)
        if "block" not in content:
            return Verdict(outcome)
        made: Verdict = from_plain(Verdict, {**content, "outcome": dict(content)})
    except ValueError as refusal:
        raise InputMalformedError(
            f"its verdict was stored by another version of photocal ({refusal})", "make it again", where=where
        ) from None
    return made
