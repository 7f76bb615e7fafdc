"""Stage `block`: what was measured in the images and what GNSS and inertial unit observed, in one folder."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from photocal.adjustment.mounting import NO_ATTITUDES, NO_POSITIONS, Attitudes, Positions
from photocal.adjustment.network import RELATIONS
from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Progress
from photocal.block.model import Block
from photocal.block.setup import MountingKeys
from photocal.project import Project
from photocal.run.stage import Stage

Observed = TypeVar("Observed", Positions, Attitudes)


def block_stage(project: Project, exposures: Path | None, measurements: Path) -> Stage:
    """Describe the stage, which follows those whose folders are given; exposures None without a flight."""
    distances, bent = project.control.distances, project.contents.project.refraction

    def make(folder: Path, _: Progress) -> None:
        """Make the files of the stage."""
        from photocal.block.folder import read_block, read_relations
        from photocal.block.writer import write_block
        from photocal.measurement.block_files import RECORD
        from photocal.run.project_checks import check_rays

        block = read_block(measurements)
        if distances is not None:
            given = read_relations(distances, "distance", block.points.names)
            others = block.relations.rows(block.relations.kind != list(RELATIONS).index("distance"))
            block = replace(block, relations=given.plus(others))
        if bent is not None:
            block = replace(block, refraction=bent)
        if exposures is not None:
            block = _flown(block, exposures, project.rig.mounting())
            check_rays(block, project.control.points)
        write_block(folder, block)
        if (measurements / RECORD).exists():
            shutil.copyfile(measurements / RECORD, folder / RECORD)

    chosen: dict[str, Any] = {} if bent is None else {"refraction": bent}
    inputs = {} if distances is None else {"distances": distances}
    if exposures is None:
        return Stage("block", "the block", make, inputs, chosen, (measurements,))
    settings = {"rig": project.rig.mounting().model_dump(mode="json"), **chosen}
    return Stage("block", "the block", make, inputs, settings, (exposures, measurements))


def _flown(block: Block, exposures: Path, keys: MountingKeys) -> Block:
    """The block with what was observed at its exposures, and what the errors of all positions share."""
    from photocal.block.mounting import make_mounting, read_attitudes, read_positions
    from photocal.block.table import read_wider_table
    from photocal.run.exposures import read_figures

    common = read_figures(exposures).common
    if common is not None:
        keys = keys.model_copy(
            update={
                "flight_shift_sigma_m": common.shift_sigma_m,
                "height_scale_sigma": common.zenith_scale_sigma,
                "height_scale_from_m": common.base_height_m,
            }
        )

    def observed(name: str, read: Callable[[Path, tuple[str, ...]], Observed], none: Observed) -> Observed:
        """What was observed at images of the block; some had no usable points."""
        path = exposures / name
        with path.open(encoding="utf-8") as rows:
            if not any(islice(rows, 1, None)):
                return none
        names = read_wider_table(path, ("image",)).unique_names("image")
        place = {image: k for k, image in enumerate(block.images.names)}
        made = read(path, names)
        image = np.array([place.get(name, -1) for name in names], dtype=np.int64)[made.image]
        return replace(made.rows(image >= 0), image=image[image >= 0])

    from_m = keys.height_scale_from_m or 0.0
    positions = observed("positions.csv", partial(read_positions, from_m=from_m), NO_POSITIONS)
    # Strips are numbered by their first image that takes part.
    first = {strip: number for number, strip in enumerate(dict.fromkeys(positions.strip.tolist()))}
    strip = np.array([first[strip] for strip in positions.strip.tolist()], dtype=np.int64)
    return replace(
        block,
        positions=replace(positions, strip=strip),
        attitudes=observed("attitudes.csv", read_attitudes, NO_ATTITUDES),
        mounting=make_mounting(keys, len(first)),
    )


def given_block_stage(source: Path) -> Stage:
    """Describe the stage that takes a ready block folder over."""

    def make(folder: Path, _: Progress) -> None:
        """Make the files of the stage."""
        if not (source / "block.toml").is_file():
            raise InputNotFoundError(
                "has no block.toml", "name a block folder in [measurements]", where=source
            )
        shutil.copytree(source, folder, dirs_exist_ok=True)

    return Stage("block", "the block", make, {"block": source})
