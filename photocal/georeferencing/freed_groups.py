"""Faults of the table in a block: how they are freed, what they become, what a flight cannot separate."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from photocal.adjustment.adjust import adjust
from photocal.adjustment.condensed import Condensed, condensed, with_second_camera
from photocal.adjustment.covariance import Shared
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.groups import GroupTest, tested
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, STRIPS, TIME
from photocal.adjustment.network import Network
from photocal.adjustment.readout import READOUT
from photocal.adjustment.solution import Solution
from photocal.adjustment.state import State, start_state
from photocal.base import policy
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.findings.hypotheses import FAULTS, Fault
from photocal.geometry.camera import PARAMETERS, Camera

# What is asked of a calibration flight: 1 m, 1 degree, 0.1 s, 1 m; the camera: 1 % of c, 0.1 s of readout.
_SCALE_COMMON = np.array([1.0] * 3 + [np.radians(1.0)] * 3 + [0.1] + [1.0] * 3 + [0.0])
_SCALE_CAMERA, _SCALE_READOUT = 0.01, 0.1
# A direction is not determined when its standard deviation stays above this share of the scale.
_UNDETERMINED = 0.05
_TAKES_PART = 0.1
# So many places are tried where the camera may have changed.
_MOST_PLACES = 6
# The first image of a second camera, and its parameters: start values of those that are free.
Change = tuple[int, Floats]
# They are settled when they change by a smaller share; it takes no more adjustments.
_SETTLED, _SETTLING = 0.02, 12


@dataclass(frozen=True)
class Separation:
    """How well the flight determines the values that could be freed together.

    sigma (k,): standard deviation when all are free, in m, rad, s and the camera's unit; the prior of 1 m, 1
        degree, 0.1 s, 1 % of c is included.
    groups: names that are not separated from each other; a single name is not determined at all.
    """

    names: tuple[str, ...]
    sigma: Floats
    correlation: Floats
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Opened:
    """A block at the minimum of its integrated adjustment, with all that faults may free as unknowns.

    first: the minimum of the block as it is.
    at: normal equations there with everything free.
    whole: the same, condensed to what all images share.
    table: the faults.
    """

    block: Block
    first: Solution
    at: Factored
    whole: Condensed
    table: tuple[Fault, ...] = FAULTS


def opened(block: Block, first: Solution | None = None, table: tuple[Fault, ...] = FAULTS) -> Opened:
    """Adjust a block, unless its adjustment is given, and set up what tells of all faults at once.

    raises PhotocalError: as the adjustment does.
    """
    with because("integrated adjustment in which faults are sought"):
        first = first or adjust(assemble(block).network)
    free = block
    for fault in table:
        if fault.frees and fault.each != "part" and _testable(block, fault, None):
            free = with_freed(free, fault, None)
    network = assemble(free).network
    at = factored(network, beside(network, first))
    return Opened(block, first, at, condensed(at), table)


def separation(given: Opened) -> Separation | None:
    """See what the block would leave open if everything were free; None without positions."""
    block, whole = given.block, given.whole
    if not len(block.positions.image):
        return None
    asked = np.zeros(len(block.mounting.sigma), dtype=bool)
    asked[LEVER], asked[SHIFT] = True, True
    asked[BORESIGHT] = len(block.attitudes.image) > 0
    asked[TIME] = bool(np.any(block.positions.velocity))
    taken = np.flatnonzero(asked)
    sigma = np.zeros(len(asked))
    sigma[taken] = _SCALE_COMMON[taken]
    cameras = tuple(replace(camera, prior_sigma=_scales(camera)) for camera in block.cameras)
    columns = [int(whole.common_columns[k]) for k in taken]
    names = [COMMON[k] for k in taken]
    scale = [float(_SCALE_COMMON[k]) for k in taken]
    for camera, camera_columns in zip(cameras, whole.camera_columns, strict=True):
        for k, column in zip(*camera_columns, strict=True):
            if np.isfinite(camera.prior_sigma[k]):
                names.append(PARAMETERS[k] + (f"[{camera.id}]" if len(cameras) > 1 else ""))
                columns.append(int(column))
                scale.append(float(camera.prior_sigma[k]))
    try:
        mounting = replace(block.mounting, sigma=sigma)
        covariance = whole.covariance(cameras, mounting)[np.ix_(columns, columns)]
    except IllPosedError:
        return None
    deviation = np.sqrt(np.diag(covariance))
    groups = _groups(tuple(names), covariance / np.outer(scale, scale))
    return Separation(tuple(names), deviation, covariance / np.outer(deviation, deviation), groups)


def _scales(camera: Camera) -> Floats:
    """Scales of the estimated ones of c, x0, y0 and the readout; infinite of the others."""
    scale = np.full(len(PARAMETERS), np.inf)
    scale[:3], scale[READOUT] = _SCALE_CAMERA * camera.value("c"), _SCALE_READOUT
    return np.where(camera.estimated, scale, np.inf)


def _groups(names: tuple[str, ...], covariance: Floats) -> tuple[tuple[str, ...], ...]:
    """Names that the undetermined directions tie together."""
    variances, vectors = np.linalg.eigh(covariance)
    open_ = vectors[:, variances > _UNDETERMINED**2]
    projector = open_ @ open_.T
    part = np.diag(projector) > _TAKES_PART
    linked = (np.abs(projector) > _TAKES_PART) & part[:, None] & part[None, :]
    _, label = connected_components(csr_array(linked), directed=False)
    groups: dict[int, list[str]] = {}
    for name, group, has in zip(names, label.tolist(), part.tolist(), strict=True):
        if has:
            groups.setdefault(group, []).append(name)
    return tuple(tuple(group) for group in groups.values())


@dataclass(frozen=True)
class Estimate:
    """One value of a freed group.

    unit: m, deg, s, mm or px.
    correction: estimated less given.
    significant: at 0.1 %, two-sided.
    """

    name: str
    unit: str
    correction: float
    value: float
    sigma: float
    t: float
    significant: bool


def faults_of(block: Block, change: Change | None, table: tuple[Fault, ...] = FAULTS) -> tuple[Fault, ...]:
    """Give the faults that a block may be tested for: what it leaves free itself is none."""
    free = {fault.code for fault in table if fault.frees and left_free(block, fault)}
    taken = free | {code for fault in table if fault.code in free for code in fault.contains}
    return tuple(
        fault
        for fault in table
        if fault.frees and fault.code not in taken and _testable(block, fault, change)
    )


def of_camera(fault: Fault) -> bool:
    """Whether a fault frees parameters of cameras; the others free values of the mounting."""
    return fault.frees[0] in PARAMETERS


def left_free(block: Block, fault: Fault) -> bool:
    """Tell whether the block itself leaves values of a fault free: all of the mounting, any of a camera."""
    if fault.each == "part":
        return False
    if of_camera(fault):
        at = [PARAMETERS.index(name) for name in fault.frees]
        return any(
            bool(c.estimated[k]) and not math.isfinite(c.prior_sigma[k]) for c in block.cameras for k in at
        )
    sigma = block.mounting.sigma
    at = _first_strip(fault) if fault.each == "strip" else _columns(fault)
    return len(sigma) > max(at) and bool(np.isinf(sigma[at]).all())


def _testable(block: Block, fault: Fault, change: Change | None) -> bool:
    """Whether the observations of a block can say anything of a fault."""
    if fault.each == "part":
        return change is not None
    if fault.each == "strip":
        return len(np.unique(block.positions.strip)) > 1
    if fault.frees[0].startswith("boresight"):
        return len(block.attitudes.image) > 0
    return fault.frees[0] != "time_offset" or bool(np.any(block.positions.velocity))


def with_freed(block: Block, fault: Fault, change: Change | None) -> Block:
    """Return the block with the values of one fault freed, weakly observed as they are given."""
    if fault.each == "part" and change is not None:
        return _split_at(block, change, fault)
    if of_camera(fault):
        return replace(block, cameras=tuple(_freed(camera, fault) for camera in block.cameras))
    sigma = block.mounting.sigma.copy()
    if fault.each == "strip":
        # Images without position have no strip: their columns stay held.
        for strip in np.unique(block.positions.strip):
            sigma[[6 * int(strip) + k for k in _first_strip(fault)]] = fault.prior
    else:
        sigma[_columns(fault)] = fault.prior
    return replace(block, mounting=replace(block.mounting, sigma=sigma))


def _freed(camera: Camera, fault: Fault) -> Camera:
    """Free parameters by what moves rays at r = c / 2 by as much as c: K1 r^2 = 1 and so on."""
    powers = {"K1": 2, "K2": 4, "K3": 6, "K4": 8, "P1": 1, "P2": 1, "P3": 3, "P4": 5, "B1": 0, "B2": 0}
    estimated, sigma, c = camera.estimated.copy(), camera.prior_sigma.copy(), camera.value("c")
    for name in fault.frees:
        k = PARAMETERS.index(name)
        estimated[k], sigma[k] = True, fault.prior * (c if k < 3 else (2.0 / c) ** powers[name])
    return replace(camera, estimated=estimated, prior_sigma=sigma)


def _columns(fault: Fault) -> list[int]:
    return [COMMON.index(name) for name in fault.frees]


def _first_strip(fault: Fault) -> list[int]:
    """Columns of the first strip's own values; those of the next one follow by six."""
    return [STRIPS + k - SHIFT.start for k in _columns(fault)]


