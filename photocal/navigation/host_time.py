"""The autopilot's time at moments that only the recording computer noted."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from photocal.navigation.time import GpsTime, HostTime, UtcTime
from photocal.navigation.vehicle import VehicleTrack


def autopilot_time(track: VehicleTrack, host: HostTime) -> tuple[GpsTime, Floats]:
    """Return the autopilot's time at moments of the recording computer's clock, and its sigma (s).

    By TIMESYNC exchanges where there are some. Else: between two messages that arrived around a moment the
    autopilot's clock is taken to run evenly: so an uneven playback does no harm beyond the distance of the
    messages.
    """
    if track.sync is not None and track.clock is not None and not track.sync.host_of_boot.played_back:
        boot, sigma = track.sync.boot(host.ns)
        utc, more = track.clock.utc(boot, host.ns)
        return UtcTime(utc).to_gps(), np.hypot(sigma, more)
    arrival = track.position_host.ns
    order = np.argsort(arrival, kind="stable")
    arrival, device = arrival[order], track.position_time.ns[order]
    after = np.clip(np.searchsorted(arrival, host.ns, side="right"), 1, max(len(arrival) - 1, 1))
    before = after - 1
    span = np.maximum(arrival[after] - arrival[before], 1)
    share = (host.ns - arrival[before]) / span
    step = device[after] - device[before]
    time = device[before] + np.rint(share * step).astype(np.int64)
    inside = (host.ns >= arrival[0]) & (host.ns <= arrival[-1])
    return GpsTime(time), np.where(inside, np.abs(step) / 4e9, np.inf)
