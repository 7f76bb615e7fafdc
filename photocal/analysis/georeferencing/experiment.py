"""Experiments: one block with several interior orientations and control patterns, or ever more control."""

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from photocal.analysis.accuracy.statistics import BiasTest, bias_test, moments, rmse_after_trend_removal
from photocal.analysis.georeferencing.comparison import (
    Differences,
    differences,
    exposure_difference,
    rms,
)
from photocal.analysis.georeferencing.methods import Degradation, Method, degraded, of_method
from photocal.analysis.georeferencing.prepared import (
    checkable,
    ground_points,
    in_local_frame,
    with_attitude_angles,
    with_roles,
)
from photocal.analysis.georeferencing.prior_sigma import (
    PriorRun,
    Support,
    SupportRun,
    run_priors,
    run_supports,
    support_of,
)
from photocal.base.arrays import Floats, Integers, spread
from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera, held_camera

Use = Literal["weighted", "fixed", "as-given"]
# A name, and which points are control; every other ground point is a check point.
Pattern = tuple[str, Integers]
SCHEMA = "photocal.control-numbers/1"
COUNTS = (0, 1, 3, 5)
CHOICES = 6


@dataclass(frozen=True)
class Experiment:
    """What is to be run.

    interiors: empty: the block's own camera.
    patterns: empty: the block's own roles.
    noise: direct orientations are the adjusted ones with this noise.
    camera: which camera of the block the interior orientations are of; the others stay as they are.
    prior: stated sigmas of positions, m, and of attitudes, rad, to be tried in every combination.
    """

    block: Block
    methods: tuple[Method, ...]
    interiors: tuple[Camera, ...] = ()
    uses: tuple[Use, ...] = ("weighted", "fixed")
    patterns: tuple[Pattern, ...] = ()
    leave_one_out: bool = False
    noise: Degradation | None = None
    seed: int = 0
    confidence: float = 0.95
    camera: int = 0
    supports: tuple[Support, ...] = ()
    prior: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())


@dataclass(frozen=True)
class ExperimentRun:
    """One run.

    without_trend: RMSE after the mean of biased components is removed, m.
    variance_factor: chi-squared over degrees of freedom; NaN when the run failed.
    residuals_px (2,): root mean square of all image residuals in x and y.
    exposures (6,): RMSE of omega, phi, kappa, rad, and X, Y, Z, m, against the reference, the block adjusted
        with all its surveyed points as control.
    points: control and check points; xyz (n, 3): their coordinates by this run, m.
    """

    interior: str
    use: str
    pattern: str
    method: Method
    control: int
    check: Differences | None
    bias: tuple[BiasTest, ...]
    without_trend: tuple[float, ...]
    variance_factor: float
    failure: str
    residuals_px: Floats = field(default_factory=lambda: np.full(2, np.nan))
    exposures: Floats = field(default_factory=lambda: np.full(6, np.nan))
    points: tuple[str, ...] = ()
    xyz: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def name(self) -> str:
        """Short name for a plot."""
        parts = (self.interior, "" if self.use == "as-given" else self.use, self.pattern, self.method)
        return " ".join(part for part in parts if part)


# Two runs that differ by their interior orientation only, and the RMSE (3,) of their differences in X, Y, Z,
# m, at the check points and at all ground points.
RunPair = tuple[ExperimentRun, ExperimentRun, Floats, Floats]


@dataclass(frozen=True)
class WithoutControlPoint:
    """A control point that was left out, so that the others judge it.

    d, sigma, w (3,): computed minus surveyed, its predicted sigma, m; d over sigma.
    """

    method: Method
    point: str
    d: Floats
    sigma: Floats
    w: Floats
    failure: str


@dataclass(frozen=True)
class ExperimentOutcome:
    """All runs of an experiment."""

    runs: tuple[ExperimentRun, ...]
    left_out: tuple[WithoutControlPoint, ...]
    supports: tuple[SupportRun, ...] = ()
    priors: tuple[PriorRun, ...] = ()

    @property
    def pairs(self) -> tuple[RunPair, ...]:
        """Runs of one method, pattern and use pair by pair, without those that failed."""
        return tuple(
            _pair(a, b)
            for a, b in combinations(self.runs, 2)
            if (a.method, a.pattern, a.use) == (b.method, b.pattern, b.use) and a.check and b.check
        )


