"""Writing the .ior, .eor, .obc and .phc files of JAICOV; the conventions are those of `jaicov`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.errors import InputMalformedError
from photocal.exchange.choices import Choices
from photocal.exchange.jaicov import MM
from photocal.exchange.parts import whole_numbers
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.conversion import Conversion, converted

Row = Sequence[str | float]

_TERMS = ("K1", "K2", "K3", "P1", "P2", "B1", "B2")


def write_jaicov(stem: Path, given: Reconstruction) -> tuple[Conversion, ...]:
    """Write .ior, .eor, .obc and .phc files."""
    if any(own.unit != "mm" for own in given.cameras):
        raise InputMalformedError("JAICOV files have cameras in mm", remedy="give the pixel pitch")
    made = tuple(converted(own, "brown-ideal", "additive", _TERMS) for own in given.cameras)
    cameras = whole_numbers([own.id for own in given.cameras])
    images, points = whole_numbers(given.image_names), whole_numbers(given.point_names)
    ior = [row for name, own in zip(cameras, made, strict=True) for row in _interior(name, own.camera)]
    _write(stem.with_suffix(".ior"), ior)
    eor: list[Row] = [
        [name, cameras[own], *(pose[3:] / MM).tolist(), *pose[:3].tolist(), "0", "0", "3"]
        for name, own, pose in zip(images, given.image_camera.tolist(), given.poses, strict=True)
    ]
    _write(stem.with_suffix(".eor"), eor)
    rays = np.bincount(given.point, minlength=len(points))
    sigma = given.xyz_sigma / MM if len(given.xyz_sigma) else np.zeros(given.xyz.shape)
    obc: list[Row] = [
        [name, *(xyz / MM).tolist(), *s.tolist(), str(count), "1", "1", "0"]
        for name, xyz, s, count in zip(points, given.xyz, sigma, rays, strict=True)
    ]
    _write(stem.with_suffix(".obc"), obc)
    _write(stem.with_suffix(".phc"), _marks(given, images, points))
    return made


def _interior(name: str, own: Camera) -> list[Row]:
    v = own.value
    size = np.array(own.size_px) * own.pitch
    return [
        [name, "-999", -v("c"), v("x0"), v("y0"), v("K1"), v("K2"), own.reference_radius],
        [v("K3")],
        [v("P1"), v("P2")],
        [v("B1"), v("B2")],
        [*size.tolist(), *(str(side) for side in own.size_px)],
    ]


def _marks(given: Reconstruction, images: list[str], points: list[str]) -> list[Row]:
    own = given.image_camera[given.image]
    size = np.array([camera.size_px for camera in given.cameras], dtype=float)[own]
    pitch = np.array([camera.pitch for camera in given.cameras])[own]
    plane = pixel_to_plane(size, pitch, given.pixels)
    residuals = np.zeros(plane.shape)
    if len(given.residuals_px):
        residuals = given.residuals_px * pitch * [1.0, -1.0]
    return [
        [images[i], points[j], *xy.tolist(), 0.0, 0.0, *r.tolist(), "1", "1", "1"]
        for i, j, xy, r in zip(given.image, given.point, plane, residuals, strict=True)
    ]


def _write(path: Path, rows: Sequence[Row]) -> None:
    lines = (" ".join(cell if isinstance(cell, str) else repr(float(cell)) for cell in row) for row in rows)
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """block.ior, block.eor, block.obc, block.phc."""
    return write_jaicov(folder / "block", given)
