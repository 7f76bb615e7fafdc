"""Plots of a result as numbers: what `result.plot` and the certificate draw, binned for the window."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

from photocal.base.arrays import Floats
from photocal.block.results.plot import displacement
from photocal.desk.views.shown import Shown, numbers
from photocal.geometry.camera import Camera, plane_to_pixel
from photocal.report.sensor import SensorResiduals, farthest_corner, radial_profile, thinned, to_plane

# Standardised residuals beyond the last bin are counted in it.
_EDGE, _BINS = 5.0, 40
_RADII, _CLOUD, _ARROWS = 24, 3000, 400


def plots(shown: Shown) -> dict[str, Any]:
    """All plots: those of each camera, and those of the block."""
    return {
        "cameras": {name: _of_camera(shown, name) for name in shown.result.cameras},
        "rays_per_point": _rays_per_point(shown),
    }


def _of_camera(shown: Shown, name: str) -> dict[str, Any]:
    result, camera = shown.result, shown.result.cameras[name]
    rays = result.residuals_of(name)
    unit, axes = result.block.observation_unit, result.block.observation_axes
    place = to_plane(camera, rays.measured, rays.residual, unit=unit, axes=axes)
    free = list(camera.free)
    return {
        "unit": camera.unit,
        "size_px": list(camera.size_px),
        "rays": len(rays),
        "radius": against_radius(camera, place),
        "standardised": histogram(rays.standardised),
        "vectors": _vectors(camera, place),
        "distortion": _distortion(camera),
        "correlation": {"names": free, "matrix": numbers(camera.correlation_of(free), 3)},
    }


def against_radius(camera: Camera, rays: SensorResiduals) -> dict[str, Any]:
    """Residuals over the distance from the principal point, px: root mean squares and mean radial part.

    Bins are rings of equal width; `cloud` has some of the rays themselves, evenly chosen.
    """
    pitch = float(np.mean(camera.pitch))
    away = (rays.place - [camera.value("x0"), camera.value("y0")]) / pitch
    radius = np.hypot(*away.T)
    radial = (rays.residual_px * away).sum(axis=1) / np.maximum(radius, 1e-9)
    length = np.hypot(*rays.residual_px.T)
    edges = np.linspace(0.0, farthest_corner(camera) / pitch, _RADII + 1)
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, _RADII - 1)
    count = np.bincount(ring, minlength=_RADII)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(ring, radial, _RADII) / count
        rms = np.sqrt(np.bincount(ring, length**2, _RADII) / count)
    chosen = np.linspace(0, len(radius) - 1, min(len(radius), _CLOUD)).astype(int)
    chosen = chosen[np.argsort(radius[chosen], kind="stable")]
    return {
        "middle_px": numbers((edges[1:] + edges[:-1]) / 2, 1),
        "count": count.tolist(),
        "rms_px": numbers(rms, 4),
        "radial_px": numbers(mean, 4),
        "radial_sigma_px": numbers(rms / np.sqrt(2.0 * np.maximum(count, 1)), 4),
        "cloud": {"radius_px": numbers(radius[chosen], 1), "length_px": numbers(length[chosen], 3)},
    }


def histogram(standardised: Floats) -> dict[str, Any]:
    """Count standardised residuals, with what the normal distribution expects of as many."""
    values = standardised[np.isfinite(standardised)]
    edges = np.linspace(-_EDGE, _EDGE, _BINS + 1)
    count, _ = np.histogram(np.clip(values, -_EDGE, _EDGE), edges)
    share = np.diff(ndtr(np.r_[-np.inf, edges[1:-1], np.inf]))
    return {
        "edges": numbers(edges, 3),
        "count": count.tolist(),
        "expected": numbers(share * len(values), 2),
        "beyond": int((np.abs(values) > _EDGE).sum()),
        "n": len(values),
        "rms": numbers(np.sqrt(np.mean(values**2)), 4) if len(values) else None,
    }


def _vectors(camera: Camera, rays: SensorResiduals) -> list[list[float]]:
    """Residuals over the format, means of cells where there are too many: column, row, vx, vy, px."""
    some = thinned(rays, camera, _ARROWS)
    return numbers(np.column_stack([_pixels(camera, some.place), some.residual_px * [1.0, -1.0]]), 3)  # type: ignore[no-any-return]


def _pixels(camera: Camera, plane: Floats) -> Floats:
    """Columns and rows of places in the image plane."""
    return plane_to_pixel(camera.size_px, camera.pitch, plane)


def _distortion(camera: Camera) -> dict[str, Any]:
    """The lens over a grid of the format, and along the radius with its standard deviation, px."""
    plane, moved = displacement(camera)
    pitch = float(np.mean(camera.pitch))
    radius = np.linspace(0.0, farthest_corner(camera), 60)
    _, displaced, sigma, decentring = (radial_profile(camera, radius) / pitch).T
    return {
        "grid": numbers(np.column_stack([_pixels(camera, plane), moved / camera.pitch * [1.0, -1.0]]), 3),
        "radius_px": numbers(radius / pitch, 1),
        "radial_px": numbers(displaced, 4),
        "sigma_px": numbers(sigma, 5),
        "decentring_px": numbers(decentring, 4),
        "principal_px": numbers(_pixels(camera, np.array([camera.value("x0"), camera.value("y0")])), 2),
    }


def _rays_per_point(shown: Shown) -> dict[str, Any]:
    rays, role = shown.result.points.rays, np.array(shown.result.points.role)
    # More rays than that are one bar.
    most_rays = 30
    tie = np.bincount(np.minimum(rays[role == "tie"], most_rays), minlength=2)
    return {"rays": list(range(len(tie))), "points": tie.tolist(), "most": most_rays}
