"""Control points against what the images say of them without control: gross ones, several, exchanged ones."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from scipy import special
from scipy.linalg import block_diag

from photocal.adjustment.adjust import minimum_of
from photocal.adjustment.factored import factorised
from photocal.adjustment.groups import CONTROL
from photocal.adjustment.joint import joint_covariance
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.adjustment.state import State
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import PhotocalError
from photocal.base.policy import policy
from photocal.geometry.distortion import slopes_of
from photocal.geometry.resection import intersect, ray_residuals
from photocal.geometry.rotation import matrix_from_angles

# Weak observations of what control would have determined: share of c; lever arm (m), boresight (rad), time
# offset (s); the shift is free.
LOOSE_C, LOOSE = 0.02, np.array([1.0] * 3 + [0.1] * 3 + [1.0])
# Principal distances by which a ray may miss the start coordinates of its point.
_ASTRAY = 0.25
# Left of the way to the places without control, squared, in units of the standard deviations.
_NEAR = 1e-4
# Coordinates of a point that a mistake concerns: its height, its place in plane, or all of them.
_ALL_AXES = (0, 1, 2)
_WRONG: tuple[tuple[int, ...], ...] = ((2,), (0, 1), _ALL_AXES)
# Factors by which the sigmas of a survey may be too small.
_FACTORS = np.geomspace(1.2, 60.0, 24)
# Random errors that are drawn to see how often a slip fits by chance, and how often it may.
DRAWS, SLIP_BY_CHANCE = 300, 0.05


@dataclass(frozen=True)
class Predicted:
    """Places of control points as the images tell them without control.

    points (n,): of the network.
    d (n, 3), covariance (3 n, 3 n): computed less given, survey included, m.
    common (3 n, k): what all of them may have in common.
    given (n, 3): as they were surveyed.
    survey (n, 3, 3): covariance of that.
    """

    points: Integers
    d: Floats
    covariance: Floats
    common: Floats
    given: Floats
    survey: Floats


@dataclass(frozen=True)
class Contradiction:
    """The fewest control points without which the others agree.

    members: rows of the prediction; two of them for an exchange.
    exchanged: whether the two have changed places.
    as_scale: whether standard deviations of the survey that are wrong by a factor explain it as well.
    instead: of each point, those that would explain it as well in its place.
    error (m, 3), sigma (m, 3): computed from the others less given, and its standard deviation, m.
    detectable (m, 3): error along an axis that would be found with 80 % power (Baarda 1968), m.
    choices: subsets of that kind that there are.
    """

    points: tuple[int, ...]
    exchanged: bool
    error: Floats
    sigma: Floats
    w: Floats
    detectable: Floats
    choices: int
    as_scale: bool = False
    instead: tuple[tuple[int, ...], ...] = ()


@dataclass(frozen=True)
class WrongSigmas:
    """No point stands apart: the sigmas of the survey are wrong by a factor.

    group: of the axis that shows it most, by its name.
    rival: points that are wrong, where they explain it as well.
    """

    group: str
    rival: Contradiction | None = None


def control_points(network: Network) -> Integers:
    """Points with surveyed coordinates in all three axes."""
    return np.flatnonzero((network.points.observed | network.points.held).all(axis=1))


def without_control(network: Network) -> Network:
    """The network with its control hardly held, and what control determines observed with caution."""
    control = control_points(network)
    weight, held = network.points.weight.copy(), network.points.held.copy()
    survey = survey_covariance(network, control)
    # Without control its points are still held, by this many times their sigmas: one ray alone does not.
    hardly = 1e4
    weight[control], held[control] = np.linalg.inv(survey) / hardly**2, False
    cameras = []
    for camera in network.cameras:
        prior = camera.prior_sigma.copy()
        prior[0] = min(prior[0], LOOSE_C * camera.value("c"))
        cameras.append(replace(camera, prior_sigma=prior, prior_correlation=None))
    sigma = network.mounting.sigma.copy()
    sigma[: len(LOOSE)] = np.minimum(sigma[: len(LOOSE)], LOOSE)
    # A shift is what all control points have in common; drifts and scales need control.
    sigma[len(LOOSE) :] = 0.0
    return replace(
        network,
        points=replace(network.points, weight=weight, held=held),
        cameras=tuple(cameras),
        mounting=replace(network.mounting, sigma=sigma),
    )


def begun_at_rays(network: Network, points: Integers) -> Network:
    """The network with those of the points that lie nowhere near their rays placed where these meet.

    A digit typed wrong may be kilometres: what is found without given coordinates cannot begin at them.
    """
    rays, exposures, values = network.rays, network.exposures, network.points.values
    rays = rays.rows(np.isin(rays.point, points))
    slopes = slopes_of(network.cameras, exposures.camera[rays.image], rays.plane)
    rotation = matrix_from_angles(exposures.started[:, :3])[rays.image]
    centre = exposures.started[rays.image, 3:]
    miss = ray_residuals(rotation, centre, values[rays.point], slopes)
    # In principal distances: attitudes to start from may be degrees off.
    near = np.isin(np.arange(len(values)), rays.point[miss < _ASTRAY])
    meeting = intersect(rays.point, len(values), centre, rotation, slopes, np.ones(len(slopes)))
    placed = np.where((near | np.isnan(meeting).any(axis=1))[:, None], values, meeting)
    return replace(network, points=replace(network.points, values=placed))


def survey_covariance(network: Network, control: Integers) -> Floats:
    """Covariance of surveyed coordinates, (n, 3, 3): a held one has no error, but rounding."""
    held, weight = network.points.held[control], network.points.weight[control]
    both = ~held[:, :, None] & ~held[:, None, :]
    return np.asarray(np.linalg.inv(np.where(both, weight, 1e8 * np.eye(3))))


def predicted(network: Network, state: State | None = None) -> Predicted | None:
    """Adjust without control, and give the places of its points; None where that cannot be.

    state: to start from, of the network with its control.
    """
    control = control_points(network)
    if len(control) < policy.fewest_control_to_blame:
        return None
    alone = without_control(begun_at_rays(network, control))
    if not len(network.positions.image):
        # Nothing else holds the block: a similarity is common to all points.
        free = replace(
            alone.points,
            weight=np.where(
                np.isin(np.arange(len(alone.points.weight)), control)[:, None, None], 0.0, alone.points.weight
            ),
        )
        alone = replace(alone, points=free, datum_points=np.zeros(0, dtype=np.int64))
    try:
        with because("control points predicted without themselves"):
            problem, minimum = minimum_of(alone, state=state, near=_NEAR)
        names = [("point", network.point_names[j]) for j in control]
        covariance = joint_covariance(factorised(problem, minimum), names)[1]
    except PhotocalError:
        return None
    computed = minimum.state.points[control]
    relative = computed - computed.mean(axis=0)
    common = np.tile(np.eye(3), (len(control), 1))
    if not len(network.positions.image):
        turns = np.cross(np.eye(3)[None, :, :], relative[:, None, :]).transpose(0, 2, 1).reshape(-1, 3)
        common = np.hstack([common, turns, relative.reshape(-1, 1)])
    given = network.points.values[control]
    survey = survey_covariance(network, control)
    whole = covariance + block_diag(*survey)
    return Predicted(control, computed - given, whole, common, given, survey)


def contradiction(seen: Predicted) -> Contradiction | WrongSigmas | None:
    """Find two points that changed places, or the fewest that contradict the others; None if not clear."""
    if len(seen.d) < policy.fewest_control_to_blame:
        return None
    pair = _exchange(seen)
    if pair is not None:
        return pair
    likeliest, rival = math.inf, None
    scales = _scales(seen)
    # Where a factor explains more than the fewest points do, the likeliest points compete with it.
    for chance in (policy.family_significance, 1.0):
        removed, axes, instead = contradicting(seen.d, seen.covariance, seen.common, chance)
        if not removed:
            continue
        # Both by their likelihood: errors of some points leave the others as they were stated.
        now = misfit(seen.d, seen.covariance, seen.common, ())
        likelier = sum(scales.values()) - now + _cost(seen.d, seen.covariance, seen.common, removed, axes)
        found = _of_points(seen, removed, instead)
        if likelier <= 0.0:
            # The more points are blamed, the more clearly each must be distinguished from a factor of all.
            return replace(found, as_scale=-likelier <= policy.as_good * len(removed))
        if likelier < likeliest:
            likeliest, rival = likelier, found
    if rival is None:
        return None
    most = CONTROL[max(scales, key=lambda axis: scales[axis])]
    return WrongSigmas(most, rival if likeliest <= policy.as_good else None)


def _of_points(
    seen: Predicted, removed: tuple[int, ...], instead: tuple[tuple[int, ...], ...]
) -> Contradiction:
    """Points that are wrong, each with those that would explain it as well in its place."""
    error, spread = zip(
        *(_beside_others(seen.d, seen.covariance, seen.common, removed, k) for k in removed), strict=True
    )
    sigma = np.sqrt(np.diagonal(np.array(spread), axis1=1, axis2=2))
    others = tuple(tuple(int(seen.points[j]) for j in rows) for rows in instead)
    return replace(_contradiction(seen, removed, np.array(error), sigma), instead=others)


def _scales(seen: Predicted) -> dict[int, float]:
    """What sigmas of the survey that are wrong by a factor gain of the likelihood, by axis, where they do.

    A factor of an axis belongs to all points, and is one unknown: it costs the logarithm of the coordinates
    (Schwarz 1978).
    """
    covariance, gains = seen.covariance, dict[int, float]()
    for axis in range(3):
        survey = np.zeros_like(covariance)
        at = np.arange(axis, len(covariance), 3)
        survey[at, at] = seen.survey[:, axis, axis]
        tried = [covariance + (factor**2 - 1.0) * survey for factor in _FACTORS]
        best = min(tried, key=lambda one: _likelihood(seen, one))
        gain = _likelihood(seen, covariance) - _likelihood(seen, best) - math.log(seen.d.size)
        if gain > 0.0:
            covariance, gains[axis] = best, gain
    return gains


def _likelihood(seen: Predicted, covariance: Floats) -> float:
    """Minus twice the logarithm of the likelihood of the differences, but for a constant."""
    _, size = np.linalg.slogdet(covariance)
    return misfit(seen.d, covariance, seen.common, ()) + float(size)


def _contradiction(
    seen: Predicted, rows: tuple[int, ...], error: Floats, sigma: Floats, *, exchanged: bool = False
) -> Contradiction:
    away = special.ndtri(policy.power) - special.ndtri(policy.significance / 2)
    points = tuple(int(seen.points[k]) for k in rows)
    count = len(list(combinations(range(len(seen.d)), len(rows))))
    return Contradiction(points, exchanged, error, sigma, error / sigma, away * sigma, count)


def _exchange(seen: Predicted) -> Contradiction | None:
    """Two points whose coordinates, exchanged, make all agree, and as they are do not."""
    n = len(seen.d)
    freedom = seen.d.size - seen.common.shape[1]
    limit = float(special.chdtri(freedom, policy.significance))
    now = misfit(seen.d, seen.covariance, seen.common, ())
    if now <= limit:
        return None
    tried = []
    for i, j in combinations(range(n), 2):
        d = seen.d.copy()
        d[[i, j]] += seen.given[[i, j]] - seen.given[[j, i]]
        tried.append((misfit(d, seen.covariance, seen.common, ()), i, j))
    best, i, j = min(tried)
    # As good as removing both: an exchange has no unknown.
    removed = misfit(seen.d, seen.covariance, seen.common, (i, j))
    if best > limit and best - removed > float(special.chdtri(6, policy.significance)):
        return None
    if now - best < float(special.chdtri(6, policy.significance / len(tried))):
        return None
    error = seen.given[[j, i]] - seen.given[[i, j]]
    spread = [_beside_others(seen.d, seen.covariance, seen.common, (i, j), k)[1] for k in (i, j)]
    sigma = np.sqrt(np.diagonal(np.array(spread), axis1=1, axis2=2))
    return _contradiction(seen, (i, j), error, sigma, exchanged=True)


def contradicting(
    d: Floats, covariance: Floats, common: Floats, chance: float = policy.family_significance
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[tuple[int, ...], ...]]:
    """Points that contradict the others, and which of their coordinates: the height, the plane, or all.

    One, two, up to a third of them: all subsets are tried together, for two that err alike hide each other.
    Of each kind as few as make the others agree, and more where each of these gains what chance does not: in
    a survey that has errors its further points and their kinds are one family of tests. Of all these the most
    probable (Schwarz 1978).

    chance: probability that any further point is taken although all further ones are right.
    returns: also, of each, those that explain it as well in its place (0.1 %). None is named where most of
        the others may have done it.
    """
    n, freedom, nobody = len(d), d.size - common.shape[1], (tuple[int, ...](), _ALL_AXES, ())
    if freedom < 1 or misfit(d, covariance, common, ()) <= special.chdtri(freedom, policy.significance):
        return nobody
    options, unclear = (
        list[tuple[float, tuple[int, ...], tuple[int, ...], tuple[tuple[int, ...], ...]]](),
        False,
    )
    for axes in _WRONG:
        best, agreed = tuple[int, ...](), math.inf
        for size in range(1, max(n // 3, 1) + 1):
            left = freedom - len(axes) * size
            if left < 1:
                break
            subsets = _subsets(n, best, size)
            tried = sorted((misfit(d, covariance, common, rows, axes), rows) for rows in subsets)
            least, best = tried[0]
            further = (n - size + 1) * len(_WRONG)
            limit = special.chdtri(len(axes), chance / further)
            if least > special.chdtri(left, policy.significance) or agreed - least < limit:
                continue
            agreed = least
            apart = float(special.chdtri(len(axes), policy.significance))
            as_good = [rows for left_over, rows in tried[1:] if left_over - least < apart]
            instead = tuple(
                tuple(sorted({j for rows in as_good if k not in rows for j in rows if j not in best}))
                for k in best
            )
            if any(2 * len(others) > n - size for others in instead):
                unclear = True
            else:
                options.append((_cost(d, covariance, common, best, axes), best, axes, instead))
    if not options:
        return nobody if unclear else (_scaled(d, covariance, common), _ALL_AXES, ())
    _, removed, axes, instead = min(options)
    return removed, axes, instead


def _cost(
    d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...], axes: tuple[int, ...]
) -> float:
    """What is left of the misfit, and what unknowns and choices cost (Schwarz 1978; Chen and Chen 2008)."""
    chosen = math.log(math.comb(len(d), len(removed)) * len(_WRONG))
    unknowns = len(axes) * len(removed) * math.log(d.size)
    return misfit(d, covariance, common, removed, axes) + unknowns + 2.0 * chosen


def _subsets(n: int, best: tuple[int, ...], size: int) -> Iterable[tuple[int, ...]]:
    # Of up to so many subsets all are tried, beyond them the best of one point fewer and each other point.
    all_subsets = 4000
    if size <= 2 or len(best) < size - 1 or np.prod(range(n - size + 1, n + 1)) < all_subsets * 6:
        return combinations(range(n), size)
    return {tuple(sorted((*best, k))) for k in range(n) if k not in best}


def _scaled(d: Floats, covariance: Floats, common: Floats) -> tuple[int, ...]:
    """Errors that the sigmas do not know stretch everything: what stands out does so against the rest."""
    n, removed = len(d), tuple[int, ...]()
    chi_squared = misfit(d, covariance, common, removed)
    while len(removed) < max(n // 3, 1):
        rest = 3 * (n - len(removed) - 1) - common.shape[1]
        if rest < 1:
            return ()
        tries = sorted(
            (misfit(d, covariance, common, (*removed, k)), k) for k in range(n) if k not in removed
        )
        (best, k), (second, _) = tries[:2]
        scale = max(best / rest, 1.0)
        if (chi_squared - best) / 3.0 / scale <= special.fdtri(3, rest, 1.0 - policy.significance / n):
            return removed
        if second - best < special.chdtri(3, policy.significance) * scale:
            return ()
        removed, chi_squared = (*removed, k), best
    return removed


def _equations(
    d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...], axes: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Equations of unit weight for the errors of points left out and the common part."""
    of_errors = np.eye(d.size).reshape(d.size, -1, 3)[:, list(removed)][:, :, list(axes)].reshape(d.size, -1)
    root = np.linalg.cholesky(covariance)
    return np.linalg.solve(root, np.hstack([of_errors, common])), np.linalg.solve(root, d.ravel())


