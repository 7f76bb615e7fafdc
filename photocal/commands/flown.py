"""`photocal flown`: what a flight covered, against what was planned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def flown(
    block: Annotated[
        Path, typer.Argument(help="Block folder, PROJECT.toml, or a set-up file of another program.")
    ],
    run: Annotated[
        Path | None, typer.Option(help="Adjustment of the block; without: orientations as given.")
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help="Folder of the image files, for exposure time and ISO.")
    ] = None,
    plan: Annotated[Path | None, typer.Option(help="plan.json of `photocal plan`, to compare with.")] = None,
    exposure_ms: Annotated[
        float | None, typer.Option(help="Exposure time where the images do not tell it, ms.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Speed over ground where the block does not tell it, m/s.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for figures, table, map and picture.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Measure a flown block: height, ground sampling, tilt, real overlaps, rays, gaps, smear.

    Overlap is the share of an image that the next one (forward) or the neighbouring strip (side) shows, over
    the ground through the block's points.

    Example: `photocal flown PROJECT.toml --images photos --plan plan/plan.json -o flown`
    """
    import json

    import numpy as np

    from acquire.console import answer
    from drivers.errors import InputMalformedError
    from photocal.accuracy.geopackage import reference_system
    from photocal.block.motion import strips, velocity_of_neighbours
    from photocal.commands.check_of_block import changed_utc
    from photocal.measurement.image_facts import read_facts
    from photocal.measurement.image_file import list_images
    from photocal.planning.flown import figures_of, flown_block, ground_through
    from photocal.planning.flown_output import against_plan, flown_text, write_flown
    from photocal.products.oriented import oriented
    from photocal.project import read_project
    from photocal.results.folder import read_result

    if block.suffix == ".toml" and (block.parent / "block.toml") != block:
        project = read_project(block)
        block, run = project.output / "block", run or project.output / "calibration"
    model, frame, shots = oriented(block, run)
    time = model.images.time
    timed = bool(np.isfinite(time).all())
    order = np.argsort(time, kind="stable") if timed else np.arange(len(shots))
    shots, seconds = shots.only(order), time[order] if timed else np.arange(len(shots), dtype=np.float64)
    velocity = np.full((len(shots), 3), np.nan)
    velocity[model.positions.image] = model.positions.velocity
    velocity = np.where((velocity != 0).any(axis=1)[:, None], velocity, np.nan)[order]
    beside, _ = velocity_of_neighbours(shots.camera, seconds, shots.station)
    way = np.where(np.isfinite(velocity), velocity, beside)
    strip, _ = strips(seconds, np.nan_to_num(way))
    # Neighbours without times tell a direction, no speed.
    moving = np.linalg.norm(way if timed else velocity, axis=1)
    moving = np.where(np.isfinite(moving), moving, np.nan if speed is None else speed)
    facts = {path.name: read_facts(path) for path in list_images(images)} if images is not None else {}
    told = [(f.exposure_s, f.iso) if (f := facts.get(name)) else (np.nan, np.nan) for name in shots.names]
    exposure, iso = np.array(told).T
    exposure = np.where(np.isfinite(exposure), exposure, np.nan if exposure_ms is None else exposure_ms / 1e3)
    points = model.points.values if run is None else read_result(run).points.values
    measured = flown_block(shots, strip, ground_through(shots, frame.to_local(points)), moving, exposure)
    figures = figures_of(measured, exposure_ms=1e3 * exposure, iso=iso)
    if plan is not None:
        try:
            figures = against_plan(figures, json.loads(plan.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError) as refusal:
            raise InputMalformedError(
                "is no plan", where=plan, remedy="name plan.json of `photocal plan`"
            ) from refusal
    if output is not None:
        system = reference_system(None if model.frame == "local" else model.frame)
        changed = changed_utc(block if block.is_file() else block / "block.toml")
        write_flown(output, measured, shots.station, moving, figures, frame.to_given, system, changed)
    answer(as_json, lambda: figures, lambda: flown_text(figures))
