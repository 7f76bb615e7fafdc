"""The autopilot's clock and that of the recording computer by TIMESYNC exchanges."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.navigation.device_clocks import (
    AutopilotClock,
    ComparedClocks,
    autopilot_clock,
    device_by_arrival,
    fit_clock,
)
from photocal.navigation.time import GpsTime

# A receiver sends an epoch up to a tenth of a second after it: computation and transmission.
_RECEIVER_LATE_S, _RECEIVER_LATE_SIGMA_S = 0.05, 0.03
Received = tuple[Integers, Integers, NDArray[Any]]


@dataclass(frozen=True)
class TimeSync:
    """Two clocks by exchanges of messages, both ways round.

    host_of_boot, boot_of_host: the recording computer's clock by the autopilot's time since boot, and the
        reverse.
    """

    host_of_boot: ComparedClocks
    boot_of_host: ComparedClocks

    def boot(self, host_ns: Integers) -> tuple[Integers, Floats]:
        """Return the autopilot's time since boot (ns) at moments of the host's clock, and the sigma (s)."""
        time, sigma = self.boot_of_host.cycles[0].convert(host_ns)
        return time, np.hypot(sigma, self.boot_of_host.constant_sigma_s)


def time_sync(boot_ns: Integers, host_ns: Integers, round_trip_ns: Integers) -> TimeSync | None:
    """Fit the recording computer's clock to the autopilot's by TIMESYNC exchanges."""
    if not len(boot_ns):
        return None
    # Answers that took longer than this multiple of the shortest waited in a queue on one way.
    slow_answer = 3.0
    least_trip_ns = 1_000_000
    shortest = max(int(round_trip_ns.min()), least_trip_ns)
    quick = round_trip_ns <= slow_answer * shortest
    boot, trip = boot_ns[quick], round_trip_ns[quick]
    middle = host_ns[quick] - trip // 2
    # A single middle is uncertain by what its trip goes over the shortest.
    resolution = max(float(np.median(trip - round_trip_ns.min())) / 1e9, 1e-4)
    # Clocks of computers are set by milliseconds at a time; what stands out of the scatter by more is a jump.
    jump_trips = 3.0
    jump = jump_trips * shortest / 1e9
    try:
        models = [fit_clock(a, b, resolution, jump) for a, b in ((boot, middle), (middle, boot))]
    except IllPosedError:
        return None
    names = (
        "recording computer by the autopilot's time since boot (TIMESYNC)",
        "autopilot's time since boot by the recording computer (TIMESYNC)",
    )
    constant = float(round_trip_ns.min()) / 1e9 / np.sqrt(12)
    compared = (ComparedClocks(name, (model,), constant) for name, model in zip(names, models, strict=True))
    return TimeSync(*compared)


def clock_through_host(
    boot_ns: Integers, host_ns: Integers, round_trip_ns: Integers, gnss: ComparedClocks
) -> AutopilotClock | None:
    """Return the UTC of an autopilot that does not tell it, by the recording computer and a GNSS receiver."""
    sync = time_sync(boot_ns, host_ns, round_trip_ns)
    if sync is None or sync.host_of_boot.played_back or gnss.played_back:
        return None
    model = sync.host_of_boot.cycles[0]
    boot = np.sort(boot_ns)
    host, _ = model.convert(boot)
    epoch, _ = gnss.cycles[0].convert(host)
    late = round(_RECEIVER_LATE_S * 1e9)
    utc = GpsTime(epoch + late).to_utc().ns
    try:
        fitted = fit_clock(boot, utc, sync.host_of_boot.scatter_s)
    except IllPosedError:
        return None
    constant = float(np.hypot(sync.host_of_boot.constant_sigma_s, _RECEIVER_LATE_SIGMA_S))
    name = "autopilot's UTC by TIMESYNC and the epochs of a GNSS receiver"
    compared = replace(sync.host_of_boot, name=name, cycles=(fitted,), constant_sigma_s=constant)
    return AutopilotClock(compared, host_ns[:1])


@dataclass(frozen=True)
class VehicleClocks:
    """The clocks of a vehicle.

    clock: UTC of its time since boot.
    sync: its time since boot against the recording computer's clock.
    utc_told: whether the autopilot itself told UTC (SYSTEM_TIME).
    """

    clock: AutopilotClock | None = None
    sync: TimeSync | None = None
    compared: tuple[ComparedClocks, ...] = ()
    utc_told: bool = False


def vehicle_clocks(
    system: Received | None, exchanges: Received | None, gnss: ComparedClocks | None
) -> VehicleClocks:
    """Fit an autopilot's clock to UTC and to the recording computer's clock."""
    millisecond_ns = 1_000_000
    # An answer after ten seconds belongs to a question before a restart.
    longest_trip_ns = 10_000_000_000
    clocks: list[ComparedClocks] = []
    clock, synced, utc_told = None, None, False
    if system is not None:
        host, _, fields = system
        boot = fields["time_boot_ms"].astype(np.int64) * millisecond_ns
        utc = fields["time_unix_usec"].astype(np.int64) * 1000
        # A bit error that a checksum of 16 bits passed shows as a time of another year.
        good = utc > 0
        good &= np.abs(utc - np.median(utc[good])) < 86_400 * 10**9 if good.any() else False
        clock = autopilot_clock(boot[good], utc[good], host[good])
        arrival = device_by_arrival(
            "autopilot's UTC by the recording computer's clock (SYSTEM_TIME)", utc[good], host[good]
        )
        clocks += [c for c in (clock.compared if clock else None, arrival) if c is not None]
        utc_told = clock is not None
    if exchanges is not None:
        host, _, fields = exchanges
        trip = host - fields["ts1"]
        answered = (fields["tc1"] > 0) & (trip >= 0) & (trip < longest_trip_ns)
        boot, trip = (values[answered].astype(np.int64) for values in (fields["tc1"], trip))
        synced = time_sync(boot, host[answered], trip)
        clocks += [] if synced is None else [synced.host_of_boot]
        if clock is None and gnss is not None:
            clock = clock_through_host(boot, host[answered], trip, gnss)
            clocks += [] if clock is None else [clock.compared]
    return VehicleClocks(clock, synced, tuple(clocks), utc_told)
