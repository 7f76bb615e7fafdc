"""Reading what a folder of a format holds: the counterparts of `writers`."""

from __future__ import annotations

from pathlib import Path

from drivers.errors import InputNotFoundError
from photocal.exchange.reconstruction import Reconstruction, cameras_alone, of_block, orientations_alone


def colmap(folder: Path) -> Reconstruction:
    """A model."""
    from photocal.exchange.colmap import read_colmap

    return read_colmap(folder)


def opencv(folder: Path) -> Reconstruction:
    """All calibrations of a folder, by their file names."""
    from photocal.exchange.opencv import read_opencv

    return cameras_alone([read_opencv(path) for path in _files(folder, "*.yml")])


def opensfm(folder: Path) -> Reconstruction:
    """A reconstruction with its tracks."""
    from photocal.exchange.opensfm import read_reconstruction

    return read_reconstruction(folder / "reconstruction.json")


def metashape(folder: Path) -> Reconstruction:
    """Cameras, aligned images and markers."""
    from photocal.exchange.metashape import read_metashape

    return read_metashape(folder / "cameras.xml").reconstruction


def opf(folder: Path) -> Reconstruction:
    """A calibrated project."""
    from photocal.exchange.opf import read_opf

    return read_opf(folder / "project.opf")


def photomodeler(folder: Path) -> Reconstruction:
    """A text export with its table of control points."""
    from photocal.exchange.photomodeler import control_beside, read_photomodeler

    control = control_beside(folder / "block.txt")
    return of_block(read_photomodeler(folder / "block.txt", control if control.exists() else None))


def dbat(folder: Path) -> Reconstruction:
    """A set-up with its tables; it has no orientations."""
    from photocal.exchange.dbat import read_dbat

    return of_block(read_dbat(folder / "setup.xml"))


def jaicov(folder: Path) -> Reconstruction:
    """The four files of a project."""
    from photocal.exchange.jaicov import read_jaicov

    return of_block(read_jaicov(folder / "block.ior", sigma_mm=1e-3))


def micmac(folder: Path) -> Reconstruction:
    """Control points, measurements, orientations and calibrations."""
    from photocal.exchange.micmac import read_micmac
    from photocal.exchange.micmac_writer import FOLDER

    return of_block(read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / FOLDER))


def patb(folder: Path) -> Reconstruction:
    """The table of rotation matrices, which needs no unit."""
    from photocal.exchange.orientation_tables import read_matrices

    return orientations_alone(*read_matrices(folder / "orientations_matrix.txt"))


def inpho(folder: Path) -> Reconstruction:
    """Photos of a project."""
    from photocal.exchange.inpho import read_inpho

    return orientations_alone(*read_inpho(folder / "orientations.prj"))


def _files(folder: Path, pattern: str) -> list[Path]:
    found = sorted(folder.glob(pattern))
    if not found:
        raise InputNotFoundError(f"has no {pattern}", where=folder, remedy="name the folder that has it")
    return found
