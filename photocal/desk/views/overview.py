"""The map and the 3-D view: stations, footprints, overlap, ellipses, differences of points and positions.

What findings are about: the images, points, observations and parameters that they name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.ellipses import ellipses, ellipsoids
from photocal.base.policy import policy
from photocal.block.model import ROLES
from photocal.block.results.adjusted_block import position_residuals
from photocal.desk.views.shown import Shown, numbers
from photocal.findings.finding import Finding
from photocal.findings.texts import PARAMETERS as PARAMETER_FIGURES
from photocal.findings.texts import Catalogue, plain, remedy_text, sentence
from photocal.findings.verdict import VerdictLine, alike_findings, every_line, headline, line_text
from photocal.geometry.camera import PARAMETERS
from photocal.planning.flown import BORDER, GroundCells, cells_seen, level_ground
from photocal.run.exposures import EXPOSURES, fixes_of_images
from photocal.run.summary import project_findings, project_verdict


def overview(shown: Shown) -> dict[str, Any]:
    """All that the map and the 3-D view need but tie points and overlap, which come as arrays."""
    result, block = shown.result, shown.block
    return {
        "name": block.name,
        "system": block.frame,
        "height": block.height,
        "in_metres": shown.in_metres,
        "placed": block.datum != "free",
        "probability": policy.confidence,
        "images": _images(shown),
        "points": _points(shown),
        "ties": int(np.sum(np.array(result.points.role) == "tie")),
        "rays": len(result.residuals),
        "cameras": list(result.cameras),
    }


def _images(shown: Shown) -> dict[str, Any]:
    block, images = shown.block, shown.result.images
    count, rms = shown.result.residuals.rms()
    camera = [shown.result.cameras[images.cameras[k].id] for k in images.camera]
    in_mm = shown.result.block.observation_unit == "mm"
    pitch = np.array([c.pitch for c in camera]).reshape(-1, 2) if in_mm else 1.0
    place = shown.on_map(images.station)
    covariance = shown.covariance_on_map(images.station, images.covariances[:, 3:, 3:])
    residual, sigma, strip = position_residuals(block, shown.result, shown.frame)
    fixes = fixes_of_images(shown.work / "exposures" / EXPOSURES)
    return {
        "names": list(images.names),
        "camera": images.camera.tolist(),
        "x": numbers(place[:, 0], 3),
        "y": numbers(place[:, 1], 3),
        "z": numbers(place[:, 2], 3),
        "footprint": numbers(footprints(shown), 2),
        "rays": count.tolist(),
        "rms_px": numbers(np.sqrt(((rms / pitch) ** 2).sum(axis=1)), 3),
        "strip": strip.tolist(),
        "position_m": numbers(residual, 4),
        "position_sigma_m": numbers(sigma, 4),
        "fix": None if fixes is None else [fixes.get(name, "") for name in images.names],
        **_spread(covariance),
    }


def _spread(covariance: Floats) -> dict[str, Any]:
    """Ellipse in the plane, ellipsoid, and the standard deviation in height."""
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    safe = np.where(known[:, None, None], covariance, 0.0)
    semi_axes, directions = ellipsoids(safe, policy.confidence)
    return {
        "ellipse": numbers(np.column_stack(ellipses(safe, policy.confidence)), 5),
        "ellipsoid": numbers(np.column_stack([semi_axes, directions.reshape(-1, 9)]), 5),
        "sigma_z_m": numbers(np.where(known, np.sqrt(safe[:, 2, 2]), np.nan), 5),
    }


def footprints(shown: Shown) -> Floats:
    """Corners and side middles of each image on the middle height of the points, (n, 8, 2); NaN beyond."""
    local, level = shown.images, _level(shown)
    places = local.on_level(BORDER, level)
    away = np.linalg.norm(places[..., :2] - local.station[:, None, :2], axis=2)
    # Beyond so many heights an oblique image has no footprint worth drawing.
    farthest = 4.0
    near = (away <= farthest * (local.station[:, None, 2] - level)).all(axis=1)
    given = shown.on_map(shown.frame.to_given(np.nan_to_num(places.reshape(-1, 3)))).reshape(places.shape)
    return np.where(near[:, None, None], given[..., :2], np.nan)


def _level(shown: Shown) -> float:
    values = shown.result.points.values
    return float(np.nanmedian(shown.frame.to_local(values)[:, 2])) if len(values) else 0.0


def _points(shown: Shown) -> dict[str, Any]:
    """Control and check points: adjusted places, and adjusted minus surveyed coordinates."""
    points, surveyed = shown.result.points, shown.block.points
    rows = [k for k, role in enumerate(points.role) if role != "tie"]
    at = [shown.surveyed.get(points.names[k], -1) for k in rows]
    values = points.values[rows]
    known = np.vstack([surveyed.values, np.full(3, np.nan)])[at]
    place, survey = shown.on_map(values), shown.on_map(np.nan_to_num(known))
    difference = np.where(np.isfinite(known), place - survey, np.nan)
    sigma = np.vstack([surveyed.sigma, np.full(3, np.nan)])[at]
    unseen = [k for k, name in enumerate(surveyed.names) if _unseen(shown, k, name)]
    return {
        "names": [points.names[k] for k in rows],
        "role": [points.role[k] for k in rows],
        "rays": points.rays[rows].tolist(),
        "x": numbers(place[:, 0], 4),
        "y": numbers(place[:, 1], 4),
        "z": numbers(place[:, 2], 4),
        "difference_m": numbers(difference, 5),
        "survey_sigma_m": numbers(sigma, 5),
        **_spread(shown.covariance_on_map(values, points.covariance[rows])),
        "unseen": {
            "names": [surveyed.names[k] for k in unseen],
            "place": numbers(shown.on_map(surveyed.values[unseen].reshape(-1, 3)), 4),
        },
    }


def _unseen(shown: Shown, k: int, name: str) -> bool:
    role = ROLES[int(shown.block.points.role[k])]
    known = bool(np.isfinite(shown.block.points.values[k]).all())
    return role != "tie" and name not in shown.point_rows and known


def ties(shown: Shown) -> bytes:
    """Tie points: x, y, z from `origin` (m), largest standard deviation (m), rays; float32 (n, 5)."""
    points = shown.result.points
    rows = np.flatnonzero(np.array(points.role) == "tie")
    place = shown.on_map(points.values[rows]) - origin(shown)
    sigma = np.nanmax(points.sigma[rows], axis=1, initial=0.0)
    return np.column_stack([place, sigma, points.rays[rows]]).astype("<f4").tobytes()


def tie_names(shown: Shown) -> list[str]:
    """Names of the tie points in the order of `ties`."""
    points = shown.result.points
    return [name for name, role in zip(points.names, points.role, strict=True) if role == "tie"]


def origin(shown: Shown) -> Floats:
    """What single precision is counted from: the first station, in full metres."""
    place = shown.on_map(shown.result.images.station[:1])
    return np.round(place[0]) if len(place) and np.isfinite(place).all() else np.zeros(3)


def overlap(shown: Shown) -> tuple[dict[str, Any], bytes]:
    """How many images show each cell of the level ground: rows from the south, one byte a cell.

    returns the places of the first cell and of those one column, one row on, in the metres of the map.
    """
    ground = _coarse(level_ground(shown.images, _level(shown)))
    count = np.bincount(np.concatenate([np.zeros(0, np.int64), *cells_seen(shown.images, ground)]))
    seen = np.zeros(len(ground.places), dtype=np.uint8)
    seen[: len(count)] = np.minimum(count, 255)
    corner = ground.places[[0, 1, ground.columns]]
    first, column, row = shown.on_map(shown.frame.to_given(corner))[:, :2]
    head = {
        "columns": ground.columns,
        "rows": len(seen) // ground.columns,
        "first": first.tolist(),
        "column": (column - first).tolist(),
        "row": (row - first).tolist(),
    }
    return head, seen.tobytes()


def _coarse(ground: GroundCells) -> GroundCells:
    """Every second, third ... cell, until there are few enough for a picture."""
    rows = len(ground.places) // ground.columns
    # Cells of the overlap on the map; it is a picture, not a measurement.
    most_cells = 40_000
    step = int(np.ceil(np.sqrt(len(ground.places) / most_cells)))
    kept = ground.places.reshape(rows, ground.columns, 3)[::step, ::step]
    return GroundCells(kept.reshape(-1, 3), ground.cell_m * step, kept.shape[1])


# "P5 (a.jpg)" as marks are named, and "P5 / a.jpg" as what was left out.
_MARK = re.compile(r"^(?P<point>.+?)(?: \((?P<image>.+)\)| / (?P<other>.+))$")
_KINDS = {"refused": "bad", "grave": "bad", "doubtful": "warn", "consequence": "warn", "note": "note"}


def findings(shown: Shown, say: Catalogue) -> dict[str, Any]:
    """All findings, grouped and worst first, each with its remedy and what it concerns; the verdict above."""
    found = project_findings(shown.work)
    verdict = project_verdict(shown.work)
    lines = every_line(found, len(shown.images))
    alike = alike_findings(found)
    return {
        "paragraph": "" if verdict is None else headline(verdict, say),
        "outcome": None if verdict is None else verdict.outcome.code,
        "lines": [_line(line, alike, shown, say) for line in lines],
    }


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
        named = (value,) if isinstance(value, str) else value if isinstance(value, tuple | list) else ()
        yield from ((key, str(each)) for each in named)


def _is_point(name: str, shown: Shown) -> bool:
    return name in shown.point_rows or name in shown.surveyed


def _parameter(name: str, finding: Finding, shown: Shown) -> tuple[str, str] | None:
    """A parameter of a camera: named with it, as "cam K1", beside it, or of the only camera."""
    camera, _, last = name.rpartition(" ")
    last = last if last in PARAMETERS else ""
    camera = camera or str(finding.figures.get("camera", "")) or next(iter(shown.result.cameras))
    return (camera, last) if last and camera in shown.result.cameras else None
