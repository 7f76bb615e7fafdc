"""Channels decoded from a DataFlash log: position, attitude, GNSS, exposures, clock and health."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from acquire.channels.decoded import Decoded, Times
from acquire.channels.log_decoder import BootTime, LogDecoder, Part
from acquire.channels.logged import Logged, fix_names
from acquire.log import foxglove
from drivers.arrays import Floats, Integers
from drivers.dataflash import DataflashFormats
from drivers.gnsstime import gps_to_utc_ns, week_to_ns
from drivers.logged import Records


class DataflashDecoder(LogDecoder[DataflashFormats]):
    """Decodes the records of a DataFlash log; a `Decoder`.

    link: name of the link.
    boot: when the autopilot started.
    """

    def __init__(self, link: str, boot: BootTime) -> None:
        super().__init__(link, boot, DataflashFormats())
        self._positions_told = False

    def _decoded(self, part: Part[DataflashFormats]) -> Iterator[Decoded]:
        for name in ("GPS", "GPS2"):
            yield from _receiver(part.logged(name), part)
        for position in self._positions(part):
            yield position.location(f"/{part.link}/position", _place(position))
        attitude = part.logged("ATT")
        angles = (np.deg2rad(attitude.records.number(name)) for name in ("Roll", "Pitch", "Yaw"))
        yield attitude.attitude(foxglove.quaternion_from_euler(*angles))
        for name, edge in (("CAM", "feedback"), ("TRIG", "trigger")):
            yield _exposure(part.logged(name), edge, part)
        texts = part.logged("MSG")
        if "Message" in texts.records:
            yield texts.health({"text": texts.records["Message"]})
        yield part.logged("PARM").parameters("Name", "Value")
        yield part.logged("BAT").battery("Volt", "Curr")

    def _positions(self, part: Part[DataflashFormats]) -> Iterator[Logged]:
        position = part.logged("POS")
        # Logs of before POS have the place beside the attitude of the second filter: good until POS comes.
        second = part.logged("AHR2")
        first = min([0] * self._positions_told + position.records.index.tolist(), default=len(part.batch))
        self._positions_told |= len(position) > 0
        yield second.rows(second.records.index < first)
        yield position


def _receiver(every: Logged, part: Part[DataflashFormats]) -> Iterator[Decoded]:
    instance = every.records.number("I")
    for number in np.unique(instance[np.isfinite(instance)]).tolist() or [-1.0]:
        receiver = "-2" if every.source == "GPS2" else f"-{number + 1:.0f}" if number > 0 else ""
        logged = every.rows(instance == number) if number >= 0 else every
        found = logged.records
        fix = found.number("Status")
        kept = logged.rows(fix >= 2)
        yield kept.location(f"/gnss/{part.link}{receiver}/fix", _place(kept))
        quality = {**logged.whole(satellites="NSats"), "hdop": found.number("HDop")}
        yield logged.status(receiver, fix_names(fix), quality)
        yield logged.clock(_told_utc(found, ("GWk", "Week"), ("GMS", "TimeMS")), part.boot_ns[found.index])


def _place(logged: Logged) -> tuple[Floats, Floats, Floats]:
    found = logged.records
    return found.number("Lat"), found.number("Lng"), found.number("Alt")


def _exposure(logged: Logged, edge: str, part: Part[DataflashFormats]) -> Decoded:
    found = logged.records
    # GPSTime is that of the last fix before: the record's own time is nearer, where it has one.
    own = part.boot_ns[found.index] >= 0
    return logged.exposure(
        edge,
        {
            "time": Times(np.where(own, logged.utc_ns, _told_utc(found, ("GPSWeek",), ("GPSTime",)))),
            "latitude_deg": found.number("Lat"),
            "longitude_deg": found.number("Lng"),
            "altitude_msl_m": found.number("Alt"),
            "roll_deg": found.number("Roll", "R"),
            "pitch_deg": found.number("Pitch", "P"),
            "yaw_deg": found.number("Yaw", "Y"),
            **logged.whole(sequence="Img"),
        },
    )


def _told_utc(found: Records, week_names: tuple[str, ...], millisecond_names: tuple[str, ...]) -> Integers:
    """Return UTC of the GPS times that records tell, nanoseconds since 1970; -1 where they tell none."""
    week, milliseconds = found.number(*week_names), found.number(*millisecond_names)
    told = (week > 0) & (week < 1 << 16) & (milliseconds >= 0)
    gps = week_to_ns(np.where(told, week, 0), np.where(told, milliseconds, 0) * 1e-3)
    return np.where(told, gps_to_utc_ns(gps), -1)
