"""Control points with their marks, as other programs write them in one file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from drivers.errors import ConfigurationError, InputMalformedError
from photocal.block.model import ObjectPoints
from photocal.exchange.ground_points import read_gcp_list
from photocal.exchange.parts import Mark, PointEntry, object_points
from photocal.exchange.source import number, read_xml, require_readable
from photocal.measurement.marks import BY_HAND_PX

Sizes = Mapping[str, tuple[int, int]]
Sigma = tuple[float, float]


@dataclass(frozen=True)
class ControlMarks:
    """Control points and where images show them.

    crs: of the coordinates; "local" without one. Geographic ones are longitude, latitude (deg), height.
    marks: px of the stored pixel grid.
    without_coordinates: points that have marks but no coordinates: they are left out.
    """

    crs: str
    points: ObjectPoints
    marks: tuple[Mark, ...]
    without_coordinates: tuple[str, ...] = ()


def read_control_marks(path: Path, sigma_m: Sigma, sizes: Sizes) -> ControlMarks:
    """Read ODM's gcp_list.txt, Metashape's XML of markers, or OpenSfM's ground_control_points.json."""
    kind = path.suffix.lower()
    if kind == ".xml":
        return _metashape(path, sigma_m)
    if kind == ".json":
        return _opensfm(path, sigma_m, sizes)
    return _gcp_list(path, sigma_m)


def in_map_system(given: ControlMarks) -> ControlMarks:
    """Take geographic coordinates to the UTM zone of their middle; others stay as they are.

    Heights stay as they are.
    """
    from pyproj import CRS, Transformer
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_utm_crs_info
    from pyproj.exceptions import CRSError

    if given.crs == "local":
        return given
    try:
        system = CRS.from_user_input(given.crs)
    except CRSError as refusal:
        raise ConfigurationError(
            f"system {given.crs!r} of the control points is not known", remedy="write it as EPSG:32722"
        ) from refusal
    if not system.is_geographic:
        authority = system.to_authority()
        return replace(given, crs=":".join(authority) if authority else given.crs)
    longitude, latitude = given.points.values[:, :2].mean(axis=0).tolist()
    if not (abs(latitude) <= 84 and abs(longitude) <= 180):
        raise ConfigurationError(
            f"control at longitude {longitude:.6f}, latitude {latitude:.6f} is impossible",
            remedy="are latitude and longitude exchanged?",
        )
    area = AreaOfInterest(longitude, latitude, longitude, latitude)
    zone = query_utm_crs_info("WGS 84", area)[0]
    name = f"{zone.auth_name}:{zone.code}"
    east, north = Transformer.from_crs(system.to_2d(), name, always_xy=True).transform(
        given.points.values[:, 0], given.points.values[:, 1], errcheck=True
    )
    values = np.column_stack([east, north, given.points.values[:, 2]])
    return replace(given, crs=name, points=replace(given.points, values=values))


def _gcp_list(path: Path, sigma_m: Sigma) -> ControlMarks:
    crs, rows = read_gcp_list(path)
    places = {row.point: row.xyz for row in rows}
    sigma = (sigma_m[0], sigma_m[0], sigma_m[1])
    marks = tuple(
        Mark(row.image, row.point, row.column, row.row, (BY_HAND_PX, BY_HAND_PX), row.place) for row in rows
    )
    entries = [PointEntry(name, "control", xyz, sigma) for name, xyz in places.items()]
    return ControlMarks(crs, object_points(entries), marks)


def metashape_marks(path: Path) -> tuple[Mark, ...]:
    """Read the pinned projections of Metashape's markers, of all of them."""
    return _marks(_chunk(path), path)


def _chunk(path: Path) -> Element:
    chunks = list(read_xml(path).iter("chunk"))
    if not chunks:
        raise InputMalformedError(
            "is no XML of Metashape's markers, the only one that is read",
            where=path,
            remedy="from Pix4D export the marks as text (*.txt or *.csv: image, point, x, y)",
        )
    if len(chunks) != 1:
        raise InputMalformedError(
            f"has {len(chunks)} chunks where one was expected",
            where=path,
            remedy="export the markers of one chunk as XML",
        )
    return chunks[0]


