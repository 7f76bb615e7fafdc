"""Answers to the step Look: map, findings, pictures, plots and 3-D view of a project that was run."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

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

    threading.Thread(target=lambda: look().warm(), daemon=True).start()
    return [
        telling("/api/look", lambda: look().overview()),
        finding("/api/look/findings", lambda asked: look().findings(asked)),
        finding("/api/look/picture", lambda asked: look().picture(asked)),
        finding("/api/look/point", lambda asked: look().point(asked)),
        telling("/api/look/plots", lambda: look().plots()),
        telling("/api/look/tie-names", lambda: look().tie_names()),
        telling("/api/look/overlap", lambda: look().overlap()[0]),
        arrays("/api/look/overlap.bin", lambda: look().overlap()[1]),
        arrays("/api/look/ties.bin", lambda: look().ties()),
        Route("/api/look/ground/{level:int}/{column:int}/{row:int}", ground),
        telling("/api/look/left-out", lambda: look().left_out()),
        doing("/api/look/leave-out", lambda body: look().leave_out(body)),
        doing("/api/look/take-back", lambda body: look().take_back(body)),
    ]
