"""Stages `calibration` and `analysis`: the integrated adjustment with the camera, and what it hides."""

from __future__ import annotations

import shutil
from pathlib import Path

from photocal.run.folders import RECORD
from photocal.run.stage import Progress, Stage


def calibration_stage(block: Path) -> Stage:
    """Describe the stage that adjusts everything together."""

    def make(folder: Path, show: Progress) -> None:
        from photocal.results.adjusting import adjust_block

        with show("calibration", None) as done:
            adjust_block(block, folder, report=lambda _: done(1))

    return Stage("calibration", "integrated adjustment with the camera", make, after=(block,))


def analysis_stage(block: Path, calibration: Path) -> Stage:
    """Describe the stage that looks for hidden errors; its folder is the run with `analysis.json`."""

    def make(folder: Path, show: Progress) -> None:
        from photocal.report.analysis_file import analyse_run

        shutil.copytree(
            calibration, folder, dirs_exist_ok=True, ignore=lambda *_: [RECORD], copy_function=shutil.copyfile
        )
        with show("analysis", None) as done:
            analyse_run(folder, block, done=lambda: done(1))

    return Stage("analysis", "hidden errors, significance, correlations", make, after=(block, calibration))
