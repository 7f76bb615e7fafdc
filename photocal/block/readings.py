"""Machine or pixel readings turned into image coordinates over fiducial marks or frame corners."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.errors import ConfigurationError, IllPosedError
from photocal.block.model import FiducialFit, Images, Observations
from photocal.block.table import known_rows, read_table, refuse
from photocal.geometry.camera import Camera
from photocal.geometry.interior import Transformation, interior_orientation

MARKS, READINGS = "fiducials.csv", "fiducial_readings.csv"


def from_readings(
    folder: Path,
    transformation: Transformation,
    cameras: tuple[Camera, ...],
    images: Images,
    observations: Observations,
) -> tuple[Observations, tuple[FiducialFit, ...]]:
    """Turn the readings of every image into image coordinates."""
    if (observations.unit, observations.axes) != ("mm", "photo"):
        raise ConfigurationError(
            "readings become image coordinates in mm, x right and y up",
            where=folder / "block.toml",
            remedy='give unit = "mm" and axes = "photo" beside readings',
        )
    marks = read_table(folder / MARKS, ("camera", "fiducial", "x", "y"))
    camera = known_rows(marks, "camera", tuple(own.id for own in cameras), "block.toml")
    index, found = marks.names("fiducial")
    names = np.array(found)[index]
    known = np.column_stack([marks.numbers("x"), marks.numbers("y")])
    place = {(int(k), str(name)): row for row, (k, name) in enumerate(zip(camera, names, strict=True))}
    table = read_table(folder / READINGS, ("image", "fiducial", "x", "y"))
    image = known_rows(table, "image", images.names, "images.csv")
    index, found = table.names("fiducial")
    read = np.array(found)[index]
    rows = [place.get((int(images.camera[i]), str(name)), -1) for i, name in zip(image, read, strict=True)]
    mark = np.array(rows, dtype=np.int64)
    refuse(table, mark < 0, "the camera has no such fiducial", f"correct it, or add it to {MARKS}")
    values = np.column_stack([table.numbers("x"), table.numbers("y")])
    plane, fits = observations.values.copy(), []
    for i, name in enumerate(images.names):
        own, seen = image == i, observations.image == i
        if not seen.any() and not own.any():
            continue
        try:
            fit = interior_orientation(values[own], known[mark[own]], transformation, tuple(read[own]))
        except IllPosedError as refusal:
            raise IllPosedError(
                refusal.what, where=f"{folder / READINGS}, image {name}", remedy=refusal.remedy
            ) from refusal
        plane[seen] = fit.applied(observations.values[seen])
        fits.append(FiducialFit(name, tuple(map(str, read[own])), fit.residuals, fit.redundancy, fit.sigma0))
    return replace(observations, values=plane), tuple(fits)
