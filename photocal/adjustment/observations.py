"""Observations beside the rays: equations of a few unknowns of the reduced system each."""

import numpy as np

from photocal.adjustment.equations import Equations
from photocal.adjustment.lasers import laser_equations
from photocal.adjustment.layout import Layout
from photocal.adjustment.mounting import (
    BORESIGHT,
    attitude_equations,
    body_to_camera,
    common_equations,
    position_equations,
)
from photocal.adjustment.network import ANGLES, RELATIONS, Network, own_parameters, own_sigma
from photocal.adjustment.rig import rig_equations
from photocal.adjustment.state import State, head_values, laser_values, turn_basis
from photocal.base.arrays import Floats
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, left_jacobian, turn_per_angle


def camera_equations(network: Network, layout: Layout, state: State) -> Equations:
    """Interior orientation parameters as observations, where they have a prior sigma.

    Correlated ones are made independent: with S R S = S L L' S, the rows of L^-1 S^-1 have unit variance.
    """
    nothing = [np.zeros(0)]
    columns, counts = [np.zeros(0, dtype=np.int64)], list[int]()
    coefficients, residuals, weights = nothing.copy(), nothing.copy(), nothing.copy()
    for k in network.observed_cameras:
        camera, values, (active, column) = network.cameras[k], state.cameras[k], layout.camera_columns[k]
        weighted = np.isfinite(camera.prior_sigma[active])
        observed, sigma = column[weighted], camera.prior_sigma[active][weighted]
        residual = (values - camera.values)[active][weighted]
        n = len(observed)
        if camera.prior_correlation is None:
            columns.append(observed)
            coefficients.append(np.ones(n))
            residuals.append(residual)
            weights.append(sigma**-2.0)
            counts += [1] * n
            continue
        at = np.asarray(active)[weighted]
        factor = np.linalg.cholesky(camera.prior_correlation[np.ix_(at, at)])
        rows = np.linalg.inv(factor) / sigma
        columns.append(np.tile(observed, n))
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
    if not layout.own_columns.size:
        return {}
    parameters, result = own_parameters(network), {}
    sigma = np.take_along_axis(own_sigma(network), np.maximum(parameters, 0), axis=1)
    of_lens = parameters < len(PARAMETERS)
    for name, chosen in (("photo-variant", of_lens), ("motion", ~of_lens)):
        weighted = chosen & (parameters >= 0) & np.isfinite(sigma)
        column, residual = layout.own_columns[weighted], state.deviations[weighted]
        ones = np.ones(len(column))
        result[name] = Equations(np.arange(len(column) + 1), column, ones, residual, sigma[weighted] ** -2.0)
    return result


