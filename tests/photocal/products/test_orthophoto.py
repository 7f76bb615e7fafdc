"""Orthophotos: against OpenCV's remapping, exact geometry, every lens model, seams, files and complaints."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from numpy.typing import NDArray

from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.results.folder import write_result
from photocal.block.results.result import (
    AdjustedPoints,
    BlockFacts,
    CheckSummary,
    Residuals,
    Result,
    Software,
)
from photocal.geometry.camera import Camera, Model, camera
from photocal.geometry.frames import ShiftedFrame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import BILINEAR, CUBIC, NEAREST
from photocal.products.oriented import ideal_limit
from photocal.products.ortho_job import displacement, terrain_points
from photocal.products.orthophoto import ImageStore, Recipe, orthophoto
from photocal.products.terrain import Grid, Terrain, ground_points
from tests.photocal.products.photo import Lens, Photo

Floats = NDArray[np.float64]

SIZE, PITCH = (400, 300), (0.01, 0.01)
LENS = Lens(4.0, 0.05, -0.03, (-3e-3, 2e-4, 0.0), (2e-4, -1e-4))
PHOTO = Photo(LENS, SIZE, PITCH, (0.05, -0.04, 0.6), (500.0, 700.0, 100.0))
FRAME = ShiftedFrame(np.array([500.0, 700.0, 0.0]))


def height(x: Floats, y: Floats) -> Floats:
    return 0.05 * (x - 500) - 0.03 * (y - 700) + 10


def lens_camera(lens: Lens, model: Model = "brown-observed") -> Camera:
    values = {"c": lens.c, "x0": lens.x0, "y0": lens.y0, "K1": lens.k[0], "K2": lens.k[1], "K3": lens.k[2],
              "P1": lens.p[0], "P2": lens.p[1]}  # fmt: skip
    return camera("one", model, "mm", SIZE, PITCH, values)


def shots_of(*photos: Photo) -> OrientedImages:
    orientation = np.array([[*p.angles, *FRAME.to_local(np.array([p.station]))[0]] for p in photos])
    cameras = tuple(
        lens_camera(p.lens, "brown-observed" if p.lens.observed else "brown-ideal") for p in photos
    )
    return OrientedImages(
        tuple(f"i{n}" for n in range(len(photos))), cameras, np.arange(len(photos)), orientation
    )


def slope(step: float = 5.0) -> Terrain:
    """A plane, so that bilinear heights are exact."""
    x, y = 380 + (np.arange(48) + 0.5) * step, 820 - (np.arange(48) + 0.5) * step
    return Terrain(height(*np.meshgrid(x, y)), (step, 0, 380, 0, -step, 820), "", "local")


def texture(random: np.random.Generator, dtype: str = "uint8", bands: int = 3) -> NDArray[Any]:
    noise = random.uniform(10, 245, (SIZE[1] // 4, SIZE[0] // 4, bands)).astype(np.float32)
    smooth = cv2.resize(noise, SIZE, interpolation=cv2.INTER_LINEAR).reshape(SIZE[1], SIZE[0], bands)
    return np.ascontiguousarray(smooth.astype(dtype))


def whole(recipe: Recipe, images: list[NDArray[Any]], workers: int = 1) -> tuple[NDArray[Any], NDArray[Any]]:
    grid = recipe.grid
    pixels = np.zeros((recipe.bands, grid.rows, grid.columns), dtype=recipe.dtype)
    chosen = np.full((grid.rows, grid.columns), -9)
    for column, row, grey, seen in orthophoto(recipe, ImageStore(lambda n: images[n]), workers):
        rows, columns = seen.shape
        pixels[:, row : row + rows, column : column + columns] = grey
        chosen[row : row + rows, column : column + columns] = seen
    return pixels, chosen


def places(photo: Photo, grid: Grid) -> Floats:
    x, y = grid.centers(0, 0, grid.columns, grid.rows)
    xs, ys = np.meshgrid(x, y)
    points = np.column_stack([xs.ravel(), ys.ravel(), height(xs, ys).ravel()])
    return photo.pixels(points).reshape(grid.rows, grid.columns, 2)


@pytest.mark.parametrize("observed", [True, False])
@pytest.mark.parametrize(
    ("method", "flag"),
    [(NEAREST, cv2.INTER_NEAREST), (BILINEAR, cv2.INTER_LINEAR), (CUBIC, cv2.INTER_CUBIC)],
)
def test_equals_remapping_by_opencv(observed: bool, method: int, flag: int) -> None:
    photo = replace(PHOTO, lens=replace(LENS, observed=observed))
    image = texture(np.random.default_rng(8))
    grid = Grid(430.0, 760.0, 0.25, 560, 480)
    recipe = Recipe(shots_of(photo), FRAME, lambda _: slope(), grid, method, 3, "uint8", 0.0)
    pixels, chosen = whole(recipe, [image], 2)
    place = places(photo, grid).astype(np.float32)
    peer = cv2.remap(image, place[..., 0], place[..., 1], flag, borderMode=cv2.BORDER_REPLICATE)
    inside = chosen == 0
    expected = (place >= -0.5).all(axis=2) & (place[..., 0] < SIZE[0] - 0.5) & (place[..., 1] < SIZE[1] - 0.5)
    assert (inside != expected).sum() <= 5
    assert inside.mean() > 0.3
    difference = np.abs(np.moveaxis(pixels, 0, 2).astype(int) - peer.astype(int)).max(axis=2)[inside]
    if method == NEAREST:
        # Both round; where a place lies between two pixels within the digits of its map they may differ.
        assert (difference > 0).mean() < 2e-4
    else:
        # OpenCV 4 interpolates in steps of a 32nd of a pixel.
        assert difference.max() <= (1 if int(cv2.__version__.split(".")[0]) > 4 else 2)
    assert (pixels[:, ~inside] == 0).all()


def test_a_fold_of_the_polynomial_shows_nothing_twice() -> None:
    folding = lens_camera(Lens(4.0, k=(-0.06, 0.0, 0.0)), "brown-ideal")
    # r + K1 r^3 turns back at r = 1/sqrt(-3 K1).
    assert ideal_limit(folding) == pytest.approx(1 / np.sqrt(0.18))
    photo = Photo(
        Lens(4.0, k=(-0.06, 0.0, 0.0), observed=False), SIZE, PITCH, (0.0, 0.0, 0.0), (500, 700, 50)
    )
    grid = Grid(400.0, 800.0, 1.0, 200, 200)
    flat = Terrain(np.zeros((48, 48)), (5, 0, 380, 0, -5, 820), "", "local")
    recipe = Recipe(shots_of(photo), FRAME, lambda _: flat, grid, NEAREST, 3, "uint8", 0.0)
    _, chosen = whole(recipe, [texture(np.random.default_rng(9))])
    x, y = grid.centers(0, 0, 200, 200)
    distance = np.hypot(*np.meshgrid(x - 500, y - 700))
    assert (chosen[distance > 50 / 4 / np.sqrt(0.18) + 1] == -1).all()
    assert (chosen[distance < 15] == 0).all()


def test_the_best_nadir_wins() -> None:
    left, right = (
        replace(PHOTO, angles=(0.0, 0.0, turn), station=(x, 700.0, 100.0))
        for turn, x in ((0.0, 480.0), (np.pi / 2, 520.0))
    )
    grid = Grid(440.0, 740.0, 0.5, 240, 160)
    recipe = Recipe(shots_of(left, right), FRAME, lambda _: slope(), grid, BILINEAR, 1, "uint16", 0.0)
    pixels, chosen = whole(
        recipe,
        [np.full((300, 400, 1), 7, np.uint16), np.full((300, 400, 1), 9, np.uint16)],
    )
    x, y = grid.centers(0, 0, 240, 160)
    xs, ys = np.meshgrid(x, y)
    for n, photo in enumerate((left, right)):
        own = np.hypot(xs - photo.station[0], ys - 700)
        other = np.hypot(xs - (1000 - photo.station[0]), ys - 700)
        place = places(photo, grid)
        visible = (place > 0).all(axis=2) & (place < [399, 299]).all(axis=2)
        assert (chosen[visible & (own < other - 1e-6)] == n).all()
        assert (pixels[0][chosen == n] == (7, 9)[n]).all()


def test_tiles_and_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    image = texture(np.random.default_rng(10))
    grid = Grid(430.0, 760.0, 0.3, 333, 287)
    recipe = Recipe(shots_of(PHOTO), FRAME, lambda _: slope(), grid, CUBIC, 3, "uint8", 255.0)
    one = whole(recipe, [image])[0]
    monkeypatch.setattr("photocal.products.orthophoto.TILE", 64)
    assert np.array_equal(one, whole(recipe, [image], 3)[0])


def test_ground_points_through_a_curved_frame() -> None:
    class Curved(ShiftedFrame):
        def to_local(self, given: Floats) -> Floats:
            d = given - self.origin
            r = 6.4e6 + d[:, 2]
            return np.column_stack(
                [r * np.sin(d[:, 0] / 6.4e6), d[:, 1], r * np.cos(d[:, 0] / 6.4e6) - 6.4e6]
            )

    frame = Curved(FRAME.origin)
    x, y = 400 + np.arange(200.0), 780 - np.arange(150.0)
    found = ground_points(x, y, slope(), frame)
    xs, ys = np.meshgrid(x, y)
    exact = frame.to_local(np.column_stack([xs.ravel(), ys.ravel(), height(xs, ys).ravel()]))
    assert found == pytest.approx(exact, abs=1e-4)


def test_points_go_to_the_image_and_back() -> None:
    random = np.random.default_rng(11)
    x, y = random.uniform(470, 530, 50), random.uniform(670, 730, 50)
    given = np.column_stack([x, y, height(x, y)])
    one = shots_of(PHOTO)
    pixel = one.project(np.full(len(given), 0), FRAME.to_local(given))
    assert pixel == pytest.approx(PHOTO.pixels(given), abs=1e-7)
    assert terrain_points(one, 0, pixel, slope(), FRAME) == pytest.approx(given, abs=1e-4)


def test_displacement_of_a_focal_length_is_a_scale() -> None:
    right = replace(PHOTO, lens=Lens(4.0), angles=(0.0, 0.0, 0.3))
    wrong = replace(right, lens=Lens(3.9))
    flat = Terrain(np.full((48, 48), 10.0), (5, 0, 380, 0, -5, 820), "", "local")
    x, y = np.array([480.0, 510.0, 500.0]), np.array([690.0, 720.0, 700.0])
    field = displacement(shots_of(right), shots_of(wrong), flat, FRAME, x, y)
    exact = (4.0 / 3.9 - 1) * np.column_stack([x - 500, y - 700])
    assert field.shift == pytest.approx(exact, abs=1e-6)


def write_job(folder: Path, size: tuple[int, int] = SIZE) -> list[str]:
    """Write block, image and terrain model; give the arguments of the command."""
    block = folder / "block"
    block.mkdir()
    (block / "block.toml").write_text(
        '[block]\nframe = "local"\nheight = "local"\n[observations]\nunit = "px"\naxes = "pixel"\n'
        "sigma = 0.5\n"
        f'[[camera]]\nid = "one"\nmodel = "brown-observed"\nunit = "mm"\nsize_px = {list(SIZE)}\n'
        "pitch_mm = 0.01\nparameters = {c = 4.0, x0 = 0.05, y0 = -0.03, K1 = -3e-3, K2 = 2e-4, P1 = 2e-4, "
        "P2 = -1e-4}\n",
        encoding="utf-8",
    )
    angles = ",".join(f"{np.degrees(a):.12f}" for a in PHOTO.angles)
    (block / "images.csv").write_text(
        f"image,camera,X,Y,Z,omega,phi,kappa\nphoto,one,500,700,100,{angles}\n", encoding="utf-8"
    )
    (block / "points.csv").write_text("point,X,Y,Z,role\nt,500,700,10,tie\n", encoding="utf-8")
    (block / "observations.csv").write_text("image,point,x,y\nphoto,t,200,150\n", encoding="utf-8")
    images = folder / "images"
    images.mkdir()
    pixels = texture(np.random.default_rng(12))[: size[1], : size[0]]
    with rasterio.open(
        images / "photo.png", "w", driver="PNG", width=size[0], height=size[1], count=3, dtype="uint8"
    ) as target:
        target.write(np.moveaxis(pixels, 2, 0))
    terrain = slope()
    with rasterio.open(
        folder / "dtm.tif", "w", driver="GTiff", width=48, height=48, count=1, dtype="float64",
        transform=rasterio.Affine(*terrain.transform), crs="EPSG:31982", nodata=-9999.0,
    ) as target:  # fmt: skip
        heights = terrain.heights.copy()
        heights[20, 20] = -9999
        target.write(heights, 1)
    source = ["ortho", str(block), "--images", str(images), "--dtm", str(folder / "dtm.tif")]
    return [*source, "--heights", "local", "-o", str(folder / "ortho.tif")]


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_file_is_a_tiled_geotiff(photocal: Callable[..., Any], tmp_path: Path) -> None:
    arguments = write_job(tmp_path)
    told = photocal(*arguments, "--cell", "0.2", "--json")
    assert told.code == 0, told.err
    figures = json.loads(told.out)
    with rasterio.open(tmp_path / "ortho.tif") as made:
        assert made.profile["tiled"]
        assert made.crs.to_epsg() == 31982
        assert made.nodata == 0
        assert made.overviews(1)
        assert made.tags()["HEIGHT_KIND"] == "local"
        pixels = made.read()
        grid = Grid(made.transform.c, made.transform.f, made.transform.a, made.width, made.height)
    assert (figures["columns"], figures["rows"], figures["cell_m"]) == (grid.columns, grid.rows, 0.2)
    # 10 um at c = 4 mm, some 90 m above the ground.
    assert figures["image_pixel_m"] == pytest.approx(0.01 / 4 * 90, rel=0.05)
    shown = (pixels > 0).all(axis=0)
    assert figures["covered"] == pytest.approx(shown.mean(), abs=1e-9)
    image = texture(np.random.default_rng(12))
    place = places(PHOTO, grid).astype(np.float32)
    peer = cv2.remap(image, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    assert np.abs(np.moveaxis(pixels, 0, 2).astype(int) - peer.astype(int)).max(axis=2)[shown].max() <= 1
    # All that the image shows lies within, except around the cell without height.
    hole = (tmp_path / "ortho.tif").exists()
    assert hole
    x, y = grid.centers(0, 0, grid.columns, grid.rows)
    xs, ys = np.meshgrid(x, y)
    without = (np.abs(xs - 482.5) < 4.8) & (np.abs(ys - 717.5) < 4.8)
    assert not shown[without].any()
    again = photocal(*arguments[:-1], tmp_path / "two.tif", "--cell", "0.2", "--workers", "1")
    assert again.code == 0
    with rasterio.open(tmp_path / "two.tif") as made:
        assert np.array_equal(made.read(), pixels)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(
    ("more", "code", "complaint"),
    [
        (["--cell", "0"], 5, "positive length"),
        (["--cell", "0.001"], 5, "far finer than the images"),
        (["--resampling", "lanczos"], 5, "use nearest, bilinear, cubic"),
        (["-o", "ortho.jpg"], 5, "use .tif, .tiff"),
        (["--crs", "EPSG:4326"], 5, "different reference systems"),
        (["--crs", "nowhere"], 5, "not a known reference system"),
        (["--heights", "orthometric"], 5, "the block has local heights"),
        (["--bounds", "1,2,3"], 5, "a rectangle"),
        (["--bounds", "0,0,10,10"], 4, "does not reach the images"),
        (["--image", "other"], 5, "not in the block"),
        (["--nodata", "7"], 5, "use 0 or 255"),
        (["--compare", "x"], 5, "go together"),
        (["--run", "nothing"], 3, "no such folder"),
        (["--dtm", "nothing.tif"], 3, "does not exist"),
        (["--dtm", __file__], 4, "cannot be read as a raster"),
    ],
)
def test_complaints_are_one_line(
    photocal: Callable[..., Any], tmp_path: Path, more: list[str], code: int, complaint: str
) -> None:
    told = photocal(*write_job(tmp_path), *more)
    assert complaint in told.err
    assert told.code == code
    assert told.err.count("\n") == 1
    assert not (tmp_path / "ortho.tif").exists()


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_terrain_model_is_not_overwritten(photocal: Callable[..., Any], tmp_path: Path) -> None:
    job = write_job(tmp_path)
    model = Path(job[job.index("--dtm") + 1])
    before = model.read_bytes()
    told = photocal(*job, "-o", model)
    assert "would be overwritten" in told.err
    assert model.read_bytes() == before


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_cells_that_leave_pixels_out_are_said(photocal: Callable[..., Any], tmp_path: Path) -> None:
    told = photocal(*write_job(tmp_path), "--cell", "1")
    assert told.code == 0
    assert "a cell is 4.4 pixels wide" in told.out


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_an_image_of_another_size_is_refused(photocal: Callable[..., Any], tmp_path: Path) -> None:
    told = photocal(*write_job(tmp_path, (200, 300)))
    assert told.code == 4
    assert "200 x 300 px, its camera 400 x 300" in told.err


def adjusted_by_hand(block: Block, c: float, folder: Path) -> None:
    """A run folder of which nothing is adjusted but c."""
    cameras = tuple(own.with_values([c, *own.values[1:]]) for own in block.cameras)
    images, nothing = block.images, np.full((1, 2), np.nan)
    first = np.zeros(1, dtype=np.int64)
    folder.mkdir()
    write_result(
        folder,
        Result(
            software=Software("test", "0"),
            block=BlockFacts(block.name, block.frame, block.datum, "px", "pixel", block.height),
            inputs=(), converged=True, iterations=1, observations=0, unknowns=0, degrees_of_freedom=0,
            chi_squared=0.0, sigma0_squared=None, global_test=None, groups=(), checks=CheckSummary(0, {}),
            cameras={own.id: own for own in cameras},
            images=OrientedImages(
                images.names, cameras, images.camera, images.values, np.zeros((len(images.names), 6, 6))
            ),
            points=AdjustedPoints(("1",), ("tie",), np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros(1, int)),
            residuals=Residuals(images.names, ("1",), first, first, np.zeros((1, 2)), *[nothing] * 3),
        ),
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_displacement_map_between_two_adjustments(photocal: Callable[..., Any], tmp_path: Path) -> None:
    arguments = write_job(tmp_path)
    for name, c in (("calibrated", 4.0), ("nominal", 3.9)):
        adjusted_by_hand(read_block(tmp_path / "block"), c, tmp_path / name)
    told = photocal(
        *arguments, "--cell", "0.5", "--json", "--run", tmp_path / "calibrated",
        "--compare", tmp_path / "nominal", "--displacement", tmp_path / "map.svg",
    )  # fmt: skip
    assert told.code == 0, told.err
    # The scale is wrong by 1/39; the corners lie some 55 m from the nadir.
    assert json.loads(told.out)["displacement_m"]["largest"] == pytest.approx(55 / 39, rel=0.25)
    assert (tmp_path / "map.svg").read_text(encoding="utf-8").startswith("<?xml")