def misfit(
    d: Floats,
    covariance: Floats,
    common: Floats,
    removed: tuple[int, ...],
    axes: tuple[int, ...] = _ALL_AXES,
) -> float:
    """Least d' C^-1 d with the common part free and coordinates of some points left out."""
    a, y = _equations(d, covariance, common, removed, axes)
    return float(np.sum((y - a @ np.linalg.lstsq(a, y, rcond=None)[0]) ** 2))


def _beside_others(
    d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...], k: int
) -> tuple[Floats, Floats]:
    """Error of a point that was left out, by the others, and its covariance."""
    a, y = _equations(d, covariance, common, removed, _ALL_AXES)
    normal = np.linalg.pinv(a.T @ a, hermitian=True)
    columns = slice(3 * removed.index(k), 3 * removed.index(k) + 3)
    return np.asarray((normal @ a.T @ y)[columns]), np.asarray(normal[columns, columns])


def slips(given: Floats, wanted: Floats, sigma: Floats, system: str) -> tuple[str, ...]:
    """Name the typing errors that made the given coordinates of the wanted ones; none that chance makes.

    A digit can be found for nearly every error: a slip is reported only where of random errors as large fewer
    than one in twenty would fit some slip as closely.

    returns: "code axis given wanted" each.
    """
    tolerance = policy.slip_sigmas * sigma
    zone = _zone_slip(given, wanted, tolerance, system)
    if zone:
        return (f"zone X {zone}",)
    told, away = _fitting(given, wanted, tolerance, sigma)
    if not told:
        return ()
    as_close = np.minimum(max(away, 1.0), policy.slip_sigmas) * sigma
    error = wanted - given
    drawn = given + random_errors(error, np.abs(error) > tolerance)
    chance = np.mean([bool(_fitting(given, other, as_close, sigma, tolerance)[0]) for other in drawn])
    return told if chance < SLIP_BY_CHANCE else ()


