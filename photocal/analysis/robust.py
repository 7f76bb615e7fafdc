"""Second opinions on the precision of cameras: images left out, drawn anew, and what the residuals say."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork, lowest, without_images
from photocal.adjustment.factored import camera_covariance_columns
from photocal.adjustment.leverage import cameras_without
from photocal.adjustment.near import Removals
from photocal.adjustment.removed import (
    FEWEST,
    groups_of,
    least_standard_error,
    standard_error,
    state_without,
)
from photocal.adjustment.score import followed_by
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy

# Beyond this many images what leaving them out does is read from the factor that there is.
CLOSED_FORM = 20
# From here on two standard deviations tell something different.
APART = 4.0 / 3.0


@dataclass(frozen=True)
class Jackknife:
    """Camera parameters with images left out.

    left_out: images that were left out together, one entry for each of m adjustments.
    cameras (m, cameras, 20): parameters without them.
    standard_error (cameras, 20): NaN for fewer than three removals, a lower bound where one was not possible.
    not_possible: images without which the rest is not determined.
    """

    left_out: tuple[tuple[str, ...], ...]
    cameras: Floats
    standard_error: Floats
    not_possible: tuple[str, ...]


def jackknife(fit: AdjustedNetwork, done: Callable[[], None] = lambda: None) -> Jackknife:
    """Take each image out of the minimum, or each group of neighbours in a large network.

    Few images are taken out of the normal equations, more of them in closed form, see `leverage`.
    Efron, The jackknife, the bootstrap and other resampling plans, 1982.
    """
    names, groups = fit.network.image_names, groups_of(fit)
    if len(names) > CLOSED_FORM:
        values, possible = cameras_without(fit, groups)
        done()
    else:
        values, possible = _without_each(fit, groups, done)
    together = [tuple(names[i] for i in np.flatnonzero(out)) for out in groups]
    left_out = tuple(group for group, can in zip(together, possible, strict=True) if can)
    not_possible = (name for group, can in zip(together, possible, strict=True) if not can for name in group)
    whole, values = fit.state.cameras, values[possible]
    errors = standard_error(values) if possible.all() else least_standard_error(values, whole, len(groups))
    return Jackknife(left_out, values, errors, tuple(not_possible))


def _without_each(
    fit: AdjustedNetwork, groups: list[Flags], done: Callable[[], None]
) -> tuple[Floats, Flags]:
    """Parameters without each group, by the minimum of the rest; and without which ones there is one."""
    values, possible = np.repeat(fit.state.cameras[None], len(groups), axis=0), np.ones(len(groups), np.bool_)
    removals = Removals(fit.factored)
    for k, out in enumerate(groups):
        try:
            values[k] = state_without(removals, out).cameras
        except NotConvergedError:
            (values[k],), _ = cameras_without(fit, [out])
        except IllPosedError:
            possible[k] = False
        done()
    return values, possible


def apart(formal: float, robust: float | None) -> bool:
    """Whether two standard deviations differ by more than a third."""
    if robust is None or not (formal > 0.0 and robust > 0.0):
        return False
    return max(formal / robust, robust / formal) > APART


def sandwich(fit: AdjustedNetwork) -> Floats:
    """Give standard deviations of camera parameters from the residuals, image by image, (cameras, 14).

    Q (sum g g') Q with g the part of an image in A'Pv (White 1980, Liang and Zeger 1986), residuals divided
    by the root of their redundancy numbers (HC2 of MacKinnon and White 1985), the whole times
    m / (m - k) for m images and k parameters. Every other observation, and every control point, is a part of
    its own.
    """
    layout = fit.factored.problem.layout
    image, images = fit.network.rays.image, len(fit.network.image_names)
    checked = np.maximum(fit.solution.redundancy, policy.least_checked)
    pull = fit.network.rays.sigma**-2.0 * fit.solution.residuals / np.sqrt(checked)
    others = list(fit.factored.others.values())
    off = np.einsum("nab,nb->na", fit.network.points.weight, fit.state.points - fit.network.points.values)
    sigma = np.zeros_like(fit.state.cameras)
    for camera, (parameters, columns) in enumerate(layout.camera_columns):
        own_images = int(np.sum(fit.network.exposures.camera == camera))
        rest = own_images - len(parameters)
        few = np.sqrt(own_images / rest) if rest >= FEWEST else np.nan
        if not len(columns):
            continue
        steps, moves = camera_covariance_columns(fit.factored, columns)
        changes = followed_by(fit.factored, steps, moves)
        for parameter, step, moved, change in zip(parameters, steps, moves, changes, strict=True):
            by_image = np.bincount(image, np.einsum("rk,rk->r", change, pull), images)
            parts: list[Floats] = [by_image.astype(np.float64)]
            parts.append(np.einsum("na,na->n", moved, off))
            for rows in others:
                if len(rows.weight):
                    effect = np.add.reduceat(rows.coefficient * step[rows.column], rows.start[:-1])
                    parts.append(effect * rows.weight * rows.residual)
            sigma[camera, parameter] = few * np.sqrt(sum(float(part @ part) for part in parts))
    return sigma


def bootstrap(
    fit: AdjustedNetwork, draws: int, rng: np.random.Generator, done: Callable[[], None] = lambda: None
) -> Floats:
    """Adjust blocks whose images were drawn with replacement: spread of all camera parameters, (cameras, 14).

    An image that is drawn twice counts twice, with all of its observations. Draws that leave something
    undetermined are left out.

    Efron, The jackknife, the bootstrap and other resampling plans, 1982.
    """
    network, images = fit.network, len(fit.network.image_names)
    cameras = []
    for _ in range(draws):
        times = rng.multinomial(images, np.full(images, 1.0 / images))
        rays = replace(
            network.rays, sigma=network.rays.sigma / np.sqrt(np.maximum(times, 1))[network.rays.image, None]
        )
        positions = replace(
            network.positions,
            covariance=network.positions.covariance
            / np.maximum(times, 1)[network.positions.image, None, None],
        )
        lasers = replace(
            network.lasers,
            sigma=network.lasers.sigma / np.sqrt(np.maximum(times, 1))[network.lasers.image],
        )
        try:
            drawn, state = without_images(
                replace(network, rays=rays, positions=positions, lasers=lasers), fit.state, times == 0
            )
            cameras.append(lowest(drawn, state, 1e-8).state.cameras)
        except (IllPosedError, NotConvergedError):
            continue
        finally:
            done()
    return np.std(cameras, axis=0, ddof=1) if len(cameras) > 1 else np.full_like(fit.state.cameras, np.nan)
