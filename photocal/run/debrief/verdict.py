"""The debrief: what a flight covers, and what can be said of it while its crew is still in the field."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers, picked
from photocal.base.errors import PhotocalError
from photocal.base.files import output_file, write_json
from photocal.base.operating_system import cache_folder
from photocal.base.progress import Progress
from photocal.base.workers import Workers, run_tasks
from photocal.block.project import Project, WantedCalibration
from photocal.findings import digits
from photocal.findings.finding import Finding, Severity, untested
from photocal.findings.texts import (
    LANGUAGES,
    Catalogue,
    catalogue,
    finding_json,
    finding_text,
    findings_of,
    plain,
)
from photocal.geometry.camera import Camera
from photocal.geometry.oriented_images import oriented_images
from photocal.geometry.rotation import turned_left
from photocal.geometry.strips import strips
from photocal.measurement.image_file import list_images
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.match_images import MatchingPlan
from photocal.navigation.exposure_run import ExposureRun
from photocal.navigation.exposures import Exposures, names_cell, orientations
from photocal.navigation.rig import CameraOnBody
from photocal.planning.area import LocalPlane
from photocal.planning.flown import FlownBlock, below_the_flight, flown_block, gaps, level_ground
from photocal.run.debrief import pictures
from photocal.run.debrief.determined import Determined, determined
from photocal.run.debrief.pictures import PictureQuality, Quick, picture_findings
from photocal.run.exposures import exposures_of
from photocal.run.output_place import check_output
from photocal.run.stage import alone

# Good pictures that must show each place inside the flown area, and the share of it that may be without.
LEAST_COVER, _MAY_LACK = 2, 0.002


@dataclass(frozen=True)
class Coverage:
    """The flown block of an uncomplete flight; m are in a plane about its middle, east and north.

    rows: exposures with a position, in the order of time, and the strip of each, from 0.
    good: rows of the block, those with a good picture.
    holes_deg (k, 2): latitude and longitude of places that too few good pictures show, the largest first.
    hole_m2, area_m2: of these places, and of all that was flown over.
    """

    rows: Integers
    strip: Integers
    good: Integers
    block: FlownBlock
    holes_deg: Floats
    hole_m2: float
    area_m2: float


def coverage(
    exposures: Exposures, usable: Flags, rig: CameraOnBody, camera: Camera, ground_m: float
) -> Coverage:
    """Lay what exposures show onto level ground.

    usable (n,): exposures with a good picture.
    ground_m: height of the ground, of the same kind as those of the exposures.
    """
    placed = exposures.placed
    rows = np.flatnonzero(placed.placed & np.isfinite(placed.lat_deg))
    latitude, longitude = placed.lat_deg[rows], placed.lon_deg[rows]
    plane = LocalPlane(float(np.median(latitude)), float(np.median(longitude)))
    station = np.column_stack([plane.to_plane(latitude, longitude), placed.height_m[rows]])
    seconds = (exposures.time.ns[rows] - exposures.time.ns[rows[0]]) / 1e9
    velocity = placed.velocity_m_s[rows]
    beside = np.gradient(station, seconds + 1e-6 * np.arange(len(rows)), axis=0)
    velocity = np.where(np.isfinite(velocity), velocity, beside)
    turn = orientations(exposures, rig)[0][rows].copy()
    # Without attitude the camera looks down, its upper edge ahead.
    level = turned_left(-np.arctan2(velocity[:, 0], velocity[:, 1]))
    turn = np.where(np.isfinite(turn), turn, level)
    every = oriented_images((camera,), np.zeros(len(rows)), turn, station)
    strip, good = strips(seconds, velocity)[0], np.flatnonzero(usable[rows])
    # The ground below all exposures, but shown by the good ones alone.
    ground = level_ground(every, ground_m)
    block = flown_block(every.only(good), strip[good], ground)
    block = replace(block, inside=below_the_flight(station, ground))
    area = ground.cell_m**2
    holes = np.array([(east, north) for east, north, _ in gaps(block, LEAST_COVER)]).reshape(-1, 2)
    degrees = np.column_stack(plane.to_degrees(holes)) if len(holes) else holes
    lacking = float(np.sum(block.inside & (block.rays < LEAST_COVER)))
    return Coverage(rows, strip, good, block, degrees, area * lacking, area * float(block.inside.sum()))


def coverage_findings(flown: Coverage, exposures: Exposures) -> list[Finding]:
    """Name strips that must be flown again, and holes."""
    findings, forward = [], flown.block.forward
    # Neighbours along a strip must share so much of what they show: less is no stereoscopic cover.
    least_overlap = 0.5
    for strip in np.unique(flown.block.strip).tolist():
        weak = np.flatnonzero((flown.block.strip == strip) & (forward < least_overlap))
        if len(weak):
            figures = {
                "strip": float(strip + 1),
                "overlap_percent": 100.0 * float(forward[weak].min()),
                "least_percent": 100.0 * least_overlap,
                "events": tuple(str(n) for n in exposures.number[flown.rows[flown.good[weak]]]),
            }
            findings.append(Finding("strip-gap", "grave", str(strip + 1), figures))
    if flown.hole_m2 > _MAY_LACK * flown.area_m2:
        latitude, longitude = flown.holes_deg[0].tolist()
        figures = {
            "hole_m2": flown.hole_m2,
            "percent": 100.0 * flown.hole_m2 / flown.area_m2,
            "latitude_deg": latitude,
            "longitude_deg": longitude,
        }
        findings.append(Finding("coverage-hole", "grave", figures=figures))
    return findings


SCHEMA, FILE = "photocal.debrief/1", "debrief.json"
# Verdict of a flight that has not ended.
SO_FAR = "flight-so-far"
# More exposures without fixed ambiguities than this are worth a line; from here on the flight is.
_MAY_FLOAT, _TOO_MANY = 0.1, 0.33
# A flight lower than this over its take-off says nothing of the ground.
_LOW_M = 5.0
# What says that something must be flown again, and what the crew must look at before it leaves.
AGAIN, LOOK = ("refused", "grave"), ("doubtful", "consequence")
_ORDER = (*AGAIN, *LOOK, "note", "passed", "untested")


# What pictures say together, where each alone says nothing: findings, what they cover, how they are oriented.
Together = tuple[Sequence[Finding], Coverage | None, Quick | None]


@dataclass(frozen=True)
class Debrief:
    """What is known of a flight, and whether it is complete, to be checked, or to be flown again."""

    verdict: Finding
    findings: tuple[Finding, ...]
    looks: tuple[PictureQuality, ...]
    exposures: ExposureRun | None = None
    flown: Coverage | None = None
    quick: Quick | None = None
    wanted: WantedCalibration = field(default_factory=WantedCalibration)

    @cached_property
    def determined(self) -> tuple[Determined, ...]:
        """Principal distance of each camera beside what is wanted; none before an orientation."""
        return () if self.quick is None else determined(self.quick, self.wanted)


def debrief(project: Project, processes: Workers, progress: Progress, last: Sequence[Camera] = ()) -> Debrief:
    """Judge a flight by its logs and pictures, as far as they are there; what is done is not done again.

    last: of the last certificate, to hold the first calibration against.
    """
    check_output(project)
    with alone(project.output):
        paths = list_images(project.picture_folder)
        plan = MatchingPlan(cache_folder(), processes, pictures.QUICK)
        findings, run, rig = list[Finding](), None, CameraOnBody()
        try:
            run, rig, refusal_of_ppk = exposures_of(project, progress)
            if refusal_of_ppk:
                findings.append(Finding("no-ppk", "grave", figures={"reason": refusal_of_ppk}))
        except PhotocalError as refusal:
            findings.append(Finding("exposures-unknown", "grave", figures={"reason": str(refusal)}))
        with progress("checking pictures", len(paths)) as done:
            # Pictures examined earlier are cached by content.
            looks = list(run_tasks(pictures.look, ((path, plan) for path in paths), processes, done))
        if run is not None:
            findings += _exposure_findings(run, len(paths))
        combined, flown, quick = judged_together(looks, run, rig, last, plan, progress)
        findings = in_order([*findings, *picture_findings(looks), *combined])
        wanted = project.contents.calibration
        made = Debrief(_verdict(findings), tuple(findings), tuple(looks), run, flown, quick, wanted)
        with output_file(project.output / FILE) as aside:
            write_json(aside, debrief_json(made))
        return made


def in_order(findings: Sequence[Finding]) -> list[Finding]:
    """Findings, the worst first."""
    return sorted(findings, key=lambda finding: _ORDER.index(finding.severity))


def judged_together(
    looks: Sequence[PictureQuality],
    run: ExposureRun | None,
    rig: CameraOnBody,
    last: Sequence[Camera],
    plan: MatchingPlan,
    progress: Progress,
    before: Quick | None = None,
) -> Together:
    """Orient good pictures quickly, hold their calibration against the last one, and see what they cover.

    before: the orientation of some of them, which is continued.
    """
    unusable = [one for one in picture_findings(looks) if one.code in pictures.UNUSABLE]
    bad = {name for finding in unusable for name in finding.figures["images"]}
    good = [look for look in looks if look.path.name not in bad and look.facts is not None]
    findings, flown, quick = list[Finding](), None, None
    if len(good) >= 3:
        facts = [look.facts for look in good if look.facts is not None]
        if run is not None:
            facts = pictures.with_positions(facts, run.exposures)
        keys = [look.key for look in good]
        quick, findings = pictures.quick_findings(facts, keys, last, plan, progress, before)
    if run is not None:
        flown, uncovered = _covered(run, rig, good, quick)
        findings = [*findings, *uncovered]
    return findings, flown, quick


def _exposure_findings(run: ExposureRun, count: int) -> list[Finding]:
    """What the exposures say by themselves: partners, positions and their state, attitudes."""
    findings = [finding for finding in findings_of(run.figures["findings"], Path(FILE)) if not finding.small]
    strangers = [finding for finding in findings if finding.code == "images-without-event"]
    lonely = sum(finding.figures["n"] for finding in strangers)
    # Of the pictures that have no exposure: they are of another flight.
    wrong_card = 0.5
    if lonely > wrong_card * count:
        figures = {"n": lonely, "all": float(count)}
        findings = [finding for finding in findings if finding not in strangers]
        findings.append(Finding("wrong-card", "grave", figures=figures))
    placed = run.exposures.placed
    status, there = placed.status[placed.placed], int(placed.placed.sum())
    loose = int((status != "fixed").sum())
    if run.trajectory is not None and loose > _MAY_FLOAT * there:
        counts = {name: float((status == name).sum()) for name in ("fixed", "float", "single")}
        severity: Severity = "grave" if loose > _TOO_MANY * there else "doubtful"
        findings.append(Finding("positions-not-fixed", severity, figures={**counts, "all": float(there)}))
    return findings


def _covered(
    run: ExposureRun, rig: CameraOnBody, good: Sequence[PictureQuality], quick: Quick | None
) -> tuple[Coverage | None, list[Finding]]:
    exposures, facts = run.exposures, next((look.facts for look in good if look.facts is not None), None)
    ground = _ground(run)
    lowest = np.nanmin(exposures.placed.height_m, initial=np.inf)
    if ground is None and quick is not None and lowest - quick.ground_m > _LOW_M:
        ground = quick.ground_m
    if facts is None or ground is None or exposures.placed.placed.sum() < 3:
        return None, [untested("coverage-hole", "no-ground-height")]
    names = {look.path.name for look in good}
    usable = np.array([not names.isdisjoint(images) for images in exposures.images])
    if usable.sum() < 2:
        return None, []
    flown = coverage(exposures, usable, rig, stated_camera("", facts).camera, ground)
    return flown, coverage_findings(flown, exposures)


def _ground(run: ExposureRun) -> float | None:
    """Height of the ground below the flight, of the kind of the exposures' heights; None if unknown.

    Of the take-off: by the height above it that pictures state, or where the trajectory stood still.
    """
    heights, above = run.exposures.placed.height_m, run.exposures.above_take_off_m
    if above is not None and np.isfinite(heights - above).any():
        return float(np.nanmedian(heights - above))
    if run.trajectory is None:
        return None
    lowest = float(np.quantile(run.trajectory.height_m, 0.02))
    return lowest if np.nanmin(heights) - lowest > _LOW_M else None


def _verdict(findings: Sequence[Finding]) -> Finding:
    """Complete, to be checked, or to be flown again."""
    again = tuple(dict.fromkeys(finding.code for finding in findings if finding.severity in AGAIN))
    look = tuple(dict.fromkeys(finding.code for finding in findings if finding.severity in LOOK))
    figures = {"n": float(len(again or look)), "codes": again or look}
    if again:
        return Finding("fly-again", "grave", figures=figures)
    if look:
        return Finding("flight-to-look-at", "doubtful", figures=figures)
    return Finding("flight-complete", "passed")


def debrief_json(made: Debrief) -> dict[str, Any]:
    """A debrief as a JSON value; pages show it as it stands."""
    say = catalogue("en")
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": finding_json(made.verdict, say),
        "summary": measured_text(_measured(made), say),
        "measured": _measured(made),
        "findings": [finding_json(finding, say) for finding in made.findings],
        "said": {language: _said(made, catalogue(language)) for language in LANGUAGES},
        "pictures": [{"image": look.path.name, **picked(look, *pictures.MEASURED)} for look in made.looks],
        "exposures": [] if made.exposures is None else _exposures(made.exposures, made.flown),
        "coverage": None,
        "quick": None,
    }
    flown, quick = made.flown, made.quick
    if flown is not None:
        overlap = _overlap(flown)
        content["coverage"] = {
            "area_m2": flown.area_m2,
            "hole_m2": flown.hole_m2,
            "holes_deg": flown.holes_deg.tolist(),
            "overlap_median": float(np.median(overlap)) if len(overlap) else None,
        }
    if quick is not None:
        content["quick"] = {"joined": quick.joined, "cameras": quick.cameras}
        content["determined"] = [asdict(camera) for camera in made.determined]
    return content


def _said(made: Debrief, say: Catalogue) -> dict[str, Any]:
    """Verdict, figures and findings in one language, for pages that have no texts of findings."""
    return {
        "verdict": finding_text(made.verdict, say, plain),
        "calibration": calibration_text(made, say),
        "summary": measured_text(_measured(made), say),
        "findings": [finding_text(finding, say, plain) for finding in made.findings],
    }


def _exposures(run: ExposureRun, flown: Coverage | None) -> list[dict[str, Any]]:
    placed, listed = run.exposures.placed, []
    strip = {} if flown is None else dict(zip(flown.rows.tolist(), flown.strip.tolist(), strict=True))
    for k, images in enumerate(run.exposures.images):
        there = bool(placed.placed[k])
        listed.append(
            {
                "event": int(run.exposures.number[k]),
                "image": names_cell(images) or None,
                "place_deg": [float(placed.lat_deg[k]), float(placed.lon_deg[k])] if there else None,
                "state": str(placed.status[k]) if there else None,
                "strip": strip[k] + 1 if k in strip else None,
            }
        )
    return listed


def debrief_text(made: Debrief, say: Catalogue) -> str:
    """A debrief in words."""
    lines = [finding_text(made.verdict, say), *calibration_text(made, say)]
    lines += [f"- {finding_text(finding, say)}" for finding in made.findings if finding.severity != "passed"]
    return "\n".join(lines + measured_text(_measured(made), say))


def _measured(made: Debrief) -> list[tuple[str, dict[str, Any]]]:
    """What was measured: keys of texts with their figures, of pictures, overlap and c of each camera."""
    quick, flown = made.quick, made.flown
    readable = sum(look.facts is not None for look in made.looks)
    told: list[tuple[str, dict[str, Any]]] = [("debrief.pictures", {"n": readable, "all": len(made.looks)})]
    if quick is not None:
        told.append(("debrief.joined", {"n": quick.joined}))
    if flown is not None and len(overlap := 100.0 * _overlap(flown)):
        least = {"median": float(np.median(overlap)), "least": float(overlap.min())}
        told.append(("debrief.overlap", least))
    for entry in () if quick is None else quick.cameras:
        if (released := entry["released"]) is not None:
            own = {"camera": entry["camera"], "unit": entry["unit"]}
            told.append(("debrief.camera", {**own, "c": released["c"], "sigma": released["sigma"]}))
    return told


def calibration_text(made: Debrief, say: Catalogue) -> list[str]:
    """Say of each camera in a line whether the flight determines c as well as is wanted."""
    flying = made.verdict.code == SO_FAR
    return [_line_of(camera, flying, say) for camera in made.determined]


def _line_of(camera: Determined, flying: bool, say: Catalogue) -> str:
    figures = {
        "camera": camera.camera,
        "unit": camera.unit,
        "wanted": digits.significant(camera.wanted, 2, say.mark),
        "source": say(f"debrief.source.{camera.source}"),
        "lacks": say(f"debrief.lacks.{camera.lacks}") if camera.lacks else "",
    }
    if camera.c is None or camera.sigma is None:
        return say("debrief.untold", **figures)
    c, sigma, _ = digits.measured(camera.c, camera.sigma, say.mark)
    good = "debrief.may_land" if flying else "debrief.determined"
    return say("debrief.undetermined" if camera.lacks else good, **figures, c=c, sigma=sigma)


def measured_text(measured: Iterable[tuple[str, dict[str, Any]]], say: Catalogue) -> list[str]:
    """Say in lines what was measured, as it stands in the ``measured`` of a debrief."""
    return [say(key, **_printed(figures, say.mark)) for key, figures in measured]


def _printed(figures: dict[str, Any], mark: str) -> dict[str, Any]:
    """Figures as their text takes them: c with the decimals of its standard deviation."""
    printed = {name: digits.Number(v, mark) if isinstance(v, float) else v for name, v in figures.items()}
    if "sigma" in figures:
        printed["c"], printed["sigma"], _ = digits.measured(figures["c"], figures["sigma"], mark)
    return printed


def _overlap(flown: Coverage) -> Floats:
    """Shares of good pictures that the next one of their strip shows, too."""
    return flown.block.forward[np.isfinite(flown.block.forward)]
