"""Marks of points, by hand or found as targets, and control with its marks, as we and others write them."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from photocal.adjustment.network import covariance_matrices
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.geodesy import enu_axes
from photocal.base.layers import SUFFIXES as LAYERS
from photocal.base.layers import file_of
from photocal.base.text_tables import folded, read_table, read_under, refuse
from photocal.block.model import NO_POINTS, Block, ObjectPoints, Role
from photocal.exchange.ground_points import read_gcp_list, read_gcp_rows
from photocal.exchange.metashape import markers
from photocal.exchange.parts import Mark, PointEntry, object_points, require_unique
from photocal.exchange.pix4d_inputs import SUFFIX as PIX4D
from photocal.exchange.pix4d_inputs import read_inputs
from photocal.exchange.source import Line, number, read_json, read_lines, read_xml, require_readable
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.geometry.frames import code_of, system_of, utm_zones
from photocal.measurement.mark_frames import are_fractions
from photocal.measurement.position_files import IMAGE_HEADS

# A point that somebody clicked, when the table does not say how well.
BY_HAND_PX = 1.0
_BY_HAND = (BY_HAND_PX, BY_HAND_PX)
Sizes = Mapping[str, tuple[int, int]]
Sigma = tuple[float, float]
# Words that head a column of points, as people write them.
POINT_HEADS = (
    "point", "ponto", "name", "nome", "label", "gcp", "marco", "vértice", "point id", "punto", "nombre",
    "punkt", "punktnummer", "punkt-id", "id", "point name", "point number", "point no", "pt", "pt id",
    "punktnr", "punktname", "nome punto", "nome ponto", "nome do ponto", "id ponto", "id punto", "nom",
    "matricule", "gcp id", "gcp name", "gcp label", "marker", "marker label", "station", "estação",
    "target", "alvo", "repère", "number", "num", "número", "numero", "nummer", "no", "nr", "nº",
    "n point", "no point", "numéro", "numéro du point", "nom du point", "nr punktu", "numer punktu", "numer",
    "nr pkt", "pkt", "nazwa", "nazwa punktu", "nº ponto", "n ponto", "número do ponto", "n punto",
)  # fmt: skip
# Words that head the columns of such tables, in the order in which tables without a head have them.
MARK_HEADS = (
    ("image", (*IMAGE_HEADS, "image_name", "imagename", "image_label", "camera", "camera_label")),
    ("point", POINT_HEADS),
    ("x", (
        "x", "u", "image_u", "image_x", "x_px", "pixelx", "pixel_x", "px", "x_pixel", "column", "col",
        "coluna", "colonne", "columna", "colonna", "kolumna", "spalte",
    )),
    ("y", (
        "y", "v", "image_v", "image_y", "y_px", "pixely", "pixel_y", "py", "y_pixel", "row", "line",
        "linha", "ligne", "fila", "riga", "wiersz", "zeile",
    )),
)  # fmt: skip
# Of our own tables, whose upper-left pixel has its centre at (0, 0).
_OWN = ("image", "point", "x", "y")
# Roles of points of OpenSfM that measure and do not hold.
_CHECKS = ("metrics_only", "check")


def read_marks(path: Path) -> tuple[Mark, ...]:
    """Read marks.csv: image, point, x, y, optional sx, sy, px of the stored pixel grid."""
    table = read_table(path, ("image", "point", "x", "y"), ("sx", "sy"))
    xy, sigma = table.matrix("xy"), table.matrix(("sx", "sy"), empty=BY_HAND_PX)
    refuse(table, (sigma <= 0).any(axis=1), "the sigma is not positive", "give a positive number")
    (image, images), (point, points) = table.names("image"), table.names("point")
    again = np.ones(len(xy), dtype=np.bool_)
    again[np.unique(image * len(points) + point, return_index=True)[1]] = False
    refuse(table, again, "the point was already marked in this image", "keep one of the marks")
    return tuple(
        Mark(images[i], points[j], x, y, (sx, sy), table.place(row))
        for row, (i, j, (x, y), (sx, sy)) in enumerate(
            zip(image, point, xy.tolist(), sigma.tolist(), strict=True)
        )
    )


def with_marks(block: Block, marks: Iterable[Mark]) -> tuple[Block, tuple[Mark, ...]]:
    """Add marks of known points in known images to a block."""
    image = {name: k for k, name in enumerate(block.images.names)}
    point = {name: k for k, name in enumerate(block.points.names)}
    rows: dict[tuple[int, int], Mark] = {}
    unknown = []
    for mark in marks:
        if mark.image in image and mark.point in point:
            rows.setdefault((image[mark.image], point[mark.point]), mark)
        else:
            unknown.append(mark)
    keys = np.array(list(rows), dtype=np.int64).reshape(-1, 2)
    xy = np.array([(m.x, m.y) for m in rows.values()]).reshape(-1, 2)
    sigma = np.array([m.sigma for m in rows.values()]).reshape(-1, 2)
    seen = block.observations.plus(keys[:, 0], keys[:, 1], xy, sigma)
    return replace(block, observations=seen), tuple(unknown)


@dataclass(frozen=True)
class ControlMarks:
    """Control points and where images show them.

    crs: of the coordinates; "local" without one, empty where nobody says it. Geographic ones are longitude,
        latitude (deg), height.
    marks: px of the stored pixel grid.
    without_coordinates: points that have marks but no coordinates: they are left out.
    rows: of the list, where it has one for each mark.
    refused: those that are not used, with the reason.
    doubtful: what looks like a typing error in others.
    assumed: points whose sigmas nobody states: they are along east, north and up in any system.
    file, cameras: where they were read, and the cameras of another program's set-up.
    beside: files that list more of the points.
    unit_m: metres of the unit that heads state.
    height, height_head: kind of the heights where a head says it, and that head.
    level: EPSG code of the system of heights that it names.
    crs_file: file beside the table that names the system; none where the table itself does.
    unordered: whether no head says which of the coordinates is east.
    """

    crs: str
    points: ObjectPoints = NO_POINTS
    marks: tuple[Mark, ...] = ()
    without_coordinates: tuple[str, ...] = ()
    rows: int = 0
    refused: tuple[str, ...] = ()
    doubtful: tuple[str, ...] = ()
    assumed: frozenset[str] = frozenset()
    file: Path = Path()
    cameras: tuple[Camera, ...] = ()
    unit_m: float = 1.0
    height: str = ""
    height_head: str = ""
    level: str = ""
    crs_file: Path | None = None
    unordered: bool = False
    beside: tuple[Path, ...] = ()


def read_control_marks(path: Path, sigma_m: Sigma, sizes: Sizes) -> ControlMarks:
    """Read ODM's gcp_list.txt, Metashape's markers (XML), OpenSfM's control (JSON), or a project of Pix4D."""
    kind = path.suffix.lower()
    if kind == PIX4D:
        return _pix4d(path, sigma_m)
    if kind == ".xml":
        return _metashape(path, sigma_m)
    if kind == ".json":
        return _opensfm(path, sigma_m, sizes)
    crs, places, marks = read_gcp_list(path, _BY_HAND)
    assumed = (sigma_m[0], *sigma_m)
    entries = [PointEntry(name, "control", xyz, assumed) for name, xyz in places.items()]
    return ControlMarks(crs, object_points(entries), marks, assumed=frozenset(places))


