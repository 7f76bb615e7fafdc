"""The live view as a local web page: the state as server-sent events, its files and nothing else."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import StreamingResponse
from starlette.routing import Route

from acquire.monitor.chart import layers
from acquire.monitor.state import State
from acquire.monitor.view_model import picture
from acquire.web import packaged

_SCRIPTS = ("figures", "alarms", "map", "monitor")
_FILES = {
    "/": "monitor.html",
    "/monitor.css": "monitor.css",
    **{f"/{name}.js": f"{name}.js" for name in _SCRIPTS},
}
_POLL_S = 0.1
# Seven decimals of a degree are a centimetre.
_DECIMALS = 7


class Latest:
    """The newest state, between the thread that makes states and those who show them."""

    def __init__(self) -> None:
        self.number = 0
        self.state = State()

    def publish(self, state: State) -> None:
        """Take a new state."""
        self.state = state
        self.number += 1


def application(latest: Latest) -> Starlette:
    """Return the page, its files and its feed.

    Parameters
    ----------
    latest : Latest
        Where the states come from.
    """

    async def feed(_: Request) -> StreamingResponse:
        return StreamingResponse(_events(latest), media_type="text/event-stream")

    return Starlette(routes=[*packaged("acquire.monitor", _FILES), Route("/feed", feed)])


async def _events(latest: Latest) -> AsyncIterator[str]:
    """Yield the state each time that it was renewed; of the map only what is new for this reader."""
    seen = 0
    drawn: dict[tuple[str, str], tuple[str, int]] = {}
    while True:
        if latest.number == seen:
            await asyncio.sleep(_POLL_S)
            continue
        seen, state = latest.number, latest.state
        yield _event("picture", picture(state).as_json())
        yield _event("chart", _news(state, drawn))


def _news(state: State, drawn: dict[tuple[str, str], tuple[str, int]]) -> list[dict[str, Any]]:
    news = []
    for layer in layers(state):
        key = (layer.kind, layer.name)
        edition, count = drawn.get(key, ("", 0))
        start = count if edition == layer.edition else 0
        drawn[key] = (layer.edition, len(layer.points))
        points = layer.points[start:].round(_DECIMALS).tolist()
        news.append(
            {"kind": layer.kind, "name": layer.name, "from": start, "points": points, "labels": layer.labels}
        )
    return news


def _event(name: str, value: Any) -> str:
    return f"event: {name}\ndata: {json.dumps(value, allow_nan=False)}\n\n"
