"""What a run can be exported to: one writer for each format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from photocal.exchange.convert import Conversion
from photocal.exchange.geographic import Origin
from photocal.exchange.orientation_tables import Angle
from photocal.exchange.reconstruction import Reconstruction


@dataclass(frozen=True)
class Choices:
    """What some formats must be told.

    Attributes
    ----------
    angle_unit : {"deg", "gon"} or None
        For tables of angles.
    origin : Origin or None
        Of a local frame, for geographic formats.
    changed_utc : str
        Time that a file may note as that of its making.
    """

    angle_unit: Angle | None = None
    origin: Origin | None = None
    changed_utc: str = "1970-01-01T00:00:00.000Z"


Floats = NDArray[np.float64]
Writer = Callable[[Path, Reconstruction, Choices], tuple[Conversion, ...]]


def _colmap(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.colmap import write_colmap

    return write_colmap(folder, given)


def _colmap_binary(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.colmap import write_colmap

    return write_colmap(folder, given, binary=True)


def _opencv(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.opencv import write_opencv

    return tuple(write_opencv(folder / f"{_file_name(own.id)}.yml", own) for own in given.cameras)


def _opensfm(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.opensfm import write_opensfm

    return write_opensfm(folder, given)


def _metashape(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.metashape import write_metashape

    return write_metashape(folder / "cameras.xml", given)


def _pix4d(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.pix4d import write_pix4d

    name = "_pix4d_calibrated_internal_camera_parameters.cam"
    return tuple(write_pix4d(folder / (_file_name(own.id) + name), own) for own in given.cameras)


def _patb(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.orientation_tables import write_angles, write_matrices

    if choices.angle_unit is None:
        raise ConfigurationError(
            "the unit of the angles is not given", remedy="name it: --angle-unit deg or --angle-unit gon"
        )
    write_angles(
        folder / f"orientations_{choices.angle_unit}.txt", given.image_names, given.poses, choices.angle_unit
    )
    write_matrices(folder / "orientations_matrix.txt", given.image_names, given.poses)
    return ()


def _inpho(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.orientation_tables import write_inpho

    for own in given.cameras:
        if own.unit != "mm":
            raise ConfigurationError(
                f"camera {own.id} is in px, but the format has the principal distance in mm",
                remedy="give the camera in mm with its pixel pitch",
            )
    distances = [given.cameras[k].value("c") for k in given.image_camera.tolist()]
    write_inpho(folder / "orientations.prj", given.image_names, given.poses, distances)
    return ()


def _jaicov(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.jaicov import write_jaicov

    return (write_jaicov(folder / "block", given),)


def _references(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.reference_table import Reference, write_references

    def rows(names: tuple[str, ...], places: Floats, sigmas: Floats) -> list[Reference]:
        return [
            Reference(name, (x, y, z), (sx, sy, sz))
            for name, (x, y, z), (sx, sy, sz) in zip(names, places.tolist(), sigmas.tolist(), strict=True)
        ]

    write_references(
        folder / "cameras.csv", "", rows(given.image_names, given.poses[:, 3:], given.pose_sigma[:, 3:])
    )
    write_references(folder / "markers.csv", "", rows(given.point_names, given.xyz, given.xyz_sigma))
    return ()


def _geojson(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.geographic import topocentric, write_geojson

    write_geojson(folder / "block.geojson", given, topocentric(_origin(choices)))
    return ()


def _geopackage(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.geographic import topocentric
    from photocal.exchange.geopackage import write_geopackage

    turn = None if choices.origin is None else topocentric(choices.origin)
    write_geopackage(folder / "block.gpkg", given, turn, choices.changed_utc)
    return ()


def _kml(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    from photocal.exchange.geographic import topocentric, write_kml

    write_kml(folder / "block.kml", given, topocentric(_origin(choices)))
    return ()


WRITERS: dict[str, Writer] = {
    "colmap": _colmap,
    "colmap-binary": _colmap_binary,
    "opencv": _opencv,
    "opensfm": _opensfm,
    "metashape": _metashape,
    "metashape-csv": _references,
    "jaicov": _jaicov,
    "pix4d": _pix4d,
    "patb": _patb,
    "inpho": _inpho,
    "geojson": _geojson,
    "kml": _kml,
    "geopackage": _geopackage,
}


def writer(name: str) -> Writer:
    """Find the writer of a format.

    Parameters
    ----------
    name : str

    Returns
    -------
    callable

    Raises
    ------
    ConfigurationError
        For a format that is not known.
    """
    if name not in WRITERS:
        raise ConfigurationError(f"format {name!r} is not known", remedy=f"use {', '.join(WRITERS)}")
    return WRITERS[name]


def _origin(choices: Choices) -> Origin:
    if choices.origin is None:
        raise ConfigurationError(
            "where the local frame lies is not given",
            remedy="name its origin: --origin LATITUDE,LONGITUDE,HEIGHT (deg, m above the ellipsoid)",
        )
    return choices.origin


def _file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"
