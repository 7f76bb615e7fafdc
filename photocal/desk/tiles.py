"""Tiles of the pictures that may be shown: those of the open project, or of a folder without one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from photocal.base.checked_toml import read_tables
from photocal.base.errors import InputNotFoundError
from photocal.desk.session import Desk
from photocal.measurement.marking.store import Picture, read_pictures
from photocal.measurement.marking.tiles import HELD_PX, Tiles

# Decoded pictures in memory while one is shown and the others are thumbnails.
_ALONE_PX = 25_000_000
Pictures = Callable[[], Mapping[str, Picture]]


class OpenPictures:
    """The pictures of the project that is open, by name; read again when their folder has changed."""

    def __init__(self, desk: Desk) -> None:
        self._desk, self._lock = desk, threading.Lock()
        self._read: tuple[object, dict[str, Picture]] = (None, {})

    def __call__(self) -> dict[str, Picture]:
        """Give them; none where the project file names no folder that is there."""
        # What is asked of the project keeps nobody from its pictures.
        named = read_tables(self._desk.file).get("images", {}).get("folder", "")
        folder = self._desk.folder / str(named)
        # It may be a pattern of names.
        where = folder if folder.is_dir() else folder.parent
        if not named or not where.is_dir():
            return {}
        state = (folder, where.stat().st_mtime_ns)
        with self._lock:
            if self._read[0] != state:
                self._read = state, read_pictures(folder)
            return self._read[1]


def route(known: Pictures, cache: Path, side_by_side: Callable[[], bool]) -> Route:
    """Return the route to tiles of pictures, by level, column and row; no other file is ever opened.

    side_by_side: whether several pictures are shown now: all of them are held.
    """
    tiles = Tiles(cache, held_px=_ALONE_PX)

    def tile(image: str, level: int, column: int, row: int) -> bytes:
        """Give a tile as JPEG."""
        picture = known().get(image)
        missing = InputNotFoundError.at(image)
        if picture is None:
            raise missing("is not a picture of this project", "choose one of the list")
        if picture.reason:
            raise missing(picture.reason, "choose another picture")
        if side_by_side():
            tiles.held_px = HELD_PX
        return tiles.tile(picture.path, level, column, row)

    async def give(request: Request) -> Response:
        """Answer with a tile."""
        made = await run_in_threadpool(lambda: tile(**request.path_params))
        # Nobody waits for the broom.
        return Response(made, media_type="image/jpeg", background=BackgroundTask(tiles.tidy))

    return Route("/api/tiles/{image}/{level:int}/{column:int}/{row:int}", give)
