"""Positions and rotations of images that an adjustment oriented, to hold exposures against them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import measure_ties
from photocal.measurement.oriented_ties import Progress

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OrientedImages:
    """Images in the frame of a block, any Cartesian one.

    Parameters
    ----------
    place : float64 (n, 3)
        X, Y, Z, m; NaN for images that the block does not have.
    rotation : float64 (n, 3, 3)
        From the block's axes to camera axes; NaN where it is not known.
    """

    place: Floats
    rotation: Floats


def oriented_images(folder: Path, images: list[str]) -> OrientedImages:
    """Read images of a run or block folder."""
    path = folder / "images.csv" if folder.is_dir() else folder
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError) as refusal:
        raise InputNotFoundError(
            "cannot be read", where=path, remedy="name the run folder of the adjustment"
        ) from refusal
    found = {}
    for number, row in enumerate(rows, 2):
        try:
            place = [float(row[axis]) for axis in "XYZ"]
            angles = [float(row.get(name) or "nan") for name in ("omega", "phi", "kappa")]
            found[row["image"]] = [*place, *angles]
        except (KeyError, TypeError, ValueError) as damage:
            raise InputMalformedError(
                "has no position of an image", where=f"{path}, line {number}", remedy="give image,X,Y,Z"
            ) from damage
    return _in_order(found, images)


def oriented_by_ties(
    paths: list[Path], images: list[str], plan: MatchingPlan, progress: Progress
) -> OrientedImages:
    """Orient images by tie points, see `photocal.measurement.measure_ties`."""
    made = measure_ties(paths, "images", plan, progress).block.images
    rows = zip(made.names, made.values.tolist(), strict=True)
    found = {name: [*row[3:6], *np.degrees(row[:3]).tolist()] for name, row in rows}
    return _in_order(found, images)


def _in_order(found: dict[str, list[float]], images: list[str]) -> OrientedImages:
    """Return images of which X, Y, Z and omega, phi, kappa (deg) are known by name."""
    unknown = [np.nan] * 6
    table = np.array([found.get(name.split(" ")[0], unknown) for name in images]).reshape(-1, 6)
    return OrientedImages(table[:, :3], matrix_from_angles(np.radians(table[:, 3:])))
