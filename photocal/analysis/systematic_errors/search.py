"""What an analysis looks at beside causes: how groups, images, axes, cameras and places scatter.

Where residuals scatter more than elsewhere, or point the same way: images, axes, places on the sensor.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork, fit, with_sigmas
from photocal.adjustment.envelope import on_one_thread
from photocal.adjustment.groups import GroupTest, group_tests
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.analysis.estimates import Estimates
from photocal.analysis.robust import Jackknife, jackknife
from photocal.analysis.systematic_errors import shifts
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS, plane_to_pixel
from photocal.hypotheses.causes import coarsely_placed, of_rays
from photocal.hypotheses.control import control_points
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.search import SystematicErrors, systematic_errors
from photocal.hypotheses.selection import SystematicError


@dataclass(frozen=True)
class VarianceComponent:
    """Scatter of one group of observations.

    ratio: standard deviation found over the one that was assumed.
    p_value: two-sided probability of so different a scatter from that of all others, already multiplied by
        the number of groups.
    """

    name: str
    observations: int
    redundancy: float
    ratio: float
    p_value: float


def kurtosis(squares: Floats, redundancy: Floats) -> float:
    """Excess kurtosis of standardised residuals, from their squares; never below that of normal ones."""
    checked = redundancy > policy.least_checked
    w2 = squares[checked] / redundancy[checked]
    if len(w2) < policy.small_sample:
        return 0.0
    return max(0.0, float(np.mean(w2**2) / np.mean(w2) ** 2) - 3.0)


def variance_components(
    names: tuple[str, ...], group: Integers, squares: Floats, redundancy: Floats, tails: float = 0.0
) -> tuple[VarianceComponent, ...]:
    """Estimate the variance of groups of observations from their residuals and redundancy numbers.

    sigma_i^2 = v'Pv_i / r_i (Foerstner 1979, one step), judged by F with r_i and r - r_i degrees of freedom.
    With an excess kurtosis the variance of a variance is larger by 1 + kurtosis / 2: so many fewer are the
    degrees of freedom (Box 1953; Layard 1973).

    tails: excess kurtosis of the residuals, see `kurtosis`.
    """
    m = len(names)
    total = np.bincount(group, squares, m)
    checked = np.bincount(group, redundancy, m)
    count = np.bincount(group, minlength=m)
    whole, all_checked = float(total.sum()), float(checked.sum())
    others = all_checked - checked
    with np.errstate(invalid="ignore", divide="ignore"):
        statistic = (total / checked) / ((whole - total) / others)
        fewer = 1.0 + tails / 2.0
        upper = special.fdtrc(checked / fewer, others / fewer, statistic)
    p_value = np.minimum(1.0, 2.0 * m * np.minimum(upper, 1.0 - upper))
    p_value[(others < 2.0) | (total <= 0.0) | (total >= whole)] = 1.0
    return tuple(
        VarianceComponent(
            name, int(count[i]), float(checked[i]), float(np.sqrt(total[i] / checked[i])), float(p_value[i])
        )
        for i, name in enumerate(names)
        if checked[i] >= 2.0
    )


@dataclass(frozen=True)
class AssumedSigma:
    """Standard deviation of the image coordinates, assumed and found.

    assumed, found: in the unit of the image plane.
    p_value: two-sided probability of the residuals if the assumption holds.
    """

    assumed: float
    found: float
    rms: float
    lower: float
    upper: float
    redundancy: float
    p_value: float


def assumed_sigma(
    sigma: Floats, residual: Floats, redundancy: Floats, probability: float = 0.95
) -> AssumedSigma:
    """Compare the assumed standard deviation of image coordinates with that of the residuals."""
    squares, r = float(np.sum((residual / sigma) ** 2)), float(redundancy.sum())
    tail = (1.0 - probability) / 2.0
    assumed = float(np.median(sigma))
    above = float(special.chdtrc(r, squares))
    return AssumedSigma(
        assumed,
        assumed * float(np.sqrt(squares / r)),
        float(np.sqrt(np.mean(residual**2))),
        assumed * float(np.sqrt(squares / special.chdtri(r, tail))),
        assumed * float(np.sqrt(squares / special.chdtri(r, 1.0 - tail))),
        r,
        2.0 * min(above, 1.0 - above),
    )


@dataclass(frozen=True)
class ResidualMap:
    """Mean residuals on a grid of cells over the sensor.

    mean_px (rows, columns, 2): mean residual (computed minus measured), column to the right and row down, px;
        NaN in empty cells.
    p_value (rows, columns): probability of so large a mean of standardised residuals without a systematic
        part.
    significant (rows, columns): cells below the level, shared among all cells.
    global_statistic, global_p_value: chi-squared of all cells together, and its probability.
    """

    columns_px: Floats
    rows_px: Floats
    count: Integers
    mean_px: Floats
    p_value: Floats
    significant: Flags
    global_statistic: float
    global_p_value: float
    cells: int


def residual_map(
    size_px: tuple[int, int],
    pixel: Floats,
    residual_px: Floats,
    standardised: Floats,
    variance_factor: float,
    level: float = 0.01,
) -> ResidualMap:
    """Test residuals for a pattern that is fixed to the sensor.

    The standardised residuals of a cell are taken as independent. The adjustment makes their sums smaller
    than that, so the test alarms less often than its level says: of 140 clean flights its two
    parts stayed below 5 % in 5, where 14 are expected, and below 1 % in none.

    pixel (n, 2): measured column and row, px.
    residual_px (n, 2): residuals in the same axes, px.
    standardised (n, 2): standardised residuals in the same axes; NaN where nothing checks a ray.
    variance_factor: variance of unit weight that the standardised residuals are judged by.
    """
    columns, rows = grid_shape(size_px, len(pixel))
    column_edges = np.linspace(-0.5, size_px[0] - 0.5, columns + 1)
    row_edges = np.linspace(-0.5, size_px[1] - 0.5, rows + 1)
    checked = np.all(np.isfinite(standardised), axis=1)
    at_column = np.clip(np.digitize(pixel[checked, 0], column_edges) - 1, 0, columns - 1)
    at_row = np.clip(np.digitize(pixel[checked, 1], row_edges) - 1, 0, rows - 1)
    cell = at_row * columns + at_column
    count = np.bincount(cell, minlength=rows * columns)
    sums = np.column_stack([np.bincount(cell, residual_px[checked, a], rows * columns) for a in (0, 1)])
    w = standardised[checked] / np.sqrt(variance_factor)
    totals = np.column_stack([np.bincount(cell, w[:, a], rows * columns) for a in (0, 1)])
    filled = np.maximum(count, 1)
    statistic = np.sum(totals**2, axis=1) / filled
    tested = count > 0
    p_value = np.where(tested, special.chdtrc(2, statistic), 1.0)
    cells = int(tested.sum())
    mean = np.where(tested[:, None], sums / filled[:, None], np.nan)
    whole = float(statistic[tested].sum())
    return ResidualMap(
        column_edges,
        row_edges,
        count.reshape(rows, columns),
        mean.reshape(rows, columns, 2),
        p_value.reshape(rows, columns),
        (p_value < 1.0 - (1.0 - level) ** (1.0 / max(cells, 1))).reshape(rows, columns),
        whole,
        float(special.chdtrc(2 * cells, whole)) if cells else 1.0,
        cells,
    )


def grid_shape(size_px: tuple[int, int], rays: int) -> tuple[int, int]:
    """Choose how many cells the rays can fill."""
    rays_per_cell = 20
    wanted = max(1.0, rays / rays_per_cell)
    columns = int(np.clip(np.sqrt(wanted * size_px[0] / size_px[1]), 1, 12))
    return columns, max(1, round(columns * size_px[1] / size_px[0]))


@dataclass(frozen=True)
class Search:
    """Everything that was found.

    causes: what explains the contradictions of the network, see `hypotheses`.
    first, last: the network as it was adjusted, and with all causes.
    positions: what a common shift of all observed positions would be and do; None where it is free.
    sigma: of the image coordinates, at the end.
    groups: each group of observations against its stated standard deviations, at the end.
    images, axes, cameras: scatter by image, by image axis and by camera, at the end.
    shifts: scale and principal point of each image, at the end.
    maps: for each camera, at the end; None for a camera without rays.
    jackknife_first, jackknife_last: before and after the corrections.
    """

    causes: SystematicErrors
    first: AdjustedNetwork
    last: AdjustedNetwork
    positions: shifts.PositionShift | None
    sigma: AssumedSigma
    groups: tuple[GroupTest, ...]
    images: tuple[VarianceComponent, ...]
    axes: tuple[VarianceComponent, ...]
    cameras: tuple[VarianceComponent, ...]
    shifts: tuple[shifts.ImageShift, ...]
    maps: tuple[ResidualMap | None, ...]
    jackknife_first: Jackknife
    jackknife_last: Jackknife

    @property
    def corrected(self) -> bool:
        """Whether the last network is free of errors of the image coordinates that the first one has."""
        return any(one.cause is not None and one.cause.field is not None for one in self.causes.errors)


def by_navigation_fixes(network: Network) -> bool:
    """Whether nothing but navigation fixes, as pictures state them, places a network."""
    otherwise = len(network.positions.image) > 0 or len(control_points(network)) > 0
    return coarsely_placed(network.exposures.sigma[:, 3:], otherwise=otherwise)


@on_one_thread
def causes_in(
    first: AdjustedNetwork,
    at_once: SystematicError | None = None,
    done: Callable[[], None] = lambda: None,
) -> SystematicErrors:
    """Look for causes in an adjusted network.

    at_once: control that was taken out of it before, since nothing could be adjusted with it.
    """
    return systematic_errors(
        first, at_once, of_rays() if by_navigation_fixes(first.network) else FAULTS, done
    )


def search(causes: SystematicErrors, done: Callable[[], None] = lambda: None) -> Search:
    """Look at how the residuals of a network scatter without the causes that were found in it."""
    first = causes.first
    last = causes.last if causes.adequate else first
    positions = shifts.position_shift(first)
    before = jackknife(first, done)
    after = jackknife(last, done) if last is not first else before
    solution, rays, good = last.solution, last.network.rays, ~causes.gross
    squares, redundancy = (solution.residuals / rays.sigma)[good] ** 2, solution.redundancy[good]
    sigma = assumed_sigma(rays.sigma[good], solution.residuals[good], redundancy)
    factor, ids = float(squares.sum() / redundancy.sum()), tuple(given.id for given in last.network.cameras)
    image = rays.image[good]
    both, flat, checked = np.repeat(image, 2), squares.ravel(), redundancy.ravel()
    camera, axis = last.network.exposures.camera[both], np.tile(np.array([0, 1]), len(image))
    tails = kurtosis(flat, checked)
    images, axes, cameras = (
        variance_components(names, group, flat, checked, tails)
        for names, group in ((last.network.image_names, both), (("x", "y"), axis), (ids, camera))
    )
    return Search(
        causes,
        first,
        last,
        positions,
        sigma,
        _groups(last, sigma, causes),
        images,
        axes,
        cameras,
        shifts.image_shifts(last, factor, done),
        tuple(_map(last, k, factor, good) for k in range(len(last.network.cameras))),
        before,
        after,
    )


def camera_estimates(fitted: AdjustedNetwork, camera: int) -> Estimates:
    """Give the estimated parameters of a camera with their a priori covariance."""
    at = np.flatnonzero(fitted.network.cameras[camera].estimated)
    return Estimates(
        tuple(PARAMETERS[i] for i in at),
        fitted.solution.cameras[camera][at],
        fitted.solution.camera_covariance[camera][np.ix_(at, at)],
    )


def _groups(last: AdjustedNetwork, sigma: AssumedSigma, causes: SystematicErrors) -> tuple[GroupTest, ...]:
    """Test groups of observations, with the sigma of the rays that was found where it differs.

    Factors that the causes came with are those of the groups: their sigmas are in the network already.
    """
    ratio = sigma.found / sigma.assumed
    if sigma.p_value < policy.family_significance and abs(ratio - 1.0) > policy.wrong_sigma:
        with because("sigma of the image coordinates that agrees"):
            last = fit(with_sigmas(last.network, ratio), last.state)
    applied = {group.name: group for group in causes.sigmas if causes.adequate}
    judged = list[GroupTest]()
    for test in group_tests(last.network, last.solution):
        known = applied.get(test.name)
        if known is None:
            judged.append(test)
            continue
        limits = {key: known.factor * getattr(test, key) for key in ("factor", "lower", "upper")}
        judged.append(replace(test, **limits, p_value=known.p_value))
    return tuple(judged)


def _map(last: AdjustedNetwork, camera: int, factor: float, good: Flags) -> ResidualMap | None:
    network: Network = last.network
    of_camera = (network.exposures.camera[network.rays.image] == camera) & good
    if not of_camera.any():
        return None
    interior = network.cameras[camera]
    down = np.array([1.0, -1.0])
    pixel: Floats = plane_to_pixel(interior.size_px, interior.pitch, network.rays.plane[of_camera])
    residual = last.solution.residuals[of_camera] / np.array(interior.pitch) * down
    w = last.solution.standardised(network.rays.sigma)[of_camera] * down
    return residual_map(interior.size_px, pixel, residual, w, factor, policy.family_significance)
