"""Answers to the step Look: map, findings, pictures, plots and 3-D view of a project that was run."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from photocal.base.web import doing, finding, telling
from photocal.desk.session import Desk
from photocal.desk.tiles import Pictures

if TYPE_CHECKING:
    from photocal.desk.views.service import Look

_BYTES = "application/octet-stream"


def routes(desk: Desk, pictures: Pictures) -> list[BaseRoute]:
    """Return what answers below ``/api/look``; what it needs is loaded beside, not before, the window."""
    lock, made = threading.Lock(), list["Look"]()

    def look() -> Look:
        """Give the service, loaded when it is first asked."""
        with lock:
            if not made:
                from photocal.desk.views.service import Look

                made.append(Look(desk, pictures))
            return made[0]

    def arrays(path: str, make: Callable[[], bytes]) -> Route:
        """Return a route that answers with an array."""

        async def give(_: Request) -> Response:
            """Answer with its bytes."""
            return Response(await run_in_threadpool(make), media_type=_BYTES)

        return Route(path, give)

    async def ground(request: Request) -> Response:
        """Answer with a tile of the orthophoto."""
        made = await run_in_threadpool(lambda: look().ground(**request.path_params))
        return Response(made, media_type="image/png")

    def told(path: str, tell: Callable[[Look], Any]) -> Route:
        """Return a route that answers with what the service tells."""
        return telling(path, lambda: tell(look()))

    def found(path: str, find: Callable[[Look, dict[str, str]], Any]) -> Route:
        """Return a route that answers what stands in its query."""
        return finding(path, lambda asked: find(look(), asked))

    def done(path: str, do: Callable[[Look, bytes], Any]) -> Route:
        """Return a route that hands the body of a request to the service."""
        return doing(path, lambda body: do(look(), body))

    threading.Thread(target=lambda: look().warm(), daemon=True).start()
    return [
        told("/api/look", lambda here: here.overview()),
        found("/api/look/findings", lambda here, asked: here.findings(asked)),
        found("/api/look/picture", lambda here, asked: here.picture(asked)),
        found("/api/look/point", lambda here, asked: here.point(asked)),
        told("/api/look/plots", lambda here: here.plots()),
        told("/api/look/tie-names", lambda here: here.tie_names()),
        told("/api/look/overlap", lambda here: here.overlap()[0]),
        arrays("/api/look/overlap.bin", lambda: look().overlap()[1]),
        arrays("/api/look/ties.bin", lambda: look().ties()),
        Route("/api/look/ground/{level:int}/{column:int}/{row:int}", ground),
        told("/api/look/left-out", lambda here: here.left_out()),
        done("/api/look/leave-out", lambda here, body: here.leave_out(body)),
        done("/api/look/take-back", lambda here, body: here.take_back(body)),
    ]
