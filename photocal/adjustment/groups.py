"""Each group of observations against its stated standard deviations, and single members: before any cause."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.covariance import equation_covariance
from photocal.adjustment.factored import Factored
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Group, Solution
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.policy import policy

CONTROL = ("control-X", "control-Y", "control-Z")
RAYS = ("image-tie", "image-control")


@dataclass(frozen=True)
class GroupTest:
    """One group of observations.

    name: one of `RAYS`, one of `CONTROL`, or as `Solution.groups`.
    factor, lower, upper: by which the stated standard deviations agree with the residuals, and its 95 %
        interval.
    p_value: two-sided, of v'Pv being chi-squared with the redundancy; cautious, since redundancy numbers
        between 0 and 1 scatter it less.
    gain: twice the logarithm of the likelihood that the factor gains (Wilks 1938): what a cause competes
        with.
    of: the camera of a group of rays.
    """

    name: str
    observations: int
    chi_squared: float
    redundancy: float
    factor: float
    lower: float
    upper: float
    p_value: float
    gain: float
    of: str = ""


def group_tests(network: Network, solution: Solution) -> tuple[GroupTest, ...]:
    """Test every group of observations that is checked by others."""
    rays = _rays(network, solution)
    groups = [*_control(network, solution)]
    groups += [group for group in solution.groups if group.name not in ("image", "control")]
    of_rays = (replace(tested(group), of=camera) for camera, group in rays if _has(group))
    return (*of_rays, *(tested(group) for group in groups if _has(group)))


def _has(group: Group) -> bool:
    return group.redundancy >= policy.fewest_redundant and group.chi_squared > 0.0


def tested(group: Group) -> GroupTest:
    """Test one group."""
    chi, r = group.chi_squared, group.redundancy
    tail = (1.0 - policy.confidence) / 2.0
    lower, upper = (float(np.sqrt(chi / special.chdtri(r, p))) for p in (tail, 1.0 - tail))
    p_value = 2.0 * min(float(special.chdtr(r, chi)), float(special.chdtrc(r, chi)))
    gain = chi - r - r * float(np.log(chi / r))
    factor = float(np.sqrt(chi / r))
    return GroupTest(group.name, group.observations, chi, r, factor, lower, upper, min(p_value, 1.0), gain)


def _rays(network: Network, solution: Solution) -> list[tuple[str, Group]]:
    """Image observations by camera, and by whether their point is known on the ground."""
    weighted = np.diagonal(network.points.weight, axis1=1, axis2=2) > 0
    known = np.any(network.points.held | weighted, axis=1)
    camera_of_ray = network.exposures.camera[network.rays.image]
    kind = 2 * camera_of_ray + np.asarray(known)[network.rays.point]
    groups = groups_of_rays(network, solution, RAYS * len(network.cameras), kind)
    return list(zip((camera.id for camera in network.cameras for _ in RAYS), groups, strict=True))


def groups_of_rays(
    network: Network, solution: Solution, names: tuple[str, ...], group: Integers
) -> list[Group]:
    """What the rays of each group, told by its number, add to v'Pv, and their redundancy."""
    count = len(names)
    squares = np.sum((solution.residuals / network.rays.sigma) ** 2, axis=1)
    chi_squared = np.bincount(group, squares, count).tolist()
    redundancy = np.bincount(group, solution.redundancy.sum(axis=1), count).tolist()
    coordinates = (2 * np.bincount(group, minlength=count)).tolist()
    return list(map(Group, names, coordinates, chi_squared, redundancy))


def _control(network: Network, solution: Solution) -> list[Group]:
    """Coordinates of control points by axis; correlated ones share v'Pv by the terms of each."""
    weight, off = network.points.weight, solution.points - network.points.values
    observed = network.points.observed
    parts = off * np.einsum("nab,nb->na", weight, off)
    taken = np.einsum("nab,nba->na", weight, solution.point_covariance)
    return [
        Group(
            name,
            int(observed[:, a].sum()),
            float(parts[observed[:, a], a].sum()),
            float(np.sum(1.0 - taken[observed[:, a], a])),
        )
        for a, name in enumerate(CONTROL)
    ]


@dataclass(frozen=True)
class Member:
    """An observed position or control point: its coordinates together against all other observations.

    kind, index: "position", and its image; or "control", and the point.
    error, covariance (3,), (3, 3): observed less what all others say, and its covariance a priori, m; zero
        and infinite where nothing is observed or nothing checks it.
    statistic: error' covariance^-1 error, which is chi-squared of so many dimensions without a gross error
        (Teunissen 1985).
    """

    kind: str
    index: int
    error: Floats
    covariance: Floats
    statistic: float
    dimensions: int


def member_tests(at: Factored, solution: Solution) -> tuple[Member, ...]:
    """Test every observed position and every control point as one, whatever correlates its coordinates."""
    network, members = at.problem.network, list[Member]()
    positions, points = network.positions, network.points
    if len(positions.image):
        rows = at.others["position"]
        taken = equation_covariance(rows, at.problem.layout.envelope, at.inverse, 3)
        residual = rows.residual.reshape(-1, 3)
        root = np.asarray(np.linalg.cholesky(positions.covariance), dtype=np.float64)
        members += _members("position", positions.image, residual, taken, root, np.ones(residual.shape, bool))
    observed = points.observed
    control = np.flatnonzero(observed.any(axis=1))
    if len(control):
        observed_axes = observed[control]
        both = observed_axes[:, :, None] & observed_axes[:, None, :]
        # What is not observed has a variance of 1 here, and nothing checks it.
        variance = np.linalg.inv(np.where(both, points.weight[control], np.eye(3)))
        root = np.asarray(np.linalg.cholesky(variance), dtype=np.float64)
        back = np.linalg.inv(root)
        off = np.where(observed_axes, solution.points[control] - points.values[control], 0.0)
        spread = np.where(both, solution.point_covariance[control], np.eye(3))
        taken = np.asarray(back @ spread @ np.swapaxes(back, 1, 2), dtype=np.float64)
        off = np.einsum("nab,nb->na", back, off)
        members += _members("control", control, off, taken, root, observed_axes)
    return tuple(members)


def _members(
    kind: str, index: Integers, residual: Floats, taken: Floats, root: Floats, observed: Flags
) -> list[Member]:
    """Test whitened residuals, computed less observed, whose adjusted values have the covariances `taken`."""
    # Of a coordinate's variance, what no other observation checks is not tested.
    checked_share = 1e-6
    left, axes = np.linalg.eigh(np.eye(3) - (taken + np.swapaxes(taken, 1, 2)) / 2.0)
    checked = left > checked_share
    axes = axes * checked[:, None, :]
    share = np.divide(1.0, left, out=np.zeros_like(left), where=checked)
    along, whole = np.einsum("nab,na->nb", axes, residual), root @ axes
    error = -np.einsum("nab,nb->na", whole, along * share)
    # What is not checked in one direction is not known in any that has part in it.
    magnitude = np.abs(root) * observed[:, :, None]
    unchecked = np.abs(root - whole @ np.swapaxes(axes, 1, 2)).max(axis=2)
    known = observed & (unchecked < checked_share * magnitude.max(axis=(1, 2))[:, None])
    covariance = (whole * share[:, None, :]) @ np.swapaxes(whole, 1, 2)
    covariance[~(known[:, :, None] & known[:, None, :])] = np.inf
    statistic, dimensions = np.sum(along**2 * share, axis=1), checked.sum(axis=1)
    return [
        Member(kind, int(i), error[k], covariance[k], float(statistic[k]), int(dimensions[k]))
        for k, i in enumerate(index)
    ]
