"""Laser distances of pictures as observations of a block: what each hit, and how rough that is."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from photocal.adjustment.lasers import NO_LASERS, LaserDistances, planes_ahead
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.adjustment.state import State, start_state
from photocal.analysis.accuracy.discrepancies import (
    DENSE,
    FEWEST_SHOTS,
    LASER_M,
    LASER_SHARE,
    NEIGHBOURS,
    SMOOTH_M,
    far_off,
)
from photocal.base.arrays import Integers
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.results.adjusted import adjusted
from photocal.findings.finding import Finding, untested
from photocal.measurement.image_facts import ImageFacts

CODE = "laser-observations"
# What distances have in common limits them long before: so many of them are enough, and each brings three
# points to the part of the normal equations that is full.
MOST_SHOTS = 200
# A point is known well by so many rays.
_RAYS = 3
# Of what a laser hit: three points of the network about it, the distance along the axis to the plane through
# them, and by how much the surface departs from that, m.
LaserTarget = tuple[Integers, float, float]


def with_lasers(block: Block, facts: Sequence[ImageFacts]) -> tuple[Block, Finding]:
    """Make the laser distances of pictures observations of a block; as it is where they are too few.

    The block is adjusted without them first: gross ones are detected by what the others differ from its
    surface, which a common error of heights does not change.

    raises PhotocalError: as `assemble` does.
    """
    by_name = {picture.name: picture.laser_m for picture in facts}
    measured = np.array([by_name.get(name, np.nan) for name in block.images.names])
    shots = np.flatnonzero(np.isfinite(measured))
    block = replace(block, lasers=NO_LASERS)
    if len(shots) < FEWEST_SHOTS:
        return block, _too_few(len(shots))
    assembly = assemble(block)
    try:
        with because("the surface that laser distances are compared with"):
            assembly, solution = adjusted(assembly)
        state = solution.state
    except (IllPosedError, NotConvergedError):
        # Without the laser something may be open: start values tell a surface, too.
        state = start_state(assembly.network)
    found = {image: target_of(assembly.network, state, image) for image in shots.tolist()}
    hit = [(image, target) for image, target in found.items() if target is not None]
    if len(hit) < FEWEST_SHOTS:
        return block, _too_few(len(hit))
    image = np.array([i for i, _ in hit])
    values = measured[image]
    computed, rough = np.array([along for _, (_, *along) in hit]).T
    if assembly.network.datum_points is not None and not len(block.relations.kind):
        # Without a scale of its own the block gets that of the laser.
        scale = float(np.median(values / computed))
        computed, rough = scale * computed, scale * rough
        block = _enlarged(block, scale)
    sigma = np.sqrt(LASER_M**2 + (LASER_SHARE * values) ** 2 + rough**2)
    far = far_off(computed - values, sigma, computed)
    kept = np.flatnonzero(~far)
    if len(kept) < FEWEST_SHOTS:
        return block, _too_few(len(kept))
    if len(kept) > MOST_SHOTS:
        kept = kept[np.linspace(0, len(kept) - 1, MOST_SHOTS).round().astype(np.int64)]
    corners = assembly.points[np.array([hit[k][1][0] for k in kept])]
    common = (LASER_M, LASER_SHARE)
    lasers = LaserDistances(image[kept], corners, values[kept], sigma[kept], common)
    figures = {
        "n": float(len(kept)), "all": float(len(shots)), "sigma_m": float(np.median(sigma[kept])),
        "elsewhere": float(far.sum()), "lonely": float(len(shots) - len(hit)),
        "spare": float(len(hit) - far.sum() - len(kept)),
        "images": tuple(block.images.names[i] for i in image[far]),
    }  # fmt: skip
    clauses = [clause for clause, counted in _CLAUSES.items() if figures[counted]]
    return replace(block, lasers=lasers), Finding(CODE, "note", figures=figures, clauses=tuple(clauses))


def _enlarged(block: Block, scale: float) -> Block:
    """The block with start values of another scale; where a system has told them they are about right."""
    if block.frame != "local":
        return block
    values = block.images.values * np.repeat([1.0, scale], 3)
    points = replace(block.points, values=scale * block.points.values)
    return replace(block, images=replace(block.images, values=values), points=points)


_CLAUSES = {"laser-left-out": "elsewhere", "laser-lonely": "lonely", "laser-spare": "spare"}


def _too_few(shots: int) -> Finding:
    figures = {"n": float(shots), "needed": float(FEWEST_SHOTS)}
    return untested(CODE, "few-laser-shots", figures)


def target_of(network: Network, state: State, image: int) -> LaserTarget | None:
    """Find what the laser of an image hit: None without points about the axis of its camera.

    In an image the reciprocal depths of a plane are linear: what the nearest points depart from that by is
    the roughness of the surface, for its target and for each corner.
    """
    from scipy.spatial import Delaunay, QhullError

    rays = network.rays
    seen = rays.point[rays.image == image]
    count = np.bincount(rays.point, minlength=len(network.points.values))
    well = seen[count[seen] >= _RAYS]
    seen = well if len(well) >= NEIGHBOURS else seen
    q = (state.points[seen] - state.centre[image]) @ state.rotation[image].T
    seen, q = seen[q[:, 2] < 0.0], q[q[:, 2] < 0.0]
    if len(seen) < NEIGHBOURS:
        return None
    slope = q[:, :2] / -q[:, 2:]
    away = np.hypot(*slope.T)
    near = np.argsort(away, kind="stable")[:NEIGHBOURS]
    if away[near[2]] > DENSE:
        return None
    design = np.column_stack([np.ones(NEIGHBOURS), slope[near]])
    shallow = -1.0 / q[near, 2]
    plane, *_ = np.linalg.lstsq(design, shallow, rcond=None)
    rest = shallow - design @ plane
    try:
        triangles = Delaunay(slope[near])
    except QhullError:
        return None
    inside = int(triangles.find_simplex(np.zeros(2)))
    if inside < 0 or plane[0] <= 0.0:
        return None
    corners = near[triangles.simplices[inside]]
    met = planes_ahead(q[corners][None])
    rough = np.hypot(SMOOTH_M, np.sqrt(np.sum(rest**2) / (NEIGHBOURS - 3)) / plane[0] ** 2)
    sigma = rough * np.sqrt(1.0 + np.sum(met.share[0] ** 2))
    return seen[corners], float(met.distance[0]), float(sigma)
