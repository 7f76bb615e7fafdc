"""Control and its marks of a Pix4D project file (.p4d), which holds what a person gave to the program.

`inputs/gcps` has a `GCP` for each point: `id`, `label`, `type` ("3DGCP" is control), `x`, `y`, `z` in the
system of `inputs/coordinateSystems/gcp`, and `lat`, `lng`, `alt` where that system is geographic. Below
each `image` of `inputs/images` an `imageGCP` has the `id` of a point and its mark, `x` and `y` in px from the
upper-left corner of the image. Sources: the makers' page on the minimum format, a project of version 4.6
without points, and two published scripts that count points and marks. They show all of this but the
attributes `x` and `y` of a mark, their origin, which is that of the program's tables of marks, and types of
points other than "3DGCP": these were written without a real project at hand.
"""

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from xml.etree.ElementTree import Element

import numpy as np

from photocal.base.errors import InputMalformedError
from photocal.block.model import Role
from photocal.exchange.parts import Mark, PointEntry
from photocal.exchange.source import number, read_xml
from photocal.geometry.frames import system_of

SUFFIX = ".p4d"
# Systems of heights by the names of their geoids, EPSG codes.
_LEVELS = {"egm96": "5773", "egm2008": "3855", "egm08": "3855"}


@dataclass(frozen=True)
class Pix4DInputs:
    """What a person gave to the program.

    points: surveyed ones, whose sigmas are 0 where a coordinate was surveyed, else infinite.
    marks: of all points, those that were never surveyed among them; px of the stored grid.
    crs: WKT of their system, "local" for one of the site, empty where the file names none.
    geoid: the one that heights refer to, by its name; empty where the file names none.
    level: EPSG code of that system of heights, where it is known.
    """

    points: tuple[PointEntry, ...]
    marks: tuple[Mark, ...]
    crs: str
    geoid: str
    level: str


def read_inputs(path: Path, mark_sigma: tuple[float, float]) -> Pix4DInputs:
    """Read the points and marks of a project file.

    raises InputMalformedError: when it is none of Pix4D, or a point or mark lacks what it should have.
    """
    root = read_xml(path)
    if root.tag != "pix4dmapper":
        raise InputMalformedError("is not a project of Pix4D", "is it the right file?", where=path)
    crs = (root.findtext("inputs/coordinateSystems/gcp/WKT") or "").strip()
    crs = "local" if crs.startswith(("LOCAL_CS", "ENGCRS", "LOCAL_DATUM")) else crs
    axes = ("lng", "lat", "alt") if _is_geographic(crs) else ("x", "y", "z")
    names, points = dict[str, str](), list[PointEntry]()
    for given in root.iterfind("inputs/gcps/GCP"):
        name = given.get("label") or given.get("id") or ""
        if not name or name in names.values():
            raise InputMalformedError(f"has two points {name!r}", "rename one of them in Pix4D", where=path)
        names[given.get("id") or name] = name
        if (point := _surveyed(given, name, axes, path)) is not None:
            points.append(point)
    marks = [
        Mark(PureWindowsPath(image.get("path") or "").name, names[of], *_place(seen, path), mark_sigma, path)
        for image in root.iterfind("inputs/images/image")
        for seen in image.iterfind("imageGCP")
        if (of := seen.get("id") or "") in names
    ]
    vertical = root.find("inputs/coordinateSystems/gcp/verticalDef")
    above = vertical is not None and vertical.get("model") == "geoid"
    geoid = (vertical.get("geoidName") or "geoid") if vertical is not None and above else ""
    plain = geoid.casefold().replace(" ", "").removesuffix("geoid")
    return Pix4DInputs(tuple(points), tuple(marks), crs, geoid, _LEVELS.get(plain, ""))


def _is_geographic(crs: str) -> bool:
    from pyproj.exceptions import CRSError

    try:
        return crs not in ("", "local") and bool(system_of(crs).is_geographic)
    except CRSError:
        return False


def _surveyed(given: Element, name: str, axes: tuple[str, str, str], path: Path) -> PointEntry | None:
    """A surveyed point; None for a manual tie point."""
    kind = (given.get("type") or "").casefold().replace(" ", "")
    check = "check" in kind
    if not (check or kind.endswith("gcp")):
        return None
    role: Role = "check" if check else "control"
    # What a point of the plane, or of height alone, has beside it was not surveyed.
    known = {"2": (True, True, False), "1": (False, False, True)}.get(kind[:1], (True, True, True))
    xyz = [
        number(given.get(axis) or "", path, f"{axis} of {name}") if surveyed else np.nan
        for axis, surveyed in zip(axes, known, strict=True)
    ]
    return PointEntry(name, role, xyz, [0.0 if surveyed else np.inf for surveyed in known])


def _place(seen: Element, path: Path) -> tuple[float, float]:
    """A mark in px of the stored grid."""
    x, y = (number(seen.get(axis) or "", path, f"{axis} of an imageGCP") - 0.5 for axis in "xy")
    return x, y
