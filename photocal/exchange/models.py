"""Models of vision programs as blocks: COLMAP, OpenSfM, Metashape's camera XML, OPF.

These have no standard deviations of image coordinates: all get 1 px, and the a posteriori variance factor
says what they are worth. Surveyed points with standard deviations carry the datum, else it is free.
"""

from __future__ import annotations

from pathlib import Path

from drivers.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.reconstruction import Reconstruction, as_block
from photocal.exchange.source import fingerprint

UNIT_SIGMA_PX = 1.0
COLMAP_FILES = ("cameras", "images", "points3D")


def read_colmap_block(path: Path) -> Block:
    """Read a COLMAP model."""
    from photocal.exchange.colmap import read_colmap

    given = read_colmap(path.parent)
    suffix = ".bin" if (path.parent / "cameras.bin").exists() else ".txt"
    return _block(path.parent.name, given, [path.with_name(name + suffix) for name in COLMAP_FILES])


def read_opensfm_block(path: Path) -> Block:
    """Read an OpenSfM reconstruction with its tracks; parameters and errors as of `read_colmap_block`."""
    from photocal.exchange.opensfm import read_reconstruction, tracks_beside

    given = read_reconstruction(path)
    tracks = tracks_beside(path)
    if not tracks.is_file():
        raise InputMalformedError(
            "has no measurements", where=path, remedy=f"put the tracks beside it as {tracks.name}"
        )
    return _block(path.stem, given, [path, tracks])


def read_opf_block(path: Path) -> Block:
    """Read an OPF project; parameters and errors as of `read_colmap_block`."""
    from photocal.exchange.opf import read_opf, resource_files

    given = read_opf(path)
    return _block(given.name, given, [path, *resource_files(path)])


def read_metashape_block(path: Path) -> Block:
    """Read a camera XML; parameters and errors as of `read_colmap_block`."""
    from photocal.exchange.metashape import read_metashape

    chunk = read_metashape(path)
    if chunk.crs:
        raise InputMalformedError(
            f"is in the coordinate system {chunk.crs[:60]!r}, its orientations are not",
            where=path,
            remedy="export the cameras of a chunk in local coordinates",
        )
    return _block(path.stem, chunk.reconstruction, [path])


def _block(name: str, given: Reconstruction, files: list[Path]) -> Block:
    if not len(given.pixels):
        raise InputMalformedError("has no measurements of points", where=files[0], remedy="export them too")
    return as_block(given, name, UNIT_SIGMA_PX, tuple(fingerprint(path) for path in files))
