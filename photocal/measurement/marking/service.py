"""What the page for marking asks and does."""

import math
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, FiniteFloat

from photocal.base.arrays import Floats
from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.base.web import checked
from photocal.base.workers import own_processes
from photocal.block.model import ROLES
from photocal.exchange.parts import Mark
from photocal.measurement.image_file import Grey, read_grey
from photocal.measurement.marking.adjustment import AdjustedMarks, adjust_marks
from photocal.measurement.marking.snap import KINDS, Kind, snap
from photocal.measurement.marking.store import MarkStore, Picture, Scene
from photocal.measurement.marking.tiles import TILE_PX, coarsest_level
from photocal.measurement.marks import BY_HAND_PX
from photocal.measurement.orientation import Orientation, ellipse, predict
from photocal.measurement.target_centre import FLAT, ground_bend, measurable

FARTHEST_REACH_PX = 60.0
# A name has something to see and nothing that breaks a line.
_NAME = r"^[^\x00-\x1f\x7f]*[^\x00-\x20\x7f][^\x00-\x1f\x7f]*$"


class _Place(Table, strict=True):
    image: str
    point: Annotated[str, Field(min_length=1, max_length=100, pattern=_NAME)]


class _Click(_Place):
    """Where somebody clicked; without kinds the mark stays there."""

    x: FiniteFloat
    y: FiniteFloat
    reach: Annotated[float, Field(gt=0, le=FARTHEST_REACH_PX)] = 12.0
    kinds: tuple[Kind, ...] = KINDS


