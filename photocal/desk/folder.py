"""Answers to the step Folder: what lies there, what is asked, and the project file as a form."""

import json
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, FiniteFloat
from starlette.routing import BaseRoute

from photocal.base.arrays import Floats
from photocal.base.checked_toml import read_tables
from photocal.base.codec import kept_json
from photocal.base.errors import PhotocalError
from photocal.base.files import write_file
from photocal.base.web import calling, doing, finding, telling
from photocal.block.folder import read_points
from photocal.block.model import NO_POINTS, ROLES
from photocal.block.project import ASKED, NAME
from photocal.desk import project_file
from photocal.desk.jobs import FOLDER, asked
from photocal.desk.session import Desk
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import SUFFIXES, list_images
from photocal.run.stage import MEMORY

# What `photocal new` has said, kept for a window that is opened again.
_SAID = "new.json"
_MOST_FOLDERS, _MOST_FILES = 300, 20_000
_LOGS = (".mcap", ".tlog", ".bin", ".ulg", ".ubx")
Short = Annotated[str, Field(max_length=300)]


def routes(desk: Desk) -> list[BaseRoute]:
    """Return what answers for the step Folder."""
    return [
        finding("/api/folders", lambda given: folders(desk, given.get("path", ""))),
        doing("/api/open", calling(_open, desk)),
        telling("/api/project", lambda: project(desk)),
        doing("/api/new", calling(_new, desk)),
        finding("/api/systems", lambda given: systems(desk, given.get("text", ""))),
        telling("/api/places", lambda: places(desk)),
        telling("/api/heights", lambda: heights(desk)),
        doing("/api/set", calling(_set, desk)),
        doing("/api/role", calling(_role, desk)),
    ]