def _pair(first: ExperimentRun, second: ExperimentRun) -> RunPair:
    """Compare the points that both runs have."""
    at = {name: k for k, name in enumerate(second.points)}
    both = [(k, at[name]) for k, name in enumerate(first.points) if name in at]
    d = np.array([first.xyz[k] - second.xyz[other] for k, other in both]).reshape(-1, 3)
    checks = set(first.check.names if first.check else ())
    at_checks = np.array([first.points[k] in checks for k, _ in both], dtype=np.bool_)
    return first, second, rms(d[at_checks]), rms(d)


def run_experiment(experiment: Experiment, done: Callable[[], None] = lambda: None) -> ExperimentOutcome:
    """Run an experiment."""
    block = with_attitude_angles(checkable(in_local_frame(experiment.block)))
    surveyed = np.flatnonzero(np.isfinite(block.points.sigma).any(axis=1))
    # Orientations with all surveyed points as control, where that can be.
    reference = None
    with suppress(PhotocalError):
        reference = of_method(with_roles(block, surveyed), "indirect").exposures
    done()
    supported = run_supports(block, experiment.supports, done)
    if experiment.noise is not None:
        # One realisation for all runs, so that they differ by what is being compared only.
        noisy = degraded(block, experiment.noise, np.random.default_rng(experiment.seed))
        block = replace(block, images=noisy.images, positions=noisy.positions, attitudes=noisy.attitudes)
        block = replace(block, mounting=noisy.mounting)
    priors = run_priors(block, *experiment.prior, reference, done)
    given_control: Pattern = ("", np.flatnonzero(block.points.of_role("control")))
    runs = []
    for method in experiment.methods:
        for pattern in experiment.patterns or (given_control,):
            for interior, use, camera in _cameras(experiment, block):
                cameras = list(block.cameras)
                cameras[experiment.camera] = camera
                setup = with_roles(replace(block, cameras=tuple(cameras)), pattern[1])
                runs.append(_run(setup, method, interior, use, pattern, experiment.confidence, reference))
                done()
    left = _leave_one_out(block, experiment.methods, done) if experiment.leave_one_out else ()
    return ExperimentOutcome(tuple(runs), left, supported, priors)


def spread_points(block: Block, candidates: Integers, count: int) -> Integers:
    """Choose points far from each other, see `spread`."""
    if not 0 < count <= len(candidates):
        raise ConfigurationError(
            f"{count} control points were asked for, the block has {len(candidates)}",
            remedy="ask for as many as there are, or fewer",
        )
    return np.asarray(candidates[spread(block.points.values[candidates, :2], count, [])])


def _cameras(experiment: Experiment, block: Block) -> list[tuple[str, Use, Camera]]:
    original = block.cameras[experiment.camera]
    if not experiment.interiors:
        return [("", "as-given", original)]
    made: list[tuple[str, Use, Camera]] = []
    for interior in experiment.interiors:
        given = replace(held_camera(interior), id=original.id)
        for use in experiment.uses:
            camera = replace(given, prior_correlation=None)
            if use == "weighted":
                known = np.isfinite(interior.prior_sigma) & (interior.prior_sigma > 0)
                sigma = np.where(known, interior.prior_sigma, np.inf)
                camera = replace(given, estimated=known, prior_sigma=sigma)
            made.append((interior.id, use, camera))
    return made


def _run(
    block: Block,
    method: Method,
    interior: str,
    use: Use,
    pattern: Pattern,
    confidence: float,
    reference: Floats | None,
) -> ExperimentRun:
    head = (interior, use, pattern[0], method, len(pattern[1]))
    try:
        result = of_method(block, method)
    except PhotocalError as refusal:
        return ExperimentRun(*head, None, (), (), float("nan"), str(refusal))
    check = differences(block, result, "check")
    figures = [moments(column) for column in check.d.T] if len(check.d) else []
    enough = len(check.d) > 1
    return ExperimentRun(
        *head,
        check,
        tuple(bias_test(m, confidence) for m in figures) if enough else (),
        tuple(rmse_after_trend_removal(m, confidence) for m in figures) if enough else (),
        result.chi_squared / result.degrees_of_freedom if result.degrees_of_freedom > 0 else float("nan"),
        "",
        np.sqrt(np.average(result.images.rms**2, axis=0, weights=result.images.rays)),
        np.full(6, np.nan) if reference is None else exposure_difference(result.exposures, reference)[2],
        tuple(block.points.names[k] for k in result.points),
        result.xyz,
    )


