"""Projects of PhotoScan (.psz) and Metashape (.psx): cameras, markers and tie points into a block.

A zip archive with doc.xml (see `metashape`, whose conventions hold) and PLY tables, or for .psx a folder of
such archives, one each for project, chunk, frame and tie points: projections of each image
(x, y in px from the upper-left corner of the upper-left pixel, track) and points (chunk coordinates, track).
Standard deviations come from the project's settings: `accuracy_projections` for markers, `accuracy_tiepoints`
for tie points (px), `accuracy_markers` for markers without their own (m). Nothing is unpacked to disk.
"""

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from photocal.base.archives import DAMAGES
from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, ObjectPoints, Observations
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.metashape import (
    chunk_of,
    chunk_transform,
    image_names,
    local_chunk,
    with_stated_positions,
)
from photocal.exchange.parts import block, pixels, require_seen_once, require_unique
from photocal.exchange.source import MAX_XML_BYTES, child, number, parse_xml, require_readable

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
}
_MAX_MEMBER = 256 << 20


def read(path: Path) -> ForeignProject:
    """Read a project with one chunk."""
    require_readable(path)
    try:
        if path.suffix.lower() == ".psx":
            return _of_parts(path)
        with zipfile.ZipFile(path) as archive:
            root = parse_xml(_member(archive, "doc.xml", path, MAX_XML_BYTES), path)
            return replace(_project(archive, root, path), program="PhotoScan")
    except DAMAGES as failure:
        raise InputMalformedError(
            f"is not a readable archive ({failure})", "was it written completely?", where=path
        ) from failure


def _of_parts(path: Path) -> ForeignProject:
    """Put the archives of a project together: each names those below it by `path`."""
    folder = path.with_suffix(".files")

    def part(place: Path) -> Element:
        """Read the document inside an archive."""
        require_readable(place)
        with zipfile.ZipFile(place) as archive:
            return parse_xml(_member(archive, "doc.xml", place, MAX_XML_BYTES), place)

    def below(place: Path, element: Element | None) -> Path:
        """Give the path that an element names, inside the project's folder alone."""
        name = "" if element is None else element.get("path", "")
        inside = (place.parent / name).resolve()
        if not name or folder.resolve() not in inside.parents:
            raise InputMalformedError("does not name its parts", "is it a project?", where=place)
        return inside

    root = part(folder / "project.zip")
    chunks = child(root, "chunks", path)
    for listed in list(chunks):
        place = below(folder / "project.zip", listed)
        chunk = part(place)
        frames = child(chunk, "frames", place)
        at = below(place, frames.find("frame"))
        frame = part(at)
        frames[:] = [frame]
        chunks.remove(listed)
        chunks.append(chunk)
        cloud = frame.find("point_cloud")
        if cloud is None:
            raise InputMalformedError("has no tie points", "align the photos, and save", where=path)
        points = below(at, cloud)
        frame.remove(cloud)
        frame.append(part(points))
    with zipfile.ZipFile(points) as archive:
        return _project(archive, root, path)


def _project(archive: zipfile.ZipFile, root: Element, path: Path) -> ForeignProject:
    given_chunk = chunk_of(root, path)
    chunk = local_chunk(given_chunk)
    element = child(root, "chunks/chunk", path)
    settings = {
        key.get("name", ""): number(key.get("value", ""), path, key.get("name", ""))
        for key in element.iterfind("settings/property")
        if key.get("name", "").startswith("accuracy_") and len(key.get("value", "").split()) == 1
    }
    given, sigma = chunk.block, _setting(settings, "accuracy_projections", path)
    marks = given.observations
    seen = pixels(marks.image, marks.point, marks.values, sigma)
    points = _with_sigmas(given.points, settings, path)
    # Geocentric ones are left to their rays.
    to_world = chunk_transform(element, path) if given_chunk.block.frame == "local" else None
    ties, rays = _ties(archive, element, given.images.names, to_world, path)
    rays = pixels(
        rays.image,
        rays.point + len(points.names),
        rays.values,
        _setting(settings, "accuracy_tiepoints", path),
    )
    points = points.with_ties(ties.names, ties.values)
    seen = seen.plus(rays.image, rays.point, rays.values, rays.sigma)
    require_unique(points.names, "point", path)
    require_seen_once(seen, given.images.names, points.names, path)
    made = block(path.stem, given.cameras, given.images, points, seen, [path])
    common = settings.get("accuracy_cameras", np.nan)
    sigma_m = np.where(np.isnan(chunk.position_sigma), common, chunk.position_sigma)
    whole = replace(chunk, block=replace(made, heads=given.heads), position_sigma=sigma_m, weighted=True)
    return with_stated_positions(whole)