def _marks(chunk: Element, path: Path) -> tuple[Mark, ...]:
    """Pinned projections; the upper-left pixel's centre is (0.5, 0.5) there."""
    images = {own.get("id", ""): own.get("label", "") for own in chunk.iterfind("cameras//camera")}
    names = {own.get("id", ""): own.get("label", "") for own in chunk.iterfind("markers//marker")}
    return tuple(
        mark
        for own in chunk.iterfind("frames/frame/markers/marker")
        for mark in _locations(own, names, images, path)
    )


def _metashape(path: Path, sigma_m: Sigma) -> ControlMarks:
    chunk = _chunk(path)
    entries, bare = [], []
    for own in chunk.iterfind("markers//marker"):
        name = own.get("label", "")
        reference = own.find("reference")
        if reference is None or reference.get("x") is None:
            bare.append(name)
        else:
            entries.append(_marker(name, reference, sigma_m, path))
    known = {entry.name for entry in entries}
    marks = tuple(mark for mark in _marks(chunk, path) if mark.point in known)
    if not marks:
        raise InputMalformedError(
            "has no placed markers with coordinates", where=path, remedy="export the markers as XML"
        )
    crs = (chunk.findtext("reference") or "").strip()
    local = not crs or crs.startswith("LOCAL_CS")
    return ControlMarks("local" if local else crs, object_points(entries), marks, tuple(bare))


def _marker(name: str, reference: Element, sigma_m: Sigma, path: Path) -> PointEntry:
    xyz = [number(reference.get(axis, ""), path, f"marker {name}") for axis in "xyz"]
    stated = [reference.get(f"s{axis}") for axis in "xyz"]
    assumed = (sigma_m[0], sigma_m[0], sigma_m[1])
    sigma = [number(s, path, f"accuracy of {name}") if s else a for s, a in zip(stated, assumed, strict=True)]
    enabled = reference.get("enabled", "true").lower() in ("true", "1")
    return PointEntry(name, "control" if enabled else "check", xyz, sigma)


def _locations(own: Element, names: Mapping[str, str], images: Mapping[str, str], path: Path) -> list[Mark]:
    name = names.get(own.get("marker_id", ""), "")
    marks = []
    for seen in own.iterfind("location"):
        image = images.get(seen.get("camera_id", ""))
        # What is not pinned was predicted, not measured.
        if image is None or seen.get("pinned", "true").lower() in ("false", "0"):
            continue
        x, y = (number(seen.get(axis, ""), path, f"marker {name}") - 0.5 for axis in "xy")
        marks.append(Mark(image, name, x, y, (BY_HAND_PX, BY_HAND_PX), path))
    return marks


def _opensfm(path: Path, sigma_m: Sigma, sizes: Sizes) -> ControlMarks:
    """Marks from the middle of the image, over its longer side."""
    require_readable(path)
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        entries, bare, marks = [], [], []
        for own in content["points"]:
            name = str(own["id"])
            place = own.get("position")
            if place is None:
                bare.append(name)
                continue
            xyz = [float(place[key]) for key in ("longitude", "latitude", "altitude")]
            entries.append(PointEntry(name, "control", xyz, (sigma_m[0], sigma_m[0], sigma_m[1])))
            for seen in own["observations"]:
                image = str(seen["shot_id"])
                x, y = (float(value) for value in seen["projection"])
                if image in sizes:
                    width, height = sizes[image]
                    x = x * max(width, height) + (width - 1) / 2
                    y = y * max(width, height) + (height - 1) / 2
                    marks.append(Mark(image, name, x, y, (BY_HAND_PX, BY_HAND_PX), path))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as failure:
        raise InputMalformedError(
            f"is no ground_control_points.json ({failure})", where=path, remedy="is it the right file?"
        ) from failure
    if not entries:
        raise InputMalformedError("has no point with coordinates", where=path, remedy="is it the right file?")
    return ControlMarks("EPSG:4326", object_points(entries), tuple(marks), tuple(bare))
