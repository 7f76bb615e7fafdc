"""An adjustment of marks alone: it shows wrong marks while they can still be corrected.

Cameras are held, images keep what is known of their exterior orientation as observations. It is no
substitute for the adjustment of the block, where tie points and free cameras take part.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from photocal.base.errors import IllPosedError
from photocal.block.model import Block, Images, ObjectPoints
from photocal.exchange.parts import Mark
from photocal.geometry.camera import held_camera
from photocal.measurement.marks import with_marks
from photocal.measurement.orientation import Orientation

# So many points orient an image of which nothing is known, or which has start values.
FEWEST_UNKNOWN, FEWEST_STARTED = 4, 3
TooFew = dict[str, str | int]


@dataclass(frozen=True)
class AdjustedMarks:
    """What an adjustment of marks found.

    residuals: of each mark, computed minus marked: image, point, vx, vy (px), and in_sigmas, the larger of
        the two standardised residuals, None where the mark is not checked by others.
    orientation: improved where images took part.
    sigma0: A posteriori standard deviation of unit weight; None without redundancy.
    left_out: images that are not used, with the marks of control points that they have and need.
    """

    residuals: tuple[dict[str, Any], ...]
    orientation: Orientation
    sigma0: float | None
    left_out: tuple[TooFew, ...]


def adjust_marks(orientation: Orientation, points: ObjectPoints, marks: Sequence[Mark]) -> AdjustedMarks:
    """Adjust marks."""
    from photocal.block.network import assemble
    from photocal.block.results.adjusted import adjusted, given_exposures, observed_residuals

    block, left_out = block_of_marks(orientation, points, marks)
    assembly, solution = adjusted(assemble(block))
    seen, rays = block.observations, assembly.rays
    v = observed_residuals(block, assembly, solution)
    # Not a number where no other observation checks a coordinate.
    standardised = np.nan_to_num(np.abs(solution.standardised(assembly.network.rays.sigma)), nan=-1).max(
        axis=1
    )
    residuals = tuple(
        {
            "image": block.images.names[seen.image[ray]],
            "point": block.points.names[seen.point[ray]],
            "vx": float(vx),
            "vy": float(vy),
            "in_sigmas": float(w) if w >= 0 else None,
        }
        for ray, (vx, vy), w in zip(rays, v, standardised, strict=True)
    )
    values, covariance = given_exposures(assembly, solution)
    factor = solution.variance_factor
    images = orientation.images
    row = {name: k for k, name in enumerate(images.names)}
    rows = np.array([row[name] for name in block.images.names], dtype=np.int64)
    poses, covariances = images.values.copy(), images.covariances.copy()
    poses[rows], covariances[rows] = values, covariance
    images = replace(images, values=poses, covariance=covariances)
    improved = replace(orientation, images=images, source="adjusted marks")
    return AdjustedMarks(
        residuals, improved, float(np.sqrt(factor)) if np.isfinite(factor) else None, left_out
    )


def block_of_marks(
    orientation: Orientation, points: ObjectPoints, marks: Sequence[Mark]
) -> tuple[Block, tuple[TooFew, ...]]:
    """Make the block of those marks that can be adjusted."""
    whole, _ = with_marks(
        Block(
            "marks",
            orientation.frame,
            orientation.height if orientation.frame != "local" else "",
            "control",
            tuple(map(held_camera, orientation.images.cameras)),
            Images.observed(orientation.images),
            points,
        ),
        marks,
    )
    seen = whole.observations
    of_control = points.of_role("control")[seen.point]
    control = np.bincount(seen.image[of_control], minlength=len(whole.images.names))
    started = np.isfinite(whole.images.values).all(axis=1)
    observed = started & np.isfinite(whole.images.sigma).all(axis=1)
    needed = np.where(observed, 0, np.where(started, FEWEST_STARTED, FEWEST_UNKNOWN))
    marked = np.bincount(seen.image, minlength=len(control)) > 0
    usable = marked & (control >= needed)
    left_out: tuple[TooFew, ...] = tuple(
        {"image": whole.images.names[i], "marks": int(control[i]), "needed": int(needed[i])}
        for i in np.flatnonzero(marked & ~usable)
    )
    ray = usable[seen.image]
    count = np.bincount(seen.point[ray], minlength=len(points.names))
    held = (count > 0) & (points.of_role("control") | (count > 1))
    ray &= held[seen.point]
    if not (ray & of_control).any():
        few = "{image} has {marks} of {needed} marks of control points that it needs"
        raise IllPosedError(
            ": ".join(
                ["no image has enough marks for an adjustment", *(few.format(**e) for e in left_out[:1])]
            ),
            "mark control points in more images",
        )
    return replace(whole, observations=seen.rows(ray)).of_images(usable).of_points(held), left_out
