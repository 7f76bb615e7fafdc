"""Stage `certificate`: the document, with the warnings of all stages."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

from photocal.project import Project
from photocal.run.stage import Progress, Stage
from photocal.run.warnings import gather, told_by

WARNINGS = "warnings.json"


def certificate_stage(project: Project, work: Path, day: dt.date, earlier: tuple[Path, ...]) -> Stage:
    """Describe the stage; `earlier` are the folders of all others.

    A certificate keeps its day until something that it says has changed.
    """
    keys = project.contents.certificate
    inputs = {} if keys.particulars is None else {"particulars": keys.particulars}

    def make(folder: Path, show: Progress) -> None:
        from photocal.report.issue import issue

        warnings = gather(work)
        text = json.dumps([one.as_json() for one in warnings], indent=1) + "\n"
        (folder / WARNINGS).write_text(text, encoding="utf-8")
        with show("certificate", None):
            issue(
                work / "analysis",
                folder,
                language=keys.language,
                day=day,
                block=work / "block",
                particulars=keys.particulars,
                client=keys.client,
                operator=keys.operator,
                told=told_by(warnings),
            )

    settings = keys.model_dump(mode="json", exclude={"particulars"})
    return Stage("certificate", "certificate", make, inputs, settings, earlier)
