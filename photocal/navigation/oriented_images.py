"""Positions of images that an adjustment oriented, to hold exposures against them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError, InputNotFoundError


def oriented_positions(folder: Path, images: list[str]) -> NDArray[np.float64]:
    """Return X, Y, Z of images in a run or block folder, m (n, 3); NaN for those that it does not have.

    Parameters
    ----------
    folder : Path
        With `images.csv`.
    images : list of str (n,)
        Names; of several cameras' ones the first counts.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        When the table cannot be read or has a cell that is no number.
    """
    path = folder / "images.csv" if folder.is_dir() else folder
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError) as refusal:
        raise InputNotFoundError(
            "cannot be read", where=path, remedy="name the run folder of the adjustment"
        ) from refusal
    place = {}
    for number, row in enumerate(rows, 2):
        try:
            place[row["image"]] = [float(row[axis]) for axis in "XYZ"]
        except (KeyError, TypeError, ValueError) as damage:
            raise InputMalformedError(
                "has no position of an image", where=f"{path}, line {number}", remedy="give image,X,Y,Z"
            ) from damage
    unknown = [np.nan] * 3
    return np.array([place.get(name.split(" ")[0], unknown) for name in images]).reshape(-1, 3)
