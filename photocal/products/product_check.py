"""Check points against an orthomosaic and a terrain model: what the products say at surveyed places."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.analysis.accuracy.discrepancies import Discrepancies
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy
from photocal.base.text_tables import read_table
from photocal.block.model import ObjectPoints
from photocal.products.options import ProductOptions
from photocal.products.raster import RasterFile, describe, opened, terrain_source


@dataclass(frozen=True)
class ProductCheck:
    """What products say at check points.

    discrepancies: product minus reference: of the target in the orthomosaic, of the height at the surveyed
        place in the terrain model; NaN where a product says nothing.
    likeness (n,): how well the target was recognised, 0 to 1; NaN without orthomosaic.
    remarks: one for each point that a product does not show.
    """

    discrepancies: Discrepancies
    likeness: Floats
    remarks: tuple[str, ...]


def read_check_points(path: Path) -> ObjectPoints:
    """Read surveyed check points.

    path: CSV with point, E, N and optional h, in m and in the reference system of the products.
    raises InputNotFoundError, InputMalformedError: when it is no such table.
    """
    table = read_table(path, ("point", "E", "N"), ("h",))
    columns = [table.numbers("E"), table.numbers("N"), table.numbers("h", empty=np.nan)]
    return ObjectPoints(table.unique_names("point"), np.column_stack(columns))


def check_products(points: ObjectPoints, options: ProductOptions) -> ProductCheck:
    """Find the targets of check points in an orthomosaic and sample a terrain model there.

    The height of the model is taken at the surveyed place (bilinear), so that an error in position does not
    count twice.

    Parameters
    ----------
    points
        Surveyed check points, m, in the reference system of the products.
    options
        Orthomosaic with round targets, lighter or darker than their surroundings, their diameter and how far
        they are looked for, m; terrain model; kinds of both heights.

    Returns
    -------
    ProductCheck
        Product minus reference, m, with remarks on points that a product does not show.

    Raises
    ------
    InputNotFoundError, InputMalformedError
        For products that cannot be read.
    ConfigurationError
        For missing or contradicting settings.
    """
    ortho, dtm = options.ortho, options.dtm
    diameter, search = options.target_diameter, options.search_radius
    if ortho is None and dtm is None:
        raise ConfigurationError("no product is given", "name an orthomosaic or a terrain model")
    product, likeness = np.full((len(points.names), 3), np.nan), np.full(len(points.names), np.nan)
    remarks: list[str] = []
    if ortho is not None:
        if not (diameter and diameter > 0 and search > 0):
            raise ConfigurationError(
                "the size of the targets is not given", "give target diameter and search distance, m"
            )
        raster = describe(ortho)
        _require_square(raster, diameter)
        for row, (name, place) in enumerate(zip(points.names, points.values, strict=True)):
            target = find_target(raster, place[:2], diameter, search)
            product[row, :2], likeness[row] = target[:2], target[2]
            if not np.isfinite(target[0]):
                remarks.append(f"point {name}: no target within {search:g} m in {ortho.name}")
    if dtm is not None:
        heights = _heights(dtm, points, options.height_kind, options.dtm_height_kind)
        product[:, 2] = heights
        remarks += [
            f"point {name}: no height in {dtm.name}"
            for name, height in zip(points.names, heights, strict=True)
            if not np.isfinite(height)
        ]
    discrepancies = Discrepancies(points.names, product - points.values, points.values.copy())
    return ProductCheck(discrepancies, likeness, tuple(remarks))


def _require_square(raster: RasterFile, diameter: float) -> None:
    a, b, _, d, e, _ = raster.transform
    wrong = ConfigurationError.at(raster.path)
    if b != 0 or d != 0 or abs(abs(a) - abs(e)) > 1e-6 * abs(a) or a <= 0 or e >= 0:
        raise wrong("is not north up with square cells", "resample it to a north-up grid")
    if diameter < 2 * a:
        raise wrong(f"a target of {diameter:g} m is smaller than two cells of {a:g} m")


def _heights(dtm: Path, points: ObjectPoints, kind: str | None, stated: str | None) -> Floats:
    raster = describe(dtm)
    model = raster.stated_heights(stated)
    wrong = ConfigurationError.at(dtm)
    if not kind:
        raise wrong(
            "the height kind of the check points is not stated",
            "name it: ellipsoidal, orthometric or local",
        )
    if model != kind:
        raise wrong(
            f"has {model} heights, the check points {kind} ones", "convert one of them with its geoid"
        )
    source = terrain_source(raster, model)
    return np.array(
        [float(source((e, n, e, n)).at(np.array([e]), np.array([n]))[0]) for e, n in points.values[:, :2]]
    )


def find_target(raster: RasterFile, place: Floats, diameter: float, search: float) -> Floats:
    """Find a round target near a place in a raster."""
    import cv2

    cell = raster.transform[0]
    radius = diameter / 2 / cell
    margin = int(np.ceil(radius)) + 2
    half = int(np.ceil(search / cell)) + margin
    column = (place[0] - raster.transform[2]) / cell - 0.5
    row = (raster.transform[5] - place[1]) / cell - 0.5
    j, i = round(float(column)), round(float(row))
    grey = _window(raster, j - half, i - half, 2 * half + 1)
    if grey is None:
        return np.full(3, np.nan)
    template = _disc(radius, margin)
    likeness = np.abs(cv2.matchTemplate(grey, template, cv2.TM_CCOEFF_NORMED))
    # Flat surroundings have no correlation; OpenCV may say anything there.
    likeness[~np.isfinite(likeness) | (likeness > 1.0001)] = 0
    v, u = np.unravel_index(int(np.argmax(likeness)), likeness.shape)
    best = float(likeness[v, u])
    # Share of the pattern of a round target that must be found again, 0 to 1.
    least_likeness = 0.6
    if best < least_likeness:
        return np.array([np.nan, np.nan, best])
    x, y = _gravity(grey[v : v + len(template), u : u + len(template)], radius)
    east = raster.transform[2] + (j - half + int(u) + x + 0.5) * cell
    north = raster.transform[5] - (i - half + int(v) + y + 0.5) * cell
    if np.hypot(east - place[0], north - place[1]) > search:
        return np.array([np.nan, np.nan, best])
    return np.array([east, north, best])


def _window(raster: RasterFile, column: int, row: int, side: int) -> NDArray[np.float32] | None:
    """Mean of the bands; None when the window leaves the raster or has no data."""
    import rasterio.windows  # type: ignore[import-untyped]

    if column < 0 or row < 0 or column + side > raster.columns or row + side > raster.rows:
        return None
    with opened(raster.path) as source:
        bands: Any = source.read(window=rasterio.windows.Window(column, row, side, side), masked=True)
    # An alpha band holds no grey levels.
    colours = bands[:3] if len(bands) >= 3 else bands[:1]
    if np.ma.getmaskarray(colours).any():
        return None
    return np.asarray(colours.mean(axis=0), dtype=np.float32)


def _disc(radius: float, margin: int) -> NDArray[np.float32]:
    """Share of each cell that a disc covers."""
    fine = 8
    side = (2 * margin + 1) * fine
    axis = (np.arange(side) + 0.5) / fine - 0.5 - margin
    inside = (axis[:, None] ** 2 + axis**2 <= radius**2).astype(np.float32)
    cells = inside.reshape(2 * margin + 1, fine, 2 * margin + 1, fine)
    return np.asarray(cells.mean(axis=(1, 3)), dtype=np.float32)


def _gravity(grey: NDArray[np.float32], radius: float) -> tuple[float, float]:
    """Centre of gravity of a target in its window, in cells."""
    side = len(grey)
    index = np.arange(side)
    x = y = (side - 1) / 2
    away = np.hypot(index[:, None] - y, index - x)
    outside = np.asarray(grey, dtype=np.float64)[away > radius + 1.2]
    around = float(np.median(outside))
    weight = np.abs(grey - around)
    # What the surroundings do by themselves would pull towards the middle of the window.
    weight[weight < 3 * policy.mad_to_sigma * np.median(np.abs(outside - around))] = 0
    for _ in range(5):
        near = weight * (np.hypot(index[:, None] - y, index - x) <= radius + 1.5)
        total = near.sum()
        x, y = float(near.sum(axis=0) @ index / total), float(near.sum(axis=1) @ index / total)
    return x, y