def read_typed_list(path: Path, sigma_m: Sigma, say: Catalogue) -> ControlMarks:
    """Read gcp_list.txt row by row: one that cannot be used is named and costs nothing but itself.

    The system is as the first line calls it. A name has the place of its first row, a place the name.
    """
    crs, given, unreadable = read_gcp_rows(path)
    refused, marks = [str(refusal) for refusal in unreadable], dict[tuple[str, str], Mark]()
    names: dict[tuple[float, float, float], str] = {}
    places: dict[str, tuple[float, float, float]] = {}
    # No coordinate is larger, m, mm among them.
    most_m = 1e11
    for row in given:
        if max(map(abs, row.xyz)) > most_m:
            refused.append(say("new.row_far", place=row.line.place, value=f"{max(row.xyz, key=abs):g}"))
            continue
        if row.name and places.get(row.name, row.xyz) != row.xyz:
            refused.append(say("new.row_moved", place=row.line.place, name=row.name))
            continue
        known = names.get(row.xyz)
        if known is None:
            free = (f"point{k}" for k in count(len(names) + 1) if f"point{k}" not in places)
            known = row.name or next(free)
            names[row.xyz], places[known] = known, row.xyz
        if (row.image, known) in marks:
            refused.append(say("new.mark_again", place=row.line.place, point=known, image=row.image))
        else:
            marks[row.image, known] = Mark(row.image, known, row.column, row.row, _BY_HAND, row.line.place)
    entries = [PointEntry(name, "control", xyz, (sigma_m[0], *sigma_m)) for name, xyz in places.items()]
    rows = len(given) + len(unreadable)
    points = object_points(entries)
    return ControlMarks(
        crs, points, tuple(marks.values()), (), rows, tuple(refused), assumed=frozenset(places)
    )


