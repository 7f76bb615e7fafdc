"""Stage `georeferencing`: direct, integrated and indirect, judged at the check points."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.base.errors import PhotocalError
from photocal.base.files import write_json
from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.run.stage import Drawing, Stage

if TYPE_CHECKING:
    from photocal.analysis.accuracy.standard import Question
    from photocal.analysis.georeferencing.direct import Calibration
    from photocal.block.model import Block
    from photocal.run.calibration import Calibrated

FIGURES = "check.json"


def georeferencing_stage(
    project: Project, block: Path, read: Callable[[Path], Block], calibrated: Calibrated
) -> Stage:
    """Describe the stage, which follows the one whose folder is `block`."""
    standards = [name for name in project.contents.judgement.standards if name.endswith(".toml")]
    return Stage(
        "georeferencing",
        "three georeferencings at the check points",
        lambda out, show: _make(project, block, out, show, read, calibrated),
        {f"standard {name}": Path(name) for name in standards},
        project.contents.judgement.model_dump(mode="json"),
        (block,),
    )


def _make(
    project: Project,
    source: Path,
    folder: Path,
    show: Progress,
    read: Callable[[Path], Block],
    calibrated: Calibrated,
) -> Drawing | None:
    from photocal.analysis.accuracy.maps import reference_system
    from photocal.analysis.accuracy.standard import SHIPPED, load_standard
    from photocal.analysis.georeferencing.comparison import check_block
    from photocal.analysis.georeferencing.methods import METHODS
    from photocal.analysis.georeferencing.output import SCHEMA, draw_check, to_json, write_check
    from photocal.base.geopackage import changed_utc
    from photocal.findings.texts import as_record
    from photocal.measurement.oriented_ties import NOT_PLACED

    standards = tuple(load_standard(name) for name in project.contents.judgement.standards or SHIPPED)
    block = read(source)
    if block.datum != "control":
        # Nothing can be judged in a relative block; that is no failure.
        with_nothing = {"schema": SCHEMA, "block": block.name, "methods": {}, "refused": []}
        write_json(folder / FIGURES, with_nothing | as_record([NOT_PLACED]))
        return None
    with show("three georeferencings", len(METHODS) + 2) as done:
        made = calibrated(None)
        known = None if isinstance(made, PhotocalError) else made
        result = check_block(
            block, standards, question_of(project), done=lambda _: done(1), on_the_job=True, known=known
        )
    system = reference_system(None if block.frame == "local" else block.frame)
    write_check(result, to_json(result), folder, system, changed_utc(source))
    return partial(draw_check, result)


def question_of(project: Project) -> Question:
    """What a project wants its products to be judged for."""
    from photocal.analysis.accuracy.standard import Question, parse_scale

    asked = project.contents.judgement
    return Question(
        None if asked.scale is None else parse_scale(asked.scale),
        asked.contour_interval_m,
        survey_horizontal_m=asked.survey_horizontal_m,
        survey_vertical_m=asked.survey_vertical_m,
        target_horizontal_m=asked.target_horizontal_m,
        target_vertical_m=asked.target_vertical_m,
    )


def calibrated_on_the_job(block: Block) -> tuple[Block, Calibration]:
    """Calibrate camera and mounting of a flight."""
    from photocal.analysis.georeferencing.direct import calibrate
    from photocal.analysis.georeferencing.prepared import (
        checkable,
        in_local_frame,
        with_attitude_angles,
        without_weak_images,
    )

    local = with_attitude_angles(checkable(in_local_frame(block)))
    return local, calibrate(without_weak_images(local)[0])
