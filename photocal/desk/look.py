"""Answers to the step Look: map, findings, pictures, plots and 3-D view of a project that was run."""

from starlette.routing import BaseRoute

from photocal.base.web_answers import telling
from photocal.desk.session import Desk


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers below ``/api/look``."""
    return [telling("/api/look", desk.shown)]