def folders(desk: Desk, path: str) -> dict[str, Any]:
    """A folder beneath the root and those in it, each with what it holds at first sight."""
    here = desk.inside(path)
    inner = sorted(entry for entry in here.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    # A link may lead out: what it leads to is not shown.
    inside = [entry for entry in inner if entry.resolve().is_relative_to(desk.root)]
    # What a run has made is nobody's flight.
    inside = [entry for entry in inside if not (entry / MEMORY).exists()]
    up = None if here == desk.root else desk.named(here.parent)
    return {
        "path": desk.named(here),
        "up": up,
        "here": _holds(desk, here),
        "folders": [_holds(desk, entry) for entry in inside[:_MOST_FOLDERS]],
        "more": max(0, len(inside) - _MOST_FOLDERS),
    }


def _holds(desk: Desk, folder: Path) -> dict[str, Any]:
    pictures = logs = 0
    try:
        for k, entry in enumerate(folder.iterdir()):
            suffix = entry.suffix.lower()
            pictures, logs = pictures + (suffix in SUFFIXES), logs + (suffix in _LOGS)
            if k > _MOST_FILES:
                break
    except OSError:
        pictures = 0
    project_there = (folder / NAME).is_file()
    counted = {"pictures": pictures, "logs": logs, "project": project_there}
    return {"name": folder.name, "path": desk.named(folder), **counted}


def _open(desk: Desk, path: Annotated[str, Field(max_length=4000)]) -> dict[str, Any]:
    desk.open(path)
    return desk.shown()


def project(desk: Desk) -> dict[str, Any]:
    """What is known of the folder that is open: its project file as a form, and what `new` has said."""
    form = project_file.shown(desk.file, desk.language) if desk.file.is_file() else None
    told = said(desk)
    # What marks may mean is seen in the pictures, in any language.
    seen = {key: (told or {}).get(key) for key in ("frames", "marks")}
    holds, line = _holds(desk, desk.folder), desk.line(["new", desk.folder])
    return {"holds": holds, "form": form, "said": desk.in_its_language(told), "line": line, **seen}


def said(desk: Desk) -> dict[str, Any] | None:
    """What `photocal new` has said last."""
    return kept_json(desk.folder / FOLDER / _SAID) or None


def places(desk: Desk) -> dict[str, Any]:
    """Control points, and the places that pictures state, for the small map; as far as they can be read."""
    facts, control, crs = pictures(desk), NO_POINTS, ""
    try:
        tables = read_tables(desk.file)
        crs = str(tables["project"]["crs"])
        control = read_points(desk.folder / str(tables["control"]["points"]))
    except (PhotocalError, OSError, LookupError, TypeError):
        control = NO_POINTS
    rows = zip(control.names, control.values.tolist(), control.role.tolist(), strict=True)
    points = [*rows][: project_file.MOST_POINTS]
    values = np.array([value for _, value, _ in points]).reshape(-1, 3)
    degrees = _local_degrees(values) if crs == "local" else _in_degrees(crs, values)
    # Points of a local system cannot be shown on one map with the places of pictures.
    placed = [one for one in facts if one.has_position and (crs != "local" or not points)]
    return {
        "points": [
            {"name": name, "role": ROLES[role], "xyz": value, "place_deg": place}
            for (name, value, role), place in zip(points, degrees, strict=True)
        ],
        "pictures": [
            {"name": one.name, "place_deg": [one.longitude_deg, one.latitude_deg]} for one in placed
        ],
    }


def pictures(desk: Desk) -> tuple[ImageFacts, ...]:
    """What the pictures of the project say of themselves; none where its folder is not known."""
    try:
        folder = desk.folder / str(read_tables(desk.file)["images"]["folder"])
        listed = list_images(folder)
        return _facts(tuple((path, path.stat().st_mtime_ns) for path in listed))
    except (PhotocalError, OSError, LookupError, TypeError):
        return ()


@lru_cache(maxsize=2)
def _facts(paths: tuple[tuple[Path, int], ...]) -> tuple[ImageFacts, ...]:
    read = []
    for path, _ in paths:
        with suppress(PhotocalError):
            read.append(read_facts(path))
    return tuple(read)


def _in_degrees(crs: str, places: Floats) -> list[list[float] | None]:
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        way = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except ProjError:
        return [None] * len(places)
    moved = np.column_stack(way.transform(places[:, 0], places[:, 1]))
    return [place if np.isfinite(place).all() else None for place in moved.tolist()]


def _local_degrees(places: Floats) -> list[list[float] | None]:
    """Local coordinates on a map of their own: metres about the place where a degree is as long each way."""
    degree_m = np.pi / 180 * 6378137.0
    moved = (places[:, :2] - places[:1, :2]) / degree_m
    return [*moved.tolist()]


def _new(desk: Desk, crs: Short = "", height: Short = "", marks: Short = "") -> dict[str, Any]:
    arguments: list[str | Path] = ["new", desk.folder]
    (known_crs, known_height), before = _answered(desk), said(desk) or {}
    # What a person has chosen of the marks stays chosen.
    marks = marks or before.get("marks", "")
    stated = {"--crs": crs or known_crs, "--height": height or known_height, "--marks": marks}
    arguments += [word for name, value in stated.items() if value for word in (name, value)]
    arguments += ["--again"] if desk.file.is_file() else []
    arguments += ["--lang", desk.language] if desk.language != "en" else []
    with desk.lock:
        answer = asked(arguments)
        (desk.folder / FOLDER).mkdir(exist_ok=True)
        frames = before.get("frames", []) if marks else answer["frames"]
        told = {"marks": marks, "line": desk.line(arguments), "language": desk.language}
        write_file(desk.folder / FOLDER / _SAID, json.dumps({**answer, "frames": frames, **told}))
    return project(desk)


def _answered(desk: Desk) -> tuple[str, str]:
    """What was asked before and stands in the project by now: system and kind of heights."""
    try:
        given = read_tables(desk.file)["project"]
    except (PhotocalError, LookupError, TypeError):
        return "", ""
    asked_before = [text.partition(":")[0] for text in (said(desk) or {}).get("asked", [])]
    crs, height = (
        str(given.get(key, "")) if key in asked_before and given.get(key) != ASKED else ""
        for key in ("crs", "height")
    )
    return crs, height


def systems(desk: Desk, text: str) -> dict[str, Any]:
    """Map systems that a text may mean, and those of the place where the pictures are."""
    from photocal.geometry.systems import called

    # A longer list helps nobody to choose.
    most_systems = 8
    found = called(text, None, most_systems) if text.strip() else ()
    exact = _by_code(text)
    listed = [{"code": one.code, "name": one.name, "area": one.area} for one in found]
    listed = [*exact, *(one for one in listed if one["code"] not in {entry["code"] for entry in exact})]
    return {"text": text, "found": bool(listed), "systems": listed or [*_here(desk)]}


def _by_code(text: str) -> list[dict[str, str]]:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    code = f"EPSG:{text.strip()}" if text.strip().isdecimal() else text.strip()
    if ":" not in code:
        return []
    try:
        system = CRS.from_user_input(code)
    except CRSError:
        return []
    area = system.area_of_use
    return [{"code": code.upper(), "name": system.name, "area": "" if area is None else area.name}]


def _here(desk: Desk) -> Iterator[dict[str, str]]:
    """The zone of the pictures, as long as nothing was typed."""
    from photocal.run.new_control import zone_of

    placed = [one for one in pictures(desk) if one.has_position]
    if placed:
        yield from _by_code(zone_of(placed))


def heights(desk: Desk) -> list[dict[str, str]]:
    """Systems of heights of the place of the pictures."""
    from photocal.geometry.systems import heights_at
    from photocal.run.project_checks import middle_of

    placed = [one for one in pictures(desk) if one.has_position]
    known = heights_at(*middle_of(placed)) if placed else ()
    return [{"code": code, "name": name} for code, name in known]


def _set(
    desk: Desk,
    key: Short,
    value: Short | Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)] | None,
) -> dict[str, Any]:
    with desk.lock:
        project_file.put(desk.file, key, value)
    return project(desk)


def _role(desk: Desk, point: Short, role: Short) -> dict[str, Any]:
    with desk.lock:
        points = read_tables(desk.file).get("control", {}).get("points", "")
        project_file.put_role(desk.inside(desk.named(desk.folder / str(points))), point, role)
    return places(desk)
