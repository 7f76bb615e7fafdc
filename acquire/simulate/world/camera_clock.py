"""What the camera's own clock says of its pictures."""

from __future__ import annotations

import datetime as dt

import numpy as np

from acquire.simulate.world.world import World


def stamps(world: World) -> list[dt.datetime]:
    """Give the time that the camera writes into each picture: offset, drift, jitter, cut to milliseconds."""
    given, random = world.configuration.pictures, world.random("pictures")
    event = world.exposures.event_s
    jitter = np.abs(random.standard_normal(len(event))) * given.clock_jitter_s
    told = event * (1 + given.clock_drift_ppm * 1e-6) + given.clock_offset_s + jitter
    unit_s = 1e-3 if given.subseconds else 1.0
    start = world.configuration.place.start_utc.astimezone(dt.UTC).replace(tzinfo=None)
    whole = np.floor(told / unit_s).astype(int).tolist()
    return [start + dt.timedelta(seconds=count * unit_s) for count in whole]
