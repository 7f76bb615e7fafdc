"""Putting a block together from what a foreign file holds: names to indices, and nothing twice.

The system of the coordinates that another program has written, from the WKT beside them.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np

from photocal.adjustment.network import NO_RELATIONS, Relations
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations, Role
from photocal.exchange.source import fingerprint, read_text
from photocal.geometry.camera import Camera
from photocal.geometry.frames import UNSTATED, level_of, parsed, reference_frame, utm_zones
from photocal.geometry.rotation import angles_from_matrix

# Where a program states no standard deviations of image coordinates, they are weighted alike first.
UNIT_SIGMA_PX = 1.0
# What a value without a standard deviation of its own is: free.
FREE = (np.inf, np.inf, np.inf)
UNKNOWN = (np.nan, np.nan, np.nan)
HEIGHTS_UNSAID = "the files do not state the reference of their heights: they are used as given"
Row = Sequence[str | float]


@dataclass(frozen=True)
class PointEntry:
    """One object point.

    xyz (3,): m; NaN when unknown.
    sigma (3,): m; 0 holds, infinity leaves free.
    """

    name: str
    role: Role = "tie"
    xyz: Sequence[float] | Floats = UNKNOWN
    sigma: Sequence[float] | Floats = FREE


@dataclass(frozen=True)
class Mark:
    """One image observation.

    place: file and line, for messages.
    """

    image: str
    point: str
    x: float
    y: float
    sigma: tuple[float, float]
    place: object


def object_points(entries: Iterable[PointEntry]) -> ObjectPoints:
    """Collect object points."""
    rows = list(entries)
    return ObjectPoints(
        tuple(row.name for row in rows),
        np.array([row.xyz for row in rows], dtype=float).reshape(-1, 3),
        np.array([row.sigma for row in rows], dtype=float).reshape(-1, 3),
        np.array([ROLES.index(row.role) for row in rows], dtype=np.int64),
    )


def observations(
    marks: Sequence[Mark],
    image_names: Sequence[str],
    point_names: Sequence[str],
    unit: Literal["px", "mm"],
    axes: Literal["pixel", "photo"],
) -> Observations:
    """Collect image observations."""
    image_index = {name: k for k, name in enumerate(image_names)}
    point_index = {name: k for k, name in enumerate(point_names)}
    seen: set[tuple[str, str]] = set()
    for mark in marks:
        malformed = InputMalformedError.at(mark.place)
        if mark.image not in image_index:
            raise malformed(f"observes image {mark.image}, which is not in the block")
        if mark.point not in point_index:
            raise malformed(f"observes point {mark.point}, which is not in the block")
        if (mark.image, mark.point) in seen:
            raise malformed(
                f"point {mark.point} is observed twice in image {mark.image}", "keep one of the observations"
            )
        if not min(mark.sigma) > 0:
            raise malformed(f"the sigma of point {mark.point} in image {mark.image} is not positive")
        seen.add((mark.image, mark.point))
    return Observations(
        unit,
        axes,
        np.array([image_index[mark.image] for mark in marks], dtype=np.int64),
        np.array([point_index[mark.point] for mark in marks], dtype=np.int64),
        np.array([(mark.x, mark.y) for mark in marks], dtype=float).reshape(-1, 2),
        np.array([mark.sigma for mark in marks], dtype=float).reshape(-1, 2),
    )


def pixels(image: Integers, point: Integers, values: Floats, sigma_px: float = UNIT_SIGMA_PX) -> Observations:
    """Observations in px, all of one standard deviation; image, point (n,), values (n, 2)."""
    return Observations("px", "pixel", image, point, values, np.full(values.shape, sigma_px))


def listed_pixels(rays: Sequence[tuple[int, int, float, float]], shift: float = 0.0) -> Observations:
    """Observations in px of (image, point, x, y) that were collected one by one.

    shift: what is added to their coordinates.
    """
    table = np.array(rays, dtype=float).reshape(-1, 4)
    image, point = table[:, :2].astype(np.int64).T
    return pixels(image, point, table[:, 2:] + shift)


def block(
    name: str,
    cameras: Sequence[Camera],
    images: Images,
    points: ObjectPoints,
    seen: Observations,
    files: Iterable[Path],
    *,
    relations: Relations = NO_RELATIONS,
    datum: Literal["control", "free"] | None = None,
) -> Block:
    """Put a block together.

    datum: free without control where it is not given.
    points: coordinates of tie points are start values, whatever sigma they have.
    """
    surveyed = ~points.of_role("tie") & np.isfinite(points.values).all(axis=1)
    stated = surveyed & np.isfinite(points.sigma).all(axis=1)
    # What is called control without a standard deviation holds nothing.
    control = points.of_role("control") & stated
    role = np.where(points.of_role("control") & ~control, ROLES.index("tie"), points.role)
    points = replace(points, sigma=np.where(stated[:, None], points.sigma, np.inf), role=role)
    return Block(
        name,
        "local",
        "",
        datum or ("control" if control.any() else "free"),
        tuple(cameras),
        images,
        points,
        seen,
        tuple(fingerprint(path) for path in files),
        relations=relations,
    )


def block_of_marks(
    name: str,
    cameras: Sequence[Camera],
    images: Images,
    surveyed: Iterable[PointEntry],
    marks: Sequence[Mark],
    files: Sequence[Path],
) -> Block:
    """Put a block together; what is marked and not surveyed is a tie point of unknown place."""
    entries = list(surveyed)
    known = {entry.name for entry in entries}
    entries += [PointEntry(name) for name in dict.fromkeys(mark.point for mark in marks) if name not in known]
    names = [entry.name for entry in entries]
    require_unique(names, "point", files[0])
    seen = observations(marks, images.names, names, "px", "pixel")
    return block(name, cameras, images, object_points(entries), seen, files, datum="control")


def rays_of(group: Integers, count: int) -> list[Integers]:
    """Rays of each image, or of each point, in their order; `group` (rays,) says which."""
    order = np.argsort(group, kind="stable")
    return np.split(order, np.searchsorted(group[order], np.arange(1, count))) if count else []


def of_cameras(given: Block, name: Literal["size_px", "pitch"]) -> Floats:
    """What the camera of each ray has, x and y, shape (rays, 2)."""
    each = np.array([getattr(camera, name) for camera in given.cameras], dtype=float).reshape(-1, 2)
    return np.asarray(each[given.images.camera[given.observations.image]])


def known(sigma: Floats) -> Floats:
    """Standard deviations as files have them: 0 for what has none."""
    return np.where(np.isfinite(sigma), sigma, 0.0)


def require_seen_once(
    seen: Observations, images: Sequence[str], points: Sequence[str], place: object
) -> None:
    """Complain when a point is observed twice in an image; raises InputMalformedError."""
    pairs = np.sort(seen.image * len(points) + seen.point)
    twice = pairs[1:][np.diff(pairs) == 0]
    if len(twice):
        image, point = divmod(int(twice[0]), len(points))
        raise InputMalformedError(
            f"point {points[point]} is observed twice in image {images[image]}",
            "keep one of the observations",
            where=place,
        )


def require_unique(names: Sequence[str], what: str, place: object) -> None:
    """Complain when a name comes twice; raises InputMalformedError."""
    if len(set(names)) < len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise InputMalformedError(f"{what} {twice} is listed twice", "keep one of the rows", where=place)


def distinct(names: Iterable[str]) -> list[str]:
    """Names of which none comes twice: images of several folders often have equal ones."""
    given = list(names)
    taken, found = set(given), list[str]()
    further = dict[str, Iterator[str]]()
    for name in given:
        own = name
        if name in further:
            own = next(one for one in further[name] if one not in taken)
            taken.add(own)
        else:
            further[name] = _numbered(name)
        found.append(own)
    return found


def _numbered(name: str) -> Iterator[str]:
    return (f"{name} ({k})" for k in count(2))


def require_file_name(name: str) -> None:
    """Complain when a name cannot be a file name inside a folder."""
    if not name or name in (".", "..") or any(letter in '/\\\0:*?"<>|' for letter in name):
        raise InputMalformedError(f"the name {name!r} cannot be a file name", "rename it")


def require_no_blanks(names: Iterable[str], remedy: str = "rename it") -> None:
    """Complain when a name would be two cells of a table whose cells stand between blanks."""
    for name in names:
        if any(letter.isspace() for letter in name):
            raise InputMalformedError(f"the name {name!r} has blanks", remedy)


def write_rows(path: Path, rows: Iterable[Row], between: str = " ") -> None:
    """Write a table: texts as they are, numbers with all their digits."""
    texts = ([str(c) if isinstance(c, str | int) else repr(float(c)) for c in row] for row in rows)
    path.write_text("".join(between.join(row) + "\n" for row in texts), encoding="utf-8", newline="\n")


def digits(values: Iterable[float]) -> str:
    """Numbers with all their digits, between blanks."""
    return " ".join(repr(float(value)) for value in values)


def whole_numbers(names: Sequence[str]) -> list[str]:
    """Give points or images whole numbers: their names where all are, else counted from 1."""
    if all(name.isdecimal() and str(int(name)) == name and len(name) < 18 for name in names):
        return list(names)
    return [str(k) for k in range(1, len(names) + 1)]


def poses_of_matrices(places: Floats, rotation: Floats, names: Sequence[str], path: object) -> Floats:
    """Exterior orientations from rotation matrices as a file prints them."""
    error = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(~(error < 1e-4) | (np.linalg.det(rotation) < 0))
    if len(bad):
        raise InputMalformedError(f"the matrix of image {names[bad[0]]} is not a rotation", where=path)
    return np.hstack([angles_from_matrix(rotation), places])


def output_system(file: Path | None, places: Floats) -> tuple[str, str, list[str]]:
    """Frame and kind of heights of a block, and what was assumed of them.

    places (n, 3): projection centres in that system.
    """
    if file is None:
        # Coordinates of a site grid are smaller than northings.
        of_a_map_m = 2e4
        large = bool((np.abs(np.nanmedian(places[:, :2], axis=0)) > of_a_map_m).all())
        told = ["no ..._wkt.prj names the system of the coordinates: taken as Cartesian"]
        return "local", "", told if large else []
    text = read_text(file).strip()
    if text.startswith(("LOCAL_CS", "ENGCRS", "LOCAL_DATUM")):
        return "local", "", []
    try:
        system = parsed(text)
        if system.is_geographic:
            raise ConfigurationError("is in degrees")
        for name, height in _kinds(system):
            frame = reference_frame(name, height, np.nanmedian(places, axis=0))
            try:
                frame.to_local(places[:1])
            except InputMalformedError:
                # The grid of its geoid is missing, or it does not hold here.
                continue
            return name, height, [] if height == "orthometric" else [HEIGHTS_UNSAID]
    except PhotocalError:
        return "local", "", [f"{file.name} names no map system in metres: coordinates are taken as Cartesian"]
    return "local", "", [f"{file.name}: {system.name} is not valid at the block: taken as Cartesian"]


def utm_zone_of(lonlat: Floats, places: Floats) -> tuple[str, tuple[str, ...]]:
    """UTM zone in which places (n, 3) lie where others say in degrees; "local" where they do not."""
    from pyproj import Transformer

    longitude, latitude = np.median(lonlat, axis=0).tolist()
    if abs(longitude) <= 180 and abs(latitude) <= 84:
        # Degrees of some digits and metres of one place differ by less, m.
        near_m = 5.0
        for code in utm_zones(latitude, longitude):
            way = Transformer.from_crs("EPSG:4326", code, always_xy=True)
            away = np.hypot(*(np.column_stack(way.transform(*lonlat.T)) - places[:, :2]).T)
            if np.nanmax(away) <= near_m:
                return code, (HEIGHTS_UNSAID,)
    return "local", ("the places are in no UTM zone: taken as Cartesian",)


def _kinds(system: Any) -> list[tuple[str, str]]:
    """Names of a system with its heights, and of its plane alone."""
    names = [(_name(level_of(system)), UNSTATED)]
    return [(_name(system), "orthometric"), *names] if system.is_compound else names


def _name(system: Any) -> str:
    """Its code, if it is that of a register, else its whole text."""
    authority = system.to_authority(min_confidence=70)
    return ":".join(authority) if authority else str(system.to_wkt())
