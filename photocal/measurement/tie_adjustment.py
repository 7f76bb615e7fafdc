"""Adjusting a block of tie points robustly: gross errors taken out, sigmas estimated from the residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.block.model import Block, Images
from photocal.block.network import NetworkOfBlock, assemble
from photocal.geometry.camera import Camera
from photocal.measurement.ray_sigmas import GROSS, ray_sigmas
from photocal.measurement.tie_block import fitting, place, with_ties
from photocal.measurement.tracks import Tracks
from photocal.results.adjusted import given_exposures, given_points

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ROUNDS = 8


@dataclass(frozen=True)
class Adjusted:
    """An adjusted block of tie points.

    Attributes
    ----------
    block : Block
        With its tie points; start values are the adjusted ones, observed values stay as observed.
    tracks : Tracks
        The tie points that are left, in the order of the block.
    values : ndarray, shape (images, 6)
        Adjusted exterior orientations in the block's frame, of the observed ones too.
    rejected : int
        Rays that were taken out.
    """

    block: Block
    tracks: Tracks
    values: Floats
    assembly: NetworkOfBlock
    solution: Solution
    rejected: int


def adjust_ties(start: Block, poses: Floats, tracks: Tracks) -> Adjusted:
    """Adjust a block with tie points and take out the rays that do not fit."""
    total = len(tracks.track)
    tracks = _placed(_oriented(start, poses), tracks)
    sigma = np.ones(len(tracks.track))
    for round_ in range(_ROUNDS):
        block = _with_points(start, poses, tracks, sigma)
        _require_rays(block)
        # Gross errors first: they must not go into the camera.
        start, assembly, solution = _solved(start, assemble(block), held=round_ == 0)
        poses = given_exposures(assembly, solution)[0]
        size, redundancy = _by_ray(assembly, solution)
        ties = slice(len(start.observations.image), None)
        sigma = ray_sigmas(tracks.scale, tracks.image, size[ties], redundancy[ties])
        # A residual shows the part of the error that the redundancy number says.
        standardised = size[ties] / (sigma * np.sqrt(2 * np.maximum(redundancy[ties], 0.05)))
        good = standardised <= (GROSS if round_ else 2 * GROSS)
        if round_ and good.all():
            break
        tracks, sigma = _with(tracks, sigma, good)
    block = _with_points(start, poses, tracks, sigma)
    start, assembly, solution = _solved(start, assemble(block), held=False)
    values = given_exposures(assembly, solution)[0]
    points = block.points.values.copy()
    tie = assembly.points >= len(start.points.names)
    points[assembly.points[tie]] = given_points(assembly, solution)[0][tie]
    block = replace(
        block,
        cameras=start.cameras,
        images=_kept(block, values),
        points=replace(block.points, values=points),
    )
    return Adjusted(block, tracks, values, assembly, solution, total - len(tracks.track))


def _placed(start: Block, tracks: Tracks) -> Tracks:
    """Tracks whose rays meet and fit."""
    values = place(start, tracks)
    block = with_ties(start, tracks, values, np.ones(len(tracks.track)))
    fit = fitting(block)[len(start.observations.image) :]
    return tracks.some(fit)


def _with(tracks: Tracks, sigma: Floats, good: Flags) -> tuple[Tracks, Floats]:
    """Tracks and sigmas with the good rays only."""
    left = np.bincount(tracks.track[good], minlength=tracks.count)
    return tracks.some(good), sigma[good & (left >= 2)[tracks.track]]


def _with_points(start: Block, poses: Floats, tracks: Tracks, sigma: Floats) -> Block:
    """Block at its present values; observed positions and angles stay as they were observed."""
    values = place(_oriented(start, poses), tracks, 0.0)
    return with_ties(replace(start, images=_kept(start, poses)), tracks, values, sigma)


def _kept(start: Block, poses: Floats) -> Images:
    images = start.images
    return replace(images, values=np.where(np.isfinite(images.sigma), images.values, poses))


def _oriented(block: Block, poses: Floats) -> Block:
    return replace(block, images=replace(block.images, values=poses))


def _solved(start: Block, assembly: NetworkOfBlock, *, held: bool) -> tuple[Block, NetworkOfBlock, Solution]:
    """Adjust, and give the cameras their new values; where the block does not bear them they are held."""
    if held:
        assembly = _with_cameras(assembly, _held(assembly.network.cameras))
    try:
        solution = adjust(assembly.network)
    except (IllPosedError, NotConvergedError):
        cameras = _held(assembly.network.cameras)
        if not any(own.estimated.any() for own in assembly.network.cameras):
            raise
        start, assembly = replace(start, cameras=cameras), _with_cameras(assembly, cameras)
        solution = adjust(assembly.network)
    cameras = tuple(own.with_values(v) for own, v in zip(start.cameras, solution.cameras, strict=True))
    return replace(start, cameras=cameras), assembly, solution


def _held(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    return tuple(replace(own, estimated=np.zeros_like(own.estimated)) for own in cameras)


def _with_cameras(assembly: NetworkOfBlock, cameras: tuple[Camera, ...]) -> NetworkOfBlock:
    return replace(assembly, network=replace(assembly.network, cameras=cameras))


def pixel_residuals(assembly: NetworkOfBlock, solution: Solution) -> Floats:
    """Residuals in the order of the block's observations, px, whatever the unit of the cameras; (n, 2)."""
    network = assembly.network
    pitch = np.array([own.pitch for own in network.cameras])[network.exposures.camera[network.rays.image]]
    residuals = np.empty_like(solution.residuals)
    residuals[assembly.rays] = solution.residuals / pitch
    return residuals


def _by_ray(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Length of the residual, px, and mean redundancy number of each observation of the block."""
    size = np.hypot(*pixel_residuals(assembly, solution).T)
    redundancy = np.empty(len(assembly.rays))
    redundancy[assembly.rays] = solution.redundancy.mean(axis=1)
    return size, redundancy


def _require_rays(block: Block) -> None:
    few = np.flatnonzero(np.bincount(block.observations.image, minlength=len(block.images.names)) < 3)
    if len(few):
        name = block.images.names[few[0]]
        raise IllPosedError(
            "shares no points with the others that fit",
            where=f"image {name}",
            remedy="take it out, or add images that overlap it",
        )
