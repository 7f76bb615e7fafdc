"""Stage `flown`: what the adjusted block and the pictures themselves say of the flight."""

import json
import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.analysis.accuracy.discrepancies import check_laser
from photocal.analysis.accuracy.maps import reference_system
from photocal.analysis.georeferencing.findings import control_by_strip, held_by_positions
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.base.geopackage import changed_utc
from photocal.base.progress import Progress
from photocal.block.model import Block
from photocal.block.motion import velocity_of_neighbours
from photocal.block.network import positions_at
from photocal.block.project import Project
from photocal.block.results.folder import read_result
from photocal.block.results.result import common_values
from photocal.findings.texts import as_record
from photocal.geometry.frames import LocalFrame
from photocal.geometry.strips import lines_of_places, order_of_places, strips
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import each_picture, list_images
from photocal.planning.flown import figures_of, flown_block, ground_through
from photocal.planning.flown_output import against_plan, draw_flown, write_flown
from photocal.planning.options import FlownOptions
from photocal.planning.position_map import draw_positions, position_differences, write_positions
from photocal.products.oriented import oriented
from photocal.report.derived_figures import NADIR_DEG
from photocal.run.stage import Drawing, Stage, pictures_of


def flown_stage(project: Project, block: Path, calibration: Path) -> Stage:
    """Describe the stage; it writes nothing of a frame of cameras, nor where they do not look down."""
    images, plan = project.contents.images, project.contents.certificate.plan
    folder_of_pictures = None if images is None else images.folder
    # Not the folder: the project itself may lie in it, with what was made last.
    inputs = {} if folder_of_pictures is None else pictures_of(project)
    inputs |= {} if plan is None else {"plan": plan}

    def make(folder: Path, show: Progress) -> Drawing | None:
        """Make the files of the stage."""
        # Where too few points tell a ground, the adjustment says so.
        with show("flown block", None), suppress(IllPosedError):
            files = FlownOptions(images=folder_of_pictures, plan=plan)
            flown = measure_flown(block, calibration, files, only_nadir=True)
            if flown is not None:
                flown.write(folder)
                return flown.draw
        return None

    return Stage("flown", "flown block", make, inputs, after=(block, calibration))


@dataclass(frozen=True)
class Flown:
    """A flown block that was measured.

    write, draw: its figures, tables and maps, and its pictures, into a folder; they raise OutputError.
    """

    figures: dict[str, Any]
    write: Drawing
    draw: Drawing


