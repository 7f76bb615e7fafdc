"""Support of a network: which points, tapes and held station determine it how well."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.findings.document import TablePart, table
from photocal.georeferencing.methods import with_roles


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
        runs.append(_run(block, support))
        done()
    return tuple(runs)


def _run(block: Block, support: Support) -> SupportRun:
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


def support_table(runs: tuple[SupportRun, ...]) -> TablePart:
    """Write the accuracy at check points beside the inner precision: they need not go together."""
    heads = ("support", "points", "tapes", "held", "R control", "R check", "sX", "sY", "sZ", "sC", "<")
    rows = []
    for run in runs:
        lengths = (run.control_m, run.check_m, *run.sigma_m, run.mean_sigma_m)
        cells = ("" if np.isnan(value) else f"{1e3 * value:.2f}" for value in lengths)
        rows.append((run.name, str(run.control), str(run.distances), run.held, *cells, run.failure))
    return table(
        "support: R is the mean length at the points, s the mean standard deviation, mm", heads, rows
    )


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
