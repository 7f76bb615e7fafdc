"""Pictures of a result: residuals, distortion of a camera, the block from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.errors import ConfigurationError, ProgramMissingError
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import undistorted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from photocal.geometry.camera import Camera

# Readable in print: a column of a page is about 17 cm wide.
_WIDE_IN, _HIGH_IN = 6.7, 3.2
# Of the arrows: so much of the width of the format for one of their usual length.
_SHARE = 0.05
_MARKS = {"control": ("^", "tab:red"), "check": ("s", "tab:green"), "tie": (".", "0.7")}


class Plots:
    """Pictures of a result; each returns its figure, which `savefig` writes."""

    # A `Result`, which is not named here: it stands on this module.
    def __init__(self, result: Any) -> None:
        self._result = result

    def residuals(self, camera: str = "") -> Figure:
        """Draw residuals over the format, and how standardised residuals are distributed.

        Parameters
        ----------
        camera
            Name of the camera; may be left out where there is one only.

        Returns
        -------
        matplotlib.figure.Figure
            Arrows where the images were measured, and the histogram with the normal distribution.

        Raises
        ------
        ConfigurationError
            For a camera that is not in the result, or without accepted observations.
        """
        # More would be a grey surface.
        most_arrows = 4000
        result, name = self._result, self._result.camera(camera).id
        rays = result.residuals_of(name)
        if not len(rays):
            raise ConfigurationError("no accepted observation is in its images", where=name)
        unit = result.block.observation_unit
        figure = _figure()
        over, spread = figure.subplots(1, 2, width_ratios=(3, 2))
        rms = float(np.sqrt(np.mean(rays.residual**2)))
        chosen = np.linspace(0, len(rays) - 1, min(len(rays), most_arrows)).astype(int)
        (x, y), (u, v) = rays.measured[chosen].T, rays.residual[chosen].T
        scale = max(rms, 1e-12) / (_SHARE * max(float(np.ptp(x)), 1e-9))
        # In pixels y points down, in the plane of the photo up: so do the arrows.
        arrows = over.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=scale, width=0.002)
        over.quiverkey(arrows, 0.75, 1.04, rms, f"{rms:.2g} {unit} rms", labelpos="E")
        pixel = result.block.observation_axes == "pixel"
        over.set(xlabel=f"{'column' if pixel else 'x'}, {unit}", ylabel=f"{'row' if pixel else 'y'}, {unit}")
        over.set_aspect("equal")
        if pixel:
            over.invert_yaxis()
        values = rays.standardised[np.isfinite(rays.standardised)]
        at = np.linspace(-5, 5, 201)
        spread.hist(np.clip(values, -5, 5), 50, range=(-5, 5), density=True, color="0.7")
        spread.plot(at, np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi), "k-", lw=1, label="normal distribution")
        spread.set(xlabel="standardised residual", ylabel="density")
        spread.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
        return figure

    def camera(self, camera: str = "") -> Figure:
        """Draw the distortion of a camera over its format, and over the distance from the principal point.

        Parameters
        ----------
        camera
            Name of the camera; may be left out where there is one only.

        Returns
        -------
        matplotlib.figure.Figure
            By how much the lens displaces places of the format, and the radial part of it over the distance
            from the principal point (cross).

        Raises
        ------
        ConfigurationError
            For a camera that is not in the result.
        """
        shown = self._result.camera(camera)
        figure = _figure()
        over, along = figure.subplots(1, 2, width_ratios=(3, 2))
        plane, moved = displacement(shown)
        pixel = plane_to_pixel(shown.size_px, shown.pitch, plane)
        to_px = np.array([1.0, -1.0]) / np.array(shown.pitch)
        u, v = (moved * to_px).T
        largest = float(np.nanmax(np.hypot(u, v), initial=1e-12))
        scale = largest / (_SHARE * shown.size_px[0])
        arrows = over.quiver(*pixel.T, u, v, angles="xy", scale_units="xy", scale=scale, width=0.003)
        over.quiverkey(arrows, 0.75, 1.04, largest, f"{largest:.3g} px", labelpos="E")
        centre = np.array([shown.value("x0"), shown.value("y0")])
        over.plot(*plane_to_pixel(shown.size_px, shown.pitch, centre), "+", color="tab:red", ms=9)
        over.set(xlabel="column, px", ylabel="row, px")
        over.set_aspect("equal")
        over.invert_yaxis()
        from_centre = plane - centre
        radius = np.linalg.norm(from_centre, axis=1)
        radial = (moved * from_centre).sum(axis=1) / np.maximum(radius, 1e-12)
        along.plot(radius / shown.pitch[0], radial / shown.pitch[0], ".", color="0.3", ms=3)
        along.set(xlabel="radial distance, px", ylabel="radial distortion, px")
        along.grid(visible=True, color="0.9")
        return figure

    def block(self) -> Figure:
        """Draw images and points from above.

        Returns
        -------
        matplotlib.figure.Figure
            Projection centres and points by their roles, with errors of the check points as arrows.
        """
        result = self._result
        figure = _figure(high=5.0)
        ax = figure.subplots()
        points = result.points
        role = np.array(points.role)
        for name, (mark, colour) in reversed(_MARKS.items()):
            of_role = role == name
            if of_role.any():
                size = 2 if name == "tie" else 6
                label = f"{name} points: {int(of_role.sum())}"
                ax.plot(*points.values[of_role, :2].T, mark, color=colour, ms=size, ls="", label=label)
        stations = result.images.station
        ax.plot(*stations[:, :2].T, "x", color="tab:blue", ms=5, label=f"images: {len(stations)}")
        if result.checks.points:
            _check_errors(result, ax)
        ax.set(xlabel="X, m", ylabel="Y, m")
        ax.set_aspect("equal", adjustable="datalim")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
        return figure


def _figure(high: float = _HIGH_IN) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as missing:
        raise ProgramMissingError("matplotlib is not installed", "run: pip install matplotlib") from missing
    return Figure(figsize=(_WIDE_IN, high), dpi=150, layout="constrained")


def displacement(camera: Camera) -> tuple[Any, Any]:
    """Places of the format in the image plane, and by how much the lens displaces their rays."""
    width, height = camera.size_px
    half = np.array([width, height]) / 2 * np.array(camera.pitch)
    x, y = np.meshgrid(np.linspace(-half[0], half[0], 17), np.linspace(-half[1], half[1], 13))
    plane = np.column_stack([x.ravel(), y.ravel()])
    ideal = undistorted(camera, plane)
    return plane, plane - np.array([camera.value("x0"), camera.value("y0")]) - ideal


def _check_errors(result: Any, ax: Any) -> None:
    number = {name: k for k, name in enumerate(result.points.names)}
    checked = [point for point in result.checks.points if point.point in number]
    at = result.points.values[[number[point.point] for point in checked]]
    errors = np.array([[point.dx, point.dy] for point in checked])
    largest = float(np.hypot(*errors.T).max(initial=1e-12))
    width = max(float(np.ptp(result.points.values[:, 0])), 1e-9)
    arrows = ax.quiver(*at[:, :2].T, *errors.T, angles="xy", scale_units="xy",
                       scale=largest / (_SHARE * width), width=0.003, color="tab:green")  # fmt: skip
    ax.quiverkey(arrows, 0.9, -0.12, largest, f"check points: {1e3 * largest:.1f} mm", labelpos="W")