def estimates_of(block: Block, freed: Block, solution: Shared, fault: Fault) -> tuple[Estimate, ...]:
    """Give the values of one fault from the solution in which it is freed."""
    critical = float(stats.norm.ppf(1.0 - policy.SIGNIFICANCE / 2.0))

    def estimate(label: str, unit: str, value: float, given: float, sigma: float) -> Estimate:
        """A freed value with its sigma and its test against the given one."""
        t = (value - given) / sigma if sigma > 0 else 0.0
        return Estimate(label, unit, value - given, value, sigma, t, abs(t) > critical)

    if of_camera(fault):
        which = [PARAMETERS.index(name) for name in fault.frees]
        return tuple(
            estimate(
                f"{PARAMETERS[k]}[{camera.id}]",
                camera.unit if k < 3 else "",
                float(solution.cameras[index, k]),
                float(camera.values[k]),
                math.sqrt(solution.camera_covariance[index, k, k]),
            )
            for index, camera in enumerate(freed.cameras if fault.each == "part" else block.cameras)
            for k in which
        )
    common, sigma = solution.common, np.sqrt(np.diag(solution.common_covariance))
    given = block.mounting.values
    if fault.each == "strip":
        labels = [
            (f"{name}[{strip}]", 6 * strip + at)
            for strip in np.unique(freed.positions.strip).tolist()
            for name, at in zip(fault.frees, _first_strip(fault), strict=True)
        ]
    else:
        labels = list(zip(fault.frees, _columns(fault), strict=True))
    unit = (
        "deg" if fault.frees[0].startswith("boresight") else "s" if fault.frees == ("time_offset",) else "m"
    )
    scale = math.degrees(1.0) if unit == "deg" else 1.0
    return tuple(
        estimate(label, unit, common[k] * scale, given[k] * scale, sigma[k] * scale) for label, k in labels
    )