def in_map_system(given: ControlMarks) -> ControlMarks:
    """Take geographic and geocentric coordinates, and maps in feet, to the UTM zone of their middle.

    Heights stay as they are; those of geocentric coordinates refer to the ellipsoid, those of a map in feet
    are in feet, too.
    """
    from pyproj import Transformer
    from pyproj.exceptions import CRSError

    if given.crs in ("", "local"):
        return replace(given, crs="local")
    try:
        system = system_of(given.crs)
    except CRSError as refusal:
        raise ConfigurationError(
            f"system {given.crs!r} of the control points is not known", "write it as EPSG:32722"
        ) from refusal
    points = given.points
    if system.is_geocentric:
        system, points = _geographic(system, points, given.assumed)
    elif (metres := unit_m(system)) != 1.0:
        system, points = _of_feet(system, metres, points, given.assumed)
    if not system.is_geographic:
        return replace(given, crs=code_of(system) or given.crs)
    # One point with a wrong sign moves no middle; of one of height alone nobody says where it is.
    longitude, latitude = np.nanmedian(points.values[:, :2], axis=0).tolist()
    if not (abs(latitude) <= 84 and abs(longitude) <= 180):
        raise ConfigurationError(
            f"control at longitude {longitude:.6f}, latitude {latitude:.6f} is impossible",
            "are latitude and longitude exchanged?",
        )
    name = utm_zones(latitude, longitude)[0]
    way = Transformer.from_crs(system.to_2d(), name, always_xy=True)
    unknown = np.isnan(points.values[:, :2]).any(axis=1)
    plane = np.column_stack(way.transform(*points.values[:, :2].T))
    plane[unknown] = np.nan
    there = np.isfinite(plane).all(axis=1) | unknown
    # A projection ends before it reaches the other side of the earth.
    refused = [
        f"control point {points.names[k]} at longitude {x:.6f}, latitude {y:.6f} lies outside of {name}"
        for k, (x, y) in enumerate(points.values[:, :2].tolist())
        if not there[k]
    ]
    moved = replace(points, values=np.column_stack([plane, points.values[:, 2]]))
    return replace(given, crs=name, points=moved.only(there), refused=(*given.refused, *refused))


def unit_m(system: Any) -> float:
    """Metres of the unit of a plane map system; 1 for another kind."""
    plane = system.is_projected and not system.is_compound
    return float(system.axis_info[0].unit_conversion_factor) if plane else 1.0


def _of_feet(
    system: Any, metres: float, points: ObjectPoints, assumed: Collection[str]
) -> tuple[Any, ObjectPoints]:
    """Take points of a map in feet to longitude, latitude (deg) and height (m); assumed sigmas are in m."""
    from pyproj import Transformer

    geographic = system.geodetic_crs.to_2d()
    longitude, latitude = Transformer.from_crs(system, geographic, always_xy=True).transform(
        points.values[:, 0], points.values[:, 1], errcheck=True
    )
    values = np.column_stack([longitude, latitude, points.values[:, 2] * metres])
    factor = np.where([name in assumed for name in points.names], 1.0, metres)[:, None]
    cross = None if points.cross is None else points.cross * factor**2
    return geographic, replace(points, values=values, sigma=points.sigma * factor, cross=cross)