def random_errors(error: Floats, wrong: Flags) -> Floats:
    """Draw errors about as large as one of three axes, half to twice, with either sign, where it is wrong."""
    rng = np.random.default_rng(1)
    size = np.exp(rng.uniform(-0.7, 0.7, (DRAWS, 3))) * np.abs(error) * rng.choice([-1.0, 1.0], (DRAWS, 3))
    return np.where(wrong, size, 0.0)


def _fitting(
    given: Floats, wanted: Floats, tolerance: Floats, sigma: Floats, wrong_from: Floats | None = None
) -> tuple[tuple[str, ...], float]:
    """Slips that explain all axes that are wrong, and how far they stay away, in standard deviations."""
    wrong = np.abs(given - wanted) > (tolerance if wrong_from is None else wrong_from)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        changed = given.copy()
        changed[[a, b]] = given[[b, a]]
        if wrong[a] and wrong[b] and np.all(np.abs(changed - wanted) <= tolerance):
            return (f"exchanged {'XYZ'[a]} {'XYZ'[b]}",), float(np.max(np.abs(changed - wanted) / sigma))
    found, away = [], 0.0
    for k in np.flatnonzero(wrong).tolist():
        slip, value = _digit_slip(float(given[k]), float(wanted[k]), float(tolerance[k]))
        if not slip:
            return (), 0.0
        away = max(away, abs(value - float(wanted[k])) / float(sigma[k]))
        found.append(f"{slip[0]} {'XYZ'[k]} {' '.join(slip[1:])}")
    return tuple(found), away


