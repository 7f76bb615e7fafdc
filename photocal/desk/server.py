"""The window: its page, its libraries, and the answers of each step."""

from pathlib import Path

from starlette.applications import Starlette

from photocal.base.checked_toml import Table
from photocal.base.errors import PhotocalError
from photocal.base.web import folder_of
from photocal.base.web_answers import checked, doing, refusal, telling
from photocal.desk import certificate, checks, folder, look, record, running, standing
from photocal.desk.session import Desk
from photocal.findings.texts import catalogue

_STEPS = (folder.routes, checks.routes, running.routes, look.routes, certificate.routes, record.routes)


class _Language(Table, strict=True):
    language: str


def application(root: Path, cache: Path) -> Starlette:
    """Return the page of a folder and what answers it.

    raises InputNotFoundError: when there is no such folder.
    """
    desk = Desk(root, cache)
    return Starlette(
        routes=[
            *folder_of("photocal.desk", "page"),
            *folder_of("photocal.desk", "vendor", "/vendor/"),
            telling("/api/desk", lambda: standing.shown(desk)),
            doing("/api/language", lambda body: _speak(desk, checked(_Language, body).language)),
            *(route for step in _STEPS for route in step(desk)),
        ],
        exception_handlers={PhotocalError: refusal},
    )


def _speak(desk: Desk, language: str) -> dict[str, str]:
    desk.language = catalogue(language).language
    return {"language": desk.language}
