"""Least squares of GNSS baselines: coordinates of control points, with blunders found and named."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.chi_square import GlobalTest, global_test, noncentrality
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy
from photocal.navigation.trajectory import enu_axes_at

# Two-sided 0.1 % for one component (lambda 17.075).
_DELTA = noncentrality()


@dataclass(frozen=True)
class Baseline:
    """A vector from one mark to another.

    name: session or file, for messages.
    vector_m (3,): Earth-centred axes, from mark to mark (antenna heights removed).
    covariance_m2 (3, 3): Earth-centred axes.
    """

    name: str
    start: str
    end: str
    vector_m: Floats
    covariance_m2: Floats


@dataclass(frozen=True)
class GroundMark:
    """A mark whose position is known: earth-centred position and covariance (zero: held)."""

    name: str
    xyz_m: Floats
    covariance_m2: Floats


@dataclass(frozen=True)
class Blunder:
    """A baseline that was left out.

    component: ``height``, ``east`` or ``north``; an error of height alone is mostly that of an antenna
        height.
    size_m: estimated error with its sign, start to end.
    test: normalised residual; rejected above `policy.times_999`.
    """

    name: str
    start: str
    end: str
    component: str
    size_m: float
    size_sigma_m: float
    test: float


@dataclass(frozen=True)
class NetworkSolution:
    """Adjusted marks.

    xyz_m (n, 3): Earth-centred positions.
    covariance_m2 (3 n, 3 n): full covariance, a priori variance of unit weight.
    residuals_m (m, 3): adjusted less measured, east, north, up, of the baselines used.
    redundancy (m, 3): redundancy numbers of east, north, up.
    detectable_m (m, 3): smallest error found with 80 % power at a level of 0.1 %; infinite where nothing
        checks it.
    effects_m (m, 3, n, 3): external reliability: what the smallest detectable error of each baseline's east,
        north and up does to the east, north and up of every mark when it is not found (Baarda 1968): Q A' P e
        times the error. Infinite where nothing checks it.
    distortion (m, 3): its length in units of the marks' covariance, the root of dx' Q^-1 dx.
    sigma0_squared: A posteriori variance of unit weight; NaN without redundancy.
    """

    names: list[str]
    xyz_m: Floats
    covariance_m2: Floats
    residuals_m: Floats
    redundancy: Floats
    detectable_m: Floats
    effects_m: Floats
    distortion: Floats
    used: list[Baseline]
    blunders: list[Blunder]
    degrees_of_freedom: int
    sigma0_squared: float

    @property
    def test(self) -> GlobalTest | None:
        """Global test of the network; None without redundancy."""
        if self.degrees_of_freedom <= 0:
            return None
        return global_test(self.sigma0_squared * self.degrees_of_freedom, self.degrees_of_freedom)


def adjust_baselines(baselines: list[Baseline], control: list[GroundMark]) -> NetworkSolution:
    """Adjust a network of baselines and leave out those that an outlier test rejects, one at a time."""
    if not control:
        raise IllPosedError(
            "no known mark: the position of the network is not determined", "give one known position"
        )
    used, blunders = list(baselines), []
    while True:
        solution, suspect = _adjust(used, control)
        if suspect is None:
            break
        blunders.append(suspect[1])
        del used[suspect[0]]
    return replace(solution, blunders=blunders)


def _adjust(
    baselines: list[Baseline], control: list[GroundMark]
) -> tuple[NetworkSolution, tuple[int, Blunder] | None]:
    held = {mark.name: mark for mark in control}
    names = list(dict.fromkeys([*held, *(n for b in baselines for n in (b.start, b.end))]))
    start = _start(baselines, held, names)
    place = {name: 3 * i for i, name in enumerate(names)}
    n, m = 3 * len(names), 3 * len(baselines)
    design, reduced, weight = np.zeros((m, n)), np.zeros(m), np.zeros((m, m))
    axes = []
    for i, b in enumerate(baselines):
        turn = enu_axes_at(start[b.start])
        axes.append(turn)
        rows = slice(3 * i, 3 * i + 3)
        design[rows, place[b.start] : place[b.start] + 3] = -turn
        design[rows, place[b.end] : place[b.end] + 3] = turn
        reduced[rows] = turn @ (b.vector_m - (start[b.end] - start[b.start]))
        weight[rows, rows] = np.linalg.inv(turn @ b.covariance_m2 @ turn.T)
    free = np.ones(n, bool)
    normal = design.T @ weight @ design
    for mark in control:
        rows = slice(place[mark.name], place[mark.name] + 3)
        if np.any(mark.covariance_m2):
            normal[rows, rows] += np.linalg.inv(mark.covariance_m2)
        else:
            free[rows] = False
    covariance = np.zeros((n, n))
    covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
    correction = covariance @ (design.T @ (weight @ reduced))
    residual = design @ correction - reduced
    # Cofactors of the residuals; redundancy is the diagonal of Qvv P (Foerstner 1979).
    cofactor = np.linalg.inv(weight) - design @ covariance @ design.T
    redundancy = np.diag(cofactor @ weight).reshape(-1, 3)
    # The test of one component with correlated observations (Baarda 1968): P v over the root of P Qvv P.
    scaled = weight @ residual
    scatter = np.diag(weight @ cofactor @ weight).copy()
    checked = (redundancy > 1e-6).all(axis=1).repeat(3)
    spread = np.sqrt(np.where(checked, np.maximum(scatter, 1e-300), np.inf))
    test = scaled / spread
    dof = m + 3 * sum(1 for mark in control if np.any(mark.covariance_m2)) - int(free.sum())
    squared = float(residual @ weight @ residual)
    shifts = correction.reshape(-1, 3)
    detectable = np.where(checked, _DELTA / spread, np.inf)
    moved = covariance @ design.T @ weight
    # dx' Q^-1 dx with dx = Q A' P e d is d^2 e' P A Q A' P e.
    inner = np.sum((weight @ design) * moved.T, axis=1)
    for mark in control:
        if np.any(mark.covariance_m2):
            shift = shifts[place[mark.name] // 3]
            squared += float(shift @ np.linalg.inv(mark.covariance_m2) @ shift)
    solution = NetworkSolution(
        names,
        np.stack([start[name] for name in names]) + shifts,
        covariance,
        residual.reshape(-1, 3),
        redundancy,
        detectable.reshape(-1, 3),
        _local(moved, np.stack([start[name] for name in names]), detectable),
        (detectable * np.sqrt(np.maximum(inner, 0.0))).reshape(-1, 3),
        list(baselines),
        [],
        dof,
        squared / dof if dof > 0 else float("nan"),
    )
    worst = int(np.argmax(np.abs(test))) if m else 0
    if not m or abs(test[worst]) <= policy.times_999:
        return solution, None
    b = baselines[worst // 3]
    blunder = Blunder(
        b.name,
        b.start,
        b.end,
        ("east", "north", "height")[worst % 3],
        float(-scaled[worst] / scatter[worst]),
        float(1 / np.sqrt(scatter[worst])),
        float(abs(test[worst])),
    )
    return solution, (worst // 3, blunder)


def _local(moved: Floats, places: Floats, detectable: Floats) -> Floats:
    """Return the effect of detectable errors on the marks, east, north, up (m, 3, n, 3)."""
    each = np.einsum("nij,njk->kni", enu_axes_at(places), moved.reshape(len(places), 3, -1))
    known = np.isfinite(detectable)
    effects = np.where(known[:, None, None], each * np.where(known, detectable, 0.0)[:, None, None], np.inf)
    return np.asarray(effects.reshape(-1, 3, len(places), 3))


def _start(baselines: list[Baseline], held: dict[str, GroundMark], names: list[str]) -> dict[str, Floats]:
    """Return start positions, carried on from mark to mark."""
    known = {name: mark.xyz_m for name, mark in held.items()}
    while True:
        before = len(known)
        for b in baselines:
            if b.start in known and b.end not in known:
                known[b.end] = known[b.start] + b.vector_m
            elif b.end in known and b.start not in known:
                known[b.start] = known[b.end] - b.vector_m
        if len(known) == before:
            break
    lost = [name for name in names if name not in known]
    if lost:
        raise IllPosedError(
            f"no chain of baselines leads from a known mark to {', '.join(lost)}",
            "measure more baselines; one left out as a blunder may have been the only one",
        )
    return known
