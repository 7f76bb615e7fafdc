"""Where an orthophoto puts things when its interior orientation is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.outputs import output_file
from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.geometry.frames import Frame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import look_up
from photocal.products.oriented import lens_tables
from photocal.products.terrain import Terrain

_PASSES = 100
_CLOSE_M = 1e-5


def image_points(shots: OrientedImages, number: int, local: Floats) -> Floats:
    """Project points into one image."""
    return shots.project(np.full(len(local), number), local)


def terrain_points(
    shots: OrientedImages, number: int, pixel: Floats, terrain: Terrain, frame: Frame
) -> Floats:
    """Intersect the rays of image points with the terrain."""
    image = np.full(len(pixel), number)
    ideal, c = shots.ideal(image, pixel)
    rotation, station = shots.at_lines(image, pixel)
    rays = np.einsum("ni,nij->nj", np.column_stack([ideal, -c]), rotation)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    height = float(np.nanmean(terrain.heights))
    above = frame.to_given(shots.station[number : number + 1])[0, 2] - height
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(rays[:, 2] < 0, -above / rays[:, 2], np.nan)
    for _ in range(_PASSES):
        given = frame.to_given(station + along[:, None] * rays)
        gap = given[:, 2] - terrain.at(given[:, 0], given[:, 1])
        step = -gap / rays[:, 2]
        along = along + step
        if not np.any(np.abs(step) > _CLOSE_M):
            break
    given = frame.to_given(station + along[:, None] * rays)
    gap = given[:, 2] - terrain.at(given[:, 0], given[:, 1])
    given[~(np.abs(gap) < 100 * _CLOSE_M)] = np.nan
    return given


@dataclass(frozen=True)
class Displacement:
    """How far apart two orthophotos of the same images put the same thing.

    position (n, 3): where the first one has it, m.
    shift (n, 2): second minus first, east and north, m.
    """

    position: Floats
    shift: Floats

    @property
    def rms(self) -> float:
        """Root mean square of the length of the shifts, m."""
        return float(np.sqrt(np.mean((self.shift**2).sum(axis=1))))

    @property
    def largest(self) -> float:
        """Length of the largest shift, m."""
        return float(np.sqrt((self.shift**2).sum(axis=1).max()))


def displacement(
    right: OrientedImages, wrong: OrientedImages, terrain: Terrain, frame: Frame, x: Floats, y: Floats
) -> Displacement:
    """Follow ground points through the right image geometry and back through the wrong one."""
    if right.names != wrong.names:
        raise ConfigurationError("the two orientations have different images", remedy="use one block")
    given = np.column_stack([x, y, terrain.at(x, y)])
    given = given[np.isfinite(given[:, 2])]
    local = frame.to_local(given)
    lenses = lens_tables(right.cameras)
    place, chosen = np.full((2, len(local)), np.nan), np.full(len(local), -1, dtype=np.int64)
    every = np.arange(len(right.names), dtype=np.int64)
    look_up(local, lenses.values, lenses.optics, lenses.limit, lenses.pitch, lenses.size, right.camera,
            right.rotation, right.station, right.movements, every, place[0], place[1], chosen)  # fmt: skip
    shift = np.full((len(local), 2), np.nan)
    for number in np.unique(chosen[chosen >= 0]):
        mine = chosen == number
        found = terrain_points(wrong, int(number), place[:, mine].T, terrain, frame)
        shift[mine] = found[:, :2] - given[mine, :2]
    seen = np.isfinite(shift).all(axis=1)
    if not seen.any():
        raise ConfigurationError("no image shows the terrain", remedy="do block and terrain share a system?")
    return Displacement(given[seen], shift[seen])


def draw_displacement(field: Displacement, title: str, path: Path) -> None:
    """Draw the shifts as arrows on a map; their scale is beside the map's own.

    raises ConfigurationError: for another ending.
    raises OutputError: when it cannot be written.
    """
    kind = path.suffix.lower()[1:]
    stamps = {"png": None, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    if kind not in stamps:
        raise ConfigurationError(f"{path} has no known ending", remedy="use .pdf, .svg or .png")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "photocal", "svg.fonttype": "path", "font.size": 8}):
        x, y = field.position[:, 0], field.position[:, 1]
        length = np.hypot(*field.shift.T)
        extent = max(float(np.ptp(x)), float(np.ptp(y)), 1e-9)
        # As high as the map is, beside its colours and below its title.
        high = 5.0 * float(np.ptp(y)) / max(float(np.ptp(x)), 1e-9)
        figure = Figure(figsize=(6.7, min(max(high, 1.8), 8.0) + 1.2), layout="constrained")
        ax = figure.add_subplot()
        scale = max(field.largest, 1e-12) / (0.06 * extent)
        arrows = ax.quiver(x, y, field.shift[:, 0], field.shift[:, 1], length, angles="xy", scale=scale,
                           scale_units="xy", width=0.002, cmap="viridis")  # fmt: skip
        figure.colorbar(arrows, ax=ax, label="displacement, m")
        ax.margins(0.08)
        ax.quiverkey(arrows, 0.1, 1.02, field.largest, f"{field.largest:.3g} m", labelpos="E")
        ax.set_aspect("equal")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.set_xlabel("E, m")
        ax.set_ylabel("N, m")
        ax.set_title(f"{title}: rms {field.rms:.3g} m, largest {field.largest:.3g} m", fontsize=9, pad=22)
        with output_file(path) as aside:
            figure.savefig(aside, format=kind, metadata=stamps[kind], dpi=200)
