"""Uncoded targets of control points: found where the exposures predict them, named by where they lie."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.progress import Progress
from photocal.base.workers import Workers, run_tasks
from photocal.block.model import ObjectPoints
from photocal.block.project import PlainTargets, Project
from photocal.exchange.parts import Mark
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.measurement.features import Arrays, array_key, cached, combined_key
from photocal.measurement.image_file import read_grey
from photocal.measurement.markers import COMMON_PX, find_coded_targets
from photocal.measurement.orientation import Orientation, predict
from photocal.measurement.patch_matching import ImageSource
from photocal.measurement.target_centre import PARTS, SMALLEST_PX, TargetImage, ground_bend, measurable
from photocal.measurement.target_search import find_targets


@dataclass(frozen=True)
class PredictedTarget:
    """Where an image should show the target of a point.

    place (2,): column and row, px.
    covariance (2, 2).
    """

    point: str
    place: Floats
    covariance: Floats
    look: TargetImage


@dataclass(frozen=True)
class FoundTargets:
    """Targets that were found in images.

    marks: with the standard deviation that the grey values give, and a common part.
    strangers: codes without a name.
    record: how many were searched for and found, and what was refused. Points are ambiguous that were given
        up because two targets fit them, or their target fits two points; too small where no image shows them
        large enough to be distinguished from a speck.
    """

    marks: tuple[Mark, ...] = ()
    strangers: tuple[str, ...] = ()
    record: dict[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


def find_plain_targets(
    sources: Sequence[ImageSource],
    orientation: Orientation,
    points: ObjectPoints,
    wanted: Sequence[PlainTargets],
    processes: Workers,
    done: Callable[[float], None],
) -> FoundTargets:
    """Find uncoded targets in images."""
    predicted = predicted_targets(orientation, points, wanted)
    expected = {
        name: tuple(s for s in in_image if s.look.large_enough) for name, in_image in predicted.items()
    }
    tasks = [(source, expected.get(source.path.name, ())) for source in sources]
    marks: list[Mark] = []
    doubts: dict[str, list[str]] = {}
    for (source, predictions), targets in zip(tasks, run_tasks(_find, tasks, processes, done), strict=True):
        name = source.path.name
        named, doubtful = identified(predictions, targets)
        marks += [replace(mark, image=name) for mark in named]
        for point, doubt in doubtful.items():
            doubts.setdefault(point, []).append(f"{doubt} in {name}")
    # An object next to a target is there in all images, though some may not show both.
    sure = tuple(mark for mark in marks if mark.point not in doubts)
    sought = sum(len(predictions) for _, predictions in tasks)
    ambiguous = [f"point {name}: {reasons[0]}" for name, reasons in doubts.items()]
    small = _too_small(predicted.values())
    findings = [Finding("target-ambiguous", "doubtful", refusal) for refusal in ambiguous]
    findings += [Finding("target-too-small", "doubtful", refusal) for refusal in small]
    if sought and not sure:
        findings.append(Finding("no-target-found", "doubtful", kinds_of(wanted), {"n": float(sought)}))
    record = {"predicted": sought, "found": len(sure), "ambiguous": ambiguous, "too_small": small}
    return FoundTargets(sure, (), record, tuple(findings))


def kinds_of(wanted: Iterable[PlainTargets]) -> str:
    """Name the kinds of targets, each once."""
    return ", ".join(dict.fromkeys(target.kind for target in wanted))


def _too_small(predicted: Iterable[Sequence[PredictedTarget]]) -> list[str]:
    largest: dict[str, PredictedTarget] = {}
    for target in (candidate for in_image in predicted for candidate in in_image):
        known = largest.get(target.point)
        if known is None or target.look.semi_axes[1] > known.look.semi_axes[1]:
            largest[target.point] = target
    return [
        f"point {name}: its {look.kind} appears {2 * look.semi_axes[1]:.1f} px wide at most, "
        f"{SMALLEST_PX[look.kind]:g} px are needed"
        for name, look in ((name, target.look) for name, target in largest.items())
        if not look.large_enough
    ]


def predicted_targets(
    orientation: Orientation, points: ObjectPoints, wanted: Iterable[PlainTargets]
) -> dict[str, tuple[PredictedTarget, ...]]:
    """Predict where images should show targets."""
    images = replace(orientation.images, cameras=tuple(map(_unsure, orientation.images.cameras)))
    unsure = replace(orientation, images=images)
    expected: dict[str, list[PredictedTarget]] = {}
    # Images that show a point with less than this probability are not searched.
    least_probability = 0.05
    for targets in wanted:
        part = targets.part or PARTS[targets.kind]
        for k, name in enumerate(points.names):
            if targets.points and name not in targets.points:
                continue
            rotation = images.in_local(unsure.to_local(points.values[k][None])).rotation
            seen = predict(unsure, points.values[k], points.sigma[k])
            for i in np.flatnonzero(seen.probability >= least_probability):
                if not (np.isfinite(seen.covariance[i]).all() and np.isfinite(seen.slope[i]).all()):
                    continue
                camera = images.cameras[images.camera[i]]
                bend = ground_bend(camera, rotation[i], seen.pixels[i])
                look = TargetImage(targets.kind, seen.slope[i, :, :2] * targets.side_m / 2, part, bend)
                target = PredictedTarget(name, seen.pixels[i], seen.covariance[i], look)
                expected.setdefault(images.names[i], []).append(target)
    return {name: tuple(of_image) for name, of_image in expected.items()}


def identified(expected: Sequence[PredictedTarget], targets: Floats) -> tuple[list[Mark], dict[str, str]]:
    """Give the targets of an image the names of the points that predict them, where that is beyond doubt."""
    marks, doubts = [], {}
    for k, target in enumerate(expected):
        fitting = targets[targets[:, 0] == k]
        if len(fitting) > 1:
            doubts[target.point] = f"{len(fitting)} targets fit it"
        if len(fitting) != 1:
            continue
        _, x, y, sx, sy = fitting[0].tolist()
        here = np.hypot(*(targets[:, 1:3] - (x, y)).T) < target.look.size / 3
        rivals = sorted({expected[int(row[0])].point for row in targets[here & (targets[:, 0] != k)]})
        if rivals:
            doubts[target.point] = f"its target fits {' and '.join(rivals)}, too,"
            continue
        sigma = (math.hypot(sx, COMMON_PX), math.hypot(sy, COMMON_PX))
        marks.append(Mark("", target.point, x, y, sigma, target.look.kind))
    return marks, doubts


def _find(task: tuple[ImageSource, tuple[PredictedTarget, ...]]) -> Floats:
    source, expected = task
    if not expected:
        return np.empty((0, 5))

    def make() -> Arrays:
        """Measure the expected targets of one picture."""
        grey = measurable(read_grey(source.path))
        rows = [
            (k, centre.column, centre.row, *centre.sigma)
            for k, target in enumerate(expected)
            for centre in find_targets(
                grey, (float(target.place[0]), float(target.place[1])), target.covariance, target.look
            )
        ]
        return {"targets": np.array(rows, dtype=float).reshape(-1, 5)}

    parts = [(s.place, s.covariance, s.look.affine, s.look.part, s.look.bend) for s in expected]
    numbers = [np.concatenate([np.ravel(part) for part in target]) for target in parts]
    kinds = ",".join(target.look.kind for target in expected)
    # Raised whenever the meaning of cached results changes.
    version = 3
    key = combined_key(version, "plain targets", source.key, kinds, array_key(*numbers))
    return np.asarray(cached(source.cache, key, ("targets",), make)["targets"], dtype=np.float64)


def _unsure(camera: Camera) -> Camera:
    """Camera with sigmas for what is to be estimated and of which nothing is said."""
    c, radius = camera.value("c"), float(np.hypot(*(np.array(camera.size_px) * camera.pitch))) / 2
    assumed = {"c": c, "x0": c, "y0": c, "K1": 1 / radius**2}
    # How wrong a camera may be that is to be estimated and says no more: displacement at the corner of an
    # image, as a part of its distance from the middle.
    unknown_camera = 0.01
    sigma = np.array([unknown_camera * assumed.get(name, np.inf) for name in PARAMETERS])
    unknown = camera.estimated & ~np.isfinite(camera.prior_sigma)
    return replace(camera, prior_sigma=np.where(unknown, sigma, camera.prior_sigma))


def targets_of_project(
    project: Project,
    sources: Sequence[ImageSource],
    lenses: Sequence[Camera],
    exposures: Orientation | None,
    control: ObjectPoints,
    workers: Workers,
    progress: Progress,
) -> FoundTargets:
    """Find the targets of a project; lenses: camera of each image."""
    given = project.control
    marks: list[Mark] = []
    strangers: list[str] = []
    findings: list[Finding] = []
    _require_points(project, control)
    for coded in given.coded_targets:
        # They were found with the features, while the pictures were decoded.
        coded_marks, unnamed = find_coded_targets(sources, lenses, coded.dictionary, coded.names)
        marks += coded_marks
        strangers += unnamed
    record: dict[str, Any] = {"coded": len(marks)}
    if given.plain_targets and exposures is None:
        findings.append(Finding("targets-not-sought", "doubtful", kinds_of(given.plain_targets)))
    elif exposures is not None and given.plain_targets:
        with progress("looking for targets", len(sources)) as done:
            plain = find_plain_targets(sources, exposures, control, given.plain_targets, workers, done)
        marks += plain.marks
        record["plain"] = plain.record
        findings += plain.findings
    return FoundTargets(tuple(marks), tuple(strangers), record, tuple(findings))


def _require_points(project: Project, control: ObjectPoints) -> None:
    table = project.control.points
    for target in project.control.plain_targets:
        for name in target.points:
            if name not in control.names:
                raise ConfigurationError(
                    f"targets ({target.kind}) name point {name}, "
                    f"which {'[control] without points' if table is None else table.name} lacks",
                    "correct the name or add the point",
                    where=project.path,
                )
