"""A stage of a run as a stranger would bring it: it tells how many images the adjusted block has."""

import json
from collections.abc import Mapping
from pathlib import Path

from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.block.results.result import Result
from photocal.run.stage import AddedStage


def make(project: Project, after: Mapping[str, Path], folder: Path, show: Progress) -> None:
    with show("counting", 1.0) as done:
        result = Result.read(after["calibration"])
        done(1.0)
    told = {"project": project.name, "images": len(result.images)}
    (folder / "count.json").write_text(json.dumps(told), encoding="utf-8")


STAGE = AddedStage("images of the adjusted block", make, after=("calibration",))
