"""How a camera, or cameras on a frame, repeat from flight to flight: variance, trends, a future use."""

import datetime as dt
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.block.results.result import AdjustedHead
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera

# What a user of the camera feels; distortion is compared over the format.
PARAMETERS = ("c", "x0", "y0")


# One calibration of the camera, with what is known of when and how warm, degrees Celsius, it was.
Occasion = tuple[Camera, dt.date | None, float | None]


@dataclass(frozen=True)
class Trend:
    """Change of a parameter with temperature (per degree) or time (per 100 days); p of there being none.

    left: standard deviation between flights that remains with it.
    """

    against: str
    slope: float
    sigma: float
    p_value: float
    left: float


@dataclass(frozen=True)
class Repeatability:
    """What several calibrations say of one parameter, in the unit of the camera.

    mean, sigma: of all flights, and its standard deviation.
    between: standard deviation between flights, beyond what the calibrations themselves are uncertain by.
    p_value: of a scatter as large without any (Cochran 1954).
    future, factor: standard uncertainty of the mean for one more flight, and Student's factor for 95 %.
    """

    parameter: str
    unit: str
    flights: int
    mean: float
    sigma: float
    between: float
    p_value: float
    future: float
    factor: float
    trends: tuple[Trend, ...]


def repeatability(occasions: Sequence[Occasion]) -> tuple[Repeatability, ...]:
    """Judge every parameter that all calibrations estimated; nothing for fewer than three of one unit.

    x_i = mean + b_i + e_i with known variances of e_i; that of b_i after Paule and Mandel (1982).
    """
    cameras = [camera for camera, _, _ in occasions]
    if len(cameras) < 3 or len({camera.unit for camera in cameras}) > 1:
        return ()
    conditions = _conditions(occasions)
    shared = [name for name in PARAMETERS if all(camera.sigma_of(name) > 0.0 for camera in cameras)]
    return tuple(_of_parameter(name, cameras, conditions) for name in shared)


def _of_parameter(
    name: str, cameras: Sequence[Camera], conditions: Sequence[tuple[str, Floats]]
) -> Repeatability:
    x = np.array([camera.value(name) for camera in cameras])
    variance = np.array([camera.sigma_of(name) for camera in cameras]) ** 2
    n, ones = len(x), np.ones((len(x), 1))
    between = between_flights(x, variance, ones)
    (mean,), covariance = _fitted(x, variance + between, ones)
    sigma = math.sqrt(covariance[0, 0])
    scatter = float(np.sum((x - np.average(x, weights=1.0 / variance)) ** 2 / variance))
    trends = (_trend(against, at, x, variance) for against, at in conditions)
    return Repeatability(
        name,
        cameras[0].unit,
        n,
        float(mean),
        sigma,
        math.sqrt(between),
        float(stats.chi2.sf(scatter, n - 1)),
        math.hypot(math.sqrt(between), sigma),
        float(stats.t.ppf(0.5 + policy.confidence / 2.0, n - 1)),
        tuple(trend for trend in trends if trend is not None),
    )


def between_flights(x: Floats, variance: Floats, design: Floats) -> float:
    """Give the variance between flights that makes the weighted sum of squares its expectation."""
    from scipy.optimize import brentq

    freedom = len(x) - len(design.T)

    def excess(between: float) -> float:
        """Weighted squares less their expectation, at a variance between flights."""
        values, _ = _fitted(x, variance + between, design)
        return float(np.sum((x - design @ values) ** 2 / (variance + between))) - freedom

    if freedom < 1 or excess(0.0) <= 0.0:
        return 0.0
    upper = float(np.ptp(x) ** 2)
    while excess(upper) > 0.0:
        upper *= 2.0
    return float(brentq(excess, 0.0, upper, xtol=1e-12 * upper))


def _fitted(x: Floats, variance: Floats, design: Floats) -> tuple[Floats, Floats]:
    normal = design.T @ (design / variance[:, None])
    covariance: Floats = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return covariance @ (design.T @ (x / variance)), covariance


def _conditions(occasions: Sequence[Occasion]) -> list[tuple[str, Floats]]:
    """Temperatures and days, where all flights have them and they differ."""
    conditions = []
    warm = [temperature_c for _, _, temperature_c in occasions]
    days = [day.toordinal() / 100.0 if day else None for _, day, _ in occasions]
    for against, values in (("temperature", warm), ("time", days)):
        known = np.array([value for value in values if value is not None], dtype=np.float64)
        if len(known) == len(occasions) and np.ptp(known) > 0.0:
            conditions.append((against, known - known.mean()))
    return conditions


