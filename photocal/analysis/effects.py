"""What a parameter does in the image: its effect over the format, in px."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats
from photocal.analysis.estimates import GROUPS, Estimates, without
from photocal.analysis.stability.methods import Method, View, fitted_pose, rotation_misfit, sensor_grid, view
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted

_ROTATION = Method("ROT", "two principal distances", "equations", 3, False, (rotation_misfit,))


@dataclass(frozen=True)
class Effect:
    """Effect of one or more parameters over the format.

    parameters: parameters that are set to zero.
    largest_px, rms_px: displacement over the format when the others keep their values.
    remaining_largest_px, remaining_rms_px: the same when the others follow, as in an adjustment without these
        parameters, and the bundle is rotated back: what no other parameter can do.
    """

    parameters: tuple[str, ...]
    largest_px: float
    rms_px: float
    remaining_largest_px: float
    remaining_rms_px: float


def effects(camera: Camera, estimates: Estimates, reach: float = np.inf) -> tuple[Effect, ...]:
    """Give the effect of every parameter but c, and of the usual groups.

    reach: largest distance of an observation from the image centre, in the unit of the camera: beyond it
        nothing determined the distortion.
    """
    names = [name for name in estimates.names if name != "c"]
    groups = [tuple(name for name in group if name in names) for group in GROUPS]
    wanted = [(name,) for name in names] + [group for group in groups if len(group) > 1]
    grid = sensor_grid(camera.size_px)
    plane = pixel_to_plane(camera.size_px, camera.pitch, grid)
    grid = grid[np.linalg.norm(plane, axis=1) <= reach]
    return tuple(effect(camera, estimates, group, grid) for group in wanted)


def effect(camera: Camera, estimates: Estimates, parameters: Iterable[str], pixels: Floats) -> Effect:
    """Give the effect of some parameters over a grid of pixels."""
    removed = tuple(parameters)
    # Beyond the observations the polynomial may fold: those pixels have no ray to compare.
    pixels = pixels[_has_ray(camera, pixels)]
    full = view(camera, pixels)
    bare = camera.changed(**dict.fromkeys(removed, 0.0))
    remaining, _ = without(estimates, removed)
    followed = dict(zip(remaining.names, remaining.values.tolist(), strict=True))
    adjusted = camera.changed(**followed | dict.fromkeys(removed, 0.0))
    alone = left = (np.nan, np.nan)
    if _has_ray(bare, pixels).all():
        alone = _sizes(view(bare, pixels).ideal - full.ideal)
    if _has_ray(adjusted, pixels).all():
        left = _sizes(_difference(full, view(adjusted, pixels)))
    return Effect(removed, *alone, *left)


def _has_ray(camera: Camera, pixels: Floats) -> Flags:
    """Where the distortion of a camera does not fold, (n,)."""
    plane = pixel_to_plane(camera.size_px, camera.pitch, pixels)
    return np.asarray(np.isfinite(undistorted(camera, plane)).all(axis=1))


def _difference(full: View, other: View) -> Floats:
    pose, _ = fitted_pose(_ROTATION, rotation_misfit, full, other)
    return rotation_misfit(full, other, pose)


def _sizes(moved: Floats) -> tuple[float, float]:
    length = np.linalg.norm(moved, axis=1)
    return float(length.max()), float(np.sqrt(np.mean(length**2)))