def _geographic(system: Any, points: ObjectPoints, assumed: Collection[str]) -> tuple[Any, ObjectPoints]:
    """Take geocentric points to longitude, latitude and ellipsoidal height, with sigmas east, north, up.

    assumed: points whose sigmas are along these already.
    """
    from pyproj import CRS, Transformer
    from pyproj.crs import GeographicCRS
    from pyproj.crs.coordinate_system import Ellipsoidal3DCS

    geographic = CRS(GeographicCRS(datum=system.datum, ellipsoidal_cs=Ellipsoidal3DCS()).to_wkt())
    there = Transformer.from_crs(system, geographic, always_xy=True)
    x, y, z = points.values.T
    values = np.column_stack(there.transform(x, y, z, errcheck=True))
    # Nobody surveys farther from the ellipsoid, m.
    highest = 20e3
    if not (np.abs(values[:, 2]) < highest).all():
        raise ConfigurationError(
            f"control that {system.name} would place {np.abs(values[:, 2]).max() / 1e3:.0f} km from the "
            "ellipsoid is not geocentric",
            'write the map system of the coordinates, such as "EPSG:31982"',
        )
    turn = enu_axes(values[:, 1], values[:, 0])
    # What only some axes hold or observe has no sigmas along others.
    whole: Flags = np.asarray((np.isfinite(points.sigma) & (points.sigma > 0.0)).all(axis=1))
    whole &= [name not in assumed for name in points.names]
    cross = np.zeros_like(points.sigma) if points.cross is None else points.cross
    covariance = covariance_matrices(np.where(whole[:, None], points.sigma, 1.0), cross)
    variance = np.einsum("nab,nbc,nac->na", turn, covariance, turn)
    sigma = np.where(whole[:, None], np.sqrt(variance), points.sigma)
    return geographic, replace(points, values=values, sigma=sigma, cross=None)


def _chunk(path: Path) -> Element:
    chunks = list(read_xml(path).iter("chunk"))
    malformed = InputMalformedError.at(path)
    if not chunks:
        raise malformed(
            "is not an XML file of Metashape's markers",
            "export points as CSV (name, east, north, height), and marks as CSV (image, point, x, y)",
        )
    if len(chunks) != 1:
        raise malformed(
            f"has {len(chunks)} chunks where one was expected", "export the markers of one chunk as XML"
        )
    return chunks[0]


def _marks(chunk: Element, path: Path) -> tuple[Mark, ...]:
    """Pinned projections; the upper-left pixel's centre is (0.5, 0.5) there."""
    images = {camera.get("id", ""): camera.get("label", "") for camera in chunk.iterfind("cameras//camera")}
    names = {marker.get("id", ""): marker.get("label", "") for marker in chunk.iterfind("markers//marker")}
    marks = []
    for marker in chunk.iterfind("frames/frame/markers/marker"):
        name = names.get(marker.get("marker_id", ""), "")
        for seen in marker.iterfind("location"):
            image = images.get(seen.get("camera_id", ""))
            # What is not pinned was predicted, not measured.
            if image is not None and seen.get("pinned", "true").lower() not in ("false", "0"):
                x, y = (number(seen.get(axis, ""), path, f"marker {name}") - 0.5 for axis in "xy")
                marks.append(Mark(image, name, x, y, _BY_HAND, path))
    return tuple(marks)


def _metashape(path: Path, sigma_m: Sigma) -> ControlMarks:
    chunk = _chunk(path)
    entries, bare, assumed = [], [], set()
    for marker in markers(chunk, path).values():
        if marker.role == "tie":
            bare.append(marker.name)
        else:
            if np.isnan(marker.sigma).all():
                assumed.add(marker.name)
            stated = zip(marker.sigma, (sigma_m[0], *sigma_m), strict=True)
            entries.append(replace(marker, sigma=[s if s == s else assumed for s, assumed in stated]))
    known = {entry.name for entry in entries}
    marks = tuple(mark for mark in _marks(chunk, path) if mark.point in known)
    if not marks:
        raise InputMalformedError(
            "has no placed markers with coordinates", "export the markers as XML", where=path
        )
    crs = (chunk.findtext("reference") or "").strip()
    # Without a reference it is not stated what the coordinates refer to.
    system = "local" if crs.startswith("LOCAL_CS") else crs
    return ControlMarks(system, object_points(entries), marks, tuple(bare), assumed=frozenset(assumed))


