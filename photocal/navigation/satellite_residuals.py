"""What the engine says of each satellite at each epoch: where it stood, and what its phase left over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Floats, Integers
from photocal.navigation.time import WEEK_NS, GpsTime

_FIELDS = 12
_MOST_EPOCHS = 200
_LONGEST_LAG_S = 300.0
_LEAST_EPOCHS = 30
# Windows of several correlation times balance noise and what is cut off (Sokal 1997, section 3).
_WINDOW = 5.0


@dataclass(frozen=True)
class SatelliteResiduals:
    """Satellites used by the engine, one row per epoch, satellite and frequency.

    time: epochs, increasing.
    satellite: such as ``G05``.
    frequency (n,): 1 or 2.
    azimuth, elevation (n,): radians.
    residual_m (n,): of the phase, double differenced: that of the reference satellite is 0.
    """

    time: GpsTime
    satellite: NDArray[np.str_]
    frequency: Integers
    azimuth: Floats
    elevation: Floats
    residual_m: Floats

    def __len__(self) -> int:
        return len(self.time)


def read_satellite_residuals(path: Path) -> SatelliteResiduals:
    """Read the satellites that were used from a status file (RTKLIB manual 2.4.2, appendix B.2).

    A file that the engine did not write tells of none.
    """
    rows: list[list[str]] = []
    if not path.exists():
        return _sights(rows)
    with path.open(encoding="latin-1") as stream:
        for line in stream:
            if line.startswith("$SAT"):
                fields = line.split(",")
                if len(fields) >= _FIELDS and fields[9] == "1":
                    rows.append(fields[1:9])
    return _sights(rows)


def _sights(rows: list[list[str]]) -> SatelliteResiduals:
    week, tow, satellite, frequency, azimuth, elevation, _, residual = (
        zip(*rows, strict=True) if rows else [()] * 8
    )
    seconds = np.array(tow, np.float64)
    ns = np.array(week, np.int64) * WEEK_NS + np.rint(seconds * 1e3).astype(np.int64) * 1_000_000
    return SatelliteResiduals(
        GpsTime(ns),
        np.array(satellite, "U3"),
        np.array(frequency, np.int64),
        np.radians(np.array(azimuth, np.float64)),
        np.radians(np.array(elevation, np.float64)),
        np.array(residual, np.float64),
    )


def shift_by_zenith_delay(satellites: SatelliteResiduals) -> Floats:
    """Return by how much positions move for each metre of zenith delay that is not taken into account."""
    first = satellites.frequency == 1
    epochs = np.unique(satellites.time.ns[first])
    moved = []
    for epoch in epochs[:: max(len(epochs) // _MOST_EPOCHS, 1)].tolist():
        rows = first & (satellites.time.ns == epoch)
        up = np.sin(satellites.elevation[rows])
        level = np.cos(satellites.elevation[rows])
        azimuth = satellites.azimuth[rows]
        system = np.array([name[0] for name in satellites.satellite[rows].tolist()])
        clocks = [(system == letter).astype(float) for letter in np.unique(system)]
        design = np.stack([-np.sin(azimuth) * level, -np.cos(azimuth) * level, -up, *clocks], axis=1)
        if len(design) <= design.shape[1]:
            continue
        weight = 1 / (1 + 1 / up**2)
        normal = design.T @ (design * weight[:, None])
        moved.append(np.linalg.solve(normal, design.T @ (weight / up))[:3])
    return np.median(moved, axis=0) if moved else np.full(3, np.nan)


def correlation_time_s(satellites: SatelliteResiduals) -> float:
    """Return how long errors of the phases last: the integral of their autocorrelation.

    The mean over a time T of errors with the variance s^2 has the variance 2 s^2 t / T with this time t
    (Sokal 1997, eq. 2.20). Residuals are taken less the mean of their system and frequency at each epoch,
    which removes the reference satellite; what correlates the positions' errors is the same multipath.
    """
    epochs, at = np.unique(satellites.time.ns, return_inverse=True)
    if len(epochs) < _LEAST_EPOCHS:
        return float("nan")
    table = _centred(satellites, at, len(epochs))
    step = float(np.median(np.diff(epochs))) / 1e9
    # Epochs a second apart tell enough, and take less time.
    stride = max(round(1.0 / step), 1)
    table, step = table[::stride], step * stride
    known = np.isfinite(table)
    filled = np.where(known, table, 0.0)
    variance = float(np.sum(filled**2)) / max(int(known.sum()), 1)
    if variance == 0:
        return float("nan")
    total = 0.5
    for lag in range(1, min(len(table) // 3, int(_LONGEST_LAG_S / step))):
        together = int(np.sum(known[lag:] & known[:-lag]))
        if not together:
            break
        total += float(np.sum(filled[lag:] * filled[:-lag])) / together / variance
        if lag >= _WINDOW * total:
            break
    return max(total, 0.5) * step


def _centred(satellites: SatelliteResiduals, at: Integers, epochs: int) -> Floats:
    """Return residuals by epoch and signal, less the mean of each system and frequency; NaN where none."""
    signal = np.array([f"{s}{f}" for s, f in zip(satellites.satellite, satellites.frequency, strict=True)])
    names, column = np.unique(signal, return_inverse=True)
    table = np.full((epochs, len(names)), np.nan)
    table[at, column] = satellites.residual_m
    group = np.array([name[0] + name[-1] for name in names.tolist()])
    for own in np.unique(group):
        part = table[:, group == own]
        known = np.isfinite(part)
        count = known.sum(axis=1, keepdims=True)
        mean = np.where(known, part, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
        # Alone, or with one other, a satellite says nothing.
        table[:, group == own] = np.where(count > 2, part - mean, np.nan)
    return table