def _digit_slip(given: float, wanted: float, tolerance: float) -> tuple[tuple[str, ...], float]:
    """Two digits swapped, one digit or the sign wrong, feet for metres: code, given, wanted; its value."""
    text = f"{given:.3f}"
    places = [i for i, mark in enumerate(text) if mark.isdigit()]
    for i, j in pairwise(places):
        marks = list(text)
        marks[i], marks[j] = marks[j], marks[i]
        swapped = "".join(marks)
        if swapped != text and abs(float(swapped) - wanted) <= tolerance:
            return ("digits-exchanged", text, swapped), float(swapped)
    for code, value in (("sign", -given), ("feet", given * 0.3048)):
        if abs(value - wanted) <= tolerance:
            return (code, text, f"{value:.3f}"), value
    for i in places:
        for digit in "0123456789":
            other = f"{text[:i]}{digit}{text[i + 1 :]}"
            if digit != text[i] and abs(float(other) - wanted) <= tolerance:
                return ("one-digit", text, other), float(other)
    return (), 0.0


def _zone_slip(given: Floats, wanted: Floats, tolerance: Floats, system: str) -> str:
    """Name the map zone in which the given coordinates are the wanted ones; empty when there is none."""
    # Neighbouring zones lie hundreds of kilometres apart.
    if system == "local" or not np.isfinite(wanted).all() or abs(given[0] - wanted[0]) < 1e4:
        return ""
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    horizontal = CRS.from_user_input(system).to_2d()
    zone, ellipsoid = horizontal.utm_zone, horizontal.ellipsoid
    if zone is None or ellipsoid is None:
        return ""
    axes = f"+a={ellipsoid.semi_major_metre} +b={ellipsoid.semi_minor_metre}"
    utm = f"+proj=utm {axes} {'+south' if zone[-1] == 'S' else ''} +units=m +no_defs +zone="
    for step in (-1, 1):
        number = (int(zone[:-1]) - 1 + step) % 60 + 1
        way = Transformer.from_crs(f"{utm}{number}", f"{utm}{zone[:-1]}", always_xy=True)
        try:
            x, y = way.transform(given[0], given[1])
        except ProjError:
            continue
        if abs(x - wanted[0]) <= tolerance[0] + 0.05 and abs(y - wanted[1]) <= tolerance[1] + 0.05:
            return str(number)
    return ""
