"""Pictures of calibrations beside each other: parameters over the sets, principal points, profiles, pairs."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from photocal.analysis.estimates import estimates_of, without
from photocal.analysis.stability.comparison import CalibrationPair
from photocal.base.files import output_picture
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import radial_profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The term whose part in the corrections is shown: the highest of the usual radial series.
_DROPPED = "K3"


def draw_parameters(calibrations: tuple[Camera, ...], pairs: tuple[CalibrationPair, ...], path: Path) -> None:
    """Draw every estimated parameter with its standard deviation over the sets, and what they do.

    Besides: the principal points, radial profiles with K3 and without (the others following, as in an
    adjustment without it), affinity along the diagonal, radial and decentring together, and all pairs.
    """
    names = [n for n in PARAMETERS if any(camera.sigma_of(n) > 0.0 for camera in calibrations)]
    rows = -(-len(names) // 4)
    with output_picture(path, (11.0, 2.1 * rows + 8.0), font=8.0, dpi=120) as canvas:
        grid = canvas.add_gridspec(rows + 3, 12)
        for k, name in enumerate(names):
            row, column = divmod(k, 4)
            _over_sets(calibrations, name, canvas.add_subplot(grid[row, 3 * column : 3 * column + 3]))
        _principal_points(calibrations, canvas.add_subplot(grid[rows, :4]))
        _radial(calibrations, canvas.add_subplot(grid[rows, 4:8]), dropped=False)
        _radial(calibrations, canvas.add_subplot(grid[rows, 8:]), dropped=True)
        _affinity(calibrations, canvas.add_subplot(grid[rows + 1, :6]))
        _together(calibrations, canvas.add_subplot(grid[rows + 1, 6:]))
        _bars(pairs, canvas.add_subplot(grid[rows + 2, :]))


def without_term(camera: Camera, term: str) -> Camera:
    """Give a calibration as an adjustment without a term would: the others follow by their correlations."""
    known = estimates_of(camera)
    if known is None or term not in known.names:
        return camera.changed(**{term: 0.0})
    left, _ = without(known, (term,))
    return camera.changed(**dict(zip(left.names, left.values.tolist(), strict=True)), **{term: 0.0})


def _over_sets(calibrations: tuple[Camera, ...], name: str, axes: "Axes") -> None:
    values = [camera.value(name) for camera in calibrations]
    sigmas = [camera.sigma_of(name) for camera in calibrations]
    axes.errorbar(range(len(values)), values, yerr=sigmas, fmt="o", color="#1a1a1a", markersize=3, capsize=2)
    axes.set_xticks(range(len(values)), [camera.id for camera in calibrations], fontsize=7)
    axes.set_title(name, loc="left")
    axes.tick_params(axis="y", labelsize=6)


def _principal_points(calibrations: tuple[Camera, ...], axes: "Axes") -> None:
    for camera in calibrations:
        pitch = np.array(camera.pitch)
        x, y = camera.values[1:3] / pitch
        axes.errorbar(
            x, y, camera.sigma_of("y0") / pitch[1], camera.sigma_of("x0") / pitch[0], "o", markersize=3
        )
        axes.annotate(camera.id, (x, y), textcoords="offset points", xytext=(3, 3), fontsize=7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("principal points, px", loc="left")


def _radius(camera: Camera) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    half = np.array(camera.size_px) * camera.pitch / 2.0
    return np.linspace(0.0, float(np.hypot(*half)), 120)


def _radial(calibrations: tuple[Camera, ...], axes: "Axes", *, dropped: bool) -> None:
    for camera in calibrations:
        own = without_term(camera, _DROPPED) if dropped else camera
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        axes.plot(radius / pitch, radial_profile(own, radius) / pitch, linewidth=1.0, label=camera.id)
    axes.set_title(f"radial, px{f', without {_DROPPED}' if dropped else ''}", loc="left")
    axes.legend(fontsize=6, frameon=False)


def _affinity(calibrations: tuple[Camera, ...], axes: "Axes") -> None:
    for camera in calibrations:
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        size = np.hypot(camera.value("B1"), camera.value("B2")) * radius
        axes.plot(radius / pitch, size / pitch, linewidth=1.0, label=camera.id)
    axes.set_title("affinity, largest at a radius, px", loc="left")


def _together(calibrations: tuple[Camera, ...], axes: "Axes") -> None:
    for camera in calibrations:
        radius, pitch = _radius(camera), float(np.mean(camera.pitch))
        size = 3.0 * np.hypot(camera.value("P1"), camera.value("P2")) * radius**2
        axes.plot(radius / pitch, (np.abs(radial_profile(camera, radius)) + size) / pitch, linewidth=1.0)
    axes.set_title("radial and decentring together, largest at a radius, px", loc="left")


def _bars(pairs: tuple[CalibrationPair, ...], axes: "Axes") -> None:
    kinds = [f"{one.method}, {one.definition}" for one in pairs[0].figures]
    width = 0.8 / len(kinds)
    for k, kind in enumerate(kinds):
        values = [pair.figures[k].value_px for pair in pairs]
        axes.bar(np.arange(len(pairs)) + k * width - 0.4, values, width, label=kind)
    axes.set_yscale("log")
    axes.set_xticks(range(len(pairs)), [f"{p.first}-{p.second}" for p in pairs], rotation=60, fontsize=7)
    axes.set_title("pairs, px", loc="left")
    axes.legend(fontsize=6, ncols=4, frameon=False)
