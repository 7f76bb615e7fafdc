"""The window: its page, its libraries, and the answers of each step."""

from pathlib import Path

from starlette.applications import Starlette

from photocal.base.errors import PhotocalError
from photocal.base.web import folder_of
from photocal.base.web_answers import refusal, telling
from photocal.desk import certificate, checks, folder, look, record, running, standing
from photocal.desk.session import Desk

_STEPS = (folder.routes, checks.routes, running.routes, look.routes, certificate.routes, record.routes)


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
            *(route for step in _STEPS for route in step(desk)),
        ],
        exception_handlers={PhotocalError: refusal},
    )
