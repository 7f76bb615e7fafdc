"""Site calibration: coordinates of a map system in a local one, from common points, plan and height apart.

As controllers of surveyors do it: a similarity in plan (shift, rotation, scale) and, for heights, a shift or
a tilted plane. Residuals are computed minus given, in the local system.

Similarity transformation between two systems of places in space.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from photocal.base.arrays import Flags, Floats
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy

# A plane through heights wants a point more than it has parameters, and width against its length.
_FEWEST_FOR_TILT, _LINE = 4, 0.02


@dataclass(frozen=True)
class CommonPoints:
    """Points in both systems; a coordinate that is NaN in either is not used.

    map_m, local_m (n, 3): east, north, height.
    sigma_m (n, 3): of both together; None where nobody states them: the residuals tell.
    """

    names: tuple[str, ...]
    map_m: Floats
    local_m: Floats
    sigma_m: Floats | None = None


@dataclass(frozen=True)
class FittedPart:
    """Plan, or height, as it was fitted.

    parameters, covariance: as `Localisation` has them.
    residual_m (n, k): computed minus given; NaN for points without it.
    miss_m (n, k): where the other points put a point, less where it was given.
    probability (n,): of a larger miss by chance; NaN where nothing checks the point.
    factor: square root of the variance factor; NaN without redundancy.
    doubtful: points that do not fit, the worst first, each tested without those before it: its miss (m) and
        the probability of a larger one.
    """

    parameters: Floats
    covariance: Floats
    residual_m: Floats
    miss_m: Floats
    probability: Floats
    redundancy: int
    factor: float

    doubtful: Mapping[int, tuple[float, float]] = field(default_factory=dict[int, tuple[float, float]])

    @property
    def beyond(self) -> Flags:
        """Points that do not fit all others, shape (n,); the family of tests alarms once in 200 cases."""
        checked = np.isfinite(self.probability)
        limit = policy.family_significance / max(int(checked.sum()), 1)
        return np.asarray(checked & (np.nan_to_num(self.probability, nan=1.0) < limit))


@dataclass(frozen=True)
class Localisation:
    """The way from a map system to a local one.

    middle_m (2,): east, north of the point that shifts and slopes belong to.
    plan: its parameters are east, north of the middle in the local system, rotation (rad, counterclockwise)
        and scale.
    height: its parameters are shift (local less map) and slopes to the east and the north.
    scale_free, tilted: whether scale and slopes were estimated.
    """

    middle_m: Floats
    plan: FittedPart
    height: FittedPart
    scale_free: bool
    tilted: bool

    def to_local(self, places: Floats) -> Floats:
        """Map coordinates, shape (n, 3), in the local system."""
        offset = places[:, :2] - self.middle_m
        return np.column_stack([_turned(self.plan.parameters, offset), places[:, 2] + self._above(offset)])

    def to_map(self, places: Floats) -> Floats:
        """Local coordinates, shape (n, 3), in the map system."""
        east, north, angle, scale = self.plan.parameters
        offset = (places[:, :2] - [east, north]) @ _rotation(angle) / scale
        return np.column_stack([offset + self.middle_m, places[:, 2] - self._above(offset)])

    def sigma_m(self, map_places: Floats) -> Floats:
        """What the parameters leave uncertain of coordinates in either system, shape (n, 3)."""
        offset = map_places[:, :2] - self.middle_m
        design = _plan_design(self.plan.parameters, offset)
        plan = np.einsum("nij,jk,nik->ni", design, self.plan.covariance, design)
        slope = np.column_stack([np.ones(len(offset)), offset])
        height = np.einsum("ni,ij,nj->n", slope, self.height.covariance, slope)
        return np.asarray(np.sqrt(np.column_stack([plan, height])))

    def _above(self, offset: Floats) -> Floats:
        shift, *slopes = self.height.parameters
        return np.asarray(shift + offset @ np.asarray(slopes))


def localise(points: CommonPoints, scale: float | None = None, *, tilt: bool = True) -> Localisation:
    """Fit a local system to common points.

    scale: from the map to the local system, held; None: estimated.
    tilt: whether heights may lie on a tilted plane; without four of them, or where they lie in a line, a
        shift is fitted.
    raises IllPosedError: for fewer than two points in plan, or none with a height.
    """
    in_plan = np.asarray(np.isfinite(points.map_m[:, :2] + points.local_m[:, :2]).all(axis=1))
    high = in_plan & np.isfinite(points.map_m[:, 2] + points.local_m[:, 2])
    if in_plan.sum() < 2 or not high.any():
        raise IllPosedError(
            f"{int(in_plan.sum())} common points have plan coordinates and {int(high.sum())} heights",
            "give two common points in plan at least, four for a check, and one with a height",
        )
    middle = points.map_m[in_plan, :2].mean(axis=0)
    offset = points.map_m[:, :2] - middle
    extent = np.linalg.svd(offset[high] - offset[high].mean(axis=0), compute_uv=False)
    tilted = tilt and int(high.sum()) >= _FEWEST_FOR_TILT and bool(extent[1] > _LINE * extent[0])
    plan = _snooped(lambda used: _fitted_plan(points, offset, used, scale), in_plan)
    columns = np.column_stack([np.ones(len(offset)), offset])
    rise, free = points.local_m[:, 2:] - points.map_m[:, 2:], np.array([True, tilted, tilted])
    height = _snooped(
        lambda used: _fitted(
            lambda p: columns @ p, lambda _: columns[:, None, :], np.zeros(3), free, rise,
            _sigma(points, [2]), used,
        ),
        high,
    )  # fmt: skip
    return Localisation(middle, plan, height, scale is None, tilted)


def _snooped(fitted: Callable[[Flags], FittedPart], used: Flags) -> FittedPart:
    """Fit to all points, and tell those that do not fit: one gross error makes its neighbours look wrong."""
    whole = part = fitted(used)
    left, doubtful = used.copy(), dict[int, tuple[float, float]]()
    while part.beyond.any():
        worst = int(np.argmin(np.where(part.beyond, part.probability, np.inf)))
        doubtful[worst] = float(np.linalg.norm(part.miss_m[worst])), float(part.probability[worst])
        left[worst] = False
        part = fitted(left)
    return replace(whole, doubtful=doubtful)


def _sigma(points: CommonPoints, columns: list[int]) -> Floats | None:
    return None if points.sigma_m is None else points.sigma_m[:, columns]


def _fitted_plan(points: CommonPoints, offset: Floats, used: Flags, scale: float | None) -> FittedPart:
    given = points.local_m[:, :2]
    a, b = offset[used], given[used] - given[used].mean(axis=0)
    # The closed form starts the fit at the right rotation.
    dot, cross = float(np.sum(a * b)), float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    start_scale = float(np.hypot(dot, cross) / np.sum(a**2)) if scale is None else scale
    start = np.array([*given[used].mean(axis=0), np.arctan2(cross, dot), start_scale])
    return _fitted(
        lambda p: _turned(p, offset), lambda p: _plan_design(p, offset), start,
        np.array([True, True, True, scale is None]), given, _sigma(points, [0, 1]), used,
    )  # fmt: skip


def _rotation(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _turned(parameters: Floats, offset: Floats) -> Floats:
    east, north, angle, scale = parameters
    return np.asarray(scale * offset @ _rotation(angle).T + [east, north])


def _plan_design(parameters: Floats, offset: Floats) -> Floats:
    """Derivatives of local plan coordinates with respect to the four parameters, shape (n, 2, 4)."""
    _, _, angle, scale = parameters
    turned = offset @ _rotation(angle).T
    design = np.zeros((len(offset), 2, 4))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -scale * turned[:, 1], scale * turned[:, 0]
    design[:, :, 3] = turned
    return design


def _fitted(
    model: Callable[[Floats], Floats], derivative: Callable[[Floats], Floats],
    start: Floats, free: Flags, given: Floats, sigma: Floats | None, used: Flags,
) -> FittedPart:  # fmt: skip
    """Fit by least squares; tests by what the other points say of each."""
    # It settles in a few rounds.
    rounds = 20
    k = given.shape[1]
    deviation = np.ones((int(used.sum()), k)) if sigma is None else np.maximum(sigma[used], 1e-6)
    weight = 1.0 / deviation.ravel()
    parameters = start.copy()
    for _ in range(rounds):
        residual = (model(parameters).reshape(given.shape)[used] - given[used]).ravel()
        design = derivative(parameters)[used].reshape(len(residual), -1)[:, free]
        step, *_ = np.linalg.lstsq(design * weight[:, None], -residual * weight, rcond=None)
        parameters[free] += step
        if np.abs(design @ step).max(initial=0.0) < 1e-9:
            break
    residual = (model(parameters).reshape(given.shape)[used] - given[used]).ravel()
    cofactor = np.asarray(np.linalg.pinv((design * weight[:, None] ** 2).T @ design), np.float64)
    redundancy = len(residual) - int(free.sum())
    squares = float(np.sum((residual * weight) ** 2))
    factor = float(np.sqrt(squares / redundancy)) if redundancy > 0 else np.nan
    miss, probability = _tested(
        residual.reshape(-1, k), design.reshape(-1, k, design.shape[1]), deviation, cofactor,
        (squares, redundancy, sigma is not None),
    )  # fmt: skip
    covariance = np.zeros((len(start), len(start)))
    # Without stated sigmas the residuals tell, and without redundancy nobody does.
    scaled = cofactor if sigma is not None else cofactor * factor**2
    covariance[np.ix_(free, free)] = scaled
    whole = np.full((3, *given.shape), np.nan)
    whole[0, used], whole[1, used] = residual.reshape(-1, k), miss
    chance = np.full(len(given), np.nan)
    chance[used] = probability
    return FittedPart(parameters, covariance, whole[0], whole[1], chance, redundancy, factor)


def _tested(
    residual: Floats,
    design: Floats,
    deviation: Floats,
    cofactor: Floats,
    sum_of_squares: tuple[float, int, bool],
) -> tuple[Floats, Floats]:
    """Miss of each point by all others, and the probability of a larger one."""
    squares, redundancy, known = sum_of_squares
    k = residual.shape[1]
    miss, probability = np.full(residual.shape, np.nan), np.full(len(residual), np.nan)
    # A point that the others leave no redundancy for is not checked.
    least_redundancy = 1e-6
    for i, (v, rows, sigma) in enumerate(zip(residual, design, deviation, strict=True)):
        variance = np.diag(sigma**2)
        left = variance - rows @ cofactor @ rows.T
        if np.linalg.eigvalsh(left / np.outer(sigma, sigma)).min() < least_redundancy:
            continue
        miss[i] = variance @ np.linalg.solve(left, v)
        statistic = float(v @ np.linalg.solve(left, v))
        if known:
            probability[i] = special.chdtrc(k, statistic)
        elif redundancy > k:
            rest = max(squares - statistic, 1e-18 * max(squares, 1e-12)) / (redundancy - k)
            probability[i] = special.fdtrc(k, redundancy - k, statistic / k / rest)
    return miss, probability


FEWEST = 3
# Triples that the search for a robust similarity tries; places beyond this many medians do not fit it.
SAMPLES, STRAY = 300, 4.0


@dataclass(frozen=True)
class Similarity:
    """X' = s R X + t.

    rotation (3, 3).
    shift (3,).
    """

    scale: float
    rotation: Floats
    shift: Floats

    def applied(self, places: Floats) -> Floats:
        """Transformed places, shape (..., 3)."""
        return np.asarray(self.scale * places @ self.rotation.T + self.shift)

    def applied_to_rotations(self, matrices: Floats) -> Floats:
        """Rotations from the new system to camera axes, from those of the old one, shape (..., 3, 3)."""
        return np.asarray(matrices @ self.rotation.T)


def similarity(source: Floats, target: Floats) -> Similarity | None:
    """Similarity that brings one set of places closest to another (Umeyama 1991, eq. 40-42).

    source, target (n, 3).

    returns: none for fewer than three places, or places in a line.
    """
    # Places whose second extent is a smaller share of their first lie too close to a line.
    line_share = 0.02
    if len(source) < FEWEST:
        return None
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - goal
    for extent in (np.linalg.svd(a, compute_uv=False), np.linalg.svd(b, compute_uv=False)):
        if not extent[1] > line_share * extent[0]:
            return None
    u, singular, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / np.sum(a**2))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)


def robust_similarity(source: Floats, target: Floats) -> tuple[Similarity, Flags] | None:
    """Similarity of least sum of misses among those of triples and of all, and the places that fit it.

    returns: fitted to the places that fit; None as in `similarity`.
    """
    count = len(source)
    rng = np.random.default_rng(count)
    choices = [np.arange(count)]
    if count > FEWEST:
        choices += [rng.choice(count, FEWEST, replace=False) for _ in range(SAMPLES)]
    moves = [move for chosen in choices if (move := similarity(source[chosen], target[chosen])) is not None]
    if not moves:
        return None
    best = min(moves, key=lambda move: float(misses_of(move, source, target).sum()))
    fits = np.ones(count, dtype=np.bool_)
    for _ in range(5):
        miss = misses_of(best, source, target)
        least = 1e-9 * float(np.ptp(target))
        fits = miss <= max(STRAY * float(np.median(miss)), least) if count > FEWEST + 1 else fits
        best = similarity(source[fits], target[fits]) or best
    return best, fits


def misses_of(move: Similarity, source: Floats, target: Floats) -> Floats:
    """Distance of each place from where a similarity takes it, shape (n,)."""
    return np.asarray(np.linalg.norm(move.applied(source) - target, axis=1))


def aligned_similarity(
    source: Floats, target: Floats, axes: Floats, goals: Floats, weight: float
) -> Similarity:
    """Similarity of places that need not determine it: directions help with the rotation.

    source, target (n, 3): one place and more.
    axes, goals (k, 3): directions in both systems.
    weight: of a direction beside those of the places, m squared.
    returns: of scale 1 where the places do not tell it.
    """
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - goal
    size = float(np.sum(a**2))
    scale = float(np.sqrt(np.sum(b**2) / size)) if size > 0 and np.sum(b**2) > 0 else 1.0
    u, _, vt = np.linalg.svd(scale * b.T @ a + weight * goals.T @ axes)
    rotation = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Similarity(scale, rotation, goal - scale * rotation @ middle)
