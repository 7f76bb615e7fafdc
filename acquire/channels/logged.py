"""Channels of an autopilot's own log: the same topics as those of MAVLink messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoded, JsonLayout, Times
from acquire.channels.layouts import CLOCK, EXPOSURE, GNSS_STATUS, HEALTH, PARAMETER
from acquire.channels.vehicle_messages import FIX_NAMES, SEA_LEVEL
from acquire.log import foxglove
from acquire.log.records import Channel
from drivers.arrays import Flags, Floats, Integers
from drivers.logged import Records


@dataclass(frozen=True)
class Logged:
    """Records of one kind with the link and the name that their messages carry, and their UTC (n,)."""

    link: str
    source: str
    records: Records
    utc_ns: Integers

    def __len__(self) -> int:
        return len(self.records)

    def rows(self, kept: Flags) -> Logged:
        """Return some of the records."""
        return Logged(self.link, self.source, self.records.rows(kept), self.utc_ns[kept])

    def json(self, topic: str, layout: JsonLayout, columns: Mapping[str, Any]) -> Decoded:
        """Return messages of a JSON type."""
        payloads = layout.rows({"link": self.link, "source": self.source, **columns}, len(self))
        channel = Channel(topic, "json", layout.schema())
        return Decoded(channel, payloads, self.records.index, self.utc_ns)

    def location(
        self,
        topic: str,
        place: tuple[Floats, Floats, Floats],
        claimed_m: tuple[Floats, Floats] | None = None,
        height: str = SEA_LEVEL,
    ) -> Decoded:
        """Return positions: latitude, longitude (deg), height (m), claimed accuracy in plane and height."""
        lat, lon, up = place
        there = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(up) & ((lat != 0) | (lon != 0))
        there &= (np.abs(lat) <= 90) & (np.abs(lon) <= 360)
        unknown = np.full(len(lat), np.nan)
        horizontal, vertical = claimed_m or (unknown, unknown)
        utc = self.utc_ns[there]
        payloads = foxglove.location_fixes(
            f"{self.link}/body_frd",
            utc,
            lat[there],
            lon[there],
            up[there],
            horizontal[there],
            vertical[there],
        )
        metadata = {"source": self.source, "height": height}
        channel = Channel(topic, "protobuf", foxglove.schema("foxglove.LocationFix"), metadata)
        return Decoded(channel, payloads, self.records.index[there], utc)

    def attitude(self, quaternion_xyzw: Floats) -> Decoded:
        """Return rotations from body to north-east-down; those with a number missing are left out."""
        there = np.isfinite(quaternion_xyzw).all(axis=1)
        utc = self.utc_ns[there]
        payloads = foxglove.frame_transforms(
            f"{self.link}/local_ned", f"{self.link}/body_frd", utc, quaternion_xyzw[there]
        )
        metadata = {"source": self.source, "rotation": "body forward-right-down to north-east-down"}
        schema = foxglove.schema("foxglove.FrameTransform")
        channel = Channel(f"/{self.link}/attitude", "protobuf", schema, metadata)
        return Decoded(channel, payloads, self.records.index[there], utc)

    def whole(self, **members: str) -> dict[str, Integers]:
        """Return members that count something under names of ours, where every record has a number."""
        found = {name: self.records.number(member) for name, member in members.items()}
        return {name: v.astype(np.int64) for name, v in found.items() if np.isfinite(v).all()}

    def status(self, receiver: str, fix: list[str], columns: Mapping[str, Any]) -> Decoded:
        """Return the quality of the fixes of a receiver."""
        told = {"time": Times(self.utc_ns), "fix": fix, **columns}
        return self.json(f"/gnss/{self.link}{receiver}/status", GNSS_STATUS, told)

    def exposure(self, edge: str, columns: Mapping[str, Any]) -> Decoded:
        """Return exposures; `columns` may have a better time than that of the records."""
        return self.json("/camera/exposure", EXPOSURE, {"edge": edge, "time": Times(self.utc_ns), **columns})

    def clock(self, device_utc_ns: Integers, boot_ns: Integers) -> Decoded:
        """Return UTC of a receiver beside the running time of the autopilot."""
        columns = {"device": Times(device_utc_ns), "boot_s": boot_ns / 1e9}
        return self.json("/clock", CLOCK, columns)

    def battery(self, voltage: str, current: str) -> Decoded:
        """Return the state of the battery from members in V and A."""
        found = self.records.number(voltage), self.records.number(current)
        return self.health(dict(zip(("voltage_v", "current_a"), found, strict=True)))

    def parameters(self, name: str, value: str) -> Decoded:
        """Return the autopilot's parameters from members with their names and values."""
        logged = self if name in self.records else self.rows(np.zeros(len(self), bool))
        columns = {"name": logged.records.columns.get(name, ()), "value": logged.records.number(value)}
        return logged.json(f"/{self.link}/parameter", PARAMETER, columns)

    def health(self, columns: Mapping[str, Any]) -> Decoded:
        """Return texts and the state of the battery."""
        return self.json("/health", HEALTH, columns)


def fix_names(types: Floats) -> list[str]:
    """Return the names of types of fixes as MAVLink's GPS_RAW_INT and both logs number them; NaN is none."""
    last = len(FIX_NAMES) - 1
    return [FIX_NAMES[min(int(v), last)] if v == v else FIX_NAMES[0] for v in types.tolist()]
