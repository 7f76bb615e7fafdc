"""Positions of exposures against those of another source: which systematic error explains the differences."""

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.base.geodesy import enu_offsets
from photocal.base.policy import policy
from photocal.findings.finding import Finding, untested
from photocal.geometry.localisation import similarity
from photocal.geometry.rotation import skew
from photocal.navigation.exposures import Exposures
from photocal.navigation.rig import CameraOnBody

_LEAST = 8
TIME, LEVER, AXES = "time-offset", "lever-arm", "lever-arm-axes"
AXIS_NAMES = ("forward", "right", "down")


@dataclass(frozen=True)
class Explanation:
    """An error that would explain the differences.

    name: ``time-offset``, ``lever-arm`` or ``lever-arm-axes``.
    value, sigma (k,): seconds (exposures later than stamped), or metres in body axes (true less given).
    axes: for swapped axes: what the lever arm should read, axis by axis.
    gain: by which the criterion of Schwarz falls.
    """

    name: str
    value: Floats
    sigma: Floats
    axes: tuple[str, ...]
    gain: float
    p: float

    @property
    def significant(self) -> bool:
        """Whether the data want it."""
        return self.p < policy.significance and self.gain > 0


@dataclass(frozen=True)
class PositionComparison:
    """What a comparison shows.

    rms_m (3,): differences after removing what is unknown between the systems, east, north, up.
    shift_m (3,): mean of theirs less ours.
    same: others that explain as much.
    detectable_s: time offset that would be found with 80 % power; infinite when the flight cannot show one.
    exchange: exchanged axes that explain most of what the best one explains.
    """

    n: int
    rms_m: Floats
    shift_m: Floats
    best: Explanation | None
    same: tuple[str, ...]
    detectable_s: float
    exchange: Explanation | None = None


def compare_positions(
    ours: Floats,
    theirs: Floats,
    velocity: Floats,
    free: str,
    to_object: Floats | None = None,
    rig: CameraOnBody | None = None,
) -> PositionComparison:
    """Find which single error explains the differences of two sources of the same exposures best.

    theirs - ours = what is unknown between the systems + v dt - R' dl. First dt and dl are held to what is
    known of them beforehand; then each is freed in turn, and every exchange and change of sign of the lever
    arm's axes tried, judged by an F test (0.1 % over all) and the criterion of Schwarz (1978). Gross
    differences are left out. Neighbours share the errors of a receiver's own solution, which wander for
    minutes: differences count as so many independent ones as their autocorrelation leaves.

    ours, theirs (n, 3): positions, m, in east, north, up about their middle.
    velocity (n, 3): of the vehicle, m/s.
    free: what is unknown between the two systems: ``shift``, or ``similarity`` (also scale and rotation).
    to_object (n, 3, 3): from body axes to east, north, up; None: not known.
    rig: lever arm that was applied to ours, and how well it and the time of the exposures are known
        beforehand; None: no lever arm was, and the time is taken as right.
    """
    rig = rig or CameraOnBody()
    rows = np.flatnonzero(np.isfinite(ours + theirs + velocity).all(axis=1))
    if len(rows) < _LEAST:
        raise IllPosedError(
            f"{len(rows)} exposures have both positions and a velocity, at least {_LEAST} are needed"
        )
    to_camera = None if to_object is None or not np.isfinite(to_object[rows]).all() else -to_object
    blocks = [_nuisance(ours, free), velocity[:, :, None], *([] if to_camera is None else [to_camera])]
    design = np.concatenate(blocks, axis=2)
    unknown = blocks[0].shape[2]
    places = {TIME: slice(unknown, unknown + 1)} | (
        {} if to_camera is None else {LEVER: slice(unknown + 1, unknown + 4)}
    )
    difference = theirs - ours
    rows = _without_gross(design, difference, rows)
    model = _Model(design[rows], difference[rows], *_noise(design[rows], difference[rows]))
    sigma = np.full(design.shape[2], np.inf)
    sigma[unknown] = rig.time_offset_sigma_s
    sigma[unknown + 1 :] = 0.0 if rig.lever_m is None else rig.lever_sigma_m
    tried = [_freed(name, model, sigma, place) for name, place in places.items()]
    if rig.lever_m is not None and to_camera is not None:
        tried += _exchanged(model, sigma, to_camera[rows], rig.lever_m)
    judged = [t for t in tried if t.significant and t.p * len(tried) < policy.significance]
    best = max(judged, key=lambda t: t.gain, default=None)
    as_good = [t.name for t in judged if best and t.name != best.name and best.gain - t.gain < policy.as_good]
    most = 0.8
    # A lever arm is known to a centimetre: exchanged axes need not explain the last of it.
    exchange = next((t for t in judged if t.name == AXES and best and t.gain > most * best.gain), None)
    return PositionComparison(
        len(rows),
        np.sqrt(np.mean(model.solved(sigma)[2] ** 2, axis=0)),
        np.mean(model.difference, axis=0),
        best,
        tuple(dict.fromkeys(as_good)),
        _detectable(model, sigma, unknown),
        exchange,
    )


