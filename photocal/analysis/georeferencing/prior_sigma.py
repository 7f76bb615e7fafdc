"""Sigmas of the exterior orientation after an adjustment against those that were stated before it.

Support of a network: which points, tapes and held station determine it how well.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.analysis.accuracy.output import told_table
from photocal.analysis.accuracy.variance_analysis import (
    VarianceEffect,
    analyse_rmse,
    variance_record,
    variance_tables,
)
from photocal.analysis.georeferencing.comparison import differences, exposure_difference
from photocal.analysis.georeferencing.methods import of_method
from photocal.analysis.georeferencing.prepared import with_roles
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.findings.document import TablePart
from photocal.findings.texts import Catalogue

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ELEMENTS = ("omega", "phi", "kappa", "x", "y", "z")


@dataclass(frozen=True)
class PriorRun:
    """An adjustment with stated sigmas of the exterior orientation.

    position_m, attitude_rad: as stated.
    sigma (6,): root mean square sigma of omega, phi, kappa (rad), X, Y, Z (m) of the images after adjustment.
    exterior (6,): root mean square difference from the reference, the block by all its surveyed points.
    check_rmse, check_sigma (3,): at the check points, m; NaN without any.
    variance_factor: chi-squared over degrees of freedom: far from 1 where what is stated is not what is so.
    """

    position_m: float
    attitude_rad: float
    sigma: Floats = field(default_factory=lambda: np.full(6, np.nan))
    exterior: Floats = field(default_factory=lambda: np.full(6, np.nan))
    check_rmse: Floats = field(default_factory=lambda: np.full(3, np.nan))
    check_sigma: Floats = field(default_factory=lambda: np.full(3, np.nan))
    variance_factor: float = np.nan
    failure: str = ""


def with_prior(block: Block, position_m: float, attitude_rad: float) -> Block:
    """Return the block with other sigmas of what its exposures observe; the values stay.

    raises ConfigurationError: when its exposures observe nothing.
    """
    sigma = block.images.sigma.copy()
    stated = np.isfinite(sigma) & (sigma > 0)
    sigma = np.where(stated, np.repeat([attitude_rad, position_m], 3), sigma)
    positions, attitudes = block.positions, block.attitudes
    if not (stated.any() or len(positions.image) or len(attitudes.image)):
        raise ConfigurationError(
            "no exposure of the block is observed, so that no sigma can be stated for it",
            "give positions.csv, or sigmas in images.csv, or [simulated_direct]",
        )
    return replace(
        block,
        images=replace(block.images, sigma=sigma),
        positions=replace(positions, covariance=_of(position_m, len(positions.image))),
        attitudes=replace(attitudes, covariance=_of(attitude_rad, len(attitudes.image))),
    )


def _of(sigma: float, count: int) -> Floats:
    return np.broadcast_to(sigma**2 * np.eye(3), (count, 3, 3)).copy()


def run_priors(
    block: Block,
    positions_m: tuple[float, ...],
    attitudes_rad: tuple[float, ...],
    reference: Floats | None,
    done: Callable[[], None] = lambda: None,
) -> tuple[PriorRun, ...]:
    """Adjust a block, in its local frame, with every combination of stated sigmas."""
    runs = []
    for stated in product(positions_m, attitudes_rad):
        runs.append(_run(block, stated, reference))
        done()
    return tuple(runs)


def _run(block: Block, stated: tuple[float, float], reference: Floats | None) -> PriorRun:
    setup = with_prior(block, *stated)
    try:
        result = of_method(setup, "integrated")
    except PhotocalError as refusal:
        return PriorRun(*stated, failure=str(refusal))
    solution = result.solution
    nothing = np.full(6, np.nan)
    variance = nothing if solution is None else np.diagonal(solution.exposure_covariance, axis1=1, axis2=2)
    check = differences(setup, result, "check")
    return PriorRun(
        *stated,
        np.sqrt(np.atleast_2d(variance).mean(axis=0)),
        nothing if reference is None else exposure_difference(result.exposures, reference)[2],
        check.rmse,
        check.predicted,
        result.chi_squared / result.degrees_of_freedom if result.degrees_of_freedom else np.nan,
    )


def prior_variance(runs: tuple[PriorRun, ...]) -> dict[str, tuple[VarianceEffect, ...]]:
    """Part the variance of the errors at the check points by the stated sigmas; empty where it cannot be."""
    good = [run for run in runs if np.isfinite(run.check_rmse).all()]
    factors = {
        "position": [f"{run.position_m:g}" for run in good],
        "attitude": [f"{run.attitude_rad:g}" for run in good],
    }
    return analyse_rmse(factors, np.array([run.check_rmse for run in good]).reshape(-1, 3))


def prior_tables(runs: tuple[PriorRun, ...], say: Catalogue) -> list[TablePart]:
    """Write what is stated beside what comes out."""
    rows = []
    for run in runs:
        turned = (*run.sigma[3:], *np.degrees(run.sigma[:3]), *run.check_rmse, *run.check_sigma)
        cells = ("" if np.isnan(v) else f"{v:.4f}" for v in (*turned, run.variance_factor))
        rows.append((f"{run.position_m:g}", f"{np.degrees(run.attitude_rad):g}", *cells, run.failure))
    return [told_table("experiment.prior", rows, say), *variance_tables(prior_variance(runs), say)]


def prior_rows(runs: tuple[PriorRun, ...]) -> list[dict[str, Any]]:
    """Give the runs as rows of a table."""
    return [
        {
            "position_m": run.position_m,
            "attitude_deg": float(np.degrees(run.attitude_rad)),
            **_by_element("sigma", run.sigma),
            **_by_element("exterior_rmse", run.exterior),
            **{f"check_rmse_{axis}_m": value for axis, value in zip("xyz", run.check_rmse, strict=True)},
            **{f"check_sigma_{axis}_m": value for axis, value in zip("xyz", run.check_sigma, strict=True)},
            "variance_factor": run.variance_factor,
            "failure": run.failure,
        }
        for run in runs
    ]


def _by_element(name: str, values: Floats) -> dict[str, float]:
    shown = (*np.degrees(values[:3]), *values[3:])
    units = ("deg",) * 3 + ("m",) * 3
    parts = zip(_ELEMENTS, units, shown, strict=True)
    return {f"{name}_{element}_{unit}": float(value) for element, unit, value in parts}


def prior_record(runs: tuple[PriorRun, ...]) -> dict[str, Any]:
    """Give the runs and their analysis of variance as a JSON value."""
    return {"runs": prior_rows(runs), "variance": variance_record(prior_variance(runs))}


def prior_plot(runs: tuple[PriorRun, ...]) -> "Figure | None":
    """Draw sigmas after adjustment against those stated, with the line where nothing is gained."""
    from matplotlib.figure import Figure

    good = [run for run in runs if not run.failure]
    if not good:
        return None
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 2)
    sigma = np.array([run.sigma for run in good])
    sides = (
        ("position", "m", np.array([run.position_m for run in good]), sigma[:, 3:]),
        ("attitude", "deg", np.degrees([run.attitude_rad for run in good]), np.degrees(sigma[:, :3])),
    )
    for axes, (what, unit, stated, after) in zip(panels, sides, strict=True):
        for k, mark in enumerate("osd"):
            axes.plot(stated, after[:, k], mark, ms=4, label=_ELEMENTS[k + 3 * (what == "position")])
        ends = np.array([stated.min(), stated.max()])
        axes.plot(ends, ends, color="0.6", lw=0.8, label="as stated")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(f"stated sigma of {what}, {unit}")
        axes.set_ylabel(f"after adjustment, {unit}")
        axes.legend(fontsize=7)
    return figure


@dataclass(frozen=True)
class Support:
    """What holds a network.

    control: points; the other surveyed ones are check points.
    distances: rows of the block's distances that take part.
    held: image whose orientation is held as given, -1 for none.
    """

    name: str
    control: Integers
    distances: Integers
    held: int


@dataclass(frozen=True)
class SupportRun:
    """What a support leads to.

    control_m, check_m: mean length of the differences at control and check points, m (R of the tank study).
    sigma_m (3,), mean_sigma_m: mean standard deviation of the object points by axis, and of all, m.
    range_m (3,): largest less smallest of them, m: small where the network is homogeneous.
    """

    name: str
    control: int
    distances: int
    held: str
    control_m: float = np.nan
    check_m: float = np.nan
    sigma_m: tuple[float, ...] = (np.nan,) * 3
    mean_sigma_m: float = np.nan
    range_m: tuple[float, ...] = (np.nan,) * 3
    failure: str = ""


def support_of(
    block: Block, name: str, points: tuple[str, ...], distances: tuple[str, ...], held: str
) -> Support:
    """Find points, distances (`from-to`) and image of a support in the block.

    raises ConfigurationError: for what the block does not have.
    """
    index = {point: k for k, point in enumerate(block.points.names)}
    relations = block.relations
    pairs = zip(relations.first.tolist(), relations.second.tolist(), strict=True)
    rows = {f"{block.points.names[a]}-{block.points.names[b]}": k for k, (a, b) in enumerate(pairs)}
    for what, wanted, known in (("point", points, index), ("distance", distances, rows)):
        strange = [one for one in wanted if one not in known]
        if strange:
            raise ConfigurationError(
                f"support {name}: the block has no {what} {strange[0]}",
                f"it has {', '.join(list(known)[:8])}",
            )
    if held and held not in block.images.names:
        raise ConfigurationError(f"support {name}: the block has no image {held}", "name one of images.csv")
    return Support(
        name,
        np.array([index[one] for one in points], dtype=np.int64),
        np.array([rows[one] for one in distances], dtype=np.int64),
        block.images.names.index(held) if held else -1,
    )


def run_supports(
    block: Block, supports: tuple[Support, ...], done: Callable[[], None] = lambda: None
) -> tuple[SupportRun, ...]:
    """Adjust a block, in its local frame, with each support."""
    runs = []
    for support in supports:
        runs.append(_supported(block, support))
        done()
    return tuple(runs)


def _supported(block: Block, support: Support) -> SupportRun:
    held = block.images.names[support.held] if support.held >= 0 else ""
    head = support.name, len(support.control), len(support.distances), held
    sigma = np.full_like(block.images.sigma, np.inf)
    if support.held >= 0:
        sigma[support.held] = 0.0
    setup = with_roles(block, support.control)
    setup = replace(
        setup,
        images=replace(block.images, sigma=sigma),
        relations=block.relations.rows(support.distances),
    )
    try:
        assembly = assemble(setup)
        solution = adjust(assembly.network)
    except PhotocalError as refusal:
        return SupportRun(*head, failure=str(refusal))
    apart = assembly.frame.to_given(solution.points) - setup.points.values[assembly.points]
    surveyed = np.isfinite(setup.points.sigma[assembly.points]).all(axis=1)
    control, check = (
        _mean_length(apart[surveyed & setup.points.of_role(role)[assembly.points]])
        for role in ("control", "check")
    )
    deviations = np.sqrt(np.diagonal(solution.point_covariance, axis1=1, axis2=2))
    return SupportRun(
        *head,
        control,
        check,
        tuple(deviations.mean(axis=0).tolist()),
        float(deviations.mean()),
        tuple(np.ptp(deviations, axis=0).tolist()),
    )


def _mean_length(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).mean()) if len(vectors) else np.nan


def support_table(runs: tuple[SupportRun, ...], say: Catalogue) -> TablePart:
    """Write the accuracy at check points beside the inner precision: they need not go together."""
    rows = []
    for run in runs:
        lengths = (run.control_m, run.check_m, *run.sigma_m, run.mean_sigma_m)
        cells = ("" if np.isnan(value) else f"{1e3 * value:.2f}" for value in lengths)
        rows.append((run.name, str(run.control), str(run.distances), run.held, *cells, run.failure))
    return told_table("experiment.support", rows, say)


def support_rows(runs: tuple[SupportRun, ...]) -> list[dict[str, Any]]:
    """Give the runs as rows of a table."""
    return [
        {
            **{key: value for key, value in vars(run).items() if not isinstance(value, tuple)},
            **{f"s{axis}_m": value for axis, value in zip("XYZ", run.sigma_m, strict=True)},
            **{f"range_{axis}_m": value for axis, value in zip("XYZ", run.range_m, strict=True)},
        }
        for run in runs
    ]
