"""Event lists of multirotors with RTK receivers: the `Timestamp.MRK` file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Floats
from drivers.errors import InputMalformedError, InputNotFoundError
from drivers.frames import Wire
from drivers.mrk import parse_event
from photocal.navigation.events import Events, counter_jumps
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import enu_axes, geocentric, geodetic

# Flag of the receiver: 50 fixed, 34 float, 16 single.
_STATUS = {50: "fixed", 34: "float"}


@dataclass(frozen=True)
class CameraEventList:
    """Events with the position that the vehicle computed in flight.

    events: the moments (GPS time).
    offset_enu_m (n, 3): from the antenna's phase centre to the camera's sensor, east, north, up.
    lat_deg, lon_deg, height_m (n,): position of the camera as the vehicle computed it (the maker: after
        compensation of the offset), ellipsoidal height.
    sigma_enu_m (n, 3): standard deviations.
    status: ``fixed``, ``float`` or ``single``.
    """

    events: Events
    offset_enu_m: Floats
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    sigma_enu_m: Floats
    status: NDArray[np.str_]


def read_mrk(path: Path) -> CameraEventList:
    """Read a `Timestamp.MRK` file.

    The columns are described in `drivers.mrk`.
    """
    try:
        lines = path.read_text("latin-1").splitlines()
    except OSError as refusal:
        reason = (refusal.strerror or str(refusal)).lower()
        raise InputNotFoundError(
            f"cannot be read ({reason})", where=path, remedy="check name and rights"
        ) from refusal
    return _listed(path.name, lines, path)


def listed_in(log: FlightLog) -> CameraEventList | None:
    """Return the event list that was imported into a flight log; None when there is none."""
    lines = [payload.decode("latin-1") for _, messages in log.raw(Wire.MRK) for payload in messages.payloads]
    return _listed("MRK", lines, log) if lines else None


def _listed(name: str, lines: list[str], path: object) -> CameraEventList:
    rows = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        found = parse_event(line)
        if found is None:
            raise InputMalformedError(
                "is no event (number, time, week, offsets N E V, Lat, Lon, Ellh, sigmas, Q)",
                where=f"{path}, line {number}",
                remedy="give the file as the vehicle wrote it",
            )
        rows.append(found)
    if not rows:
        raise InputMalformedError("has no events", where=path, remedy="check the flight's folder")
    t = np.array(rows)
    count = t[:, 0].astype(np.int64)
    time = GpsTime.from_week(t[:, 2].astype(np.int64), t[:, 1])
    events = Events(name, time, count, np.zeros(len(t)), counter_jumps(count, "events"))
    return CameraEventList(
        events,
        np.stack([t[:, 4], t[:, 3], -t[:, 5]], axis=1) * 1e-3,
        t[:, 6],
        t[:, 7],
        t[:, 8],
        t[:, [10, 9, 11]],
        np.array([_STATUS.get(int(q), "single") for q in t[:, 12]], "U6"),
    )


def moved(
    lat_deg: Floats, lon_deg: Floats, height_m: Floats, offset_enu_m: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return geodetic positions moved by east, north, up offsets: from the antenna to the camera."""
    at = geocentric(lat_deg, lon_deg, height_m)
    turn = np.stack([enu_axes(a, b) for a, b in zip(lat_deg.tolist(), lon_deg.tolist(), strict=True)])
    return geodetic(at + np.einsum("nji,nj->ni", turn, offset_enu_m))
