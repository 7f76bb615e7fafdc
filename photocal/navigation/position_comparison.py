"""Positions of exposures against those of another source: which systematic error explains the differences."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from drivers.errors import IllPosedError

Floats = NDArray[np.float64]
_LEAST = 8
_SIGNIFICANCE = 0.001
# What falls short by no more than this is as good a name for the same error (Raftery 1995: over 10 is
# very strong evidence).
_AS_GOOD = 10.0
_GROSS = 5.0
TIME, LEVER, AXES = "time-offset", "lever-arm", "lever-arm-axes"
AXIS_NAMES = ("forward", "right", "down")


@dataclass(frozen=True)
class PositionPairs:
    """The same exposures by two sources, in east, north, up about their middle.

    Parameters
    ----------
    ours, theirs : float64 (n, 3)
        Positions, m.
    velocity : float64 (n, 3)
        Of the vehicle, m/s.
    to_object : float64 (n, 3, 3)
        From body axes to east, north, up.
    lever_m : float64 (3,) or None
        Lever arm that was applied to ours, body axes.
    free : str
        What is unknown between the two systems: ``shift``, or ``similarity`` (also scale and rotation).
    """

    ours: Floats
    theirs: Floats
    velocity: Floats
    to_object: Floats
    lever_m: Floats | None
    free: str


@dataclass(frozen=True)
class Explanation:
    """An error that would explain the differences.

    Parameters
    ----------
    name : str
        ``time-offset``, ``lever-arm`` or ``lever-arm-axes``.
    value, sigma : float64 (k,)
        Seconds (exposures later than stamped), or metres in body axes (true less given).
    axes : str
        For swapped axes: what the lever arm should read.
    gain : float
        By which the criterion of Schwarz falls.
    p : float
        Probability of the F test.
    """

    name: str
    value: Floats
    sigma: Floats
    axes: str
    gain: float
    p: float

    @property
    def significant(self) -> bool:
        """Whether the data want it."""
        return self.p < _SIGNIFICANCE and self.gain > 0


@dataclass(frozen=True)
class PositionComparison:
    """What a comparison shows.

    Parameters
    ----------
    n : int
        Exposures used.
    rms_m : float64 (3,)
        Differences after removing what is unknown between the systems, east, north, up.
    shift_m : float64 (3,)
        Mean of theirs less ours.
    best : Explanation or None
        The best significant one.
    same : tuple of str
        Others that explain as much.
    detectable_s : float
        Time offset that would be found with 80 % power; infinite when the flight cannot show one.
    """

    n: int
    rms_m: Floats
    shift_m: Floats
    best: Explanation | None
    same: tuple[str, ...]
    detectable_s: float


def compare_positions(pairs: PositionPairs) -> PositionComparison:
    """Find which single error explains the differences of two sources best.

    theirs - ours = what is unknown between the systems + v dt + R' dl: beside the former, a time offset dt,
    an error dl of the lever arm and every exchange and change of sign of its axes are tried in turn, judged
    by an F test (0.1 % over all) and the criterion of Schwarz (1978). Gross differences are left out.

    Parameters
    ----------
    pairs : PositionPairs

    Returns
    -------
    PositionComparison

    Raises
    ------
    IllPosedError
        With fewer than eight common exposures, or a flight along one line.
    """
    known = np.isfinite(pairs.ours + pairs.theirs + pairs.velocity).all(axis=1)
    rows = np.flatnonzero(known)
    if len(rows) < _LEAST:
        raise IllPosedError(
            f"{len(rows)} exposures have both positions, at least {_LEAST} are needed to compare them"
        )
    nuisance = _nuisance(pairs)
    columns = {TIME: pairs.velocity[:, :, None]}
    if np.isfinite(pairs.to_object[rows]).all():
        columns[LEVER] = pairs.to_object
    difference = pairs.theirs - pairs.ours
    whole = np.concatenate([nuisance, *columns.values()], axis=2)
    for _ in range(5):
        # Gross errors are told by what is left when all errors looked for are allowed.
        residual = _fit(whole[rows], difference[rows])[0]
        size = np.linalg.norm(residual, axis=1)
        scale = max(float(np.median(size)), 1e-6)
        kept = rows[size <= _GROSS * scale]
        if len(kept) == len(rows) or len(kept) < _LEAST:
            break
        rows = kept
    d, base = difference[rows], nuisance[rows]
    residual, _, _ = _fit(base, d)
    tried = [_try(name, base, block[rows], d) for name, block in columns.items()]
    if pairs.lever_m is not None and LEVER in columns:
        tried += _exchanged(base, pairs.to_object[rows], pairs.lever_m, d)
    count = len(tried)
    judged = [t for t in tried if t.significant and t.p * count < _SIGNIFICANCE]
    best = max(judged, key=lambda t: t.gain, default=None)
    same = () if best is None else _as_good(best, judged)
    return PositionComparison(
        len(rows),
        np.sqrt(np.mean(residual**2, axis=0)),
        np.mean(d, axis=0),
        best,
        same,
        _detectable(base, columns[TIME][rows], whole[rows], d),
    )


def _as_good(best: Explanation, judged: list[Explanation]) -> tuple[str, ...]:
    names = [t.name for t in judged if t is not best and best.gain - t.gain < _AS_GOOD]
    return tuple(dict.fromkeys(name for name in names if name != best.name))


def _nuisance(pairs: PositionPairs) -> Floats:
    n = len(pairs.ours)
    shift = np.broadcast_to(np.eye(3), (n, 3, 3))
    if pairs.free == "shift":
        return shift
    place = pairs.ours - np.nanmean(pairs.ours, axis=0)
    x, y, z = place.T
    zero = np.zeros(n)
    skew = np.moveaxis(np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]), -1, 0)
    return np.concatenate([shift, skew, place[:, :, None]], axis=2)


def _fit(design: Floats, d: Floats) -> tuple[Floats, Floats, Floats]:
    """Return residuals (n, 3), the unknowns and their cofactors."""
    a, y = design.reshape(-1, design.shape[2]), d.ravel()
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-12)
    inverse = np.linalg.pinv((a / scale).T @ (a / scale), rcond=1e-10)
    x = inverse @ (a / scale).T @ y / scale
    return (y - a @ x).reshape(d.shape), x, inverse / np.outer(scale, scale)


def _try(name: str, base: Floats, block: Floats, d: Floats) -> Explanation:
    residual0, _, _ = _fit(base, d)
    residual, x, cofactor = _fit(np.concatenate([base, block], axis=2), d)
    k = block.shape[2]
    dof = d.size - base.shape[2] - k
    rss0, rss = float(np.sum(residual0**2)), max(float(np.sum(residual**2)), 1e-18)
    f = (rss0 - rss) / k / (rss / dof)
    sigma = np.sqrt(np.maximum(np.diag(cofactor)[-k:] * rss / dof, 0.0))
    gain = d.size * np.log(rss0 / rss) - k * np.log(d.size)
    return Explanation(name, x[-k:], sigma, "", float(gain), float(stats.f.sf(f, k, dof)))


def _exchanged(base: Floats, to_object: Floats, lever_m: Floats, d: Floats) -> list[Explanation]:
    """Try every exchange and change of sign of the lever arm's axes."""
    residual0, _, _ = _fit(base, d)
    rss0 = float(np.sum(residual0**2))
    dof = d.size - base.shape[2]
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            meant = np.array(signs) * lever_m[list(order)]
            if np.allclose(meant, lever_m, atol=1e-6):
                continue
            moved = np.einsum("nij,j->ni", to_object, meant - lever_m)
            residual, _, _ = _fit(base, d - moved)
            rss = max(float(np.sum(residual**2)), 1e-18)
            gain = d.size * np.log(rss0 / rss)
            # Nothing is estimated: the ratio of the two variances is judged as if one value had been.
            p = float(stats.f.sf(max(rss0 / rss - 1, 0.0) * dof, 1, dof))
            text = ", ".join(f"{v:+.3f} {name}" for v, name in zip(meant, AXIS_NAMES, strict=True))
            found.append(Explanation(AXES, meant - lever_m, np.zeros(3), text, float(gain), p))
    # Exchanges that differ only where the lever arm is zero are the same.
    found.sort(key=lambda e: -e.gain)
    return found[:1]


def _detectable(base: Floats, velocity: Floats, whole: Floats, d: Floats) -> float:
    residual, _, _ = _fit(whole, d)
    spread = float(np.sum(residual**2)) / max(d.size - whole.shape[2], 1)
    a, v = base.reshape(-1, base.shape[2]), velocity.reshape(-1, 1)
    free = v - a @ np.linalg.pinv(a, rcond=1e-10) @ v
    length = float(np.linalg.norm(free))
    if length < 1e-3 * float(np.linalg.norm(v)) or length == 0:
        return float("inf")
    # Two-sided 0.1 % with a power of 80 % (Baarda 1968).
    return float(4.13 * np.sqrt(spread) / length)
