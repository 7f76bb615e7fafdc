"""Products sampled at check points: the published statistics of two orthomosaics, from rendered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from numpy.typing import NDArray

from photocal.analysis.accuracy.assessment import assess
from photocal.analysis.accuracy.standard import Question, load_standard
from photocal.base.errors import ConfigurationError
from photocal.block.model import ObjectPoints
from photocal.products.options import ProductOptions
from photocal.products.product_check import check_products, read_check_points
from photocal.products.raster import system_wkt, write_terrain
from photocal.products.terrain import Terrain

Floats = NDArray[np.float64]

CELL, DIAMETER = 0.25, 0.75
# Mean and standard deviation of the corrections, reference minus product, E, N, h, m (ixus220, Table 5).
PUBLISHED = {
    "no_gcp": ((2.22, 0.56), (2.16, 0.50), (2.83, 1.70)),
    "gcp_8": ((-0.04, 0.20), (0.02, 0.26), (-0.27, 0.28)),
}


def with_moments(random: np.random.Generator, moments: tuple[tuple[float, float], ...]) -> Floats:
    """Thirty discrepancies with exactly these means and standard deviations."""
    drawn = random.uniform(-1, 1, (30, 3))
    drawn = (drawn - drawn.mean(axis=0)) / drawn.std(axis=0, ddof=1)
    return np.asarray(drawn * [s for _, s in moments] + [m for m, _ in moments])


@dataclass(frozen=True)
class Products:
    points: ObjectPoints
    ortho: Path
    dtm: Path
    exact: Floats


def render(folder: Path, name: str) -> Products:
    random = np.random.default_rng(2015)
    exact = with_moments(random, PUBLISHED[name])
    grid = np.array([(i, j) for i in range(6) for j in range(5)], dtype=float)
    enh = np.column_stack(
        [500000 + 20 + 30 * grid + random.uniform(0, 3, (30, 2)), random.uniform(500, 520, 30)]
    )
    enh[:, 1] += 8_230_000 - 500_000
    west, north, side = 500000.0, 8_230_000 + 200.0, 800
    product = enh - exact
    fine = 4
    image = random.normal(90, 3, (side, side))
    for east, northing, _ in product:
        j, i = int((east - west) / CELL) - 6, int((north - northing) / CELL) - 6
        axis = (np.arange(13 * fine) + 0.5) / fine * CELL
        x, y = west + j * CELL + axis, north - i * CELL - axis
        disc = np.hypot(x - east, (y - northing)[:, None]) <= DIAMETER / 2
        share = disc.reshape(13, fine, 13, fine).mean(axis=(1, 3))
        image[i : i + 13, j : j + 13] += share * 140
    pixels = np.clip(np.round(image), 1, 255).astype(np.uint8)
    crs = system_wkt("EPSG:31982")
    with rasterio.open(
        folder / "ortho.tif", "w", driver="GTiff", width=side, height=side, count=3, dtype="uint8",
        transform=rasterio.Affine(CELL, 0, west, 0, -CELL, north), crs=crs, nodata=0,
    ) as target:  # fmt: skip
        target.write(np.stack([pixels] * 3))
    # Level ground of 10 m around each point has the height that the product is to say.
    cells = np.zeros((100, 100))
    for (east, northing, _), h in zip(enh, product[:, 2], strict=True):
        j, i = int((east - west) / 2), int((north - northing) / 2)
        cells[i - 2 : i + 3, j - 2 : j + 3] = h
    write_terrain(Terrain(cells, (2.0, 0, west, 0, -2.0, north), crs, "ellipsoidal"), folder / "dtm.tif")
    names = tuple(f"{n + 1:02d}" for n in range(30))
    return Products(ObjectPoints(names, enh), folder / "ortho.tif", folder / "dtm.tif", exact)


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_statistics_from_sampled_products(name: str, tmp_path: Path) -> None:
    products = render(tmp_path, name)
    found = check_products(
        products.points,
        ProductOptions(
            ortho=products.ortho,
            target_diameter=DIAMETER,
            search_radius=6.0,
            dtm=products.dtm,
            height_kind="ellipsoidal",
        ),
    )
    assert found.remarks == ()
    assert (found.likeness > 0.8).all()
    # A tenth of a cell in position; heights are stored with 7 digits.
    assert np.abs(found.discrepancies.correction_m - products.exact)[:, :2].max() < 0.1 * CELL
    assert found.discrepancies.correction_m[:, 2] == pytest.approx(products.exact[:, 2], abs=1e-4)
    result = assess(found.discrepancies, (load_standard("decree-89817"),), Question(1125.0, 1.0))
    for component, (mean, deviation) in zip(result.components, PUBLISHED[name], strict=True):
        assert -component.moments.mean_m == pytest.approx(mean, abs=0.005)
        assert component.moments.std_m == pytest.approx(deviation, abs=0.005)
        # The published verdict: all of no_gcp is biased, of gcp_8 the height alone.
        assert component.bias is not None
        assert component.bias.significant == (name == "no_gcp" or component.name == "h")
    classes = [table.precision_class for table in result.tables]
    assert classes == ([None, None] if name == "no_gcp" else ["A", "A"])


def test_what_a_product_does_not_show_is_said(tmp_path: Path) -> None:
    products = render(tmp_path, "gcp_8")
    enh = products.points.values.copy()
    enh[3, :2] += 12.0
    enh[7, :2] += 5000.0
    found = check_products(
        ObjectPoints(products.points.names, enh),
        ProductOptions(
            ortho=products.ortho,
            target_diameter=DIAMETER,
            search_radius=3.0,
            dtm=products.dtm,
            height_kind="ellipsoidal",
        ),
    )
    assert [remark.split(":")[0] for remark in found.remarks] == ["point 04", "point 08", "point 08"]
    assert np.isnan(found.discrepancies.d_m[[3, 7], 0]).all()
    assert np.isfinite(np.delete(found.discrepancies.d_m, [3, 7], axis=0)).all()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda _: {}, "no product"),
        (lambda p: {"ortho": p.ortho}, "size"),
        (
            lambda p: {"ortho": p.ortho, "target_diameter": 0.3, "search_radius": 2.0},
            "smaller than two cells",
        ),
        (lambda p: {"dtm": p.dtm}, "not stated"),
        (lambda p: {"dtm": p.dtm, "height_kind": "orthometric"}, "has ellipsoidal heights"),
        (lambda p: {"dtm": p.dtm, "height_kind": "local", "dtm_height_kind": "local"}, "not local ones"),
    ],
)
def test_complaints(change: Callable[[Products], dict[str, object]], complaint: str, tmp_path: Path) -> None:
    products = render(tmp_path, "gcp_8")
    with pytest.raises(ConfigurationError, match=complaint):
        check_products(products.points, ProductOptions(**change(products)))  # type: ignore[arg-type]


def test_check_points_are_read(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("point,E,N,h\na,1,2,3\nb,4,5,\n", encoding="utf-8")
    found = read_check_points(path)
    assert found.names == ("a", "b")
    assert found.values[0].tolist() == [1, 2, 3]
    assert np.isnan(found.values[1, 2])
