"""Projects of PhotoScan (.psz) and Metashape (.psx): cameras, markers and tie points into a block.

A zip archive with doc.xml (see `metashape`, whose conventions hold) and PLY tables, or for .psx a folder of
such archives, one each for project, chunk, frame and tie points: projections of each image
(x, y in px from the upper-left corner of the upper-left pixel, track) and points (chunk coordinates, track).
Standard deviations come from the project's settings: `accuracy_projections` for markers, `accuracy_tiepoints`
for tie points (px), `accuracy_markers` for markers without their own (m). Nothing is unpacked to disk.
"""

import struct
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block, Images
from photocal.exchange import parts
from photocal.exchange.metashape import Chunk, chunk_of, chunk_transform, image_names, local_chunk
from photocal.exchange.source import MAX_XML_BYTES, child, fingerprint, number, parse_xml, require_readable

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
# What a damaged, encrypted or exotic archive makes the reader raise.
_ARCHIVE_FAILURES = (
    zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    UnicodeDecodeError,
)  # fmt: skip


def read_photoscan(path: Path) -> Block:
    """Read a project with one chunk."""
    return read_project(path)[0]


def read_project(path: Path) -> tuple[Block, Chunk]:
    """Read a project with one chunk: its block, and the chunk with the positions of its images."""
    require_readable(path)
    try:
        if path.suffix.lower() == ".psx":
            return _of_parts(path)
        with zipfile.ZipFile(path) as archive:
            return _block(archive, parse_xml(_member(archive, "doc.xml", path, MAX_XML_BYTES), path), path)
    except _ARCHIVE_FAILURES as failure:
        raise InputMalformedError(
            f"is no readable archive ({failure})", "was it written completely?", where=path
        ) from failure


def _of_parts(path: Path) -> tuple[Block, Chunk]:
    """Put the archives of a project together: each names those below it by `path`."""
    folder = path.with_suffix(".files")

    def part(place: Path) -> Element:
        require_readable(place)
        with zipfile.ZipFile(place) as archive:
            return parse_xml(_member(archive, "doc.xml", place, MAX_XML_BYTES), place)

    def below(place: Path, element: Element | None) -> Path:
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
        return _block(archive, root, path)


def _block(archive: zipfile.ZipFile, root: Element, path: Path) -> tuple[Block, Chunk]:
    given_chunk = chunk_of(root, path)
    chunk = local_chunk(given_chunk)
    element = child(root, "chunks/chunk", path)
    settings = {
        key.get("name", ""): number(key.get("value", ""), path, key.get("name", ""))
        for key in element.iterfind("settings/property")
        if key.get("name", "").startswith("accuracy_") and len(key.get("value", "").split()) == 1
    }
    given = chunk.reconstruction
    entries = [_marker(marker, settings, path) for marker in chunk.markers]
    sigma = _setting(settings, "accuracy_projections", path)
    marks = [
        parts.Mark(given.image_names[i], given.point_names[j], x, y, (sigma, sigma), path)
        for i, j, (x, y) in zip(given.image, given.point, given.pixels.tolist(), strict=True)
    ]
    ties, tie_marks = _tie_points(
        archive, element, given_chunk, _setting(settings, "accuracy_tiepoints", path), path
    )
    shots = Images(given.image_names, given.image_camera, given.poses, exposure=given.exposure)
    block = parts.block(
        path.stem, given.cameras, shots, [*entries, *ties], [*marks, *tie_marks], [fingerprint(path)]
    )
    common = settings.get("accuracy_cameras", np.nan)
    sigma_m = np.where(np.isnan(chunk.position_sigma), common, chunk.position_sigma)
    return replace(block, heads=given.heads), replace(chunk, position_sigma=sigma_m)


def _marker(marker: parts.PointEntry, settings: dict[str, float], path: Path) -> parts.PointEntry:
    if marker.role != "control":
        return parts.PointEntry(marker.name, marker.role, marker.xyz)
    sigma = np.array(marker.sigma)
    common = _setting(settings, "accuracy_markers", path) if np.isnan(sigma).any() else 0.0
    return parts.PointEntry(marker.name, "control", marker.xyz, np.where(np.isnan(sigma), common, sigma))


def _setting(settings: dict[str, float], key: str, path: Path) -> float:
    if not settings.get(key, 0.0) > 0:
        raise InputMalformedError(f"has no positive setting {key}", "set it and save again", where=path)
    return settings[key]


def _tie_points(
    archive: zipfile.ZipFile, element: Element, chunk: Chunk, sigma: float, path: Path
) -> tuple[list[parts.PointEntry], list[parts.Mark]]:
    cloud = element.find("frames/frame/point_cloud")
    if cloud is None:
        return [], []
    points = _ply(archive, child(cloud, "points", path).get("path", ""), ("x", "y", "z", "id"), path)
    to_world = chunk_transform(element, path)
    xyz = np.column_stack([points[axis] for axis in "xyz"]).astype(float)
    # Geocentric ones are left to their rays.
    xyz = np.full_like(xyz, np.nan) if chunk.crs else xyz @ to_world[:3, :3].T + to_world[:3, 3]
    # Markers have numbers for names too.
    names = {int(key): f"tie{key}" for key in points["id"]}
    entries = [
        parts.PointEntry(names[int(key)], "tie", row) for key, row in zip(points["id"], xyz, strict=True)
    ]
    labels = image_names(element)
    oriented = set(chunk.reconstruction.image_names)
    marks = []
    for projections in cloud.iterfind("projections"):
        image = labels.get(projections.get("camera_id", ""), "")
        rows = _ply(archive, projections.get("path", ""), ("x", "y", "id"), path)
        if image in oriented:
            marks += [
                parts.Mark(image, names[key], x - 0.5, y - 0.5, (sigma, sigma), path)
                for x, y, key in zip(rows["x"].tolist(), rows["y"].tolist(), rows["id"].tolist(), strict=True)
                if key in names
            ]
    return entries, marks


def _member(archive: zipfile.ZipFile, name: str, path: Path, most: int) -> bytes:
    """Content of a member, never more than `most` bytes whatever its header says."""
    try:
        # Other compressions may ask for dictionaries of any size.
        if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputMalformedError(f"its {name!r} is compressed in a strange way", where=path)
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
        raise malformed(f"its {name!r} is no binary PLY table")
    words = [line.split() for line in lines]
    count = [row[2] for row in words if row[:2] == ["element", "vertex"] and len(row) == 3]
    fields = [(row[2], _TYPES.get(row[1], "")) for row in words if row[:1] == ["property"] and len(row) == 3]
    known = all(kind for _, kind in fields) and len(dict(fields)) == len(fields)
    if len(count) != 1 or not count[0].isdecimal() or not known or not set(wanted) <= set(dict(fields)):
        raise malformed(f"its {name!r} has not the columns {', '.join(wanted)}")
    layout = np.dtype(fields)
    if int(count[0]) * layout.itemsize > len(body):
        raise malformed(f"its {name!r} claims more rows than it has", "is it cut?")
    rows = np.frombuffer(body, layout, int(count[0]))
    if not all(np.isfinite(rows[column]).all() for column in wanted):
        raise malformed(f"its {name!r} has a number that is not finite")
    return rows
