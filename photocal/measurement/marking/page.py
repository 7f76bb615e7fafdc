"""The page for marking: its files and its routes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from acquire.web import packaged
from drivers.errors import ConfigurationError, InputNotFoundError, PhotocalError
from photocal.measurement.marking.scene import Scene
from photocal.measurement.marking.service import MarkingService
from photocal.measurement.marking.store import MarkStore
from photocal.measurement.marking.tiles import TileAddress

_FILES = {
    "/": "marking.html",
    "/marking.css": "marking.css",
    "/marking.js": "marking.js",
    "/view.js": "view.js",
    "/tiles.js": "tiles.js",
}
_LONGEST_REQUEST = 10_000


def application(scene: Scene, store: MarkStore, cache: Path) -> Starlette:
    """Return the page and what answers it."""
    service = MarkingService(scene, store, cache)

    def telling(path: str, tell: Callable[[], dict[str, Any]]) -> Route:
        async def give(_: Request) -> Response:
            return JSONResponse(await run_in_threadpool(tell))

        return Route(path, give)

    def doing(path: str, do: Callable[[bytes], dict[str, Any]]) -> Route:
        async def give(request: Request) -> Response:
            return JSONResponse(await run_in_threadpool(do, await _body(request)))

        return Route(path, give, methods=["POST"])

    async def images(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(service.images, request.query_params.get("point", "")))

    async def tile(request: Request) -> Response:
        asked = request.path_params
        address = TileAddress(asked["level"], asked["column"], asked["row"])
        made = await run_in_threadpool(service.tile, asked["image"], address)
        # Nobody waits for the broom.
        return Response(made, media_type="image/jpeg", background=BackgroundTask(service.tidy))

    return Starlette(
        routes=[
            *packaged("photocal.measurement.marking", _FILES),
            telling("/project", service.project),
            telling("/state", service.state),
            Route("/images", images),
            Route("/tiles/{image}/{level:int}/{column:int}/{row:int}", tile),
            doing("/mark", service.mark),
            doing("/remove", service.remove),
            doing("/undo", lambda _: service.undo()),
            doing("/redo", lambda _: service.redo()),
            doing("/adjust", lambda _: service.adjust()),
        ],
        exception_handlers={PhotocalError: _refusal},
    )


async def _body(request: Request) -> bytes:
    # A form of another site cannot have this type.
    if request.headers.get("content-type") != "application/json":
        raise ConfigurationError("the request is no JSON", remedy="use the page")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST_REQUEST:
            raise ConfigurationError("the request is too long", remedy="use the page")
    return body


async def _refusal(_: Request, refusal: Exception) -> Response:
    status = 404 if isinstance(refusal, InputNotFoundError) else 422
    return JSONResponse({"error": str(refusal)}, status)
