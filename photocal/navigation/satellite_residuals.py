"""What satellites show: how long errors last, how the air moves positions, and what floats are off."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Floats, Integers
from photocal.navigation.engine import SEARCHED_DEG, Mode
from photocal.navigation.time import WEEK_NS, GpsTime

# The engine's weights of codes at the zenith, m, of one receiver (its options stats-errphase and
# stats-eratio1), and by how much it trusts GLONASS less.
_CODE_M, _GLONASS = 0.3, 1.5
# So many stretches of each length are examined.
_MOST_STRETCHES = 200


@dataclass(frozen=True)
class SatelliteResiduals:
    """Satellites used by the engine, one row per epoch, satellite and frequency.

    satellite: such as ``G05``.
    frequency (n,): 1 or 2.
    azimuth, elevation (n,): radians.
    residual_m, code_m (n,): of phase and code, double differenced: those of the reference satellite are 0.
    """

    time: GpsTime
    satellite: NDArray[np.str_]
    frequency: Integers
    azimuth: Floats
    elevation: Floats
    residual_m: Floats
    code_m: Floats

    def __len__(self) -> int:
        return len(self.time)


def read_satellite_residuals(path: Path) -> SatelliteResiduals:
    """Read the satellites that were used from a status file (RTKLIB manual 2.4.2, appendix B.2)."""
    least_fields = 12
    rows: list[list[str]] = []
    # A file that the engine did not write tells of none.
    if path.exists():
        with path.open(encoding="latin-1") as stream:
            records = (line.split(",") for line in stream if line.startswith("$SAT"))
            rows = [fields[1:9] for fields in records if len(fields) >= least_fields and fields[9] == "1"]
    week, tow, satellite, frequency, azimuth, elevation, code, residual = (
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
        np.array(code, np.float64),
    )


def satellite_residuals(mode: Mode, rover: Path, folder: Path) -> SatelliteResiduals:
    """Return the satellites of the forward run with the base that `solve` has done in the folder."""
    return read_satellite_residuals(folder / f"{rover.stem}-{mode}-forward.pos.stat")


def shift_by_zenith_delay(satellites: SatelliteResiduals) -> Floats:
    """Return by how much positions move for each metre of zenith delay that is not taken into account."""
    first = (satellites.frequency == 1) & (satellites.elevation >= np.radians(SEARCHED_DEG))
    epochs = np.unique(satellites.time.ns[first])
    moved = []
    most_epochs = 200
    for epoch in epochs[:: max(len(epochs) // most_epochs, 1)].tolist():
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
    """Return how long errors of the phases last: the integral of their autocorrelation."""
    # The mean over a time T of errors with the variance s^2 has the variance 2 s^2 t / T with this time t
    # (Sokal 1997, eq. 2.20). Residuals are taken less the mean of their system and frequency at each epoch,
    # which removes the reference satellite; what correlates the positions' errors is the same multipath.
    epochs, at = np.unique(satellites.time.ns, return_inverse=True)
    least_epochs = 30
    if len(epochs) < least_epochs:
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
    longest_lag_s = 300.0
    # Windows of several correlation times balance noise and what is cut off (Sokal 1997, section 3).
    window = 5.0
    for lag in range(1, min(len(table) // 3, int(longest_lag_s / step))):
        together = int(np.sum(known[lag:] & known[:-lag]))
        if not together:
            break
        total += float(np.sum(filled[lag:] * filled[:-lag])) / together / variance
        if lag >= window * total:
            break
    return max(total, 0.5) * step


def _centred(satellites: SatelliteResiduals, at: Integers, epochs: int) -> Floats:
    """Return residuals by epoch and signal, less the mean of each system and frequency; NaN where none."""
    signal = np.array([f"{s}{f}" for s, f in zip(satellites.satellite, satellites.frequency, strict=True)])
    names, column = np.unique(signal, return_inverse=True)
    table = np.full((epochs, len(names)), np.nan)
    table[at, column] = satellites.residual_m
    groups = np.array([name[0] + name[-1] for name in names.tolist()])
    for group in np.unique(groups):
        part = table[:, groups == group]
        known = np.isfinite(part)
        count = known.sum(axis=1, keepdims=True)
        mean = np.where(known, part, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
        # Alone, or with one other, a satellite says nothing.
        table[:, groups == group] = np.where(count > 2, part - mean, np.nan)
    return table


@dataclass(frozen=True)
class CodeErrors:
    """What mean codes of some time are off, over what they would be with white noise of the engine's weights.

    A float ambiguity is the mean of code less phase over the epochs that it has been held: the position is
    off by what the mean codes of these epochs are off. Where errors last (multipath, air, delays of channels)
    a mean over n epochs has not 1/n of the variance of one. By as much the mean codes of the satellites
    contradict each other, which their residuals show, whatever the position; satellites beyond those that
    place and clocks take up are needed for that.

    one_m (3,): standard deviations of a position by the codes of one epoch, with the engine's weights: east,
        north, up.
    epochs (k,): lengths of the means, growing to that of the recording.
    factor (k,): their variance over that of white noise of the engine's weights.
    """

    one_m: Floats
    epochs: Floats
    factor: Floats

    def sigma_m(self, claimed_m: Floats) -> Floats:
        """Return standard deviations (n, 3) for those that the engine claims of float positions."""
        # A claimed sigma tells how many epochs it counts on. Beyond the recording the engine counts what
        # phases add as the satellites move: their errors last, too.
        counted = np.maximum((self.one_m / claimed_m) ** 2, 1.0)
        factor = np.exp(np.interp(np.log(counted), np.log(self.epochs), np.log(self.factor)))
        return np.asarray(claimed_m * np.sqrt(factor))


def code_errors(satellites: SatelliteResiduals) -> CodeErrors | None:
    """Measure how mean codes of growing stretches contradict each other; None with too few satellites."""
    epochs, at = np.unique(satellites.time.ns, return_inverse=True)
    count, lengths = len(epochs), [1]
    while 2 * lengths[-1] < count:
        lengths.append(2 * lengths[-1])
    lengths += [count] if count > lengths[-1] else []
    one, known, factors = np.full(3, np.nan), list[int](), list[float]()
    for length in lengths:
        first = np.arange(0, count - length + 1, length)
        first = first[:: max(len(first) // _MOST_STRETCHES, 1)]
        bounds = np.searchsorted(at, np.stack([first, first + length]))
        found = [_contradiction(satellites, slice(a, b), length) for a, b in bounds.T.tolist()]
        seen = [each for each in found if each is not None]
        if not seen:
            continue
        if not known:
            one = np.median([sigma for _, _, sigma in seen], axis=0)
        factor = length * sum(square for square, _, _ in seen) / sum(freedom for _, freedom, _ in seen)
        # A mean of twice the length gains no more than white noise lets it.
        factors.append(max(factor, *factors[-1:], 1e-6))
        known.append(length)
    return CodeErrors(one, np.array(known, float), np.array(factors)) if known else None


def _contradiction(
    satellites: SatelliteResiduals, rows: slice, length: int
) -> tuple[float, int, Floats] | None:
    """Return v'Pv of the mean codes of a stretch in a position and clocks, its freedom, and sigmas of it."""
    signals = np.char.add(satellites.satellite[rows], satellites.frequency[rows].astype("U1"))
    names, signal = np.unique(signals, return_inverse=True)
    seen = np.bincount(signal)
    mean, up, east, north = (
        np.bincount(signal, values) / seen
        for values in (
            satellites.code_m[rows],
            np.sin(satellites.elevation[rows]),
            np.cos(satellites.elevation[rows]) * np.sin(satellites.azimuth[rows]),
            np.cos(satellites.elevation[rows]) * np.cos(satellites.azimuth[rows]),
        )
    )
    # A satellite that was there for less than half of it tells of another stretch.
    use = 2 * seen >= length
    # The reference satellite of each system and frequency is taken up by a clock of theirs.
    kinds = np.array([name[0] + name[-1] for name in names.tolist()])
    clocks = kinds[use, None] == np.unique(kinds[use])
    design = np.column_stack([-east[use], -north[use], -up[use], clocks])
    freedom = len(design) - design.shape[1]
    if freedom < 1:
        return None
    less = np.where(np.char.startswith(names[use], "R"), _GLONASS, 1.0)
    variance = 2 * (_CODE_M * less) ** 2 * (1 + 1 / up[use] ** 2)
    weight = seen[use] / length / variance
    normal = design.T @ (design * weight[:, None])
    if np.linalg.matrix_rank(normal) < len(normal):
        return None
    inverse = np.linalg.inv(normal)
    off = mean[use] - design @ (inverse @ (design.T @ (weight * mean[use])))
    return float(np.sum(weight * off**2)), freedom, np.sqrt(np.diag(inverse)[:3])
