"""Channels decoded from a PX4 log: position, attitude, GNSS, exposures, clock and health."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoded, Times
from acquire.channels.log_decoder import BootTime, LogDecoder, Part
from acquire.channels.logged import Logged, fix_names
from drivers.arrays import Floats, Integers
from drivers.ulog import UlogFormats

_YEAR_2000_US, _YEAR_2100_US = 946_684_800e6, 4_102_444_800e6
_RECEIVERS = {"vehicle_gps_position": "", "sensor_gps": "-sensor", "sensor_gps[1]": "-sensor-2"}


class UlogDecoder(LogDecoder[UlogFormats]):
    """Decodes the records of a PX4 log; a `Decoder`.

    link: name of the link.
    boot: when the autopilot started.
    """

    def __init__(self, link: str, boot: BootTime) -> None:
        super().__init__(link, boot, UlogFormats())

    def _decoded(self, part: Part[UlogFormats]) -> Iterator[Decoded]:
        for topic, receiver in _RECEIVERS.items():
            yield from _receiver(part.logged(topic), receiver, part)
        position = part.logged("vehicle_global_position")
        found = position.records
        place = found.number("lat"), found.number("lon"), found.number("alt")
        yield position.location(f"/{part.link}/position", place)
        attitude = part.logged("vehicle_attitude")
        # PX4 turns body vectors (forward, right, down) into north, east, down, as the log does.
        yield attitude.attitude(_quaternion(attitude)[:, [1, 2, 3, 0]])
        for topic, edge in (("camera_capture", "feedback"), ("camera_trigger", "trigger")):
            yield _exposure(part.logged(topic), edge)
        texts = part.formats.texts(part.batch)
        logged = Logged(part.link, "logging", texts, part.utc_ns[texts.index])
        yield logged.health({"severity": texts["severity"], "text": texts["text"]})
        parameters = part.formats.parameters(part.batch)
        told = Logged(part.link, "parameter", parameters, part.utc_ns[parameters.index])
        yield told.parameters("name", "value")
        yield part.logged("battery_status").battery("voltage_v", "current_a")


def _receiver(logged: Logged, receiver: str, part: Part[UlogFormats]) -> Iterator[Decoded]:
    found = logged.records
    if not len(found):
        return
    fix = found.number("fix_type")
    kept = logged.rows(fix >= 2)
    claimed = kept.records.number("eph"), kept.records.number("epv")
    yield kept.location(f"/gnss/{part.link}{receiver}/fix", _gps_place(kept), claimed)
    quality = {
        "hdop": found.number("hdop"),
        "horizontal_m": found.number("eph"),
        "vertical_m": found.number("epv"),
    }
    yield logged.status(receiver, fix_names(fix), {**logged.whole(satellites="satellites_used"), **quality})
    device = _told_utc(found.number("time_utc_usec"), earliest_us=0.0)
    yield logged.clock(device, part.boot_ns[found.index])


def _gps_place(logged: Logged) -> tuple[Floats, Floats, Floats]:
    found = logged.records
    if "latitude_deg" in found:  # since 1.15
        height = found.number("altitude_msl_m")
        return found.number("latitude_deg"), found.number("longitude_deg"), height
    return found.number("lat") * 1e-7, found.number("lon") * 1e-7, found.number("alt") * 1e-3


def _quaternion(logged: Logged) -> Floats:
    found = logged.records
    if "q" not in found or found["q"].shape[1:] != (4,):
        return np.full((len(found), 4), np.nan)
    with np.errstate(invalid="ignore"):  # a damaged number may be a signalling NaN
        return np.asarray(found["q"], float)


def _exposure(logged: Logged, edge: str) -> Decoded:
    found = logged.records
    gps = _told_utc(found.number("timestamp_utc"), earliest_us=_YEAR_2000_US)
    columns: dict[str, Any] = {"time": Times(np.where(gps >= 0, gps, logged.utc_ns))}
    names = {"latitude_deg": "lat", "longitude_deg": "lon", "altitude_msl_m": "alt"}
    columns |= {name: found.number(member) for name, member in names.items() if member in found}
    return logged.exposure(edge, {**columns, **logged.whole(sequence="seq")})


def _told_utc(microseconds: Floats, earliest_us: float) -> Integers:
    """Return UTC that records tell, nanoseconds since 1970; -1 where they tell none."""
    told = (microseconds > earliest_us) & (microseconds < _YEAR_2100_US)
    return np.where(told, np.where(told, microseconds, 0).astype(np.int64) * 1000, -1)
