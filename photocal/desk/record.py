"""Answers to the step Record: the recording beneath the folder, shown by the monitor's own page."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.routing import BaseRoute, Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from acquire.monitor.page import Latest, application
from acquire.monitor.tail import follow, tail_of
from photocal.base.checked_toml import read_tables
from photocal.base.errors import PhotocalError
from photocal.base.web import POLICY, telling
from photocal.desk.session import Desk
from photocal.run.stage import MEMORY

_DEPTH, _MOST = 3, 5000


class Watch:
    """Follows the recording of a folder in a thread of its own, until another folder is opened."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._stop = threading.Event()
        self._page: ASGIApp = application(Latest())
        self._guard = threading.Lock()

    def on(self, folder: Path | None, debrief: Path, plan: Path | None) -> None:
        """Follow this folder from now on; nothing changes where it is followed already."""
        with self._guard:
            if folder == self._folder:
                return
            self._stop.set()
            self._folder, self._stop = folder, threading.Event()
            if folder is None:
                self._page = application(Latest())
                return
            latest = Latest(lambda: folder, debrief, plan)
            self._page = application(latest)
            work = (tail_of(folder), latest.publish, self._stop)
            threading.Thread(target=follow, args=work, daemon=True).start()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the monitor does; the window alone may frame it."""

        async def framed(message: Message) -> None:
            """Send an answer whose page may stand in the window."""
            if message["type"] == "http.response.start":
                policy = POLICY.replace("frame-ancestors 'none'", "frame-ancestors 'self'")
                MutableHeaders(scope=message)["content-security-policy"] = policy
            await send(message)

        await self._page(scope, receive, framed)


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers for the step Record."""
    watch = Watch()
    return [telling("/api/record", lambda: state(desk, watch)), Mount("/monitor", watch)]


def state(desk: Desk, watch: Watch) -> dict[str, Any]:
    """The recording that was written last, the mission beside it, and what would begin one."""
    files = [*_files(desk.folder, _DEPTH)]
    logs = [path for path in files if path.name.startswith("flight-") and path.suffix == ".mcap"]
    newest = max(logs, key=lambda path: path.name, default=None)
    plan = next((path for path in files if path.suffix == ".waypoints"), None)
    folder = None if newest is None else newest.parent
    try:
        watch.on(folder, desk.folder / "work" / "debrief.json", plan)
    except PhotocalError:
        # A mission that cannot be read keeps nobody from seeing the recording.
        watch.on(folder, desk.folder / "work" / "debrief.json", None)
    settings = [path for path in files if path.suffix == ".toml" and _records(path)]
    shown: list[str | Path] = ["monitor", folder or desk.folder, "--page"]
    shown += [] if plan is None else ["--plan", plan]
    return {
        "file": None if newest is None else desk.named(newest),
        "plan": None if plan is None else desk.named(plan),
        "configurations": [desk.named(path) for path in settings],
        "calibration": _calibration(desk.folder / "work" / "debrief.json", desk.language),
        "line": desk.line(shown, "acquire"),
        "begin": [
            desk.line([step, path], "acquire") for path in settings[:1] for step in ("check", "record")
        ],
    }


def _calibration(file: Path, language: str) -> list[tuple[str, bool]]:
    """What a debrief in flight says of each camera, and whether c is as well determined as is wanted."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        lines = content["said"][language]["calibration"] if "live" in content else []
        cameras = content["determined"] if lines else []
        return [(str(line), not camera["lacks"]) for line, camera in zip(lines, cameras, strict=True)]
    except (OSError, ValueError, LookupError, TypeError):
        return []


def _files(folder: Path, depth: int) -> Iterator[Path]:
    for number, path in enumerate(sorted(folder.iterdir())):
        if number > _MOST or path.name.startswith(".") or path.is_symlink():
            continue
        if path.is_file():
            yield path
        elif depth and path.is_dir() and not (path / MEMORY).exists():
            yield from _files(path, depth - 1)


def _records(path: Path) -> bool:
    try:
        return "recording" in read_tables(path)
    except PhotocalError:
        return False
