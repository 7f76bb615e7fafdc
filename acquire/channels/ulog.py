"""Channels decoded from a PX4 log: position, attitude, GNSS, exposures, clock and health."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.boot_time import BootTime
from acquire.channels.decoded import Decoded, Times, in_order
from acquire.channels.logged import Logged
from acquire.channels.vehicle_messages import FIX_NAMES
from drivers.frames import Batch
from drivers.ulog import UlogFormats

_RECEIVERS = {"vehicle_gps_position": "", "sensor_gps": "-sensor", "sensor_gps[1]": "-sensor-2"}


class UlogDecoder:
    """Decodes the records of a PX4 log; a `Decoder`.

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
        self._formats = UlogFormats()

    def feed(self, batch: Batch, log_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        self._formats.learn(batch)
        boot = self._formats.boot_ns(batch)
        utc = np.where(boot >= 0, self._boot.of(boot), log_ns)
        return utc, in_order(self._decoded(batch, utc, boot))

    def _decoded(self, batch: Batch, utc: NDArray[np.int64], boot: NDArray[np.int64]) -> Iterator[Decoded]:
        for topic, receiver in _RECEIVERS.items():
            yield from self._receiver(self._logged(batch, topic, utc), receiver, boot)
        position = self._logged(batch, "vehicle_global_position", utc)
        found = position.records
        place = found.number("lat"), found.number("lon"), found.number("alt")
        yield position.location(f"/{self._link}/position", place)
        attitude = self._logged(batch, "vehicle_attitude", utc)
        wxyz = _quaternion(attitude)
        # PX4 turns body vectors (forward, right, down) into north, east, down, as the log does.
        yield attitude.attitude(wxyz[:, [1, 2, 3, 0]])
        for topic, edge in (("camera_capture", "feedback"), ("camera_trigger", "trigger")):
            yield _exposure(self._logged(batch, topic, utc), edge)
        yield from self._health(batch, utc)

    def _logged(self, batch: Batch, topic: str, utc: NDArray[np.int64]) -> Logged:
        records = self._formats.decode(batch, topic)
        return Logged(self._link, topic, records, utc[records.index])

    def _receiver(self, logged: Logged, receiver: str, boot: NDArray[np.int64]) -> Iterator[Decoded]:
        found = logged.records
        if not len(found):
            return
        fix = found.number("fix_type")
        kept = logged.rows(fix >= 2)
        claimed = kept.records.number("eph"), kept.records.number("epv")
        yield kept.location(f"/gnss/{self._link}{receiver}/fix", _gps_place(kept), claimed)
        names = [FIX_NAMES[min(int(v), len(FIX_NAMES) - 1)] if v == v else "none" for v in fix.tolist()]
        satellites = found.number("satellites_used")
        columns = {"satellites": satellites.astype(np.int64)} if np.isfinite(satellites).all() else {}
        quality = {
            "hdop": found.number("hdop"),
            "horizontal_m": found.number("eph"),
            "vertical_m": found.number("epv"),
        }
        yield logged.status(receiver, names, {**columns, **quality})
        utc_us = found.number("time_utc_usec")
        known = (utc_us > 0) & (utc_us < 4_102_444_800e6)
        device = np.where(known, np.where(known, utc_us, 0).astype(np.int64) * 1000, -1)
        yield logged.clock(device, boot[found.index])

    def _health(self, batch: Batch, utc: NDArray[np.int64]) -> Iterator[Decoded]:
        texts = self._formats.texts(batch)
        logged = Logged(self._link, "logging", texts, utc[texts.index])
        if len(logged):
            yield logged.health({"severity": texts["severity"], "text": texts["text"]})
        battery = self._logged(batch, "battery_status", utc)
        if len(battery):
            volt, current = battery.records.number("voltage_v"), battery.records.number("current_a")
            yield battery.health({"voltage_v": volt, "current_a": current})


def _gps_place(logged: Logged) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    found = logged.records
    if "latitude_deg" in found:  # since 1.15
        height = found.number("altitude_msl_m")
        return found.number("latitude_deg"), found.number("longitude_deg"), height
    return found.number("lat") * 1e-7, found.number("lon") * 1e-7, found.number("alt") * 1e-3


def _quaternion(logged: Logged) -> NDArray[np.float64]:
    found = logged.records
    if "q" not in found or found["q"].shape[1:] != (4,):
        return np.full((len(found), 4), np.nan)
    with np.errstate(invalid="ignore"):  # a damaged number may be a signalling NaN
        return np.asarray(found["q"], float)


def _exposure(logged: Logged, edge: str) -> Decoded:
    found = logged.records
    utc_us = found.number("timestamp_utc")
    told = (utc_us > 946_684_800e6) & (utc_us < 4_102_444_800e6)
    gps = np.where(told, utc_us, 0).astype(np.int64) * 1000
    columns: dict[str, Any] = {"time": Times(np.where(told, gps, logged.utc_ns))}
    sequence = found.number("seq")
    if np.isfinite(sequence).all():
        columns["sequence"] = sequence.astype(np.int64)
    names = {"latitude_deg": "lat", "longitude_deg": "lon", "altitude_msl_m": "alt"}
    columns |= {name: found.number(member) for name, member in names.items() if member in found}
    return logged.exposure(edge, columns)
