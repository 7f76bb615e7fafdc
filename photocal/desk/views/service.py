"""What answers for the step Look: views of the last run, remembered until there is another."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from photocal.base.errors import ConfigurationError, InputNotFoundError, PhotocalError
from photocal.base.web import checked
from photocal.block.project import LeaveOutKeys
from photocal.block.results.folder import RESULT
from photocal.desk.session import Desk
from photocal.desk.tiles import Pictures
from photocal.desk.views import overview, pictures
from photocal.desk.views.ground import ground_of, ground_tile, ground_told
from photocal.desk.views.plots import plots
from photocal.desk.views.shown import Shown, adjusted_in, read_shown
from photocal.findings.texts import LANGUAGES, catalogue
from photocal.measurement.marking.tiles import TILE_PX, coarsest_level
from photocal.run.block import FINDINGS
from photocal.run.left_out import leave_out, take_back
from photocal.run.summary import read_json

if TYPE_CHECKING:
    from photocal.products.raster import RasterFile

Made = TypeVar("Made")


class Look:
    """The project as its last run left it; read again when another run was made.

    A view is made once for each run: the map, plots and findings of a large block take a second each.
    """

    def __init__(self, desk: Desk, pictures: Pictures) -> None:
        self._desk, self._known_pictures = desk, pictures
        self._lock = threading.RLock()
        self._state: object = None
        self._shown: Shown | None = None
        self._views: dict[object, Any] = {}
        self._ground: RasterFile | None = None

    def shown(self) -> Shown:
        """Give what the last run left; raises InputNotFoundError before one."""
        work = self._desk.project().output
        with self._lock:
            state = _state(work)
            if self._shown is None or state != self._state:
                self._shown, self._state, self._views = read_shown(work), state, {}
            return self._shown

    def view(self, key: object, make: Callable[[Shown], Made]) -> Made:
        """Give a view, made or remembered."""
        shown = self.shown()
        with self._lock:
            if key not in self._views:
                self._views[key] = make(shown)
            made: Made = self._views[key]
        return made

    def plots(self) -> dict[str, Any]:
        """All plots as numbers."""
        return self.view("plots", plots)

    def tie_names(self) -> list[str]:
        """Names of the tie points, in the order of `ties`."""
        return self.view("tie names", overview.tie_names)

    def ties(self) -> bytes:
        """Tie points as an array."""
        return self.view("ties", overview.ties)

    def overlap(self) -> tuple[dict[str, Any], bytes]:
        """Where the cells of the overlap lie, and how many pictures show each."""
        return self.view("overlap", overview.overlap)

    def overview(self) -> dict[str, Any]:
        """What map and 3-D view begin with."""
        made = self.view("overview", overview.overview)
        known = self._known_pictures()
        # It is made when the run is over: looked for each time.
        self._ground = ground = ground_of(self.shown(), self._desk.folder)
        return {
            **made,
            "ground": None if ground is None else ground_told(ground, self._desk.named(ground.path)),
            "origin": self.view("origin", overview.origin).tolist(),
            "pictures": {name: not picture.reason for name, picture in known.items()},
            "coarsest": {name: coarsest_level(picture.size_px) for name, picture in known.items()},
            "tile_px": TILE_PX,
            "marking": self._desk.project().control.marks is not None and bool(known),
            "left_out": self.left_out(),
        }

    def warm(self) -> None:
        """Make what is asked for first, before anybody asks; without a run there is nothing to make."""
        with suppress(PhotocalError, OSError):
            self.overview()
            self.findings({"language": self._desk.language})
            self.overlap()

    def findings(self, asked: dict[str, str]) -> dict[str, Any]:
        """All findings in a language."""
        language = asked.get("language", "en")
        say = catalogue(language if language in LANGUAGES else "en")
        return self.view(("findings", say.language), lambda shown: overview.findings(shown, say))

    def picture(self, asked: dict[str, str]) -> dict[str, Any]:
        """Observations of one picture; none if it is not used."""
        name = asked.get("name", "")
        known = self._known_pictures().get(name)
        try:
            told = pictures.picture(self.shown(), name)
        except InputNotFoundError:
            if known is None:
                raise
            told = {"name": name, "size_px": list(known.size_px), "place": [], "points": [], "predicted": []}
        reason = "is not in the folder of pictures" if known is None else known.reason
        return {**told, "reason": reason, "turn": 0 if known is None else known.turn_deg}

    def point(self, asked: dict[str, str]) -> dict[str, Any]:
        """Observations of one point."""
        return pictures.point(self.shown(), asked.get("name", ""))

    def ground(self, level: int, column: int, row: int) -> bytes:
        """A tile of the orthophoto that the map shows."""
        if self._ground is None:
            raise InputNotFoundError("has no orthophoto", "run photocal ortho", where=self._desk.folder)
        return ground_tile(self._ground, level, column, row)

    def left_out(self) -> dict[str, Any]:
        """What is left out by hand, and whether the last run knew it."""
        entries = [entry.model_dump() for entry in self._desk.project().contents.leave_out]
        known = read_json(self._desk.project().output / "block" / FINDINGS) or {}
        computed = [
            {key: given["figures"][key] or None for key in ("image", "point")}
            | {"reason": given["figures"]["reason"]}
            for given in known.get("findings", ())
            if given["code"] == "left-out-by-hand"
        ]
        return {"entries": entries, "waiting": entries != computed}

    def leave_out(self, body: bytes) -> dict[str, Any]:
        """Leave something out with a reason."""
        return self._changed(leave_out, body)

    def take_back(self, body: bytes) -> dict[str, Any]:
        """Take something in again."""
        return self._changed(take_back, body)

    def _changed(self, change: Callable[[Path, LeaveOutKeys], None], body: bytes) -> dict[str, Any]:
        entry = checked(LeaveOutKeys, body)
        shown = self.shown()
        for name, known in ((entry.image, shown.block.images.names), (entry.point, shown.block.points.names)):
            if change is leave_out and name is not None and name not in known:
                raise ConfigurationError("is not in the block", "choose one of the block", where=name)
        with self._desk.lock:
            change(self._desk.file, entry)
        return self.left_out()


def _state(work: Path) -> object:
    """What changes when another run was made."""
    paths = (adjusted_in(work) / RESULT, work / "block" / "block.toml")
    certified = work / "certificate" / "certificate.json"
    seen = [path.stat() for path in (*paths, *([certified] if certified.is_file() else []))]
    return (str(work), tuple((state.st_mtime_ns, state.st_size, state.st_ino) for state in seen))
