"""Answers to the step Check: the machine, what contradicts in the project, and the debrief of the flight."""

import json
from pathlib import Path
from typing import Any

from starlette.routing import BaseRoute

from photocal.base.codec import kept_json
from photocal.base.errors import PhotocalError
from photocal.base.files import write_file
from photocal.base.web import calling, doing, telling
from photocal.desk.jobs import DEBRIEF, FOLDER, RUN, asked
from photocal.desk.project_file import with_field
from photocal.desk.running import changed_since
from photocal.desk.session import Desk
from photocal.findings.texts import catalogue, finding_json, findings_of

# The second is what `photocal debrief` writes.
_KEPT, _DEBRIEF = "check.json", "debrief.json"


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers for the step Check."""
    return [
        telling("/api/check", lambda: state(desk)),
        doing("/api/check/start", lambda _: _check(desk)),
        doing("/api/debrief/start", calling(_debrief, desk)),
        doing("/api/debrief/stop", lambda _: _stop(desk)),
    ]


def state(desk: Desk) -> dict[str, Any]:
    """What the last check has found, and the debrief as it stands."""
    job = desk.job(DEBRIEF).state()
    return {
        "checked": desk.in_its_language(checked(desk)),
        "changed": changed_since(desk, kept(desk)),
        "debrief": debrief(desk),
        "job": job,
        "running": desk.job(RUN).state()["state"] == "busy",
        "error": with_field(job["error"], desk.language),
        "lines": {"doctor": desk.line(_doctor(desk)), "debrief": desk.line(["debrief", desk.folder])},
    }


def checked(desk: Desk) -> dict[str, Any] | None:
    """What the last check has found."""
    return kept_json(kept(desk)) or None


def kept(desk: Desk) -> Path:
    """File of the last check, there or not."""
    return desk.folder / FOLDER / _KEPT


def _doctor(desk: Desk) -> list[str | Path]:
    try:
        crs = desk.project().crs
    except (PhotocalError, OSError):
        crs = "local"
    system = ["--crs", crs] if crs != "local" else []
    return ["doctor", desk.folder, *system, *(["--lang", desk.language] if desk.language != "en" else [])]


def _check(desk: Desk) -> dict[str, Any]:
    """Ask the machine, and hold the inputs of the project against each other."""
    from photocal.run.project_checks import check_project

    machine = asked(_doctor(desk))
    content: dict[str, Any] = {"machine": machine, "problem": None, "language": desk.language}
    try:
        check_project(desk.project())
    except PhotocalError as refusal:
        content["problem"] = with_field(str(refusal).removeprefix(f"{desk.file}: "), desk.language)
    (desk.folder / FOLDER).mkdir(exist_ok=True)
    with desk.lock:
        write_file(kept(desk), json.dumps(content))
    return state(desk)


def debrief(desk: Desk) -> dict[str, Any] | None:
    """What the debrief has written, as far as it is there, in the language of the window."""
    # It computes, too: the window is there before it.
    from photocal.run.debrief.verdict import measured_text

    try:
        path = desk.project().output / _DEBRIEF
        content, say = json.loads(path.read_bytes()), catalogue(desk.language)
        verdict, *found = findings_of([content["verdict"], *content["findings"]], path)
        return {
            "verdict": finding_json(verdict, say),
            "summary": measured_text(content["measured"], say),
            "findings": [
                finding_json(one, say) for one in found if one.severity not in ("passed", "untested")
            ],
            "exposures": content["exposures"],
            "coverage": content["coverage"],
            "pictures": len(content["pictures"]),
        }
    except (PhotocalError, OSError, ValueError, LookupError, TypeError):
        return None


def _debrief(desk: Desk, *, live: bool = False) -> dict[str, Any]:
    follow: list[str | Path] = ["--live"] if live else []
    desk.start(DEBRIEF, ["debrief", desk.folder, *follow])
    return state(desk)


def _stop(desk: Desk) -> dict[str, Any]:
    desk.job(DEBRIEF).stop()
    return state(desk)
