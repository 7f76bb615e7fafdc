"""Readings of a machine: over fiducial marks into image coordinates, repeated ones into their mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.block.model import FiducialFit, Images, Observations, Repetition
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


def mean_of_readings(
    readings: Observations, limit: float, path: Path, images: tuple[str, ...], points: tuple[str, ...]
) -> tuple[Observations, Repetition]:
    """Take the mean of repeated readings of a point in an image, each with the same weight.

    A reading that is farther than the limit from the median of its group, in x or y, is rejected. The stated
    standard deviation is that of one reading: the mean of n has it by the root of n.

    raises InputMalformedError: when no two readings of a point agree, so that none can stay.
    """
    pair = readings.image * len(points) + readings.point
    order = np.argsort(pair, kind="stable")
    _, first, count = np.unique(pair[order], return_index=True, return_counts=True)
    group = np.repeat(np.arange(len(first)), count)
    values = readings.values[order]
    middle = np.array([np.median(values[a : a + n], axis=0) for a, n in zip(first, count, strict=True)])
    kept = (np.abs(values - middle[group]) <= limit).all(axis=1)
    stays = np.bincount(group[kept], minlength=len(first))
    if (stays == 0).any():
        worst = order[first[int(np.argmin(stays))]]
        point, image = points[readings.point[worst]], images[readings.image[worst]]
        raise InputMalformedError(
            f"the readings of point {point} in image {image} lie more than {limit:g} {readings.unit} apart",
            where=path,
            remedy="read the point again, or give a wider rejection_limit in [observations]",
        )
    group, values, variance = group[kept], values[kept], readings.sigma[order][kept] ** 2
    sums = np.zeros((len(first), 4))
    np.add.at(sums, group, np.hstack([values, variance]))
    mean, variance = np.hsplit(sums / stays[:, None], 2)
    redundancy = int((stays - 1).sum())
    x, y = np.sqrt(((values - mean[group]) ** 2).sum(axis=0) / max(redundancy, 1)).tolist()
    spread = (x, y) if redundancy else None
    counts = len(kept), int((~kept).sum()), limit, spread, int(stays.min()), int(stays.max())
    chosen = order[first]
    of_mean = np.sqrt(variance / stays[:, None])
    means = replace(
        readings, image=readings.image[chosen], point=readings.point[chosen], values=mean, sigma=of_mean
    )
    return means, Repetition(*counts)
