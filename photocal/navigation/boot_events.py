"""Exposures that an autopilot noted by its time since boot alone, placed by its clock."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Integers
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import ardupilotmega
from photocal.navigation.device_clocks import AutopilotClock
from photocal.navigation.events import Events, counter_jumps
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.time import UtcTime

# Member with the time, its unit in nanoseconds, and the member with the count.
_KINDS = {
    "CAMERA_FEEDBACK": ("time_usec", 1000, "img_idx"),
    "CAMERA_TRIGGER": ("time_usec", 1000, "seq"),
    "CAMERA_IMAGE_CAPTURED": ("time_boot_ms", 1_000_000, "image_index"),
}
# From 2000 on a time is UTC, below it counts from the start of the autopilot.
_EARLIEST_UTC_NS = 946_684_800 * 1_000_000_000


def boot_exposures(log: FlightLog, link: str | None, clock: AutopilotClock) -> dict[str, Events]:
    """Return the exposures whose only device time is that since boot, by the message that told them."""
    dialect = ardupilotmega()
    found: dict[str, list[tuple[Integers, Integers, Integers]]] = {}
    for _, messages in log.raw(Wire.MAVLINK, link=link):
        batch = batch_of_payloads(Wire.MAVLINK, messages.payloads, dialect)
        for name, (member, unit_ns, count) in _KINDS.items():
            got = decode(batch, dialect.number(name), dialect)
            boot = got.fields[member].astype(np.int64) * unit_ns
            own = boot < _EARLIEST_UTC_NS
            if name == "CAMERA_IMAGE_CAPTURED":
                own &= got.fields["time_utc"] == 0
            if own.any():
                number = got.fields[count].astype(np.int64)
                found.setdefault(name, []).append((boot[own], messages.log_ns[got.index][own], number[own]))
    joined = {
        name: [np.concatenate(column) for column in zip(*parts, strict=True)] for name, parts in found.items()
    }
    return {name: _placed(name, boot, host, number, clock) for name, (boot, host, number) in joined.items()}


def _placed(name: str, boot: Integers, host: Integers, number: Integers, clock: AutopilotClock) -> Events:
    utc, sigma = clock.utc(boot, host)
    # An exposure that came twice, over two links, counts once.
    _, first = np.unique(np.stack([boot, number]), axis=1, return_index=True)
    order = first[np.argsort(utc[first], kind="stable")]
    remarks = [*counter_jumps(number[order], name), f"{name}: placed by {clock.compared.name}"]
    return Events(name, UtcTime(utc[order]).to_gps(), number[order], sigma[order], remarks)
