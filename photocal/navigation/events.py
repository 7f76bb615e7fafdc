"""Moments at which a camera exposed, by whoever noted them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.log.reader import LogReader
from drivers.errors import InputMalformedError
from drivers.gnsstime import GPS_EPOCH_NS, SECOND_NS, week_to_ns
from photocal.navigation.time import GpsTime, UtcTime

Floats = NDArray[np.float64]
RISING, FALLING = "rising", "falling"
_NEW_FALLING, _TIME_VALID, _NEW_RISING, _BASE_SHIFT = 0x04, 0x40, 0x80, 3
_BASE_RECEIVER, _BASE_GNSS, _BASE_UTC = 0, 1, 2
_COUNTER = 1 << 16


@dataclass(frozen=True)
class Events:
    """Exposures in the order of time.

    Parameters
    ----------
    source : str
        What noted them, for example ``TIM-TM2 rising of rover``.
    time : GpsTime (n,)
        When.
    number : int64 (n,)
        The device's own count.
    accuracy_s : float64 (n,)
        Accuracy of the time that the device claims; 0 where it claims none.
    remarks : list of str
        What is odd: jumps of the counter, edges without a time.
    """

    source: str
    time: GpsTime
    number: NDArray[np.int64]
    accuracy_s: Floats
    remarks: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.time)

    def delayed(self, delay_s: float) -> Events:
        """Return the exposures themselves, `delay_s` after what was noted (trigger, cable, shutter)."""
        shift = np.full(len(self), round(delay_s * 1e9), np.int64)
        return Events(self.source, self.time.shifted(shift), self.number, self.accuracy_s, self.remarks)


def time_marks(fields: NDArray[Any], edge: str, link: str, leap_s: int | None = None) -> Events:
    """Return the events of one edge from RXM-TIM-TM2 messages.

    Parameters
    ----------
    fields : structured array (n,)
        Fields by the names of the interface description, in the order of the recording.
    edge : str
        ``rising`` or ``falling``.
    link : str
        Whose they are.
    leap_s : int, optional
        GPS time minus UTC where the table has ended.

    Returns
    -------
    Events
        With jumps of the counter in the remarks. Several edges between two epochs of navigation come as
        several messages, of which each brings at most one new edge of a kind.

    Raises
    ------
    InputMalformedError
        When the marks are in the receiver's own time, which nothing ties to GPS time.
    """
    letter, bit = ("R", _NEW_RISING) if edge == RISING else ("F", _NEW_FALLING)
    new = fields[(fields["flags"] & bit) != 0]
    base = new["flags"] >> _BASE_SHIFT & 3
    valid = ((new["flags"] & _TIME_VALID) != 0) & (new[f"wn{letter}"] > 0)
    own = valid & (base == _BASE_RECEIVER)
    if own.any():
        raise InputMalformedError(
            f"{int(own.sum())} time marks are in the receiver's own time base",
            where=f"link {link}",
            remedy="set the time base of CFG-TIMEx or TIM-TM2 to GNSS or UTC",
        )
    stamp = week_to_ns(new[f"wn{letter}"], 0.0)
    stamp = stamp + new[f"towMs{letter}"].astype(np.int64) * 1_000_000 + new[f"towSubMs{letter}"]
    gps = stamp.copy()
    utc = valid & (base == _BASE_UTC)
    if utc.any():
        # The week and its milliseconds count UTC from the GPS epoch: the leap seconds are missing in them.
        gps[utc] = UtcTime(stamp[utc] + GPS_EPOCH_NS).to_gps(leap_s).ns
    remarks = counter_jumps(new["count"].astype(np.int64), edge)
    if not valid.all():
        remarks.append(f"{int((~valid).sum())} {edge} edges without a valid time left out")
    bases = {int(v) for v in np.unique(base[valid]).tolist()}
    remarks.append("time base " + " and ".join({1: "GNSS", 2: "UTC"}.get(b, str(b)) for b in sorted(bases)))
    kept = np.flatnonzero(valid)
    order = kept[np.argsort(gps[kept], kind="stable")]
    accuracy = new["accEst"][order] * 1e-9
    number = new["count"][order].astype(np.int64)
    return Events(
        f"TIM-TM2 {edge} of {link}",
        GpsTime(gps[order]),
        number,
        accuracy,
        remarks,
    )


def counter_jumps(count: NDArray[np.int64], edge: str) -> list[str]:
    """Return a sentence for each place where a counter (modulo 65536) does not go on by one."""
    step = np.diff(count) % _COUNTER
    # Falling edges share the counter of the rising ones: a step of 0 between them is no loss.
    return [
        f"{edge} edges: the counter goes from {int(count[i])} to {int(count[i + 1])}, "
        f"{int(step[i]) - 1} missing"
        for i in np.flatnonzero(step > 1).tolist()
    ]


def logged_exposures(path: Path) -> list[Events]:
    """Return the exposures that autopilot or camera reported in a flight log, one `Events` per message.

    Exposures without a device time are left out and counted: the time of receipt is not that of the
    exposure.
    """
    found: dict[str, list[tuple[int, int, int]]] = {}
    untimed: dict[str, int] = {}
    for chunk in LogReader(path).chunks():
        for messages in chunk:
            if messages.channel.topic != "/camera/exposure":
                continue
            rows = zip(messages.payloads, messages.log_ns.tolist(), messages.publish_ns.tolist(), strict=True)
            for payload, log_ns, publish_ns in rows:
                row = json.loads(payload)
                source = str(row["source"])
                if source == "TIM-TM2":
                    continue
                found.setdefault(source, [])
                time = row.get("time")
                if time is None or log_ns == publish_ns:
                    untimed[source] = untimed.get(source, 0) + 1
                    continue
                ns = int(time["sec"]) * SECOND_NS + int(time["nsec"])
                found[source].append((ns, int(row.get("sequence", -1)), int(row.get("accuracy_ns") or 0)))
    return [_logged(source, rows, untimed.get(source, 0)) for source, rows in found.items()]


def _logged(source: str, rows: Iterable[tuple[int, int, int]], untimed: int) -> Events:
    table = np.array(sorted(rows), np.int64).reshape(-1, 3)
    remarks = counter_jumps(table[:, 1], source)
    if untimed:
        remarks.append(f"{source}: {untimed} exposures without a device time left out")
    time = UtcTime(table[:, 0]).to_gps()
    return Events(source, time, table[:, 1], np.asarray(table[:, 2] * 1e-9, np.float64), remarks)
