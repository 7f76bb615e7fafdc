"""Channels decoded from an event list (`Timestamp.MRK`): exposures and the place of the camera at each."""

from __future__ import annotations

import numpy as np

from acquire.channels.decoded import Decoded, Times
from acquire.channels.logged import Logged
from acquire.channels.receiver import ELLIPSOIDAL
from drivers import mrk
from drivers.arrays import Integers
from drivers.frames import Batch
from drivers.gnsstime import gps_to_utc_ns

# Flag of the receiver.
_FIXES = {50: "rtk_fixed", 34: "rtk_float", 16: "3d"}


class EventListClock:
    """Gives each event its UTC."""

    def __init__(self) -> None:
        self.sources: set[str] = set()

    def feed(self, batch: Batch) -> Integers:
        """Return UTC of each frame, nanoseconds since 1970; -1 where it is not told."""
        events = mrk.decode(batch)
        utc = np.full(len(batch), -1, np.int64)
        gps = mrk.event_gps_ns(events)
        utc[events.index] = np.where(gps >= 0, gps_to_utc_ns(gps), -1)
        self.sources |= {"event list"} if (utc >= 0).any() else set()
        return utc

    def restart(self, near_ns: int) -> None:
        """Do nothing: each event tells its whole time."""


class EventListDecoder:
    """Decodes the events of a list; a `Decoder`."""

    def __init__(self, link: str) -> None:
        self._link = link
        self._clock = EventListClock()

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the time of each event and the decoded messages."""
        told = self._clock.feed(batch)
        utc = np.where(told >= 0, told, log_ns)
        events = Logged(self._link, "MRK", mrk.decode(batch), utc)
        if not len(events):
            return utc, []
        found = events.records
        horizontal = np.hypot(found["sigma_north_m"], found["sigma_east_m"])
        place = found["latitude_deg"], found["longitude_deg"], found["height_m"]
        claimed = horizontal, found["sigma_up_m"]
        columns = {
            "sequence": found["number"].astype(np.int64),
            "time": Times(told),
            "latitude_deg": found["latitude_deg"],
            "longitude_deg": found["longitude_deg"],
        }
        quality = {"horizontal_m": horizontal, "vertical_m": found["sigma_up_m"]}
        return utc, [
            events.exposure("feedback", columns),
            events.location(f"/gnss/{self._link}/fix", place, claimed, ELLIPSOIDAL),
            events.status("", [_FIXES.get(int(flag), "3d") for flag in found["flag"].tolist()], quality),
        ]