def _leave_one_out(
    block: Block, methods: tuple[Method, ...], done: Callable[[], None]
) -> tuple[WithoutControlPoint, ...]:
    control = np.flatnonzero(block.points.of_role("control"))
    nothing = np.full(3, np.nan)
    left = []
    for method in methods:
        for point in control:
            name = block.points.names[point]
            check, failure = None, "it has fewer than two rays"
            try:
                setup = checkable(with_roles(block, control[control != point]))
                check = differences(setup, of_method(setup, method), "check")
            except PhotocalError as refusal:
                failure = str(refusal)
            done()
            if check is None or name not in check.names:
                left.append(WithoutControlPoint(method, name, nothing, nothing, nothing, failure))
                continue
            k = check.names.index(name)
            sigma = np.sqrt(np.diag(check.covariance[k]))
            left.append(WithoutControlPoint(method, name, check.d[k], sigma, check.w[k], ""))
    return tuple(left)


class _Noise(Table):
    position_m: PositiveFloat
    attitude_deg: PositiveFloat
    seed: NonNegativeInt = 0


class _Interior(Table):
    cameras: str
    camera: str = ""
    use: tuple[Literal["weighted", "fixed"], ...] = ("weighted", "fixed")


class _Pattern(Table):
    name: str
    points: list[str] = Field(min_length=1)


class _Prior(Table):
    position_m: tuple[PositiveFloat, ...] = Field(min_length=1)
    attitude_deg: tuple[PositiveFloat, ...] = Field(min_length=1)


class _Support(Table):
    name: str
    points: tuple[str, ...] = ()
    distances: tuple[str, ...] = ()
    held: str = ""


class _Control(Table):
    pattern: tuple[_Pattern, ...] = ()
    counts: tuple[PositiveInt, ...] = ()
    leave_one_out: bool = False


class _File(Table):
    block: str
    methods: tuple[Method, ...] = ("integrated",)
    confidence: float = Field(default=0.95, gt=0.0, lt=1.0)
    simulated_direct: _Noise | None = None
    interior: _Interior | None = None
    control: _Control = _Control()
    support: tuple[_Support, ...] = ()
    prior: _Prior | None = None


def read_experiment(
    path: Path, read_block: Callable[[Path], Block], read_interiors: Callable[[Path], tuple[Camera, ...]]
) -> Experiment:
    """Read an experiment.

    raises InputNotFoundError: when it does not exist.
    raises ConfigurationError: for wrong keys or values, and for points that are not in the block.
    """
    asked = read_toml(path, _File)
    block = read_block(path.parent / asked.block)
    interiors: tuple[Camera, ...] = ()
    uses: tuple[Use, ...] = ()
    camera = 0
    if asked.interior is not None:
        interiors, uses = read_interiors(path.parent / asked.interior.cameras), tuple(asked.interior.use)
        camera = _camera(block, asked.interior.camera, path)
        _require_fitting(block.cameras[camera], interiors, path)
    noise = asked.simulated_direct
    return Experiment(
        block,
        tuple(asked.methods),
        interiors,
        uses,
        _patterns(asked.control, block, path),
        asked.control.leave_one_out,
        None if noise is None else Degradation(noise.position_m, math.radians(noise.attitude_deg)),
        0 if noise is None else noise.seed,
        asked.confidence,
        camera,
        tuple(support_of(block, one.name, one.points, one.distances, one.held) for one in asked.support),
        ((), ())
        if asked.prior is None
        else (asked.prior.position_m, tuple(map(math.radians, asked.prior.attitude_deg))),
    )


def _camera(block: Block, name: str, path: Path) -> int:
    """Which camera of the block gets the interior orientations."""
    names = [camera.id for camera in block.cameras]
    if not name and len(names) == 1:
        return 0
    if name not in names:
        reason = f"camera {name} is not in the block" if name else "the block has several cameras"
        raise ConfigurationError(
            reason, where=path, remedy=f'write camera = "..." in [interior]: {", ".join(names)}'
        )
    return names.index(name)


def _require_fitting(camera: Camera, interiors: tuple[Camera, ...], path: Path) -> None:
    for interior in interiors:
        if interior.unit != camera.unit or interior.size_px != camera.size_px:
            raise ConfigurationError(
                f"interior orientation {interior.id} is of another image size or unit "
                f"than camera {camera.id}",
                where=path,
                remedy="give calibrations of the block's own camera",
            )


