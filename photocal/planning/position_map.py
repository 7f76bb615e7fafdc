"""Observed minus adjusted camera positions, exposure by exposure: a table, a map for QGIS and a picture."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.mounting import SHIFT, Mounting, Positions, antennas, body_to_camera
from photocal.analysis.accuracy.maps import round_down
from photocal.base.arrays import Floats
from photocal.base.files import output_folder, output_picture, write_rows
from photocal.base.geopackage import Layer, ReferenceSystem, add_layer, geopackage
from photocal.geometry.oriented_images import OrientedImages

_NUMBERS = ("dX_m", "dY_m", "dZ_m")
_LAYER = Layer(
    "positions",
    "POINT",
    has_heights=False,
    columns={"name": "TEXT", **dict.fromkeys(_NUMBERS, "DOUBLE")},
)


@dataclass(frozen=True)
class PositionDifferences:
    """Observed minus adjusted projection centres.

    names (n), station, d_m (n, 3): in the local frame, m.
    """

    names: tuple[str, ...]
    station: Floats
    d_m: Floats

    def figures(self) -> dict[str, Any]:
        """Give mean, standard deviation and largest difference by axis, m."""
        largest = self.d_m[np.abs(self.d_m).argmax(axis=0), range(3)]
        spread = self.d_m.std(axis=0, ddof=1) if len(self.d_m) > 1 else np.full(3, np.nan)
        return {
            "exposures": len(self.names),
            "mean_m": self.d_m.mean(axis=0).tolist(),
            "std_m": spread.tolist(),
            "largest_m": largest.tolist(),
        }


def position_differences(
    images: OrientedImages, positions: Positions, mounting: Mounting, common: Floats
) -> PositionDifferences | None:
    """Reduce observed antenna positions to the camera and compare them with the adjusted centres.

    images: adjusted, in the local frame; positions: in the same frame.
    common: adjusted lever arm, boresight and time offset; what flight and strips have in common stays in the
        differences.
    """
    if not len(positions.image):
        return None
    of_rig = np.where(np.arange(len(common)) < SHIFT.start, common, 0.0)
    matrix = body_to_camera(mounting, of_rig)
    antenna = antennas(positions, matrix, of_rig, images.rotation, images.station)
    names = tuple(images.names[k] for k in positions.image)
    return PositionDifferences(names, images.station[positions.image], positions.values - antenna)


def write_positions(
    folder: Path,
    made: PositionDifferences,
    to_given: Callable[[Floats], Floats],
    system: ReferenceSystem,
    changed_utc: str,
) -> None:
    """Write positions.csv and positions.gpkg; raises OutputError."""
    rows = list(zip(made.names, made.d_m.tolist(), strict=True))
    with output_folder(folder) as aside:
        cells = [[name, *(f"{value:.4f}" for value in d)] for name, d in rows]
        write_rows(aside / "positions.csv", ["image", *_NUMBERS], cells)
        with geopackage(aside / "positions.gpkg", system) as database:
            places = to_given(made.station)[:, :2]
            features = [(place[None], [name, *d]) for place, (name, d) in zip(places, rows, strict=True)]
            add_layer(database, _LAYER, system, features, changed_utc)


def draw_positions(made: PositionDifferences, path: Path) -> None:
    """Draw the plane part as enlarged vectors and the height as colour."""
    with output_picture(path, (6.5, 5.0)) as figure:
        axes = figure.add_subplot()
        x, y = made.station[:, 0], made.station[:, 1]
        plane = np.linalg.norm(made.d_m[:, :2], axis=1)
        width = max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
        # The longest vector of the picture is this share of its width.
        share = 0.08
        longest = max(float(plane.max()), 1e-9)
        times = share * width / longest
        high = max(float(np.abs(made.d_m[:, 2]).max()), 1e-9)
        drawn = axes.scatter(
            x,
            y,
            c=made.d_m[:, 2],
            cmap="RdBu_r",
            vmin=-high,
            vmax=high,
            s=18,
            edgecolors="0.4",
            linewidths=0.4,
        )
        arrows = axes.quiver(
            x, y, *made.d_m[:, :2].T, angles="xy", scale_units="xy", scale=1.0 / times, width=0.003
        )
        unit = round_down(longest)
        axes.quiverkey(arrows, 0.88, 1.03, unit, f"{unit:g} m", labelpos="E", coordinates="axes")
        figure.colorbar(drawn, ax=axes, label="height, observed minus adjusted, m")
        axes.set_title("camera positions, observed minus adjusted", loc="left", fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("m")
        axes.set_ylabel("m")
