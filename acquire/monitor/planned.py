"""What was planned, to lie under the track: the line of a mission file, and what each picture covers."""

import json
from pathlib import Path

import numpy as np

from acquire.monitor.state import Track
from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError, InputNotFoundError, reason

_HEAD, _FIELDS = "QGC WPL 110", 12
# Of MAVLink's commands those that name a place on the way: waypoint, and waypoint of a spline.
_PLACES = (16, 82)


def planned_line(path: Path) -> Floats:
    """Read the places of a mission (``QGC WPL 110``) in their order, but for its home.

    Returns
    -------
    array
        Latitude and longitude, degrees, shape (n, 2).

    Raises
    ------
    InputNotFoundError
        When it cannot be read.
    InputMalformedError
        When it is no such file.
    """
    try:
        head, *lines = path.read_text(encoding="utf-8-sig").strip().splitlines()
    except OSError as refusal:
        raise InputNotFoundError(
            f"cannot be read ({reason(refusal)})", "name flight.waypoints", where=path
        ) from refusal
    except (UnicodeDecodeError, ValueError):
        head, lines = "", []
    wrong = InputMalformedError.at(path)
    if head.strip() != _HEAD:
        raise wrong(f"does not begin with {_HEAD}", "name the flight.waypoints of photocal plan")
    places = []
    for number, line in enumerate(lines, 2):
        fields = line.split()
        try:
            item, command = int(fields[0]), int(fields[3])
            place = float(fields[8]), float(fields[9])
        except (ValueError, IndexError):
            raise wrong(f"line {number} is not a mission item", "make it again") from None
        if len(fields) == _FIELDS and item > 0 and command in _PLACES and any(place):
            places.append(place)
    return np.array(places, dtype=np.float64).reshape(-1, 2)


def planned_footprint(path: Path) -> tuple[float, float] | None:
    """Read what a picture covers by the plan beside a mission: m along and across the flight.

    Returns
    -------
    tuple of two floats, or None
        Of the lowest planned height; none without a ``plan.json`` that states it.
    """
    try:
        content = json.loads((path.parent / "plan.json").read_text(encoding="utf-8"))
        level = min(content["levels"], key=lambda one: float(one["height_m"]))
        columns, rows = map(float, level["footprint_m"])
        along = {"columns": (columns, rows), "rows": (rows, columns)}[content["along"]]
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return along if min(along) > 0 else None


def covered(pictures: Track, flown: Track, footprint: tuple[float, float]) -> Floats:
    """Lay a footprint around each picture, along the course that was flown before it.

    Parameters
    ----------
    pictures, flown
        Places of the pictures, and the track of the vehicle.
    footprint
        Metres along and across the flight.

    Returns
    -------
    array
        Four corners of each picture, degrees, shape (4n, 2); none of pictures before the vehicle moved.
    """
    if not len(pictures.points) or len(flown.points) < 2:
        return np.empty((0, 2))
    # Time and distance for a course: positions of a single receiver are noisy.
    over_ns, least_m = 2_000_000_000, 2.0
    # Of the mean sphere: a footprint is known to some percent.
    metres_per_deg = 111_195.0
    scale = metres_per_deg * np.array([1.0, np.cos(np.radians(pictures.points[0, 0]))])
    begin = flown.times_ns[0]
    known = (flown.times_ns - begin).astype(np.float64)
    now, before = (
        np.column_stack([np.interp(when, known, flown.points[:, axis]) for axis in (0, 1)]) * scale
        for when in (pictures.times_ns - begin, pictures.times_ns - begin - over_ns)
    )
    way = now - before
    length = np.linalg.norm(way, axis=1)
    moved = length > least_m
    ahead = way[moved] / length[moved, None]
    # North and east: to the right of north is east.
    right = ahead[:, ::-1] * [-1.0, 1.0]
    sides = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    offsets = [0.5 * (a * footprint[0] * ahead + b * footprint[1] * right) for a, b in sides]
    corners = pictures.points[moved, None] + np.stack(offsets, axis=1) / scale
    return np.asarray(corners.reshape(-1, 2))
