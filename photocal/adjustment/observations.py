"""Observations beside the rays: equations of a few unknowns of the reduced system each."""

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.equations import Equations
from photocal.adjustment.layout import Layout
from photocal.adjustment.mounting import attitude_equations, common_equations, position_equations
from photocal.adjustment.network import Network, own_parameters, own_sigma
from photocal.adjustment.rig import rig_equations
from photocal.adjustment.state import State, head_values, turn_basis
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle


def camera_equations(network: Network, layout: Layout, state: State) -> Equations:
    """Interior orientation parameters as observations, where they have a prior sigma.

    Correlated ones are made independent: with S R S = S L L' S, the rows of L^-1 S^-1 have unit variance.
    """
    columns, coefficients, residuals, weights, counts = [], [], [], [], list[int]()
    for camera, values, (active, column) in zip(
        network.cameras, state.cameras, layout.camera_columns, strict=True
    ):
        weighted = np.isfinite(camera.prior_sigma[active])
        own, sigma = column[weighted], camera.prior_sigma[active][weighted]
        residual = (values - camera.values)[active][weighted]
        n = len(own)
        if camera.prior_correlation is None:
            columns.append(own)
            coefficients.append(np.ones(n))
            residuals.append(residual)
            weights.append(sigma**-2.0)
            counts += [1] * n
            continue
        at = np.asarray(active)[weighted]
        factor = np.linalg.cholesky(camera.prior_correlation[np.ix_(at, at)])
        rows = np.linalg.inv(factor) / sigma
        columns.append(np.tile(own, n))
        coefficients.append(rows.ravel())
        residuals.append(rows @ residual)
        weights.append(np.ones(n))
        counts += [n] * n
    return Equations(
        np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64),
        np.concatenate(columns),
        np.concatenate(coefficients),
        np.concatenate(residuals),
        np.concatenate(weights),
    )


def deviation_equations(network: Network, layout: Layout, state: State) -> dict[str, Equations]:
    """Each image's deviations observed as zero: photo-variant parameters, and motion during the readout."""
    own, result = own_parameters(network), {}
    sigma = np.take_along_axis(own_sigma(network), np.maximum(own, 0), axis=1)
    for name, chosen in (("photo-variant", own < len(PARAMETERS)), ("motion", own >= len(PARAMETERS))):
        weighted = chosen & (own >= 0) & np.isfinite(sigma)
        column, residual = layout.own_columns[weighted], state.deviations[weighted]
        ones = np.ones(len(column))
        result[name] = Equations(np.arange(len(column) + 1), column, ones, residual, sigma[weighted] ** -2.0)
    return result


def exposure_equations(network: Network, layout: Layout, state: State) -> Equations:
    """Exterior orientation elements as observations, where they have a sigma."""
    sigma = network.exposures.sigma
    weighted = np.isfinite(sigma) & (sigma > 0)
    image, which = np.nonzero(weighted)
    turning = which < 3
    angles = angles_from_matrix(state.rotation)
    current = np.hstack([angles, state.centre])
    residual = (current - network.exposures.values)[image, which]
    residual[turning] = (residual[turning] + np.pi) % (2 * np.pi) - np.pi
    # One unknown for a coordinate of the centre, three for an angle.
    count = np.where(turning, 3, 1)
    start = np.concatenate([[0], np.cumsum(count)])
    column, coefficient = np.empty(start[-1], dtype=np.int64), np.ones(start[-1])
    column[start[:-1][~turning]] = layout.image_columns[image, which][~turning]
    if turning.any():
        images = np.unique(image[turning])
        row_of = {int(i): k for k, i in enumerate(images)}
        angle_per_turn = np.linalg.inv(turn_per_angle(angles[images])) @ turn_basis(network, state)[images]
        at = start[:-1][turning][:, None] + np.arange(3)
        rows = [row_of[int(i)] for i in image[turning]]
        column[at] = layout.image_columns[image[turning], :3]
        coefficient[at] = angle_per_turn[rows, which[turning]]
    free = np.ones(layout.size)
    free[layout.image_columns[sigma == 0]] = 0.0
    return Equations(start, column, coefficient * free[column], residual, sigma[image, which] ** -2.0)


def relation_equations(network: Network, layout: Layout, state: State) -> dict[str, Equations]:
    """Observations between points, by kind."""
    relations = network.relations
    place = {int(j): k for k, j in enumerate(layout.kept_points)}
    result = {}
    own = dict(relations.own)
    for code, kind in enumerate(relations.names):
        mine = relations.kind == code
        if not mine.any():
            continue
        first, second = relations.first[mine], relations.second[mine]
        difference = state.points[second] - state.points[first]
        computed, by_second = own[kind](difference) if kind in own else related(kind, difference)
        residual = computed - relations.values[mine]
        if kind == "azimuth":
            residual = (residual + np.pi) % (2 * np.pi) - np.pi
        columns = [layout.point_columns[[place[int(j)] for j in points]] for points in (first, second)]
        free = [~network.points.held[points] for points in (first, second)]
        coefficient = np.hstack([-by_second * free[0], by_second * free[1]])
        start = 6 * np.arange(len(first) + 1)
        weight = relations.sigma[mine] ** -2.0
        result[kind] = Equations(start, np.hstack(columns).ravel(), coefficient.ravel(), residual, weight)
    return result


def mounting_equations(network: Network, layout: Layout, state: State) -> dict[str, Equations]:
    """Antenna positions, attitudes, heads of rigs and their common unknowns, where there are any."""
    mounting, rig, result = network.mounting, network.rig, dict[str, Equations]()
    mounted = len(network.positions.image) or len(network.attitudes.image)
    if not mounted and not len(rig.first):
        return result
    basis = turn_basis(network, state)
    columns = np.where(network.exposures.sigma == 0, -1, layout.image_columns)
    common, of_mounting = layout.common_columns, len(mounting.values)
    if len(rig.first):
        exposures, heads = network.exposures, head_values(network, state.common)
        own = common[of_mounting:]
        moving = exposures.camera, state.rotation, state.centre, exposures.motion
        result["rig"] = rig_equations(rig, heads, *moving, columns, basis, own.reshape(heads.shape))
        result["head"] = common_equations(rig.values.ravel(), rig.sigma.ravel(), heads.ravel(), own)
    if not mounted:
        return result
    return result | {
        "position": position_equations(
            network.positions, mounting, state.common, state.rotation, state.centre, columns, basis, common
        ),
        "attitude": attitude_equations(
            network.attitudes, mounting, state.common, state.rotation, columns, basis, common
        ),
        "mounting": common_equations(
            mounting.values, mounting.sigma, state.common[:of_mounting], common[:of_mounting]
        ),
    }


def related(kind: str, difference: Floats) -> tuple[Floats, Floats]:
    """Value of a relation and its derivative with respect to the second point."""
    if kind == "distance":
        length = np.linalg.norm(difference, axis=1)
        return length, difference / length[:, None]
    if kind == "height_difference":
        return difference[:, 2], np.broadcast_to([0.0, 0.0, 1.0], difference.shape)
    dx, dy = difference[:, 0], difference[:, 1]
    square = dx**2 + dy**2
    return np.arctan2(dx, dy), np.column_stack([dy / square, -dx / square, np.zeros_like(dx)])