def _trend(against: str, at: Floats, x: Floats, variance: Floats) -> Trend | None:
    freedom = len(x) - 2
    if freedom < 1:
        return None
    design = np.column_stack([np.ones(len(x)), at])
    left = between_flights(x, variance, design)
    (_, slope), covariance = _fitted(x, variance + left, design)
    sigma = math.sqrt(covariance[1, 1])
    # Where nothing is left between flights the sigmas of the calibrations count, which are known.
    t = abs(slope) / sigma
    p_value = 2.0 * float(stats.t.sf(t, freedom) if left > 0.0 else stats.norm.sf(t))
    return Trend(against, float(slope), sigma, p_value, math.sqrt(left))


def repeatability_text(results: Sequence[Repeatability], say: Catalogue) -> str:
    """Write it for people, one line for each parameter and each trend."""
    lines = [say("compared.repeats")]
    for result in results:
        names = {"parameter": result.parameter, "unit": result.unit, "flights": result.flights}
        sizes = {"mean": result.mean, "sigma": result.sigma, "between": result.between}
        future = {"future": result.factor * result.future, "factor": result.factor}
        lines.append(say.told("compared.repeat", **names, **sizes, **future, p=result.p_value))
        for t in result.trends:
            kind = {key: say(f"compared.{key}_{t.against}") for key in ("against", "per")}
            sizes = {"slope": t.slope, "sigma": t.sigma, "p": t.p_value, "left": t.left}
            lines.append(say.told("compared.trend", **kind, **sizes, unit=result.unit))
    return "\n".join(lines)


@dataclass(frozen=True)
class Moved:
    """How a head differs between two calibrations.

    differences, sigma: second less first of what is estimated in both, by name (`adjustment.rig.OF_HEAD`;
        deg, m, s); turns are about the axes of the head.
    p_value: of so large a difference when nothing has changed, with all covariances.
    """

    camera: str
    of: str
    first: str
    second: str
    differences: dict[str, float]
    sigma: dict[str, float]
    p_value: float

    @property
    def different(self) -> bool:
        """Whether the head moved."""
        return self.p_value < policy.repeat_significance


def compared_heads(calibrations: Mapping[str, Sequence[AdjustedHead]]) -> tuple[Moved, ...]:
    """Compare the heads that two calibrations have in common, each pair of them."""
    moves = []
    for (first, of_first), (second, of_second) in itertools.combinations(calibrations.items(), 2):
        others = {(head.camera, head.of): head for head in of_second}
        pairs = ((head, others.get((head.camera, head.of))) for head in of_first)
        moves += [moved for a, b in pairs if b and (moved := _moved(first, second, a, b)) is not None]
    return tuple(moves)


def _moved(first: str, second: str, a: AdjustedHead, b: AdjustedHead) -> Moved | None:
    """Difference of one head; None where nothing of it is estimated in both."""
    names = tuple(name for name in a.free if name in b.free)
    if not names:
        return None
    turns = [Rotation.from_rotvec(head.rotation_deg, degrees=True) for head in (a, b)]
    turn = (turns[1] * turns[0].inv()).as_rotvec(degrees=True)
    all_of = dict(zip(("turn_x", "turn_y", "turn_z"), turn.tolist(), strict=True))
    all_of |= {key: b.values[key].value - a.values[key].value for key in a.values if key not in all_of}
    difference = np.array([all_of[name] for name in names])
    covariance = a.covariance(names) + b.covariance(names)
    sigma = np.sqrt(np.diag(covariance))
    # Scaled to correlations: degrees and metres differ in size.
    w = difference / sigma
    chi_squared = float(w @ np.linalg.solve(covariance / np.outer(sigma, sigma), w))
    return Moved(
        a.camera,
        a.of,
        first,
        second,
        dict(zip(names, difference.tolist(), strict=True)),
        dict(zip(names, sigma.tolist(), strict=True)),
        float(stats.chi2.sf(chi_squared, len(names))),
    )


def heads_text(moves: Sequence[Moved], say: Catalogue) -> str:
    """Write it for people, one line for each head and pair."""
    lines = [say("compared.heads")]
    for head in moves:
        parts = []
        for name, value in head.differences.items():
            factor = 3600.0 if name.startswith("turn") else 1000.0
            sigma = say.row([factor * head.sigma[name]], ".2g")
            parts.append(f"{name} {say.row([factor * value], '+.3g')} +- {sigma}")
        who = {key: getattr(head, key) for key in ("camera", "of", "first", "second")}
        verdict = say("compared.has_moved" if head.different else "compared.as_before")
        told = {"figures": say("join.figures").join(parts), "verdict": verdict}
        lines.append(say.told("compared.moved", **who, **told, p=head.p_value))
    return "\n".join(lines)