def measure_flown(
    block: Path,
    run: Path | None,
    files: FlownOptions | None = None,
    exposure_s: float = math.nan,
    speed_m_s: float = math.nan,
    only_nadir: bool = False,
) -> Flown | None:
    """Measure a flown block.

    run: adjustment of the block; None takes the orientations as given.
    exposure_s, speed_m_s: where images and block do not tell them.
    only_nadir: gives none for blocks of several cameras, of axes that do not look down, or without a scale.
    raises IllPosedError: for fewer than three points.
    """
    files = files or FlownOptions()
    model, frame, shots = oriented(block, run)
    time = model.images.time
    timed = bool(np.isfinite(time).all())
    order = np.argsort(time, kind="stable") if timed else order_of_places(shots.names, shots.station)
    shots, seconds = shots.only(order), time[order] if timed else np.arange(len(shots), dtype=np.float64)
    scaled = model.datum != "free" or len(model.relations.kind) > 0 or len(model.lasers.image) > 0
    axis = float(np.median(shots.rotation[:, 2, 2])) if len(shots) else -1.0
    nadir = len(shots.cameras) == 1 and axis >= math.cos(math.radians(NADIR_DEG))
    if only_nadir and not (nadir and scaled):
        return None
    velocity = np.full((len(shots), 3), np.nan)
    velocity[model.positions.image] = model.positions.velocity
    velocity = np.where((velocity != 0).any(axis=1)[:, None], velocity, np.nan)[order]
    beside, _ = velocity_of_neighbours(shots.camera, seconds, shots.station)
    way = np.where(np.isfinite(velocity), velocity, beside)
    moved = timed or bool(np.isfinite(velocity).any())
    strip = strips(seconds, np.nan_to_num(way))[0] if moved else lines_of_places(shots.station)
    # Neighbours without times tell a direction, no speed.
    moving = np.linalg.norm(way if timed else velocity, axis=1)
    moving = np.where(np.isfinite(moving), moving, speed_m_s)
    read = each_picture(list_images(files.images), read_facts)[0] if files.images is not None else []
    facts = {picture.name: picture for picture in read}
    stated = [(f.exposure_s, f.iso) if (f := facts.get(name)) else (np.nan, np.nan) for name in shots.names]
    exposure, iso = np.array(stated).T
    exposure = np.where(np.isfinite(exposure), exposure, exposure_s)
    points = model.points.values if run is None else read_result(run).points.values
    control = control_by_strip(model, shots.names, strip)
    measured = flown_block(shots, strip, ground_through(shots, frame.to_local(points)), moving, exposure)
    figures = figures_of(measured, exposure_ms=1e3 * exposure, iso=iso)
    lasers = np.array([f.laser_m if (f := facts.get(name)) else np.nan for name in shots.names])
    # As observations they are no check of the surface that they made.
    checks = files.terrain is not None or not len(model.lasers.image)
    if checks and np.isfinite(lasers).any():
        hit, near = shots.station - lasers[:, None] * shots.rotation[:, 2], frame.to_local(points)
        if files.terrain is not None:
            near = _of_terrain(hit, model, frame, files.terrain, files.terrain_heights)
        figures |= as_record([check_laser(hit, lasers, near, _share_of_c(run))])
    figures |= {"control_by_strip": control, "held_by_positions": held_by_positions(model)}
    apart = None
    if run is not None:
        common = common_values(read_result(run).mounting, model.mounting.values)
        observed = positions_at(model, frame, shots.names)
        apart = position_differences(shots, observed, model.mounting, common)
        if apart is not None:
            figures["positions"] = apart.figures()
    if (plan := files.plan) is not None:
        try:
            figures = against_plan(figures, json.loads(plan.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError) as refusal:
            raise InputMalformedError(
                "is not a plan", where=plan, remedy="name plan.json of `photocal plan`"
            ) from refusal

    def write(folder: Path) -> None:
        """Write figures, tables and maps."""
        system = reference_system(None if model.frame == "local" else model.frame)
        changed = changed_utc(block if block.is_file() else block / "block.toml")
        write_flown(folder, measured, shots.station, moving, figures, frame.to_given, system, changed)
        if apart is not None:
            write_positions(folder, apart, frame.to_given, system, changed)

    def draw(folder: Path) -> None:
        """Draw the overlaps, and how far positions are off."""
        draw_flown(measured, shots.station, folder / "flown.svg")
        if apart is not None:
            draw_positions(apart, folder / "positions.svg")

    return Flown(figures, write, draw)


def _of_terrain(hit: Floats, model: Block, frame: LocalFrame, path: Path, heights: str | None) -> Floats:
    """Points of a terrain model about what lasers hit, (n, 3), in the same frame.

    raises ConfigurationError: when block and model differ in their systems or kinds of heights.
    """
    from photocal.products.ortho_job import heights_of, system_of
    from photocal.products.raster import describe, terrain_source

    raster = describe(path)
    kind = heights_of(raster, model, heights)
    system_of(raster, model, None)
    target = frame.to_given(hit[np.isfinite(hit).all(axis=1)])
    # Nine points about each, m apart: closer than the surface may be to be one.
    steps = np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    about = (target[:, None] + steps).reshape(-1, 3)
    (west, south), (east, north) = about[:, :2].min(axis=0), about[:, :2].max(axis=0)
    ground = terrain_source(raster, kind)((west, south, east, north)).at(about[:, 0], about[:, 1])
    on_it = np.isfinite(ground)
    return frame.to_local(np.column_stack([about[:, :2], ground])[on_it])


def _share_of_c(run: Path | None) -> float:
    """Standard deviation of the principal distance of a run over it; 0 where it is held."""
    cameras = () if run is None else read_result(run).cameras.values()
    return max((camera.sigma_of("c") / camera.value("c") for camera in cameras), default=0.0)