def _patterns(control: _Control, block: Block, path: Path) -> tuple[Pattern, ...]:
    index = {name: k for k, name in enumerate(block.points.names)}
    surveyed = np.isfinite(block.points.sigma).any(axis=1) | block.points.of_role("control")
    patterns = []
    for pattern in control.pattern:
        for name in pattern.points:
            wrong = ConfigurationError.at(path)
            if name not in index:
                raise wrong(
                    f"point {name} of pattern {pattern.name} is not in the block", "name points of points.csv"
                )
            if not surveyed[index[name]]:
                raise wrong(
                    f"point {name} of pattern {pattern.name} has no sigma, so it cannot be control",
                    "give it sX, sY, sZ in points.csv",
                )
        patterns.append((pattern.name, np.array([index[n] for n in pattern.points])))
    usable = ground_points(block)
    usable = usable[surveyed[usable]]
    patterns += [(f"{n} control", spread_points(block, usable, n)) for n in control.counts]
    return tuple(patterns)


def control_numbers(
    block: Block, counts: Iterable[int] = COUNTS, seed: int = 0, done: Callable[[], None] = lambda: None
) -> tuple[ExperimentOutcome, dict[str, Any]]:
    """Repeat the adjustment with several numbers of control points.

    raises ConfigurationError: with fewer than two surveyed points.
    """
    surveyed = ground_points(block)
    usable = surveyed[np.isfinite(block.points.sigma[surveyed]).all(axis=1)]
    if len(usable) < 2:
        raise ConfigurationError(
            f"{len(usable)} surveyed points with sigmas cannot judge each other",
            remedy="survey more points, and give sX, sY, sZ of check points, too",
        )
    observed = len(block.positions.image) or np.isfinite(block.images.sigma[:, 3:]).any()
    method: Method = "integrated" if observed else "indirect"
    patterns: list[Pattern] = []
    random = np.random.default_rng(seed)
    for count in sorted({n for n in counts if 0 <= n < len(usable) - 1}):
        chosen = [spread_points(block, usable, count)] if count else [usable[:0]]
        chosen += [random.choice(usable, count, replace=False) for _ in range(CHOICES - 1 if count else 0)]
        patterns += [(f"{count} control", np.sort(points)) for points in chosen]
    patterns += [("all but one", usable[usable != point]) for point in usable]
    outcome = run_experiment(Experiment(block, (method,), patterns=tuple(patterns)), done)
    return outcome, {
        "schema": SCHEMA,
        "method": method,
        "points": len(usable),
        "numbers": _by_number(outcome),
    }


def _by_number(outcome: ExperimentOutcome) -> list[dict[str, Any]]:
    rows = []
    for count in sorted({run.control for run in outcome.runs}):
        runs = [run for run in outcome.runs if run.control == count]
        checks = [run.check for run in runs if run.check is not None and run.check.names]
        row: dict[str, Any] = {"control": count, "choices": len(runs), "failed": len(runs) - len(checks)}
        if not checks:
            rows.append(row | {"failure": runs[0].failure})
            continue
        d = np.vstack([check.d for check in checks])
        sigma = np.sqrt(np.vstack([np.diagonal(check.covariance, axis1=1, axis2=2) for check in checks]))
        rows.append(
            row
            | {
                "errors": len(d),
                "rmse_m": dict(zip("XYZ", rms(d).tolist(), strict=True)),
                "predicted_m": dict(zip("XYZ", rms(sigma).tolist(), strict=True)),
                "within_95_percent": float(np.mean(np.abs(d) <= policy.times_95 * sigma)),
            }
        )
    return rows


def numbers_text(figures: dict[str, Any], say: Catalogue) -> str:
    """Write them for people, and from which number on more control is hardly worth while."""
    lines = [say("experiment.numbers", method=say.term(figures["method"]), points=figures["points"])]
    predicted = {}
    for row in figures["numbers"]:
        if "rmse_m" not in row:
            lines.append(say("experiment.numbers_failed", control=row["control"], reason=row["failure"]))
            continue
        cells = ", ".join(f"{1e3 * row['rmse_m'][a]:.0f}/{1e3 * row['predicted_m'][a]:.0f}" for a in "XYZ")
        counts = {"control": row["control"], "choices": row["choices"], "errors": 3 * row["errors"]}
        share = f"{100 * row['within_95_percent']:.0f}"
        lines.append(say("experiment.numbers_row", **counts, cells=cells, share=share))
        predicted[row["control"]] = float(np.linalg.norm(list(row["predicted_m"].values())))
    if predicted:
        least = min(predicted.values())
        # More control is said to be worth while where it lowers what is predicted by more than this.
        worth = 0.1
        enough = min(count for count, value in predicted.items() if value <= (1 + worth) * least)
        lines.append(say("experiment.enough", n=enough))
    return "\n".join(lines)
