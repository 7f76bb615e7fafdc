"""Marks of control as they will be used: brought to the stored pictures, the others named."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from photocal.exchange.parts import Mark
from photocal.findings.finding import Finding
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.mark_frames import AS_STORED, FrameChoice, MarkFrame, choose_frame, inside


@dataclass(frozen=True)
class SettledMarks:
    """Marks of known points in pictures that are there, px of the stored grid.

    frame: of the pictures that they were made in.
    left_out: marks that cannot be used, each with the finding that says why.
    """

    marks: tuple[Mark, ...]
    frame: MarkFrame
    left_out: tuple[tuple[Mark, Finding], ...]
    findings: tuple[Finding, ...]


def settle_marks(
    marks: Sequence[Mark], points: Collection[str], facts: Sequence[ImageFacts], folder: Mapping[str, Path]
) -> SettledMarks:
    """Settle marks before any work.

    points: names of those that are known.
    folder: where the pictures lie, by name.
    """
    pictures, names = {image.name: image for image in facts}, frozenset(points)
    left_out = [(mark, cause) for mark in marks if (cause := _unknown(mark, names, pictures)) is not None]
    lost = {id(mark) for mark, _ in left_out}
    here = [mark for mark in marks if id(mark) not in lost]
    frame, findings = AS_STORED, list[Finding]()
    if here:
        choice = choose_frame(here, pictures, folder)
        if choice.sure and choice.chosen != AS_STORED:
            frame = choice.chosen
            findings.append(_reframed(choice))
    kept = list[Mark]()
    for given, mark in zip(here, frame.stored(here, pictures), strict=True):
        if inside(mark, pictures[mark.image].size_px):
            kept.append(mark)
            continue
        figures = {"image": mark.image, "x": mark.x, "y": mark.y}
        left_out.append((given, Finding("mark-outside", "doubtful", mark.point, figures)))
    return SettledMarks(tuple(kept), frame, tuple(left_out), tuple(findings))


def _unknown(mark: Mark, points: Collection[str], pictures: Collection[str]) -> Finding | None:
    """What a mark names that is not there; None for a mark that can be used."""
    subject = f"{mark.point} ({mark.image})"
    if mark.point not in points:
        return Finding("unknown-mark", "doubtful", subject, cause="no-such-point")
    if mark.image not in pictures:
        return Finding("unknown-mark", "doubtful", subject, cause="no-such-picture")
    return None


def _reframed(choice: FrameChoice) -> Finding:
    own, best = choice.fit_of(AS_STORED), choice.fits[0]
    figures = {"frame": str(choice.chosen), "n": float(choice.pairs), "outside": float(own.outside)}
    if np.isnan(best.miss):
        return Finding("marks-reframed", "doubtful", figures=figures, clauses=("all-fall-inside",))
    figures |= {"percent": 100.0 * best.miss, "percent_as_stored": 100.0 * own.miss}
    return Finding("marks-reframed", "doubtful", figures=figures, clauses=("pairs-meet",))
