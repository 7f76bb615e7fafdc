"""What the stages found doubtful, in one list: it is shown at the end and stands in the certificate."""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Iterable, Iterator
from pathlib import Path
from typing import Any

from photocal.report.warning_sections import NO_WARNINGS, ProcessingWarnings
from photocal.run.doubt import Doubt
from photocal.run.root_causes import causes_first
from photocal.run.stage import made_in

LEAST_FIXED_PERCENT = 95.0
# A parameter that goes so many of its prior sigmas away.
CONTRADICTED = 4.0
# Findings of the exposures that are told image by image.
_SAID_ABOVE = ("unmatched-images", "exposures-without-position")
_NAMED = 5
_UNMATCHED = (
    (
        "unmatched_images",
        "image",
        "images-without-event",
        "without an event: no mark was recorded when they were taken, or it was lost.",
    ),
    ("ambiguous_images", "image", "images-ambiguous", "that may belong to several events: left out."),
    (
        "unmatched_events",
        "event",
        "events-without-image",
        "without an image: images are missing from the folder, or were never written.",
    ),
)


_NOT_CHECKED = Doubt(
    "certificate",
    "not-checked",
    "the stage georeferencing was not made: nobody has looked for faults of positions, mounting and control.",
)


def gather(work: Path, stages: Container[str] | None = None) -> tuple[Doubt, ...]:
    """Collect the warnings of the stages: causes, consequences, notes, each in the order of the stages.

    Parameters
    ----------
    work : Path
        Work folder.
    stages : container of str, optional
        Names of the stages that count; without, all that are there.

    Returns
    -------
    tuple of Doubt
        Each code and text once.
    """
    found: dict[tuple[str, str], Doubt] = {}
    for stage, name, read in _SOURCES:
        counts = stages is None or stage in stages
        figures = read_json(work / stage / name) if counts else None
        for code, text in read(figures) if figures is not None else ():
            found.setdefault((code, text), Doubt(stage, code, text))
    ppk = read_json(work / "ppk" / "ppk.json")
    return causes_first(found.values(), 100.0 if ppk is None else float(ppk["fixed_percent"]))


def told_beside(run: Path) -> ProcessingWarnings:
    """Give what the whole processing told to a certificate that is made of one of its stages.

    Parameters
    ----------
    run : Path
        Run folder; a stage of `photocal run` or not.

    Returns
    -------
    ProcessingWarnings
        Nothing for a folder of `photocal adjust`, which has no stages beside it.
    """
    work = run.resolve().parent
    if not (made_in(work) / run.resolve().name).is_dir():
        return NO_WARNINGS
    found = gather(work)
    if not (work / "georeferencing").is_dir():
        found += (_NOT_CHECKED,)
    return told_by(found)


def told_by(doubts: Iterable[Doubt]) -> ProcessingWarnings:
    """Sort warnings and notes for a certificate."""
    kinds: tuple[list[str], list[str]] = ([], [])
    for one in doubts:
        kinds[one.kind == "note"].append(f"{one.code}: {one.text}")
    return ProcessingWarnings(tuple(kinds[0]), tuple(kinds[1]))


def read_json(path: Path) -> dict[str, Any] | None:
    """Read the figures of a stage; None when it was not made."""
    if not path.is_file():
        return None
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _of_ppk(figures: dict[str, Any]) -> Iterator[tuple[str, str]]:
    told = list(_told(figures))
    fixed = float(figures["fixed_percent"])
    if fixed < LEAST_FIXED_PERCENT and "ppk-not-fixed" not in dict(told):
        text = (
            f"{fixed:.1f} % of the epochs have fixed ambiguities, {figures['float']} are float and "
            f"{figures['single']} single: positions there are decimetres, not centimetres."
        )
        yield "ppk-not-fixed", text
    yield from told


def _of_exposures(figures: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for camera in figures["cameras"]:
        for key, noun, code, text in _UNMATCHED:
            if camera[key]:
                yield code, f"{_listed(camera[key], noun)} {text}"
    for event in figures["not_placed"][:_NAMED]:
        yield "exposure-not-placed", f"event {event['event']} has no position: {event['reason']}."
    for check in figures.get("checks", ()):
        if check["verdict"] == "failed":
            yield check["code"], check["text"]
    without = int(figures["placed"]) - int(figures["with_attitude"])
    told = list(_told(figures))
    if without > 0 and "telemetry-gap" not in dict(told):
        yield "telemetry-gap", f"{without} exposures have no attitude: telemetry was lost."
    yield from ((code, text) for code, text in told if code not in _SAID_ABOVE)


def _of_measurements(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for left in record.get("left_out", ())[:_NAMED]:
        yield "image-left-out", f"image {left['image']} takes no part: {left['reason']}."
    yield from _told(record)
    for text in record.get("warnings", ()):
        yield "measurement", str(text)


def _of_calibration(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Parameters that left what was known of them: something else went into them."""
    for name, camera in result["cameras"].items():
        for key, one in camera["parameters"].items():
            prior, given = one["prior_sigma"], one.get("given")
            if not prior or given is None or abs(one["value"] - given) <= CONTRADICTED * prior:
                continue
            text = (
                f"{key} of camera {name} became {one['value']:.6g} {camera['unit']}, "
                f"{abs(one['value'] - given) / prior:.1f} prior sigmas from the {given:.6g} that was given: "
                "this flight hardly determines it, and what the model lacks goes into it."
            )
            yield "prior-contradicted", text


def _of_analysis(figures: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What the other stages cannot see; the rest of the analysis has its own part of the certificate."""
    for finding in figures["findings"]:
        if finding["kind"] == "rolling-shutter" and not finding["small"]:
            yield "rolling-shutter", finding["sentence"]


def _told(figures: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for finding in figures.get("findings", ()):
        yield finding["code"], finding["text"]


def _listed(names: list[Any], noun: str) -> str:
    shown = ", ".join(str(name) for name in names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{len(names)} {noun}{'s' if len(names) > 1 else ''} ({shown}{more})"


_SOURCES: tuple[tuple[str, str, Callable[[dict[str, Any]], Iterator[tuple[str, str]]]], ...] = (
    ("ppk", "ppk.json", _of_ppk),
    ("exposures", "exposures.json", _of_exposures),
    ("measurements", "measurement.json", _of_measurements),
    ("calibration", "result.json", _of_calibration),
    ("georeferencing", "check.json", _told),
    ("analysis", "analysis.json", _of_analysis),
)
