"""How wrong float positions are, by what the residuals of the codes show: an error that lasts is no noise."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Floats
from photocal.navigation.engine import SatelliteResiduals

# The engine's weights of codes at the zenith, m, of one receiver (its options stats-errphase and
# stats-eratio1), and by how much it trusts GLONASS less.
_CODE_M, _GLONASS = 0.3, 1.5
# So many stretches of each length are examined.
_MOST_STRETCHES = 200


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
