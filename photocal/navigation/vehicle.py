"""What the autopilot itself recorded: its positions and attitudes, by its own clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.log.reader import LogReader
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import ardupilotmega
from photocal.navigation.time import GpsTime, HostTime, UtcTime

Floats = NDArray[np.float64]
_STRAY_NS = 5_000_000_000


@dataclass(frozen=True)
class VehicleTrack:
    """Positions and attitudes of the first autopilot of a log, in the order of its own clock.

    Parameters
    ----------
    position_time, attitude_time : GpsTime (n,), (m,)
        By the autopilot's clock, never by arrival.
    position_host : HostTime (n,)
        Arrival of the positions.
    lat_deg, lon_deg, height_msl_m, height_rel_m : float64 (n,)
        Height above sea level as the autopilot computes it, and above the take-off.
    angles : float64 (m, 3)
        Roll, pitch, yaw of the body (forward, right, down) in north, east, down; radians.
    untimed : int
        Messages without a time of the autopilot, left out.
    """

    position_time: GpsTime
    position_host: HostTime
    lat_deg: Floats
    lon_deg: Floats
    height_msl_m: Floats
    height_rel_m: Floats
    attitude_time: GpsTime
    angles: Floats
    untimed: int


def read_vehicle(path: Path) -> VehicleTrack:
    """Read GLOBAL_POSITION_INT and ATTITUDE from the raw frames of a flight log."""
    dialect = ardupilotmega()
    kinds = {name: dialect.number(name) for name in ("GLOBAL_POSITION_INT", "ATTITUDE")}
    found: dict[str, list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]]] = {k: [] for k in kinds}
    owner: int | None = None
    untimed = 0
    for chunk in LogReader(path).chunks():
        for messages in chunk:
            if messages.channel.encoding != Wire.MAVLINK.encoding:
                continue
            batch = batch_of_payloads(Wire.MAVLINK, messages.payloads, dialect)
            for name, kind in kinds.items():
                got = decode(batch, kind, dialect)
                if not len(got):
                    continue
                owner = int(got.system[0]) if owner is None else owner
                host, device = messages.log_ns[got.index], messages.publish_ns[got.index]
                own = got.system == owner
                # Where the device told no time the log repeats the time of arrival.
                timed = own & (host != device)
                untimed += int((own & ~timed).sum())
                found[name].append((host[timed], device[timed], got.fields[timed]))
    host, position_utc, p = _joined(found["GLOBAL_POSITION_INT"])
    _, attitude_utc, a = _joined(found["ATTITUDE"])
    empty = np.empty(0)
    scale = {"lat": 1e-7, "lon": 1e-7, "alt": 1e-3, "relative_alt": 1e-3}
    columns = {name: empty if p is None else p[name] * unit for name, unit in scale.items()}
    angles = (
        np.empty((0, 3))
        if a is None
        else np.stack([a[name].astype(float) for name in ("roll", "pitch", "yaw")], axis=1)
    )
    return VehicleTrack(
        UtcTime(position_utc).to_gps(),
        HostTime(host),
        columns["lat"],
        columns["lon"],
        columns["alt"],
        columns["relative_alt"],
        UtcTime(attitude_utc).to_gps(),
        angles,
        untimed,
    )


def _joined(
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any] | None]:
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.int64), None
    host, device, fields = (np.concatenate(column) for column in zip(*parts, strict=True))
    kept = np.flatnonzero(~_strays(device))
    _, first = np.unique(device[kept], return_index=True)
    rows = kept[first]
    return host[rows], device[rows], fields[rows]


def _strays(device: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which single times stand out of the order of arrival: damage that a checksum of 16 bits passed.

    In a sequence that grows the middle of five is its own median.
    """
    if len(device) < 5:
        return np.zeros(len(device), bool)
    padded = np.concatenate([device[:1].repeat(2), device, device[-1:].repeat(2)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5)
    return np.asarray(np.abs(device - np.median(windows, axis=1).astype(np.int64)) > _STRAY_NS)


def autopilot_time(track: VehicleTrack, host: HostTime) -> tuple[GpsTime, Floats]:
    """Return the autopilot's time at moments of the recording computer's clock, and its sigma (s).

    Between two messages that arrived around a moment the autopilot's clock is taken to run evenly: so an
    uneven playback does no harm beyond the distance of the messages.

    Returns
    -------
    time : GpsTime (n,)
    sigma_s : float64 (n,)
        A quarter of the autopilot's time between the two messages; infinite outside the log.
    """
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


def attitude_at(track: VehicleTrack, time: GpsTime, largest_gap_s: float = 1.5) -> Floats:
    """Return roll, pitch, yaw (rad) by spherical interpolation; NaN where no attitude is near (n, 3)."""
    from scipy.spatial.transform import Rotation, Slerp

    stamps = track.attitude_time.ns
    angles = np.full((len(time), 3), np.nan)
    if len(stamps) < 2:
        return angles
    after = np.clip(np.searchsorted(stamps, time.ns, side="right"), 1, len(stamps) - 1)
    gap = (stamps[after] - stamps[after - 1]) / 1e9
    near = (time.ns >= stamps[0]) & (time.ns <= stamps[-1]) & (gap <= largest_gap_s)
    seconds = (stamps - stamps[0]) / 1e9
    turns = Rotation.from_euler("ZYX", track.angles[:, ::-1])
    if near.any():
        between = Slerp(seconds, turns)((time.ns[near] - stamps[0]) / 1e9)
        angles[near] = between.as_euler("ZYX")[:, ::-1]
    return angles
