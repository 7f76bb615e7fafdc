"""The live view as a local web page: the state as server-sent events, its files and nothing else."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Sequence
from itertools import compress
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from acquire.monitor.planned import planned_footprint, planned_line
from acquire.monitor.state import RecordingState
from acquire.monitor.view_model import MapLayer, layers, view_of
from photocal.base.web import packaged

_SCRIPTS = ("texts", "figures", "alarms", "map", "monitor")
_FILES = {
    "/": "monitor.html",
    "/monitor.css": "monitor.css",
    "/texts.json": "texts.json",
    **{f"/{name}.js": f"{name}.js" for name in _SCRIPTS},
}
# Findings of a debrief that ask nothing of the crew.
_PASSED = ("passed", "untested", "note")


class Latest:
    """The newest state, between the thread that makes states and those who show them."""

    def __init__(
        self,
        folder: Callable[[], Path | None] = lambda: None,
        debrief: Path | None = None,
        plan: Path | None = None,
    ) -> None:
        self.number = 0
        # Under all that is flown lies what was to be flown.
        planned = () if plan is None else (MapLayer("plan", plan.stem, planned_line(plan), str(plan)),)
        self.planned: tuple[MapLayer, ...] = planned
        self.footprint = None if plan is None else planned_footprint(plan)
        self._debrief = debrief
        self.state = RecordingState()
        self._folder = folder
        self._flight = ""
        self._heard: int | None = None
        self._heard_ns = 0

    def publish(self, state: RecordingState) -> None:
        """Take a new state."""
        if state.flight != self._flight:
            self._flight, self._heard, self._heard_ns = state.flight, None, self._kept_ns(state.flight)
        self.state = state
        self.number += 1

    def heard(self) -> int:
        """Return the number of the last alarm that a person has confirmed.

        Numbers begin anew with each view of a flight; what was confirmed before it is known by its time.
        """
        if self._heard is not None:
            return self._heard
        old = [alarm.number for alarm in self.state.alarms if alarm.time_ns <= self._heard_ns]
        return max(old, default=0)

    def confirm(self, number: int) -> None:
        """Take note that a person has seen the alarms up to one, and keep that beside the log."""
        self._heard = number
        times = [alarm.time_ns for alarm in self.state.alarms if alarm.number <= number]
        path = self._path(self._flight)
        self._heard_ns = max([self._heard_ns, *times])
        self.number += 1
        if path is not None:
            # A log on a disk that cannot be written is shown all the same.
            with contextlib.suppress(OSError):
                path.write_text(str(self._heard_ns), encoding="ascii")

    def debrief(self) -> dict[str, Any]:
        """What a debrief has written, by language: verdict, figures and findings; empty while there is none.

        In flight it holds the pictures that have come against those that the cameras have reported.
        """
        if self._debrief is None:
            return {}
        try:
            content = json.loads(self._debrief.read_text(encoding="utf-8"))
            english = {
                "verdict": content["verdict"]["text"],
                "summary": content.get("summary", []),
                "findings": [row["text"] for row in content["findings"]],
                "calibration": [],
            }
            good = [not camera["lacks"] for camera in content.get("determined", [])]
            told = [row["severity"] not in _PASSED for row in content["findings"]]
            come = list[str]()
            reported = sum(counted.feedbacks for counted in self.state.exposures.values())
            if "live" in content and reported:
                come = [f"{len(content['pictures'])} of {reported} reported pictures have been received"]
            return {
                language: {
                    "verdict": said["verdict"],
                    "calibration": [*zip(said.get("calibration", []), good, strict=False)],
                    "summary": [*come, *said["summary"]],
                    "findings": [*compress(said["findings"], told)],
                }
                for language, said in {"en": english, **content.get("said", {})}.items()
            }
        except (OSError, ValueError, LookupError, TypeError):
            return {}

    def _kept_ns(self, flight: str) -> int:
        path = self._path(flight)
        try:
            return 0 if path is None else int(path.read_text(encoding="ascii"))
        except (OSError, ValueError):
            return 0

    def _path(self, flight: str) -> Path | None:
        folder = self._folder()
        return None if folder is None or not flight else folder / f".{flight}.heard"


def application(latest: Latest) -> Starlette:
    """Return the page, its files and its feed."""
    # A request holds one number, no more.
    longest_request = 20

    async def feed(_: Request) -> StreamingResponse:
        """Server-sent events of what the monitor knows."""
        return StreamingResponse(_events(latest), media_type="text/event-stream")

    async def heard(request: Request) -> Response:
        """Take a number that the page sends, and refuse what is longer than any."""
        body = b""
        async for piece in request.stream():
            body += piece
            if len(body) > longest_request:
                return Response(status_code=413)
        if not body.isdigit():
            return Response(status_code=400)
        latest.confirm(int(body))
        return Response(status_code=204)

    routes = [Route("/feed", feed), Route("/heard", heard, methods=["POST"])]
    return Starlette(routes=[*packaged("acquire.monitor", _FILES), *routes])


async def _events(latest: Latest) -> AsyncIterator[str]:
    """Yield the state each time that it was renewed; of the map only what is new for this reader."""
    seen, sent = 0, dict[str, Any]()
    drawn: dict[tuple[str, str], tuple[str, int]] = {}
    poll_s = 0.1
    while True:
        if latest.number == seen:
            await asyncio.sleep(poll_s)
            continue
        seen, state = latest.number, latest.state
        yield _event("view", {**view_of(state).as_json(), "heard": latest.heard()})
        yield _event("chart", _news((*latest.planned, *layers(state, latest.footprint)), drawn))
        debrief = latest.debrief()
        if debrief != sent:
            sent = debrief
            yield _event("debrief", debrief)


def _news(shown: Sequence[MapLayer], drawn: dict[tuple[str, str], tuple[str, int]]) -> list[dict[str, Any]]:
    # Seven decimals of a degree are a centimetre.
    decimals = 7
    news = []
    for layer in shown:
        key = (layer.kind, layer.name)
        edition, count = drawn.get(key, ("", 0))
        start = count if edition == layer.edition else 0
        drawn[key] = (layer.edition, len(layer.points))
        points = layer.points[start:].round(decimals).tolist()
        news.append(
            {"kind": layer.kind, "name": layer.name, "from": start, "points": points, "labels": layer.labels}
        )
    return news


def _event(name: str, value: Any) -> str:
    return f"event: {name}\ndata: {json.dumps(value, allow_nan=False)}\n\n"
