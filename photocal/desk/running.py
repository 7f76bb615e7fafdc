"""Answers to the step Run: the stages with their times, one command at work, and what it says."""

import datetime as dt
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from starlette.routing import BaseRoute

from photocal.base.codec import kept_json
from photocal.base.errors import PhotocalError
from photocal.base.web import calling, doing, telling
from photocal.block.project import Project
from photocal.desk.certificate import issued_as
from photocal.desk.jobs import DEBRIEF, RUN
from photocal.desk.project_file import with_field
from photocal.desk.session import Desk
from photocal.run.output_place import STAGES
from photocal.run.stage import RECORD, made_in


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers for the step Run."""
    return [
        telling("/api/run", lambda: state(desk)),
        doing("/api/run/start", calling(_start, desk)),
        doing("/api/run/stop", lambda _: _stop(desk)),
        telling("/api/run/log", lambda: {"log": desk.job(RUN).log()}),
    ]


def state(desk: Desk) -> dict[str, Any]:
    """Every stage with its time and state, how far the one at work is, and an error with its field."""
    from photocal.run.campaign import PROGRESS, stages

    job = desk.job(RUN).state()
    told: dict[str, Any] = {
        "job": job,
        "error": with_field(job["error"], desk.language),
        "line": desk.line(["run", desk.folder]),
        "stages": [],
        "progress": None,
        "verdict": None,
        "debriefing": desk.job(DEBRIEF).state()["state"] == "busy",
    }
    try:
        project = desk.project()
        listed = stages(project, dt.datetime.now().astimezone().date())
    except (PhotocalError, OSError) as refusal:
        return {**told, "error": told["error"] or with_field(str(refusal), desk.language)}
    work = project.output
    progress = kept_json(work / PROGRESS) if job["state"] == "busy" else {}
    names = [stage.name for stage in listed]
    said = told_stages(desk.job(RUN).log(), names) if job["state"] != "none" else {}
    issued = issued_as(work / "certificate", desk.language)
    return {
        **told,
        "stages": [*_stages(work, names, said, job)],
        "progress": {key: progress.get(key) for key in ("title", "share", "left_s", "run")},
        "verdict": None if job["state"] == "busy" or issued is None else issued["verdict"],
    }


def _stages(
    work: Path, names: list[str], said: Mapping[str, str], job: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Each stage: made, kept, at work or to come; and its time by the record."""
    found = []
    for name in names:
        record = kept_json(made_in(work) / name / RECORD)
        seconds = record.get("seconds")
        now = said.get(name, "")
        state = now or ("there" if record else "none")
        if job["state"] == "busy" and not now:
            begun = all(before in said for before in names[: names.index(name)])
            state = "busy" if begun else "waits"
        found.append({"name": name, "ours": name in STAGES, "state": state, "seconds": seconds})
    return found


def told_stages(log: str, names: list[str]) -> dict[str, str]:
    """Stages that a run has named in its lines: made or kept."""
    found = {}
    for said in log.splitlines():
        parts = said.rsplit(": ", 2)
        if len(parts) == 3 and parts[1] in names:
            found[parts[1]] = "kept" if parts[2] == "kept" else "made"
    return found


def _start(desk: Desk, again: Annotated[str, Field(max_length=50)] = "") -> dict[str, Any]:
    arguments: list[str | Path] = ["run", desk.folder]
    desk.start(RUN, [*arguments, "--again", again] if again else arguments)
    return state(desk)


def _stop(desk: Desk) -> dict[str, Any]:
    desk.job(RUN).stop()
    return state(desk)


def made_stages(project: Project) -> list[str]:
    """Stages of ours that lie in the work folder, whether they are up to date or not."""
    return [name for name in STAGES if (made_in(project.output) / name / RECORD).is_file()]


def changed_since(desk: Desk, done: Path) -> bool:
    """Whether the project, or a table beside it, is younger than a file that tells what was made of them."""
    files = [path for path in desk.folder.iterdir() if path.suffix in (".csv", ".toml")]
    written = max((path.stat().st_mtime for path in files), default=0.0)
    return done.is_file() and written > done.stat().st_mtime
