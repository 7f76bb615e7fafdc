"""Stages `calibration`, `analysis`, `certificate`: the integrated adjustment, what it hides, its document."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.base.errors import PhotocalError
from photocal.base.progress import Progress
from photocal.block.project import Project
from photocal.report.keys import own_key
from photocal.run.stage import RECORD, Stage
from photocal.run.summary import gather, read_json

if TYPE_CHECKING:
    from photocal.analysis.searched_block import SearchedBlock
    from photocal.block.model import Block
    from photocal.block.results.adjusted import Report
    from photocal.findings.verdict import Verdict

    Calibrated = Callable[[Report | None], SearchedBlock | PhotocalError]


def calibration_stage(block: Path, calibrated: Calibrated) -> Stage:
    """Describe the stage that adjusts everything together."""

    def make(folder: Path, show: Progress) -> None:
        """Make the files of the stage."""
        from photocal.block.results.adjusted import write_adjusted

        with show("calibration", None) as done:
            made = calibrated(lambda _: done(1))
        if isinstance(made, PhotocalError):
            raise made
        write_adjusted(made.adjusted, block, folder)

    return Stage("calibration", "integrated adjustment with the camera", make, after=(block,))


def calibrated_once(block: Path, read: Callable[[Path], Block]) -> Calibrated:
    """Adjust a block when the first stage asks for it; all get the same, or the same refusal."""
    made: list[SearchedBlock | PhotocalError] = []

    def calibrated(report: Report | None) -> SearchedBlock | PhotocalError:
        """Give the block adjusted."""
        from photocal.analysis.searched_block import SearchedBlock
        from photocal.block.results.adjusted import adjustment_of

        if not made:
            try:
                made.append(SearchedBlock(adjustment_of(read(block), report=report)))
            except PhotocalError as refusal:
                made.append(refusal)
        return made[0]

    return calibrated


def analysis_stage(block: Path, calibration: Path, calibrated: Calibrated) -> Stage:
    """Describe the stage that looks for hidden errors; its folder is the run with `analysis.json`."""

    def make(folder: Path, show: Progress) -> None:
        """Make the files of the stage."""
        from photocal.analysis.analyse_run import analyse_searched, write_analysis

        made = calibrated(None)
        if isinstance(made, PhotocalError):
            raise made

        shutil.copytree(
            calibration, folder, dirs_exist_ok=True, ignore=lambda *_: [RECORD], copy_function=shutil.copyfile
        )
        with show("analysis", 1.0) as done:
            outcome = analyse_searched(made, done=done)
        write_analysis(folder, outcome, made.adjusted.block, made.adjusted.result)

    return Stage("analysis", "hidden errors, significance, correlations", make, after=(block, calibration))


def certificate_stage(
    project: Project,
    work: Path,
    day: dt.date,
    earlier: tuple[Path, ...],
    judged: Callable[[Verdict], None] = lambda _: None,
) -> Stage:
    """Describe the stage; `earlier` are the folders of all others, `judged` gets the verdict beforehand.

    A certificate keeps its day until something that it says has changed.
    """
    keys = project.contents.certificate
    key = own_key()
    fingerprint = key.fingerprint if key else ""
    language = keys.language or "en"
    inputs = {} if keys.particulars is None else {"particulars": keys.particulars}

    def make(folder: Path, show: Progress) -> None:
        """Make the files of the stage."""
        from photocal.measurement.picture_tests import told_conditions
        from photocal.report.certificate_metadata import read_particulars
        from photocal.report.issue import issue
        from photocal.run.project_checks import facts_of_pictures

        with show("certificate", None):
            given = read_particulars(
                keys.particulars,
                day,
                client=keys.client,
                operator=keys.operator,
                form=keys.form,
                key=fingerprint,
                pictures=told_conditions(facts_of_pictures(project, None)),
                flown=read_json(work / "flown" / "flown.json"),
            )
            block, warnings = work / "block", gather(work)
            issue(
                work / "analysis",
                folder,
                given,
                language=language,
                block=block,
                warnings=warnings,
                judged=judged,
            )

    def keep(made: Path, public: Path) -> tuple[str, ...]:
        """Keep a signed certificate that another would replace."""
        from photocal.report.issue import NAME
        from photocal.report.signing import keep_signed

        kept = keep_signed(public, (made / NAME).read_bytes())
        return (f"the signed certificate is kept in {kept}",) if kept else ()

    settings = {
        **keys.model_dump(mode="json", exclude={"particulars", "plan"}),
        "language": language,
        "key": fingerprint,
    }
    return Stage("certificate", "certificate", make, inputs, settings, earlier, keep)
