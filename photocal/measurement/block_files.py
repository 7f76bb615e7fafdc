"""Writing a block folder: what the adjustment reads, in plain tables."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.network import ANGLES, RELATIONS
from photocal.base.files import write_json, write_rows
from photocal.block.folder import EXPOSURE, POINT_CROSS
from photocal.block.model import ROLES, Block, Images
from photocal.block.motion import RATE, SIGMAS_OF_MOTION, VELOCITY
from photocal.block.rig import head_lines
from photocal.geometry.camera import PARAMETERS, SHAKE, Camera

# Of `measurement.json`.
SCHEMA = "photocal.measurement/1"
PIXEL_ORIGIN = "centre of the upper-left stored pixel is (0, 0); EXIF orientation is not applied"
IMAGE = ("image", "camera", "X", "Y", "Z", "omega", "phi", "kappa", "sX", "sY", "sZ", "so", "sp", "sk")


@dataclass(frozen=True)
class Measured:
    """A block that was measured, and how, for `measurement.json`."""

    block: Block
    record: dict[str, Any]


def write_block(folder: Path, block: Block, record: dict[str, Any]) -> None:
    """Write a block with observations in px of the stored pixel grid."""
    (folder / "block.toml").write_text(_setup(block), encoding="utf-8", newline="\n")
    images, points, seen = block.images, block.points, block.observations
    more = _more_columns(images)
    write_rows(
        folder / "images.csv",
        (*IMAGE, *more),
        (
            [
                name,
                block.cameras[camera].id,
                *(_cell(v, 6) for v in value[3:]),
                *(_cell(v, 8) for v in np.degrees(value[:3])),
                *(_cell(v, 6) for v in sigma[3:]),
                *(_cell(v, 8) for v in np.degrees(sigma[:3])),
                *(cells[k] for cells in more.values()),
            ]
            for k, (name, camera, value, sigma) in enumerate(
                zip(images.names, images.camera, images.values, images.sigma, strict=True)
            )
        ),
    )
    cross = np.zeros((len(points.names), 0)) if points.cross is None else points.cross
    write_rows(
        folder / "points.csv",
        ("point", "X", "Y", "Z", "sX", "sY", "sZ", *(POINT_CROSS if cross.size else ()), "role"),
        (
            [name, *(_cell(v, 6) for v in (*value, *sigma)), *map(repr, covariances), ROLES[role]]
            for name, value, sigma, covariances, role in zip(
                points.names, points.values, points.sigma, cross.tolist(), points.role, strict=True
            )
        ),
    )
    write_rows(
        folder / "observations.csv",
        ("image", "point", "x", "y", "sx", "sy"),
        (
            [
                images.names[image],
                points.names[point],
                *(_cell(v, 4) for v in value),
                *(_cell(v, 4) for v in s),
            ]
            for image, point, value, s in zip(seen.image, seen.point, seen.values, seen.sigma, strict=True)
        ),
    )
    relations = block.relations
    for code, kind in enumerate(RELATIONS):
        of_kind = np.flatnonzero(relations.kind == code)
        if len(of_kind):
            scale = 180 / np.pi if kind in ANGLES else 1.0
            named = ([points.names[j] for j in ends if j >= 0] for ends in relations.ends[of_kind])
            figures = {"value": relations.values[of_kind] * scale, "sigma": relations.sigma[of_kind] * scale}
            if kind == "line":
                del figures["value"]
            rows = zip(named, np.column_stack(list(figures.values())), strict=True)
            cells = ([*names, *(_cell(v, 8) for v in numbers)] for names, numbers in rows)
            write_rows(folder / f"{kind}s.csv", (*RELATIONS[kind], *figures), cells)
    write_json(folder / "measurement.json", record, 2)


def _more_columns(images: Images) -> dict[str, Sequence[str]]:
    """Columns of the images that only some blocks have: exposures of frames, velocity and rate, time."""
    columns: dict[str, Sequence[str]] = {EXPOSURE: images.exposure} if any(images.exposure) else {}
    # What inside is the turn of what a camera sees is the rate of the camera outside.
    scale = np.array([1.0] * 3 + [-np.degrees(1.0)] * (images.motion.shape[1] - 3))
    known = {
        **dict(zip((*VELOCITY, *RATE, *SHAKE), (images.motion * scale).T, strict=False)),
        **dict(zip(SIGMAS_OF_MOTION, (images.motion_sigma * np.abs(scale[:6])).T, strict=True)),
        "time_s": images.time,
        "temperature_c": images.temperature,
    }
    for name, values in known.items():
        if np.isfinite(values).any():
            columns[name] = [_cell(value, 6) for value in values.tolist()]
    return columns


def _setup(block: Block) -> str:
    lines = [
        "# Written by photocal measure; measurement.json says how.",
        "[block]",
        f"name = {json.dumps(block.name)}",
        f"frame = {json.dumps(block.frame)}",
        f"height = {json.dumps(block.height)}",
        f"datum = {json.dumps(block.datum)}",
        *([f'global_test = "{block.global_test[1]}"'] if block.global_test[1] != "two-sided" else []),
        *([f"refraction = {block.refraction}"] if block.refraction is not None else []),
        *(["curvature = true"] if block.curvature else []),
        "",
        "[observations]",
        'unit = "px"',
        'axes = "pixel"',
    ]
    for camera in block.cameras:
        lines += ["", "[[camera]]", *_camera(camera)]
    # A head whose images were all left out is none of the block's; one alone is no frame.
    ids = {camera.id for camera in block.cameras}
    heads = tuple(head for head in block.heads if {head.camera, head.of} <= ids)
    lines += head_lines(heads if len(heads) > 1 else ())
    return "\n".join(lines) + "\n"


def _camera(camera: Camera) -> Iterable[str]:
    used = {n: v for n, v in zip(PARAMETERS, camera.values, strict=True) if v or n == "c"}
    estimate = [name for name, on in zip(PARAMETERS, camera.estimated, strict=True) if on]
    prior = {n: s for n, s in zip(PARAMETERS, camera.prior_sigma, strict=True) if math.isfinite(s)}
    yield f"id = {json.dumps(camera.id)}"
    yield f'model = "{camera.model}"'
    yield f'unit = "{camera.unit}"'
    yield f"size_px = [{camera.size_px[0]}, {camera.size_px[1]}]"
    if camera.unit == "mm":
        yield f"pitch_mm = [{camera.pitch[0]!r}, {camera.pitch[1]!r}]"
    yield f"affinity = {json.dumps(camera.affinity)}"
    yield f"affinity_form = {json.dumps(camera.affinity_form)}"
    yield f"R0 = {camera.reference_radius!r}"
    yield f'distortion_at = "{camera.distortion_at}"'
    if camera.shutter != "global":
        yield f'shutter = "{camera.shutter}"'
        yield f'readout_direction = "{camera.readout_direction}"'
        velocity, rate = camera.gust[0], float(np.degrees(camera.gust[1]))
        yield f"gust = {{ velocity_m_s = {velocity!r}, rate_deg_s = {rate!r} }}"
    yield f"estimate = {json.dumps(estimate)}"
    yield "parameters = { " + ", ".join(f"{n} = {float(v)!r}" for n, v in used.items()) + " }"
    if camera.guessed:
        yield "guessed = true"
    if prior:
        yield "prior_sigma = { " + ", ".join(f"{n} = {float(s)!r}" for n, s in prior.items()) + " }"


def _cell(value: float, digits: int) -> str:
    """Write a number; one that is not known, or a free sigma, stays empty."""
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
