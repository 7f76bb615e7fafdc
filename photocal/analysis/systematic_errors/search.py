"""What an analysis looks at beside causes: how groups, images, axes, cameras and places scatter."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork, fit, with_sigmas
from photocal.adjustment.groups import GroupTest, group_tests
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.analysis.estimates import Estimates
from photocal.analysis.robust import Jackknife, jackknife
from photocal.analysis.systematic_errors import scatter, shifts
from photocal.base.arrays import Flags, Floats
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS, plane_to_pixel
from photocal.hypotheses.search import SystematicErrors, systematic_errors


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
    sigma: scatter.AssumedSigma
    groups: tuple[GroupTest, ...]
    images: tuple[scatter.VarianceComponent, ...]
    axes: tuple[scatter.VarianceComponent, ...]
    cameras: tuple[scatter.VarianceComponent, ...]
    shifts: tuple[shifts.ImageShift, ...]
    maps: tuple[scatter.ResidualMap | None, ...]
    jackknife_first: Jackknife
    jackknife_last: Jackknife

    @property
    def corrected(self) -> bool:
        """Whether the last network is free of errors of the image coordinates that the first one has."""
        return any(one.cause is not None and one.cause.field is not None for one in self.causes.errors)


def search(first: AdjustedNetwork, done: Callable[[], None] = lambda: None) -> Search:
    """Look for causes in an adjusted network, and at how its residuals scatter without them."""
    causes = systematic_errors(first, done=done)
    last = causes.last if causes.adequate else first
    positions = shifts.position_shift(first)
    before = jackknife(first, done)
    after = jackknife(last, done) if last is not first else before
    solution, rays, good = last.solution, last.network.rays, ~causes.gross
    squares, redundancy = (solution.residuals / rays.sigma)[good] ** 2, solution.redundancy[good]
    sigma = scatter.assumed_sigma(rays.sigma[good], solution.residuals[good], redundancy)
    factor, ids = float(squares.sum() / redundancy.sum()), tuple(given.id for given in last.network.cameras)
    image = rays.image[good]
    both, flat, checked = np.repeat(image, 2), squares.ravel(), redundancy.ravel()
    camera, axis = last.network.exposures.camera[both], np.tile(np.array([0, 1]), len(image))
    tails = scatter.kurtosis(flat, checked)
    images, axes, cameras = (
        scatter.variance_components(names, group, flat, checked, tails)
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


def _groups(
    last: AdjustedNetwork, sigma: scatter.AssumedSigma, causes: SystematicErrors
) -> tuple[GroupTest, ...]:
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


def _map(last: AdjustedNetwork, camera: int, factor: float, good: Flags) -> scatter.ResidualMap | None:
    network: Network = last.network
    of_camera = (network.exposures.camera[network.rays.image] == camera) & good
    if not of_camera.any():
        return None
    interior = network.cameras[camera]
    down = np.array([1.0, -1.0])
    pixel: Floats = plane_to_pixel(interior.size_px, interior.pitch, network.rays.plane[of_camera])
    residual = last.solution.residuals[of_camera] / np.array(interior.pitch) * down
    w = last.solution.standardised(network.rays.sigma)[of_camera] * down
    return scatter.residual_map(interior.size_px, pixel, residual, w, factor, policy.family_significance)
