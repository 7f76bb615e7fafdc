"""From tie points and the images' own positions to a block, gross errors taken out, sigmas estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Rays
from photocal.adjustment.solution import Solution
from photocal.adjustment.start.values import start_values
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.network import Assembly, assemble, observed_plane
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.resection import ray_residuals
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.start_camera import group_cameras, principal_distance_px, start_camera
from photocal.measurement.tracks import Tracks

Floats = NDArray[np.float64]

# Sigma of a position that the image does not state, m: single-frequency receivers in the air.
POSITION_SIGMA_M = (1.5, 1.5, 3.0)
# A level block without control says little about c, x0 and y0, which go with the heights and the
# positions: they are held until somebody asks for them.
ESTIMATE = ("K1", "K2")
# Fewer positions do not fix a datum.
FEWEST_POSITIONS = 3
# A ray is wrong when its residual exceeds so many of its standard deviations.
GROSS = 3.5
# At the start, when the camera is not calibrated, when it exceeds so many medians of all.
START_GROSS = 8.0
_ROUNDS = 8
# Image points of coarse features are less precise: sigmas are estimated in so many classes of scale.
CLASSES = 4


@dataclass(frozen=True)
class TieBlock:
    """A block of tie points.

    Attributes
    ----------
    block : Block
    record : dict
        Figures for `measurement.json`.
    """

    block: Block
    record: dict[str, Any]


def make_tie_block(facts: Sequence[ImageFacts], tracks: Tracks, places: Floats, name: str) -> TieBlock:
    """Make a block of images with positions, adjust it robustly and take out what is wrong.

    Parameters
    ----------
    facts : sequence of ImageFacts
    tracks : Tracks
    places : ndarray, shape (images, 3)
        Projection centres, m.
    name : str
        Of the block.

    Returns
    -------
    TieBlock
        Observations with estimated sigmas; exposures and points at their adjusted values.

    Raises
    ------
    PhotocalError
        When the tie points do not determine the images.
    """
    block = _oriented(_start_block(facts, tracks, places, name))
    tracks, block = _placed(tracks, block)
    rays = _fitting(block)
    block = _with_observed_positions(block, places)
    unit = np.ones(len(tracks.track))
    total = len(rays)
    for round_ in range(_ROUNDS):
        part, used = _of_rays(block, tracks, rays)
        assembly = assemble(part)
        if round_ == 0:
            # Gross errors first: they must not go into the camera.
            assembly = _with_held_cameras(assembly)
        solution = adjust(assembly.network)
        size, redundancy = _by_ray(assembly, solution)
        index = np.flatnonzero(used)
        unit[index] = _class_sigmas(tracks.scale[index], size, redundancy)
        block = _with_sigma(_moved(block, part, assembly, solution), unit)
        # A residual shows the part of the error that the redundancy number says.
        standardised = size / (unit[index] * np.sqrt(2 * np.maximum(redundancy, 0.05)))
        limit = GROSS if round_ else 2 * GROSS
        bad = standardised > limit
        if round_ and not bad.any():
            break
        rays = used.copy()
        rays[index[bad]] = False
    else:
        part, used = _of_rays(block, tracks, rays)
        assembly = assemble(part)
        solution = adjust(assembly.network)
    block, used = _of_rays(block, tracks, rays)
    return TieBlock(block, _figures(block, tracks.some(used), solution, total - int(used.sum())))


def _start_block(facts: Sequence[ImageFacts], tracks: Tracks, places: Floats, name: str) -> Block:
    names, member = group_cameras(facts)
    cameras = []
    for k, camera_name in enumerate(names):
        one = facts[int(np.flatnonzero(member == k)[0])]
        c, _ = principal_distance_px(one)
        cameras.append(start_camera(camera_name, one, c, ESTIMATE))
    poses = np.zeros((len(facts), 6))
    poses[:, :3], poses[:, 3:] = np.nan, places
    sigma = np.full((len(facts), 6), np.inf)
    stated = np.array([f.position_sigma_m for f in facts])
    sigma[:, 3:] = np.where(np.isfinite(stated) & (stated > 0), stated, POSITION_SIGMA_M)
    sigma[np.isnan(places).any(axis=1)] = np.inf
    points = tuple(f"t{j + 1}" for j in range(tracks.count))
    free = np.full((tracks.count, 3), np.inf)
    role = np.full(tracks.count, ROLES.index("tie"))
    ones = np.ones((len(tracks.track), 2))
    return Block(
        name,
        "local",
        "",
        "control" if np.isfinite(places).all(axis=1).sum() >= FEWEST_POSITIONS else "free",
        (),
        tuple(cameras),
        Images(tuple(f.name for f in facts), member, poses, sigma),
        ObjectPoints(points, np.full((tracks.count, 3), np.nan), free, role),
        Observations("px", "pixel", tracks.image, tracks.track, tracks.pixels, ones),
        (),
    )


def _of_rays(block: Block, tracks: Tracks, rays: NDArray[np.bool_]) -> tuple[Block, NDArray[np.bool_]]:
    """Give the block with some of its rays, without points that lost all but one."""
    left = np.bincount(tracks.track[rays], minlength=tracks.count)
    used = rays & (left >= 2)[tracks.track]
    points = np.flatnonzero(left >= 2)
    seen, known = block.observations, block.points
    missing = np.flatnonzero(np.bincount(seen.image[used], minlength=len(block.images.names)) < 3)
    if len(missing):
        raise IllPosedError(
            f"image {block.images.names[missing[0]]} shares no points with the others",
            where=f"image {block.images.names[missing[0]]}",
            remedy="take it out, or add images that overlap it",
        )
    return (
        replace(
            block,
            points=ObjectPoints(
                tuple(known.names[j] for j in points),
                known.values[points],
                known.sigma[points],
                known.role[points],
            ),
            observations=replace(
                seen,
                image=seen.image[used],
                point=np.searchsorted(points, seen.point[used]),
                values=seen.values[used],
                sigma=seen.sigma[used],
            ),
        ),
        used,
    )


def _oriented(block: Block) -> Block:
    """Find the orientations from the tie points, in the frame of the given positions."""
    seen = block.observations
    plane, sigma = observed_plane(block)
    order = np.argsort(seen.point, kind="stable")
    rays = Rays(seen.image[order], seen.point[order], plane[order], sigma[order])
    given = block.images.values.copy()
    given[:, :3] = np.nan
    found = start_values(
        block.cameras,
        block.images.camera,
        given,
        block.points.values,
        rays,
        free=not np.isfinite(given[:, 3:]).any(),
    )
    if len(found.lost):
        names = ", ".join(block.images.names[j] for j in found.lost[:5])
        raise IllPosedError(
            f"{len(found.lost)} image(s) cannot be oriented to the others by their tie points: {names}",
            where=block.name,
            remedy="take them out, or add images that overlap them",
        )
    return replace(
        block,
        images=replace(block.images, values=found.exposures),
        points=replace(block.points, values=found.points),
    )


def _placed(tracks: Tracks, block: Block) -> tuple[Tracks, Block]:
    """Keep the points that their rays could be intersected to."""
    placed: NDArray[np.bool_] = np.asarray(np.isfinite(block.points.values).all(axis=1))
    part, used = _of_rays(block, tracks, placed[tracks.track])
    return tracks.some(used), part


def _fitting(block: Block) -> NDArray[np.bool_]:
    """Rays that fit the start values: a gross error would keep least squares from converging."""
    seen = block.observations
    plane, _ = observed_plane(block)
    camera = block.images.camera[seen.image]
    c = np.array([own.value("c") for own in block.cameras])[camera]
    rotation = matrix_from_angles(block.images.values[:, :3])[seen.image]
    centre = block.images.values[seen.image, 3:]
    miss = ray_residuals(rotation, centre, block.points.values[seen.point], plane / c[:, None]) * c
    return np.asarray(miss <= START_GROSS * np.median(miss))


def _with_observed_positions(block: Block, places: Floats) -> Block:
    """Give the images the positions that were observed, where they stand as observations."""
    values = block.images.values.copy()
    values[:, 3:] = np.where(np.isfinite(block.images.sigma[:, 3:]), places, values[:, 3:])
    return replace(block, images=replace(block.images, values=values))


def _with_held_cameras(assembly: Assembly) -> Assembly:
    held = tuple(replace(own, estimated=np.zeros_like(own.estimated)) for own in assembly.network.cameras)
    return replace(assembly, network=replace(assembly.network, cameras=held))


def _by_ray(assembly: Assembly, solution: Solution) -> tuple[Floats, Floats]:
    """Length of the residual, px, and mean redundancy number of each ray of the block."""
    size, redundancy = np.empty(len(assembly.rays)), np.empty(len(assembly.rays))
    size[assembly.rays] = np.hypot(*solution.residuals.T)
    redundancy[assembly.rays] = solution.redundancy.mean(axis=1)
    return size, redundancy


def _class_sigmas(scale: Floats, size: Floats, redundancy: Floats) -> Floats:
    """Sigma of a coordinate for each ray: of its class of scale, robust against what is still wrong."""
    edges = np.quantile(scale, np.linspace(0, 1, CLASSES + 1)[1:-1])
    member = np.searchsorted(edges, scale)
    sigma = np.ones(len(scale))
    for k in range(CLASSES):
        mine = (member == k) & (redundancy > 0.05)
        if mine.any():
            # Squared lengths over 2 r are exponential in units of the variance; three sigma cut 1 % of them.
            squares = size[mine] ** 2 / (2 * redundancy[mine])
            good = squares <= 9 * np.median(squares) / np.log(2)
            sigma[member == k] = np.sqrt(
                size[mine][good] @ size[mine][good] / (2 * redundancy[mine][good].sum())
            )
    return np.maximum(sigma, 0.02)


def _moved(block: Block, part: Block, assembly: Assembly, solution: Solution) -> Block:
    """Take the adjusted values as start values of the next round; observed positions stay observed."""
    exposures = np.hstack([solution.exposures[:, :3], assembly.frame.to_given(solution.exposures[:, 3:])])
    values = np.where(np.isfinite(block.images.sigma), block.images.values, exposures)
    place = {name: j for j, name in enumerate(block.points.names)}
    points = block.points.values.copy()
    index = [place[part.points.names[j]] for j in assembly.points]
    points[index] = assembly.frame.to_given(solution.points)
    cameras = tuple(own.with_values(v) for own, v in zip(block.cameras, solution.cameras, strict=True))
    return replace(
        block,
        cameras=cameras,
        images=replace(block.images, values=values),
        points=replace(block.points, values=points),
    )


def _with_sigma(block: Block, unit: Floats) -> Block:
    sigma = np.column_stack([unit, unit])
    return replace(block, observations=replace(block.observations, sigma=sigma))


def _figures(block: Block, tracks: Tracks, solution: Solution, rejected: int) -> dict[str, Any]:
    rays = tracks.rays
    cameras = [
        {
            "camera": own.id,
            "parameters": {n: float(v) for n, v in zip(PARAMETERS, value, strict=True) if v},
            "sigma": {
                n: float(covariance[k, k] ** 0.5) for k, n in enumerate(PARAMETERS) if own.estimated[k]
            },
            "held": [n for k, n in enumerate(PARAMETERS[:3]) if not own.estimated[k]],
        }
        for own, value, covariance in zip(
            block.cameras, solution.cameras, solution.camera_covariance, strict=True
        )
    ]
    return {
        "points": tracks.count,
        "observations": len(tracks.track),
        "rejected_observations": rejected,
        "points_by_rays": {str(n): int(c) for n, c in enumerate(np.bincount(rays)) if c},
        "share_of_four_and_more": float(np.mean(rays >= 4)),
        "rms_px": float(np.sqrt(np.mean(solution.residuals**2))),
        "sigma_px": float(np.sqrt(np.mean(block.observations.sigma**2))),
        "variance_factor": float(solution.variance_factor),
        "cameras": cameras,
    }
