"""How each step stands: a state for its sign and colour, and the key of its word.

The window: its page, its libraries, and the answers of each step.
"""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote, unquote

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.web import calling, doing, folder_of, refusing, telling
from photocal.block.project import Project
from photocal.desk import certificate, checks, folder, look, marking, record, running, tiles
from photocal.desk.jobs import RUN
from photocal.desk.session import Desk
from photocal.findings.texts import catalogue
from photocal.measurement.marking.service import MarkingService
from photocal.measurement.marking.store import MarkStore, Scene
from photocal.run.stage import MEMORY

Stands = dict[str, str]


def shown(desk: Desk) -> dict[str, Any]:
    """What the rail of the page shows."""
    steps = standing(desk)
    names = ("folder", "check", "run", "look", "certificate")
    following = next((name for name in names if steps[name]["state"] in ("none", "bad")), "certificate")
    title = desk.folder.name or str(desk.folder)
    return {
        **desk.shown(),
        "title": title,
        "steps": steps,
        "next": following,
        "line": desk.line(["desk", desk.root]),
    }


def standing(desk: Desk) -> dict[str, Stands]:
    """How the steps of the project stand."""
    none = _as("none", "")
    steps = dict.fromkeys(("folder", "check", "run", "look", "certificate", "mark", "record"), none)
    if not desk.file.is_file():
        return {**steps, "folder": _as("none", "stands.choose")}
    checked = checks.checked(desk)
    if checked is not None:
        bad = checked.get("problem") or any(one["state"] == "bad" for one in checked["machine"])
        steps["check"] = _as("bad", "stands.problem") if bad else _as("good", "stands.checked")
        if running.changed_since(desk, checks.kept(desk)):
            steps["check"] = _as("warn", "stands.changed")
    try:
        project = desk.project()
    except (PhotocalError, OSError) as refusal:
        asked = "still to be filled in" in str(refusal)
        return {**steps, "folder": _as("warn", "stands.asked") if asked else _as("bad", "stands.problem")}
    steps["folder"] = _as("good", "stands.chosen")
    return {**steps, **_processed(desk, project)}


def _processed(desk: Desk, project: Project) -> dict[str, Stands]:
    job = desk.job(RUN).state()["state"]
    made = running.made_stages(project)
    issued = certificate.issued_as(project.output / "certificate")
    steps = {}
    if job in ("busy", "failed", "stopped"):
        signs = {"busy": "busy", "failed": "bad", "stopped": "warn"}
        steps["run"] = _as(signs[job], f"stands.{job}")
    elif "analysis" in made:
        changed = running.changed_since(desk, project.output / MEMORY)
        steps["run"] = _as("warn", "stands.changed") if changed else _as("good", "stands.run")
    if issued is not None:
        signs = {"passed": "good", "note": "good", "doubtful": "warn"}
        look = signs.get(issued["verdict"]["severity"], "bad")
        steps["look"] = _as(look, f"stands.found-{look}")
        signed = issued["signed"]
        steps["certificate"] = _as("good", "stands.signed") if signed else _as("warn", "stands.unsigned")
    return steps


def _as(state: str, word: str) -> Stands:
    return {"state": state, "word": word}


_STEPS = (folder.routes, checks.routes, running.routes, certificate.routes, record.routes)


def application(root: Path, cache: Path, place: str = "", run: Path | None = None) -> Starlette:
    """Return the page of a folder and what answers it.

    place: where it opens, instead of at the step that comes next.
    run: adjustment that orients the pictures of the place Mark, instead of the project's own.
    raises InputNotFoundError: when there is no such folder.
    """
    desk = Desk(root, cache)
    pictures, marked = tiles.OpenPictures(desk), marking.OpenMarking(desk, run)
    opens = {"next": place} if place else {}
    return _served(
        lambda: shown(desk) | opens,
        desk,
        *(route for step in _STEPS for route in step(desk)),
        *look.routes(desk, pictures),
        *marking.routes(marked, marked.place),
        tiles.route(pictures, cache, lambda: marked.opened),
    )


def marking_application(scene: Scene, store: MarkStore, cache: Path) -> Starlette:
    """Return the page with the place Mark alone, for pictures without a project of the usual name."""
    service = MarkingService(scene, store)
    here = {"root": str(store.path), "folder": ".", "file": False, "title": scene.name, "next": "mark"}
    told = here | {"steps": {"mark": _as("none", "")}, "line": ""}
    return _served(
        lambda: told,
        # Who reads a page that has no project.
        SimpleNamespace(language="en"),
        *marking.routes(lambda: service, service.project),
        tiles.route(lambda: scene.pictures, cache, lambda: True),
    )


def _one_folder(app: ASGIApp, desk: Desk, refuse: Callable[[Request, Exception], Response]) -> ASGIApp:
    """Refuse what a page asks for another folder than the one that is open: a second window opened that."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that names no other folder."""
        here = desk.named(desk.folder)
        meant = (
            unquote(Headers(scope=scope).get("photocal-folder", quote(here)))
            if scope["type"] == "http"
            else here
        )
        if meant == here:
            return await app(scope, receive, send)
        refusal = ConfigurationError(
            f"another window has opened the folder {desk.folder.name}: nothing was done",
            f"choose {meant} again, or reload the page to go on there",
        )
        return await refuse(Request(scope), refusal)(scope, receive, send)

    return answer


def _served(
    told: Callable[[], dict[str, Any]], reader: Desk | SimpleNamespace, *answers: BaseRoute
) -> Starlette:
    """The page, its libraries, how it stands, and what answers it."""
    refuse = refusing(lambda text: catalogue(reader.language).refused(text))
    return Starlette(
        middleware=[Middleware(_one_folder, reader, refuse)] if isinstance(reader, Desk) else [],
        routes=[
            *folder_of("photocal.desk", "page"),
            *folder_of("photocal.desk", "vendor", "/vendor/"),
            telling("/api/desk", told),
            doing("/api/language", calling(_speak, reader)),
            *answers,
        ],
        exception_handlers={PhotocalError: refuse},
    )


def _speak(reader: Desk | SimpleNamespace, language: str) -> dict[str, str]:
    reader.language = catalogue(language).language
    return {"language": reader.language}
