"""Variance components: how large the standard deviations of each group of observations really are.

Every group's variance is scaled by its v'Pv over its redundancy and the network adjusted again, until
nothing changes (Foerstner 1979; at the end the estimate is that of Helmert 1924).
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjust import adjusted_network
from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.covariance import equation_covariance
from photocal.adjustment.envelope import factorise, product, selected_inverse, solve
from photocal.adjustment.equations import add_equations
from photocal.adjustment.factored import Factored
from photocal.adjustment.groups import groups_of_rays
from photocal.adjustment.network import Network
from photocal.adjustment.normal import diagonal_addresses
from photocal.adjustment.solution import ComponentFactor, Group, Solution
from photocal.adjustment.solver import Iteration, moved_by
from photocal.adjustment.state import State
from photocal.base.arrays import Integers
from photocal.base.errors import IllPosedError, NotConvergedError

# A variance is settled when a round changes it by less than this share of itself.
SETTLED = 1e-3
# A variance that shrinks below this share of the given one is running to zero.
VANISHED = 1e-6
# Division of the rays into groups of one standard deviation each: names, and the group of each ray.
RayGroups = tuple[tuple[str, ...], Integers]


@dataclass(frozen=True)
class VarianceComponents:
    """Estimated variance components and the adjustment with them.

    fitted: the network with the standard deviations that were found, adjusted.
    """

    components: tuple[ComponentFactor, ...]
    fitted: AdjustedNetwork
    rounds: int

    @property
    def network(self) -> Network:
        """With the standard deviations that were found."""
        return self.fitted.network

    @property
    def solution(self) -> Solution:
        """The adjustment of the network."""
        return self.fitted.solution


def rays_together(network: Network) -> RayGroups:
    """All rays as one group, `image`."""
    return ("image",), np.zeros(len(network.rays.image), dtype=np.int64)


def rays_by_camera(network: Network) -> RayGroups:
    """One group of rays for each camera, named after it."""
    names = tuple(f"image {camera.id}" for camera in network.cameras)
    return names, network.exposures.camera[network.rays.image]


def estimate_components(
    network: Network,
    rays: RayGroups | None = None,
    hold: Collection[str] = (),
    report: Callable[[Iteration], None] | None = None,
    start: AdjustedNetwork | None = None,
    settled: float = SETTLED,
) -> VarianceComponents:
    """Estimate the variance of each group of observations.

    hold: groups whose variance stays as it is given.
    start: the network, adjusted: the first round has it, and the last round's adjustment is then the last.
    settled: share of itself by which a variance may still change.
    raises IllPosedError: when the network is singular, or a variance runs to zero.
    raises NotConvergedError: when the variances do not settle.
    """
    most_rounds = 60
    rays = rays or rays_together(network)
    factors: dict[str, float] = {}
    # With less redundancy a group says nothing about its own variance.
    fewest = 1.0
    scaled, fitted = network, start or adjusted_network(network, report)
    for rounds in range(1, most_rounds + 1):
        solution = fitted.solution
        groups = groups_of_rays(scaled, solution, *rays)
        groups += [group for group in solution.groups if group.name != "image"]
        free = [g for g in groups if g.name not in hold and g.redundancy > fewest]
        change = {group.name: group.chi_squared / group.redundancy for group in free}
        if all(abs(share - 1) < settled for share in change.values()):
            if start is None:
                # What is reported begins where the block does, however the sigmas were found.
                fitted = adjusted_network(scaled, report)
            return VarianceComponents(_components(groups, change, factors), fitted, rounds)
        for name, share in change.items():
            factors[name] = factors.get(name, 1.0) * float(np.sqrt(share))
            if factors[name] ** 2 < VANISHED:
                raise IllPosedError(
                    f"the variance of group {name} tends to zero",
                    "hold its standard deviation: its residuals do not determine it",
                    where=f"group {name}",
                )
        scaled = with_factors(network, rays, factors)
        fitted = adjusted_network(scaled, report, fitted.state)
    raise NotConvergedError(
        f"the variance components have not settled after {most_rounds} rounds",
        "hold the groups with the least redundancy, or look for gross errors first",
    )


def rest_of_way(step: float, before: float) -> float:
    """The rest of a way whose steps shrink at a steady rate (Aitken 1926); else the step alone."""
    slowest = 0.9
    rate = step / before if before else 0.0
    return step / (1.0 - rate) if 0.0 < rate < slowest else step


def settled_factor(at: Factored, name: str) -> tuple[float, State]:
    """By what the standard deviations of a group beside rays and points must be multiplied to agree.

    The state is that to which they then lead, to first order.

    The rounds of `estimate_components`, with the derivatives of one minimum: images and points stay as they
    are eliminated, so that a round costs a factorisation and no pass over the rays.

    name: a group of `Factored.others`.
    """
    most_rounds = 30
    rows, structure = at.others[name], at.problem.layout.envelope
    given, held = product(structure, at.normal.matrix), at.problem.held
    row_of = np.repeat(np.arange(len(rows.weight)), np.diff(rows.start))
    held_diagonal = diagonal_addresses(at.problem)[held]
    total, before, step = 1.0, 0.0, np.zeros(at.problem.layout.size)
    for _ in range(most_rounds):
        matrix, gradient = given.copy(), at.normal.gradient.copy()
        added = rows._replace(weight=rows.weight * (total**-2.0 - 1.0))
        add_equations(*added, structure, matrix, gradient)
        gradient[held], matrix[held_diagonal] = 0.0, 1.0
        if factorise(structure, matrix) >= 0:
            break
        step = solve(structure, matrix, -gradient)
        step[held] = 0.0
        residual = rows.residual + np.bincount(row_of, rows.coefficient * step[rows.column], len(rows.weight))
        taken = equation_covariance(rows, structure, selected_inverse(structure, matrix), 1).ravel()
        weight = rows.weight / total**2
        redundancy, chi_squared = len(weight) - float(weight @ taken), float(weight @ residual**2)
        if min(redundancy, chi_squared) <= 0.0 or total**2 < VANISHED:
            # Residuals that vanish with their sigmas tell no factor.
            break
        change = 0.5 * math.log(chi_squared / redundancy)
        total *= math.exp(rest_of_way(change, before))
        if abs(change) < SETTLED:
            break
        before = change
    return total, moved_by(at.problem, at.state, at.normal, step)[0]


def _components(
    groups: list[Group], free: Collection[str], factors: dict[str, float]
) -> tuple[ComponentFactor, ...]:
    """The components with the standard deviation of a variance: sigma^2 sqrt(2 / r) (Foerstner 1979).

    It leaves out what the groups share, which is little when each has redundancy of its own.
    """
    result = []
    for group in groups:
        factor = factors.get(group.name, 1.0)
        held = group.name not in free
        sigma = None if held else factor / float(np.sqrt(2 * group.redundancy))
        of_group = group.name, group.observations, group.redundancy
        result.append(ComponentFactor(*of_group, factor, sigma, estimated=not held))
    return tuple(result)


def with_factors(network: Network, rays: RayGroups, factors: dict[str, float]) -> Network:
    """Multiply the standard deviations of groups of observations."""

    def of(name: str) -> float:
        """Factor of a group; 1 for one that is not estimated."""
        return factors.get(name, 1.0)

    names, group = rays
    by_ray = np.array([of(name) for name in names])[group]
    by_relation = np.array([of(kind) for kind in network.relations.names])[network.relations.kind]
    exposures, positions = network.exposures, network.positions
    attitudes, mounting, rig, frame = network.attitudes, network.mounting, network.rig, of("rig")
    lasers, shared = network.lasers, of("laser-offset")
    # 0 holds and infinity frees a value: both stay what they are.
    return replace(
        network,
        rays=replace(network.rays, sigma=network.rays.sigma * by_ray[:, None]),
        points=replace(network.points, weight=network.points.weight / of("control") ** 2),
        cameras=tuple(
            replace(
                camera,
                prior_sigma=camera.prior_sigma * of("camera"),
                deviation_sigma=camera.deviation_sigma * of("photo-variant"),
            )
            for camera in network.cameras
        ),
        exposures=replace(
            exposures,
            sigma=exposures.sigma * of("exposure"),
            motion_sigma=None if exposures.motion_sigma is None else exposures.motion_sigma * of("motion"),
        ),
        relations=replace(network.relations, sigma=network.relations.sigma * by_relation),
        positions=replace(positions, covariance=positions.covariance * of("position") ** 2),
        attitudes=replace(attitudes, covariance=attitudes.covariance * of("attitude") ** 2),
        mounting=replace(mounting, sigma=mounting.sigma * of("mounting")),
        rig=replace(
            rig, sigma=rig.sigma * of("head"), stiffness=rig.stiffness * frame, gust=rig.gust * frame
        ),
        lasers=replace(
            lasers,
            sigma=lasers.sigma * of("laser"),
            common_sigma=tuple(shared * sigma for sigma in lasers.common_sigma),
        ),
    )