def _pix4d(path: Path, sigma_m: Sigma) -> ControlMarks:
    """Control of a project file; what it says of accuracies is not read."""
    given = read_inputs(path, _BY_HAND)
    if not given.points:
        raise InputMalformedError(
            "has no surveyed points", "export the marks of tie points as a table", where=path
        )
    assumed = np.array([sigma_m[0], *sigma_m])
    entries = [replace(point, sigma=np.maximum(point.sigma, assumed)) for point in given.points]
    known = {point.name for point in entries}
    marks = tuple(mark for mark in given.marks if mark.point in known)
    return ControlMarks(
        given.crs,
        object_points(entries),
        marks,
        assumed=frozenset(known),
        height="orthometric" if given.geoid else "",
        height_head=given.geoid,
        level=given.level,
    )


def _opensfm(path: Path, sigma_m: Sigma, sizes: Sizes) -> ControlMarks:
    """Marks from the middle of the image, over its longer side."""
    require_readable(path)
    malformed = InputMalformedError.at(path)
    content: Any = read_json(path)
    if not isinstance(content, dict) or "points" not in content:
        raise malformed("is not a ground_control_points.json: it has no points", "is it the right file?")
    try:
        entries, bare, marks = [], [], []
        for point in content["points"]:
            name = str(point["id"])
            place = point.get("position")
            if place is None:
                bare.append(name)
                continue
            xyz = [float(place[key]) for key in ("longitude", "latitude", "altitude")]
            role: Role = "check" if point.get("role") in _CHECKS else "control"
            entries.append(PointEntry(name, role, xyz, (sigma_m[0], *sigma_m)))
            for seen in point["observations"]:
                image = str(seen["shot_id"])
                x, y = (float(value) for value in seen["projection"])
                if image in sizes:
                    width, height = sizes[image]
                    x = x * max(width, height) + (width - 1) / 2
                    y = y * max(width, height) + (height - 1) / 2
                    marks.append(Mark(image, name, x, y, _BY_HAND, path))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as failure:
        raise malformed(
            f"is not a ground_control_points.json ({failure})", "is it the right file?"
        ) from failure
    if not entries:
        raise malformed("has no point with coordinates", "is it the right file?")
    points = object_points(entries)
    return ControlMarks("EPSG:4326", points, tuple(marks), tuple(bare), assumed=frozenset(points.names))


def read_any_marks(path: Path, sizes: Mapping[str, tuple[int, int]]) -> tuple[Mark, ...]:
    """Read marks of ours, of Pix4D, of Metashape (XML or table), gcp_list.txt, OpenSfM's control or a sheet.

    A table of Pix4D has image, point, x, y and no head; its fifth column is the zoom in one program and an
    accuracy in another, and is not used. Tables of Metashape's scripts have a head and the same order. In
    both the upper-left corner of the upper-left pixel is (0, 0). A table with the head of our marks.csv is
    taken as ours.
    """
    kind = path.suffix.lower()
    if file_of(path).suffix.lower() in LAYERS:
        marks = _sheet(path)
    elif kind == ".xml":
        marks = _marks(_chunk(path), path)
    elif kind == ".json":
        marks = read_control_marks(path, (1.0, 1.0), sizes).marks
    else:
        marks = _text(path)
    if not marks:
        raise InputMalformedError("has no marks", "is it the right file?", where=path)
    marks = named_after(marks, sizes)
    turned = named_after([replace(mark, image=mark.point, point=mark.image) for mark in marks], sizes)
    # Points may stand before pictures.
    if not any(mark.image in sizes for mark in marks) and any(mark.image in sizes for mark in turned):
        marks = turned
    require_unique([f"{mark.point} in image {mark.image}" for mark in marks], "point", path)
    return marks


def from_corner(pixels: Floats) -> Floats:
    """Places counted from the corner of the upper-left pixel, (n, 2), from its centre; fractions stay."""
    half = 0.5
    return pixels if are_fractions(pixels) else pixels - half


def named_after(
    marks: Iterable[Mark], images: Iterable[str], others: Collection[str] = ()
) -> tuple[Mark, ...]:
    """Give marks the names of image files: other programs leave out endings, or name folders, too.

    others: pictures of the same names in other folders, as "folder/name"; whose marks stay theirs.
    """
    names = set(images)
    stems: dict[str, list[str]] = {}
    for name in names:
        stems.setdefault(Path(name).stem.casefold(), []).append(name)

    def named(image: str) -> str:
        """Give the picture that a table means, by name or by stem."""
        parts = image.replace("\\", "/").split("/")
        last, below = parts[-1], "/".join(parts[-2:])
        if below in names or below in others:
            return below
        alike = stems.get(last.casefold(), []) or stems.get(Path(last).stem.casefold(), [])
        return last if last in names else alike[0] if len(alike) == 1 else image

    return tuple(replace(mark, image=named(mark.image)) for mark in marks)