def exposure_equations(network: Network, layout: Layout, state: State) -> Equations:
    """Exterior orientation elements as observations, where they have a sigma."""
    sigma = network.exposures.sigma
    image, which = np.nonzero(np.isfinite(sigma) & (sigma > 0))
    if not len(image):
        nothing, none = np.zeros(0), np.zeros(0, dtype=np.int64)
        return Equations(np.zeros(1, dtype=np.int64), none, nothing, nothing, nothing)
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
    result = {}
    functions = dict(relations.further)
    for code, kind in enumerate(relations.names):
        of_kind = relations.kind == code
        if not of_kind.any():
            continue
        count = 2 if kind in functions else len(RELATIONS[kind])
        ends = relations.ends[of_kind, :count]
        points = state.points[ends]
        if count == 2:
            difference = points[:, 1] - points[:, 0]
            value, by_second = functions[kind](difference) if kind in functions else related(kind, difference)
            computed, by_end = value[:, None], np.stack([-by_second, by_second], axis=1)[:, None]
        else:
            computed, by_end = among_three(kind, points)
        residual = computed - relations.values[of_kind, None]
        if kind in ANGLES:
            residual = (residual + np.pi) % (2 * np.pi) - np.pi
        # A point across a line has two components, any other kind one value.
        rows, width = residual.size, 3 * count
        columns = layout.point_columns[np.searchsorted(layout.kept_points, ends)].reshape(-1, 1, width)
        columns = np.broadcast_to(columns, (len(ends), residual.shape[1], width))
        coefficient = by_end * ~network.points.held[ends][:, None]
        weight = np.repeat(relations.sigma[of_kind] ** -2.0, residual.shape[1])
        start = width * np.arange(rows + 1)
        result[kind] = Equations(start, columns.ravel(), coefficient.ravel(), residual.ravel(), weight)
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
        head_columns = common[len(common) - heads.size :]
        moving = exposures.camera, (state.rotation, state.centre), exposures.motion
        result["rig"] = rig_equations(rig, heads, *moving, columns, basis, head_columns.reshape(heads.shape))
        result["head"] = common_equations(rig.values.ravel(), rig.sigma.ravel(), heads.ravel(), head_columns)
    if not mounted:
        return result
    body = body_to_camera(mounting, state.common), left_jacobian(state.common[BORESIGHT])
    return result | {
        "position": position_equations(
            network.positions, body, state.common, state.rotation, state.centre, columns, basis, common
        ),
        "attitude": attitude_equations(network.attitudes, body, state.rotation, columns, basis, common),
        "mounting": common_equations(
            mounting.values, mounting.sigma, state.common[:of_mounting], common[:of_mounting]
        ),
    }


def distance_equations(network: Network, layout: Layout, state: State) -> dict[str, Equations]:
    """Laser distances, and what they have in common, where there are any."""
    lasers, exposures = network.lasers, network.exposures
    if not len(lasers.image):
        return {}
    corners = layout.point_columns[np.searchsorted(layout.kept_points, lasers.corners)].reshape(-1, 9)
    first = len(network.mounting.values)
    common = layout.common_columns[first : first + len(lasers.common_sigma)]
    return laser_equations(
        lasers,
        (state.rotation, state.centre),
        state.points,
        laser_values(network, state.common),
        (layout.image_columns, corners, common),
        turn_basis(network, state),
        (exposures.sigma != 0, ~network.points.held),
    )


def related(kind: str, difference: Floats) -> tuple[Floats, Floats]:
    """Value of a relation and its derivative with respect to the second point."""
    if kind == "distance":
        length = np.linalg.norm(difference, axis=1)
        return length, difference / length[:, None]
    if kind == "height_difference":
        return difference[:, 2], np.broadcast_to([0.0, 0.0, 1.0], difference.shape)
    dx, dy, dz = difference.T
    square = dx**2 + dy**2
    if kind == "vertical_angle":
        level = np.sqrt(square)
        by_level = -dz / (level * (square + dz**2))
        by_second = np.column_stack([dx * by_level, dy * by_level, level / (square + dz**2)])
        return np.arctan2(dz, level), by_second
    return np.arctan2(dx, dy), np.column_stack([dy / square, -dx / square, np.zeros_like(dx)])


def among_three(kind: str, points: Floats) -> tuple[Floats, Floats]:
    """Values (n, m) of a relation of three points (n, 3, 3), and derivatives (n, m, 3, 3) by each of them.

    The components of a point across a line are about axes that turn with the line, so that the line's own
    turn, about the point's foot, is all there is to differentiate.
    """
    if kind == "horizontal_angle":
        (back, by_back), (on, by_on) = (related("azimuth", points[:, k] - points[:, 0]) for k in (1, 2))
        return (on - back)[:, None], np.stack([by_back - by_on, -by_back, by_on], axis=1)[:, None]
    along = points[:, 1] - points[:, 0]
    axes = np.linalg.svd(along[:, None])[2][:, 1:]
    apart = points[:, 2] - points[:, 0]
    share = np.sum(apart * along, axis=1) / np.sum(along**2, axis=1)
    by_point = np.column_stack([share - 1.0, -share, np.ones_like(share)])
    return np.einsum("nmi,ni->nm", axes, apart), by_point[:, None, :, None] * axes[:, :, None]
