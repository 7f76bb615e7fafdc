"""A rendered flight with a control list as people type it: sizes, turns, slips, absent pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from pyproj import Proj, Transformer

from tests.photocal.measurement.site import SIDE, Site, flight, texture

Floats = NDArray[np.float64]
# Warsaw, in the Polish system of 1992: the middle of the ground.
MIDDLE, CRS = np.array([634600.0, 485300.0, 110.0]), "EPSG:2180"
# Six points of level ground, each in several pictures.
GROUND = np.array(
    [[-7.0, -4, 0], [0.5, -5, 0.004], [7, -3.5, -0.003], [-6.5, 4.5, 0.002], [1, 4, -0.004], [7, 5, 0.001]]
)
NAMES = tuple(f"G{k + 1}" for k in range(len(GROUND)))


@dataclass(frozen=True)
class Row:
    """A row of the list: a point's place, and where a picture shows it."""

    place: tuple[float, float, float]
    x: float
    y: float
    image: str
    name: str

    def text(self) -> str:
        """Write it as gcp_list.txt has it."""
        x, y, z = self.place
        return f"{x:.3f} {y:.3f} {z:.3f} {self.x:.2f} {self.y:.2f} {self.image} {self.name}".rstrip()


@cache
def _rendered(folder: Path) -> Site:
    """Render the flight once."""
    own = flight()
    own = replace(own, names=tuple(name.replace(".png", ".jpg") for name in own.names))
    own.render(texture(5, SIDE), folder)
    return own


def scale() -> float:
    """Metres of the map for a metre on the ground."""
    longitude, latitude = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(*MIDDLE[:2])
    return float(Proj(CRS).get_factors(longitude, latitude).meridional_scale)


def on_the_map(local: Floats) -> Floats:
    """Places of the rendered ground, (n, 3), in the map system."""
    return MIDDLE + local * [scale(), scale(), 1.0]


def rows(site: Site) -> list[Row]:
    """Every mark of every point, to some tenths of a pixel."""
    rng, found = np.random.default_rng(6), []
    width, height = site.camera.size_px
    for name, place, given in zip(NAMES, GROUND, on_the_map(GROUND), strict=True):
        pixels = site.views.project(np.arange(8), np.tile(place, (8, 1))) + rng.normal(0, 0.2, (8, 2))
        for image, (x, y) in zip(site.names, pixels, strict=True):
            if 5 < x < width - 6 and 5 < y < height - 6:
                found.append(Row(tuple(given.tolist()), float(x), float(y), image, name))
    return found


def resized(factor: float) -> Callable[[list[Row]], list[Row]]:
    """Marks as in pictures of another size."""
    return lambda rows: [
        replace(row, x=(row.x + 0.5) * factor - 0.5, y=(row.y + 0.5) * factor - 0.5) for row in rows
    ]


def site_folder(
    pictures: Path,
    folder: Path,
    change: Callable[[list[Row]], Sequence[Row]] = list,
    *,
    first: str = CRS,
    orientation: int = 1,
    positions: bool = False,
    absent: Sequence[str] = (),
) -> list[Row]:
    """Make a folder of pictures and a control list; `change` spoils its rows.

    pictures: where the rendered ones are kept.
    orientation: what EXIF says of how viewers turn them.
    """
    site = _rendered(pictures)
    (folder / "images").mkdir(parents=True)
    way = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
    noise = np.random.default_rng(3).normal(0, [0.8, 0.8, 1.5], (8, 3))
    for name, place in zip(site.names, on_the_map(site.poses[:, 3:]) + noise, strict=True):
        if name in absent:
            continue
        exif = Image.Exif()
        exif[0x0110], exif[0x0112] = "TestCam", orientation
        exif.get_ifd(0x8769)[0xA405] = 34
        if positions:
            longitude, latitude = way.transform(*place[:2])
            gps = exif.get_ifd(0x8825)
            for key, value in ((2, latitude), (4, longitude)):
                gps[key] = (
                    IFDRational(int(value)),
                    IFDRational(0),
                    IFDRational(round(value % 1 * 3.6e9), 10**6),
                )
            gps[1], gps[3], gps[6] = "N", "E", IFDRational(round(place[2] * 1000), 1000)
        with Image.open(pictures / name) as picture:
            picture.save(folder / "images" / name, exif=exif, quality=95)
    typed = list(change(rows(site)))
    (folder / "gcp_list.txt").write_text("\n".join([first, *(row.text() for row in typed)]) + "\n")
    return typed