def positions_moved(block: Block, solution: Shared, fault: Fault, stated: Floats) -> float:
    """How far an error that was freed moves the positions, in stated sigmas; infinite where it does not."""
    positions, given = block.positions, block.mounting.values
    if "positions" not in fault.where or not len(positions.image):
        return math.inf
    strips = np.unique(positions.strip).tolist() if fault.each == "strip" else [0]
    first = _first_strip(fault) if fault.each == "strip" else _columns(fault)
    columns = np.array([6 * strip + k for strip in strips for k in first])
    moved = (solution.common - given)[columns]
    covariance = solution.common_covariance[np.ix_(columns, columns)]
    scale = np.tile(stated, len(strips))
    if fault.frees == ("time_offset",):
        scale = stated[:2].min() / np.median(np.linalg.norm(positions.velocity, axis=1), keepdims=True)
    elif fault.each == "strip":
        n = len(strips)
        against = np.kron(np.eye(n) - (1.0 - np.eye(n)) / (n - 1), np.eye(3))
        moved, covariance = against @ moved, against @ covariance @ against.T
    sure = np.abs(moved) > stats.norm.isf(policy.SIGNIFICANCE / 2.0) * np.sqrt(np.diag(covariance))
    return float(np.max(np.abs(moved) / scale, where=sure, initial=0.0))


def places_of_change(block: Block) -> tuple[int, ...]:
    """List the images before which the camera may have changed: first ones of strips, else quarters."""
    count = len(block.images.names)
    if len(block.cameras) != 1 or count < 2 * policy.FEWEST_IMAGES_OF_CAMERA:
        return ()
    strip = np.full(count, -1)
    strip[block.positions.image] = block.positions.strip
    first = np.flatnonzero((np.diff(strip) != 0) & (strip[1:] >= 0) & (strip[:-1] >= 0)) + 1
    if not len(first):
        first = np.arange(1, 4) * count // 4
    first = first[
        (first >= policy.FEWEST_IMAGES_OF_CAMERA) & (first <= count - policy.FEWEST_IMAGES_OF_CAMERA)
    ]
    chosen = np.linspace(0, len(first) - 1, min(len(first), _MOST_PLACES)).round().astype(int)
    return tuple(int(first[k]) for k in np.unique(chosen))


