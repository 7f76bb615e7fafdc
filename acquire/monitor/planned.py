"""The line that was to be flown, of a mission file, to lie under the track."""

from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError, InputNotFoundError

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
        reason = (refusal.strerror or "").lower()
        raise InputNotFoundError(
            f"cannot be read ({reason})", "name flight.waypoints", where=path
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
            raise wrong(f"line {number} is no item of a mission", "make it again") from None
        if len(fields) == _FIELDS and item > 0 and command in _PLACES and any(place):
            places.append(place)
    return np.array(places, dtype=np.float64).reshape(-1, 2)