@dataclass(frozen=True)
class _Model:
    """Differences, their design, the standard deviation of one, and which share of them is independent."""

    design: Floats
    difference: Floats
    noise_m: float = 1.0
    share: float = 1.0

    @property
    def size(self) -> float:
        """Number of independent differences, each of three coordinates."""
        return self.share * self.difference.size

    def solved(self, sigma: Floats | None = None) -> tuple[float, Floats, Floats, Floats]:
        """Solve with unknowns free (infinite; None: all), weighted (positive) or held at zero (0)."""
        sigma = np.full(self.design.shape[2], np.inf) if sigma is None else sigma
        used = np.flatnonzero(sigma > 0)
        a = self.design.reshape(-1, self.design.shape[2])[:, used]
        weight = np.where(np.isfinite(sigma[used]), self.noise_m / np.sqrt(self.share) / sigma[used], 0.0)
        scale = np.maximum(np.sqrt(np.sum(a**2, axis=0) + weight**2), 1e-12)
        normal = (a / scale).T @ (a / scale) + np.diag((weight / scale) ** 2)
        inverse = np.linalg.pinv(normal, rcond=1e-10)
        y = self.difference.ravel()
        estimates = inverse @ (a / scale).T @ y / scale
        x = np.zeros(len(sigma))
        x[used] = estimates
        residual = y - a @ estimates
        cofactor = np.zeros((len(sigma), len(sigma)))
        cofactor[np.ix_(used, used)] = inverse / np.outer(scale, scale)
        squares = float(residual @ residual + np.sum((weight * estimates) ** 2))
        return max(squares, 1e-18), x, residual.reshape(self.difference.shape), cofactor


def _without_gross(design: Floats, difference: Floats, rows: Integers) -> Integers:
    gross = 5.0
    for _ in range(5):
        # Gross errors are detected by what is left when all errors looked for are allowed.
        size = np.linalg.norm(_Model(design[rows], difference[rows]).solved()[2], axis=1)
        kept = rows[size <= gross * max(float(np.median(size)), 1e-6)]
        if len(kept) == len(rows) or len(kept) < _LEAST:
            break
        rows = kept
    return rows


def _noise(design: Floats, difference: Floats) -> tuple[float, float]:
    """Give the standard deviation of a difference, and which share of the differences is independent."""
    squares, _, residual, _ = _Model(design, difference).solved()
    together = float(np.sum(residual[1:] * residual[:-1]))
    # Of neighbours that are more alike than this the correlation cannot be determined.
    most_alike = 0.9
    r = float(np.clip(together / max(float(np.sum(residual**2)), 1e-300), 0.0, most_alike))
    return float(np.sqrt(squares / max(difference.size - design.shape[2], 1))), (1 - r) / (1 + r)


def _nuisance(ours: Floats, free: str) -> Floats:
    shift = np.broadcast_to(np.eye(3), (len(ours), 3, 3))
    if free == "shift":
        return shift
    place = ours - np.nanmean(ours, axis=0)
    return np.concatenate([shift, -skew(place), place[:, :, None]], axis=2)


def _freed(name: str, model: _Model, sigma: Floats, place: slice) -> Explanation:
    rss0 = model.solved(sigma)[0]
    free = sigma.copy()
    free[place] = np.inf
    rss, x, _, cofactor = model.solved(free)
    k = place.stop - place.start
    size = model.size
    dof = max(size - float(np.isinf(free).sum()), 1.0)
    f = max((rss0 - rss) / k / (rss / dof), 0.0)
    spread = np.sqrt(np.maximum(np.diag(cofactor)[place] * rss / dof, 0.0))
    gain = size * np.log(rss0 / rss) - k * np.log(size)
    return Explanation(name, x[place], spread, (), float(gain), float(special.fdtrc(k, dof, f)))