def _with_sigmas(markers: ObjectPoints, settings: dict[str, float], path: Path) -> ObjectPoints:
    """Markers with the sigmas of the settings where they have none of their own; check points without."""
    control = markers.of_role("control")[:, None]
    bare = control & np.isnan(markers.sigma)
    common = _setting(settings, "accuracy_markers", path) if bare.any() else 0.0
    return replace(markers, sigma=np.where(control, np.where(bare, common, markers.sigma), np.inf))


def _setting(settings: dict[str, float], key: str, path: Path) -> float:
    if not settings.get(key, 0.0) > 0:
        raise InputMalformedError(f"has no positive setting {key}", "set it and save again", where=path)
    return settings[key]


def _ties(
    archive: zipfile.ZipFile, element: Element, images: Sequence[str], to_world: Floats | None, path: Path
) -> tuple[ObjectPoints, Observations]:
    """Tie points, at their places where the way to the world is given, and their rays in oriented images."""
    cloud = element.find("frames/frame/point_cloud")
    if cloud is None:
        return NO_POINTS, NO_OBSERVATIONS
    rows = _ply(archive, child(cloud, "points", path).get("path", ""), ("x", "y", "z", "id"), path)
    xyz = np.column_stack([rows[axis] for axis in "xyz"]).astype(float)
    xyz = np.full_like(xyz, np.nan) if to_world is None else xyz @ to_world[:3, :3].T + to_world[:3, 3]
    # Markers have numbers for names too.
    ties = ObjectPoints(tuple(f"tie{key}" for key in rows["id"].tolist()), xyz)
    order, labels, seen = np.argsort(rows["id"], kind="stable"), image_names(element), NO_OBSERVATIONS
    for projections in cloud.iterfind("projections"):
        label = labels.get(projections.get("camera_id", ""), "")
        marks = _ply(archive, projections.get("path", ""), ("x", "y", "id"), path)
        if label in images and len(rows):
            place = np.searchsorted(rows["id"], marks["id"], sorter=order)
            point = order[np.minimum(place, len(rows) - 1)]
            known = rows["id"][point] == marks["id"]
            xy = np.column_stack([marks["x"], marks["y"]]).astype(float)[known] - 0.5
            image = np.full(len(xy), images.index(label))
            seen = seen.plus(image, point[known], xy, np.ones_like(xy))
    return ties, seen


def _member(archive: zipfile.ZipFile, name: str, path: Path, most: int) -> bytes:
    """Content of a member, never more than `most` bytes whatever its header says."""
    try:
        # Other compressions may ask for dictionaries of any size.
        if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputMalformedError(f"its {name!r} is compressed by an unknown method", where=path)
        with archive.open(name) as member:
            content = member.read(most + 1)
    except KeyError as failure:
        raise InputMalformedError(f"has no {name!r}", "is it a project?", where=path) from failure
    if len(content) > most:
        raise InputMalformedError(f"its {name!r} is larger than {most >> 20} MiB", where=path)
    return content


def _ply(archive: zipfile.ZipFile, name: str, wanted: tuple[str, ...], path: Path) -> NDArray[Any]:
    """Vertices of a binary PLY table."""
    head, separator, body = _member(archive, name, path, _MAX_MEMBER).partition(b"end_header\n")
    lines = head.decode("ascii", errors="replace").split("\n")
    malformed = InputMalformedError.at(path)
    if not separator or lines[0] != "ply" or "format binary_little_endian 1.0" not in lines:
        raise malformed(f"its {name!r} is not a binary PLY table")
    words = [line.split() for line in lines]
    count = [row[2] for row in words if row[:2] == ["element", "vertex"] and len(row) == 3]
    fields = [(row[2], _TYPES.get(row[1], "")) for row in words if row[:1] == ["property"] and len(row) == 3]
    known = all(kind for _, kind in fields) and len(dict(fields)) == len(fields)
    if len(count) != 1 or not count[0].isdecimal() or not known or not set(wanted) <= set(dict(fields)):
        raise malformed(f"its {name!r} does not have the columns {', '.join(wanted)}")
    layout = np.dtype(fields)
    if int(count[0]) * layout.itemsize > len(body):
        raise malformed(f"its {name!r} states more rows than it has", "is it truncated?")
    rows = np.frombuffer(body, layout, int(count[0]))
    if not all(np.isfinite(rows[column]).all() for column in wanted):
        raise malformed(f"its {name!r} has a number that is not finite")
    return rows