def _split_at(block: Block, change: Change, fault: Fault) -> Block:
    """Return the block with a second camera from an image on, what the fault frees free in both."""
    (original,) = block.cameras
    first = _freed(original, fault)
    begin, values = change
    second = replace(first.with_values(values), id=f"{original.id}@{block.images.names[begin]}")
    camera = np.where(np.arange(len(block.images.names)) >= begin, 1, 0)
    return replace(block, cameras=(first, second), images=replace(block.images, camera=camera))


def unknowns_of(block: Block, fault: Fault, estimates: tuple[Estimate, ...]) -> int:
    """Count what freeing a fault adds: for a second camera all its free values, and those of the first."""
    if fault.each != "part":
        return len(estimates)
    (camera,) = block.cameras
    free = camera.estimated.copy()
    which = [PARAMETERS.index(name) for name in fault.frees]
    held = int((~free[which]).sum())
    free[which] = True
    return int(free.sum()) + held


def best_change(given: Opened, fault: Fault) -> tuple[Change, Condensed] | None:
    """Find the image from which a second camera explains most; with the equations that have it."""
    block, first = given.block, given.first
    tried: list[tuple[float, Change, Condensed]] = []
    for image in places_of_change(block):
        later = np.arange(len(block.images.names)) >= image
        change = image, first.cameras[0]
        split = with_freed(block, fault, change)
        with suppress(IllPosedError):
            whole = with_second_camera(given.whole, given.at, first.residuals, later)
            tried.append((whole.with_sigmas(split.cameras, split.mounting).chi_squared, change, whole))
    return min(tried, key=lambda one: one[0])[1:] if tried else None


def beside(network: Network, first: Solution) -> State:
    """Where to start from the minimum of the same images and points with other unknowns."""
    start, known = start_state(network), first.state
    if known.points.shape != start.points.shape or known.centre.shape != start.centre.shape:
        return start
    # A second camera begins as the first one is.
    loose = np.array([camera.estimated for camera in network.cameras])
    of_first = np.minimum(np.arange(len(network.cameras)), len(known.cameras) - 1)
    common, free = start.common, network.mounting.sigma > 0
    if known.common.shape == common.shape == free.shape:
        common = np.where(free, known.common, common)
    return replace(
        start,
        cameras=np.where(loose, known.cameras[of_first], start.cameras),
        common=common,
        rotation=known.rotation,
        centre=known.centre,
        points=known.points,
        deviations=known.deviations,
    )


def wrong_sigma(first: Solution, cause: float) -> GroupTest | None:
    """Choose the group whose stated sigmas are wrong, rather than a cause.

    A factor is one unknown, and gains likelihood where all residuals of a group are too large or too small;
    an error competes with it (Schwarz 1978). Too small residuals no error explains.
    """
    groups = (tested(group) for group in first.groups if group.name in ("position", "attitude"))
    wrong = [
        group
        for group in groups
        if group.redundancy >= policy.FEWEST_REDUNDANT
        and group.p_value < policy.SIGNIFICANCE
        and abs(group.factor - 1.0) > policy.WRONG_SIGMA
        and (group.factor < 1.0 or group.gain > cause)
    ]
    return max(wrong, key=lambda test: test.gain, default=None)


def with_agreeing(block: Block, test: GroupTest) -> tuple[Block, GroupTest]:
    """Give positions or attitudes the standard deviations that agree (Foerstner 1979), and their factor."""
    total = 1.0
    for _ in range(_SETTLING):
        total *= test.factor
        observed = block.positions if test.name == "position" else block.attitudes
        scaled: dict[str, Any] = {
            f"{test.name}s": replace(observed, covariance=observed.covariance * test.factor**2)
        }
        block = replace(block, **scaled)
        with because(f"standard deviations of {test.name}s that agree"):
            groups = adjust(assemble(block).network).groups
        test = tested(next(group for group in groups if group.name == test.name))
        if abs(test.factor - 1.0) < _SETTLED:
            break
    limits = total * test.lower / test.factor, total * test.upper / test.factor
    return block, replace(test, factor=total, lower=limits[0], upper=limits[1])