def pointed_after(marks: Iterable[Mark], points: Iterable[str]) -> tuple[Mark, ...]:
    """Give marks the names of points that are written alike but for small letters, blanks, signs, zeros."""
    names, alike = set(points), dict[str, list[str]]()
    for name in names:
        alike.setdefault(_plain(name), []).append(name)
    meant = {word: same[0] for word, same in alike.items() if len(same) == 1}
    return tuple(
        mark if mark.point in names else replace(mark, point=meant.get(_plain(mark.point), mark.point))
        for mark in marks
    )


def _plain(name: str) -> str:
    """A name as it is compared: GCP-01 is gcp1, but 1-01 is not 11."""
    without_zeros = re.sub(r"(?<!\d)0+(?=\d)", "", folded(name))
    return re.sub(r"(?<!\d) | (?!\d)", "", without_zeros)


def _text(path: Path) -> tuple[Mark, ...]:
    lines = read_lines(path, windows=True)
    first = lines[0].text.strip() if lines else ""
    delimiter = next((character for character in ("\t", ";", ",") if character in first), None)
    last = lines[-1].text.split() if lines else []
    by_blanks = len(last) > 3 and not _is_number(last[0]) and all(map(_is_number, last[2:4]))
    if delimiter is None and not by_blanks:
        # Blanks between coordinates, and the system in the first line.
        return read_control_marks(path, (1.0, 1.0), {}).marks
    cells = [cell.strip().strip('"') for cell in first.split(delimiter)]
    # With capitals it is somebody's own table.
    if tuple(cells[:4]) == _OWN:
        return read_marks(path)
    head = [cell.lower().replace(" ", "_") for cell in cells]
    order = _order(head, path)
    body = lines if order is None else lines[1:]
    marks = [_mark(line, delimiter, order or (0, 1, 2, 3)) for line in body]
    # In all others the corner of that pixel is (0, 0).
    pixels = from_corner(np.array([(mark.x, mark.y) for mark in marks]).reshape(-1, 2))
    return tuple(replace(mark, x=x, y=y) for mark, (x, y) in zip(marks, pixels.tolist(), strict=True))


def _sheet(path: Path) -> tuple[Mark, ...]:
    table = read_under(path, dict(MARK_HEADS), _OWN)
    pixels = table.matrix("xy")
    if tuple(table.heads.values()) != _OWN:
        pixels = from_corner(pixels)
    rows = zip(table.texts("image"), table.texts("point"), pixels.tolist(), strict=True)
    return tuple(
        Mark(image, point, x, y, _BY_HAND, table.place(k)) for k, (image, point, (x, y)) in enumerate(rows)
    )


def _order(head: Sequence[str], path: Path) -> tuple[int, ...] | None:
    """Where image, point, x and y stand in a head; None for a first row that is a mark."""
    if len(head) >= 4 and _is_number(head[2]) and _is_number(head[3]):
        return None
    order = []
    for what, words in MARK_HEADS:
        known = [folded(word) for word in words]
        here = [k for k, cell in enumerate(head) if folded(cell) in known]
        if what == "point":
            # Beside a number of the row, or a picture's own name.
            here = sorted(here, key=lambda k: known.index(folded(head[k])))[:1]
        if len(here) != 1:
            raise InputMalformedError(
                f"its header {', '.join(head)!r} does not say which column is the {what}",
                "name the columns image_name,gcp_name,image_u,image_v, or leave the header out",
                where=path,
            )
        order.append(here[0])
    return tuple(order)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _mark(line: Line, delimiter: str | None, order: Sequence[int]) -> Mark:
    cells = [cell.strip().strip('"') for cell in line.text.split(delimiter)]
    if len(cells) <= max(order) or not cells[order[0]] or not cells[order[1]]:
        raise line.malformed(f"has {len(cells)} cells where image, point, x, y were expected")
    if delimiter != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    x, y = (number(cells[k], line.place, "mark") for k in order[2:])
    return Mark(cells[order[0]], cells[order[1]], x, y, _BY_HAND, line.place)