class MarkingService:
    """What lies on the table: the scene, its marks, and what the last adjustment found."""

    def __init__(self, scene: Scene, store: MarkStore) -> None:
        self._scene, self.store = scene, store
        self._adjusted: AdjustedMarks | None = None
        self._adjusted_marks: dict[tuple[str, str], tuple[float, float]] = {}

    def project(self) -> dict[str, Any]:
        """What does not change."""
        scene = self._scene
        return {
            "name": scene.name,
            "listed": scene.listed,
            "adjustable": scene.orientation is not None and len(scene.points.names) > 0,
            "tile_px": TILE_PX,
            "kinds": list(KINDS),
            "by_hand_px": BY_HAND_PX,
            "images": [
                {
                    "name": name,
                    "width": picture.size_px[0],
                    "height": picture.size_px[1],
                    "turn": picture.turn_deg,
                    "coarsest": coarsest_level(picture.size_px),
                    "reason": picture.reason,
                }
                for name, picture in scene.pictures.items()
            ],
            "points": [
                {"name": name, "role": ROLES[role]}
                for name, role in zip(scene.points.names, scene.points.role.tolist(), strict=True)
            ],
        }

    def state(self) -> dict[str, Any]:
        """Marks, and what the last adjustment said of them."""
        marks = self.store.marks
        undo, redo = self.store.history
        return {
            "marks": [
                {"image": m.image, "point": m.point, "x": m.x, "y": m.y, "sx": m.sigma[0], "sy": m.sigma[1]}
                for m in marks
                # What is marked in a picture that is not there is marked nowhere.
                if m.image in self._scene.pictures
            ],
            "absent": sorted({m.image for m in marks} - set(self._scene.pictures)),
            "undo": undo,
            "redo": redo,
            "residuals": self._residuals(marks),
            "sigma0": None if self._adjusted is None else self._adjusted.sigma0,
        }

    def _residuals(self, marks: tuple[Mark, ...]) -> list[dict[str, Any]]:
        """Residuals of marks that have not moved since they were adjusted."""
        if self._adjusted is None:
            return []
        now = {(m.image, m.point): (m.x, m.y) for m in marks}
        return [
            residual
            for residual in self._adjusted.residuals
            for key in [(residual["image"], residual["point"])]
            if key in now and now[key] == self._adjusted_marks.get(key)
        ]

    def images(self, point: str) -> dict[str, Any]:
        """Images by how likely they show a point, and where."""
        names = [name for name, picture in self._scene.pictures.items() if not picture.reason]
        orientation = self._orientation
        known = self._scene.points
        seen: dict[str, dict[str, Any]] = {}
        if orientation is not None and point in known.names:
            k = known.names.index(point)
            prediction = predict(orientation, known.values[k], known.sigma[k])
            for i, name in enumerate(orientation.images.names):
                x, y = prediction.pixels[i].tolist()
                likely = float(prediction.probability[i])
                outline = ellipse(prediction.covariance[i])
                if math.isnan(likely):
                    continue
                seen[name] = {
                    "x": x if math.isfinite(x) else None,
                    "y": y if math.isfinite(y) else None,
                    "probability": likely,
                    "ellipse": outline if math.isfinite(x) else None,
                }
        ranked = sorted(names, key=lambda name: self._rank(name, seen.get(name)))
        return {
            "point": point,
            "source": "" if orientation is None else orientation.source,
            "images": [{"name": name, **seen.get(name, {})} for name in ranked],
        }

    def _rank(self, name: str, seen: dict[str, Any] | None) -> tuple[float, float, str]:
        """The surest first, of equally sure ones those nearer to their middle; unknown ones in between."""
        if seen is None:
            return (-0.01, 0.0, name)
        if seen["x"] is None:
            return (0.0, math.inf, name)
        width, height = self._scene.pictures[name].size_px
        aside = max(abs(2 * seen["x"] / width - 1), abs(2 * seen["y"] / height - 1))
        return (-round(seen["probability"], 2), aside, name)

    def mark(self, body: bytes) -> dict[str, Any]:
        """Set a mark, on the centre of the target there if one is wanted and found."""
        click = checked(_Click, body)
        path = self._picture(click.image).path
        width, height = self._scene.pictures[click.image].size_px
        if not (-0.5 <= click.x <= width - 0.5 and -0.5 <= click.y <= height - 0.5):
            raise ConfigurationError("the place is outside of the image", "mark inside", where=click.image)
        if self._scene.listed and click.point not in self._scene.points.names:
            raise ConfigurationError(
                f"point {click.point} is not in the table of points", "choose a point of the list"
            )
        place = (click.x, click.y)
        snapped, kind = None, None
        if click.kinds:
            facts = path.stat()
            grey = _grey(path, facts.st_mtime_ns, facts.st_size)
            bend = self._bend(click.image, place)
            snapped = snap(grey, place, click.reach, click.kinds, self._scene.dictionaries, bend)
        sigma = (BY_HAND_PX, BY_HAND_PX)
        if snapped is not None:
            kind, centre = snapped
            place, sigma = (centre.column, centre.row), centre.sigma
        # Decimals in marks.csv: what is shown is what is written.
        decimals = 4
        x, y, *sigmas = (round(value, decimals) for value in (*place, *sigma))
        self.store.put(Mark(click.image, click.point, x, y, (sigmas[0], sigmas[1]), ""))
        return self.state() | {"snapped": kind}

    @property
    def _orientation(self) -> Orientation | None:
        return self._scene.orientation if self._adjusted is None else self._adjusted.orientation

    def _bend(self, image: str, place: tuple[float, float]) -> Floats:
        """How level ground is bent there; not at all where nothing is known of the image."""
        orientation = self._orientation
        if orientation is None or image not in orientation.images.names:
            return FLAT
        k = orientation.images.names.index(image)
        values = orientation.images.values[k : k + 1]
        if not np.isfinite(values).all():
            return FLAT
        rotation = orientation.images.in_local(orientation.to_local(values[:, 3:])).rotation[k]
        camera = orientation.images.cameras[orientation.images.camera[k]]
        return ground_bend(camera, rotation, np.array(place))

    def remove(self, body: bytes) -> dict[str, Any]:
        """Take a mark away."""
        place = checked(_Place, body)
        self.store.remove((place.image, place.point))
        return self.state()

    def undo(self) -> dict[str, Any]:
        """Take the last change back."""
        return self._where(self.store.undo())

    def redo(self) -> dict[str, Any]:
        """Make the change again that was taken back."""
        return self._where(self.store.redo())

    def _where(self, key: tuple[str, str] | None) -> dict[str, Any]:
        return self.state() | {"at": None if key is None else {"image": key[0], "point": key[1]}}

    def adjust(self) -> dict[str, Any]:
        """Adjust all marks in a process of its own, so that the page goes on."""
        scene, marks = self._scene, self.store.marks
        if scene.orientation is None:
            raise ConfigurationError(
                "the camera is not known", "open a project with [[camera]], or give --run"
            )
        with own_processes(1) as pool:
            adjusted = pool.submit(adjust_marks, scene.orientation, scene.points, marks).result()
        self._adjusted, self._adjusted_marks = adjusted, {(m.image, m.point): (m.x, m.y) for m in marks}
        return self.state() | {"left_out": list(adjusted.left_out)}

    def _picture(self, name: str) -> Picture:
        picture = self._scene.pictures.get(name)
        missing = InputNotFoundError.at(name)
        if picture is None:
            raise missing("is not an image of this project", "choose one of the list")
        if picture.reason:
            raise missing(picture.reason, "choose another image")
        return picture


@lru_cache(maxsize=2)
def _grey(path: Path, _changed: int, _size: int) -> Grey:
    return measurable(read_grey(path))