def _exchanged(model: _Model, sigma: Floats, to_camera: Floats, lever_m: Floats) -> list[Explanation]:
    """Try every exchange and change of sign of the lever arm's axes; return the best one."""
    rss0 = model.solved(sigma)[0]
    size = model.size
    dof = max(size - float(np.isinf(sigma).sum()), 1.0)
    explanations = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            meant = np.array(signs) * lever_m[list(order)]
            if np.allclose(meant, lever_m, atol=1e-6):
                continue
            left = model.difference - to_camera @ (meant - lever_m)
            rss = replace(model, difference=left).solved(sigma)[0]
            # Nothing is estimated: the ratio of the two variances is judged as if one value had been.
            p = float(special.fdtrc(1, dof, max(rss0 / rss - 1, 0.0) * dof))
            text = tuple(f"{v:+.3f} {name}" for v, name in zip(meant, AXIS_NAMES, strict=True))
            gain = float(size * np.log(rss0 / rss))
            explanations.append(Explanation(AXES, meant - lever_m, np.zeros(3), text, gain, p))
    # Exchanges that differ only where the lever arm is zero are the same: the first of them counts.
    return [max(explanations, key=lambda e: e.gain)] if explanations else []


def _detectable(model: _Model, sigma: Floats, place: int) -> float:
    others = sigma.copy()
    others[place] = 0.0
    velocity = replace(model, difference=model.design[:, :, place])
    length = float(np.sqrt(velocity.solved(others)[0]))
    if length < 1e-3 * float(np.linalg.norm(velocity.difference)) or length == 0:
        return float("inf")
    # Two-sided 0.1 % with a power of 80 % (Baarda 1968).
    return float(4.13 * model.noise_m / np.sqrt(model.share) / length)


def judge_positions(source: str, ours: Exposures, theirs: Floats, rig: CameraOnBody, free: str) -> Finding:
    """Compare exposures with positions of another source."""
    code, beside = "positions", {"source": source, "free": free}
    p = ours.placed
    known = p.placed & np.isfinite(theirs).all(axis=1)
    if known.sum() < 8:
        return untested(code, "few-common", {**beside, "n": float(known.sum())})
    origin = np.mean(p.place[known], axis=0)
    here = p.rows(known).offsets(origin)
    if free == "similarity":
        aligned = similarity(theirs[known], here)
        if aligned is None:
            return untested(code, "on-one-line", beside)
        there = aligned.applied(theirs[known])
    else:
        lat, lon, height = theirs[known].T
        there = enu_offsets(lat, lon, height, origin)
    body = ours.carrier if ours.carrier is not None else ours.attitude
    velocity = p.velocity_m_s[known]
    turn = np.swapaxes(body.rotation[known], 1, 2)
    try:
        comparison = compare_positions(here, there, velocity, free, turn, rig)
    except IllPosedError as refusal:
        return untested(code, "ill-posed", {**beside, "reason": str(refusal)})
    return _judged(comparison, beside, rig.lever_m)


def _judged(comparison: PositionComparison, beside: dict[str, str], lever_m: Floats | None) -> Finding:
    best, seen = comparison.best, bool(np.isfinite(comparison.detectable_s))
    figures: dict[str, Any] = {
        **beside,
        "exposures": comparison.n,
        "rms_enu_m": comparison.rms_m.tolist(),
        "shift_enu_m": comparison.shift_m.tolist(),
        "detectable_time_offset_s": comparison.detectable_s if seen else None,
        "detectable_ms": comparison.detectable_s * 1e3 if seen else None,
        "numbers": tuple(f"{v:.3f}" for v in comparison.rms_m),
    }
    if best is None:
        return Finding("positions", "passed", figures=figures, clauses=("would-show" if seen else "one-way",))
    figures |= {"explanation": best.name, "value": best.value.tolist(), "sigma": best.sigma.tolist()}
    figures["as_good"] = list(comparison.same)
    clauses = []
    if best.name == TIME:
        figures |= {"late_ms": abs(best.value[0]) * 1e3, "late_sigma_ms": best.sigma[0] * 1e3}
        clauses.append("later" if best.value[0] > 0 else "earlier")
    elif best.name == AXES:
        figures["exchanged"] = _axes(best.axes)
        clauses.append("fits")
    else:
        parts = zip(best.value, AXIS_NAMES, strict=True)
        figures["lever"] = tuple(f"mm {1e3 * v:+.0f} {name}" for v, name in parts)
        clauses.append("wrong-by" if lever_m is not None else "there-is")
    if comparison.exchange is not None and best is not comparison.exchange:
        figures["exchanged_axes"] = ", ".join(comparison.exchange.axes)
        figures["exchanged"] = _axes(comparison.exchange.axes)
        clauses.append("or-exchanged")
    elif comparison.same:
        figures["same"] = comparison.same
        clauses.append("as-good")
    return Finding(best.name, "grave", figures=figures, clauses=tuple(clauses))


def _axes(arm: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"m {part}" for part in arm)
