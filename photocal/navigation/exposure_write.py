"""Everything that `photocal exposures` leaves in its folder."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from photocal.navigation.exposure_files import (
    with_images,
    write_block_images,
    write_exposures,
    write_geo_txt,
    write_geopackage_of,
)
from photocal.navigation.exposure_plot import plot_exposures
from photocal.navigation.exposure_run import ExposureRun
from photocal.navigation.exposure_sources import ELLIPSOIDAL
from photocal.navigation.rig import Rig


def write_run(folder: Path, run: ExposureRun, rig: Rig, camera: str, crs: str | None) -> dict[str, Any]:
    """Write tables, GeoPackage and plot; return the figures with the frame of `images.csv`.

    rig: camera axes and boresight.
    crs: system of `images.csv`; without: local.

    Raises
    ------
    ConfigurationError
        When the kind of the heights does not allow that system.
    """
    figures = dict(run.figures)
    write_exposures(folder / "exposures.csv", run.exposures)
    if len(with_images(run.exposures)):
        if crs is not None and run.exposures.height_kind != ELLIPSOIDAL:
            raise ConfigurationError(
                f"heights are {run.exposures.height_kind}: they cannot be taken to {crs}",
                where="--crs",
                remedy="leave out --crs",
            )
        figures["images_csv"] = write_block_images(folder / "images.csv", run.exposures, camera, rig, crs)
        write_geo_txt(folder / "geo.txt", run.exposures, rig)
        changed = dt.datetime.now(dt.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        write_geopackage_of(folder / "exposures.gpkg", run.exposures, rig, camera, changed)
    plot_exposures(run, folder / "exposures.png")
    return figures
