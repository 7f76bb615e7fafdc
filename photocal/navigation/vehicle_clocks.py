"""What tells an autopilot's time: SYSTEM_TIME, else TIMESYNC with a GNSS receiver on the same computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Integers
from photocal.navigation.device_clocks import (
    AutopilotClock,
    ComparedClocks,
    autopilot_clock,
    device_by_arrival,
)
from photocal.navigation.time_sync import TimeSync, clock_through_host, time_sync

Received = tuple[Integers, Integers, NDArray[Any]]
_MILLISECOND_NS = 1_000_000
_LONGEST_TRIP_NS = 10_000_000_000


@dataclass(frozen=True)
class VehicleClocks:
    """The clocks of a vehicle.

    clock: UTC of its time since boot.
    sync: its time since boot against the recording computer's clock.
    compared: all that were compared.
    told: whether the autopilot itself told UTC (SYSTEM_TIME).
    """

    clock: AutopilotClock | None
    sync: TimeSync | None
    compared: list[ComparedClocks]
    told: bool


def vehicle_clocks(
    system: Received | None, exchanges: Received | None, gnss: ComparedClocks | None
) -> VehicleClocks:
    """Fit an autopilot's clock to UTC and to the recording computer's clock."""
    clocks: list[ComparedClocks] = []
    clock, synced, told = None, None, False
    if system is not None:
        host, _, fields = system
        boot = fields["time_boot_ms"].astype(np.int64) * _MILLISECOND_NS
        utc = fields["time_unix_usec"].astype(np.int64) * 1000
        # A bit error that a checksum of 16 bits passed shows as a time of another year.
        good = utc > 0
        good &= np.abs(utc - np.median(utc[good])) < 86_400 * 10**9 if good.any() else False
        clock = autopilot_clock(boot[good], utc[good], host[good])
        arrival = device_by_arrival(
            "autopilot's UTC by the recording computer's clock (SYSTEM_TIME)",
            utc[good],
            host[good],
        )
        clocks += [c for c in (clock.compared if clock else None, arrival) if c is not None]
        told = clock is not None
    if exchanges is not None:
        host, _, fields = exchanges
        trip = host - fields["ts1"]
        answered = (fields["tc1"] > 0) & (trip >= 0) & (trip < _LONGEST_TRIP_NS)
        boot, trip = (values[answered].astype(np.int64) for values in (fields["tc1"], trip))
        synced = time_sync(boot, host[answered], trip)
        clocks += [] if synced is None else [synced.host_of_boot]
        if clock is None and gnss is not None:
            clock = clock_through_host(boot, host[answered], trip, gnss)
            clocks += [] if clock is None else [clock.compared]
    return VehicleClocks(clock, synced, clocks, told)
