"""Channels decoded from a DataFlash log: position, attitude, GNSS, exposures, clock and health."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.boot_time import BootTime
from acquire.channels.decoded import Decoded, Times, in_order
from acquire.channels.logged import Logged
from acquire.channels.vehicle_messages import FIX_NAMES
from acquire.log import foxglove
from drivers.dataflash import DataflashFormats
from drivers.frames import Batch
from drivers.gnsstime import gps_to_utc_ns, week_to_ns


class DataflashDecoder:
    """Decodes the records of a DataFlash log; a `Decoder`.

    Parameters
    ----------
    link : str
        Name of the link.
    boot : BootTime
        When the autopilot started.
    """

    def __init__(self, link: str, boot: BootTime) -> None:
        self._link = link
        self._boot = boot
        self._formats = DataflashFormats()
        self._positions_told = False

    def feed(self, batch: Batch, log_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        self._formats.learn(batch)
        boot = self._formats.boot_ns(batch)
        utc = np.where(boot >= 0, self._boot.of(boot), log_ns)
        return utc, in_order(self._decoded(batch, utc, boot))

    def _decoded(self, batch: Batch, utc: NDArray[np.int64], boot: NDArray[np.int64]) -> Iterator[Decoded]:
        for name in ("GPS", "GPS2"):
            yield from self._receiver(self._logged(batch, name, utc), boot)
        for position in self._positions(batch, utc):
            yield position.location(f"/{self._link}/position", _place(position))
        attitude = self._logged(batch, "ATT", utc)
        angles = (np.deg2rad(attitude.records.number(name)) for name in ("Roll", "Pitch", "Yaw"))
        yield attitude.attitude(foxglove.quaternion_from_euler(*angles))
        for name, edge in (("CAM", "feedback"), ("TRIG", "trigger")):
            yield _exposure(self._logged(batch, name, utc), edge, boot)
        yield from self._health(batch, utc)

    def _positions(self, batch: Batch, utc: NDArray[np.int64]) -> Iterator[Logged]:
        position = self._logged(batch, "POS", utc)
        # Logs of before POS have the place beside the attitude of the second filter: good until POS comes.
        second = self._logged(batch, "AHR2", utc)
        first = min([0] * self._positions_told + position.records.index.tolist(), default=len(batch))
        self._positions_told |= len(position) > 0
        yield second.rows(second.records.index < first)
        yield position

    def _logged(self, batch: Batch, name: str, utc: NDArray[np.int64]) -> Logged:
        records = self._formats.decode(batch, name)
        return Logged(self._link, name, records, utc[records.index])

    def _receiver(self, every: Logged, boot: NDArray[np.int64]) -> Iterator[Decoded]:
        instance = every.records.number("I")
        for number in np.unique(instance[np.isfinite(instance)]).tolist() or [-1.0]:
            receiver = "-2" if every.source == "GPS2" else f"-{number + 1:.0f}" if number > 0 else ""
            logged = every.rows(instance == number) if number >= 0 else every
            found = logged.records
            fixed = found.number("Status") >= 2
            kept = logged.rows(fixed)
            yield kept.location(f"/gnss/{self._link}{receiver}/fix", _place(kept))
            names = [FIX_NAMES[min(int(v), len(FIX_NAMES) - 1)] for v in found.number("Status").tolist()]
            satellites = found.number("NSats")
            columns = {"satellites": satellites.astype(np.int64)} if np.isfinite(satellites).all() else {}
            yield logged.status(receiver, names, {**columns, "hdop": found.number("HDop")})
            week, tow = found.number("GWk", "Week"), found.number("GMS", "TimeMS")
            told = (week > 0) & (week < 1 << 16) & (tow >= 0)
            device = np.where(told, _gps_utc(np.where(told, week, 0), np.where(told, tow, 0)), -1)
            yield logged.clock(device, boot[found.index])

    def _health(self, batch: Batch, utc: NDArray[np.int64]) -> Iterator[Decoded]:
        texts = self._logged(batch, "MSG", utc)
        if len(texts) and "Message" in texts.records:
            yield texts.health({"text": texts.records["Message"]})
        battery = self._logged(batch, "BAT", utc)
        if len(battery):
            volt, current = battery.records.number("Volt"), battery.records.number("Curr")
            yield battery.health({"voltage_v": volt, "current_a": current})


def _place(logged: Logged) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    found = logged.records
    return found.number("Lat"), found.number("Lng"), found.number("Alt")


def _exposure(logged: Logged, edge: str, boot: NDArray[np.int64]) -> Decoded:
    found = logged.records
    week, tow = found.number("GPSWeek"), found.number("GPSTime")
    told = (week > 0) & (week < 1 << 16) & (tow >= 0)
    gps = _gps_utc(np.where(told, week, 0), np.where(told, tow, 0))
    # GPSTime is that of the last fix before: the record's own time is nearer, where it has one.
    own = boot[found.index] >= 0
    columns: dict[str, Any] = {
        "time": Times(np.where(own, logged.utc_ns, np.where(told, gps, -1))),
        "latitude_deg": found.number("Lat"),
        "longitude_deg": found.number("Lng"),
        "altitude_msl_m": found.number("Alt"),
        "roll_deg": found.number("Roll", "R"),
        "pitch_deg": found.number("Pitch", "P"),
        "yaw_deg": found.number("Yaw", "Y"),
    }
    numbered = found.number("Img")
    if np.isfinite(numbered).all():
        columns["sequence"] = numbered.astype(np.int64)
    return logged.exposure(edge, columns)


def _gps_utc(week: NDArray[np.float64], milliseconds: NDArray[np.float64]) -> NDArray[np.int64]:
    return gps_to_utc_ns(week_to_ns(week, milliseconds * 1e-3))
