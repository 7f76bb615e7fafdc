"""What a run can be exported to: one function for each format, all of one shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import ConfigurationError
from photocal.exchange.convert import Conversion
from photocal.exchange.geographic import Origin, ToGeographic, topocentric
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


Writer = Callable[[Path, Reconstruction, Choices], tuple[Conversion, ...]]


def colmap(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """cameras.txt, images.txt, points3D.txt."""
    from photocal.exchange.colmap import write_colmap

    return write_colmap(folder, given)


def colmap_binary(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """cameras.bin, images.bin, points3D.bin."""
    from photocal.exchange.colmap import write_colmap

    return write_colmap(folder, given, binary=True)


def opencv(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A YAML file for each camera."""
    from photocal.exchange.opencv import write_opencv

    return tuple(write_opencv(folder / f"{file_name(own.id)}.yml", own) for own in given.cameras)


def opensfm(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """cameras.json, reconstruction.json, tracks.csv."""
    from photocal.exchange.opensfm import write_opensfm

    return write_opensfm(folder, given)


def odm(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """gcp_list.txt of the control points, geo.txt of the images."""
    from photocal.exchange.ground_points import write_odm

    write_odm(folder, given)
    return ()


def metashape(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A camera XML."""
    from photocal.exchange.metashape_writer import write_metashape

    return write_metashape(folder / "cameras.xml", given)


def metashape_csv(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Reference tables of the images and of the points."""
    from photocal.exchange.reference_table import references, write_references

    crs = "" if given.frame == "local" else _wkt(given.frame)
    cameras = references(given.image_names, given.poses[:, 3:], given.pose_sigma[:, 3:])
    write_references(folder / "cameras.csv", crs, cameras)
    write_references(folder / "markers.csv", crs, references(given.point_names, given.xyz, given.xyz_sigma))
    return ()


def pix4d(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A .cam file for each camera."""
    from photocal.exchange.pix4d import write_pix4d

    name = "_pix4d_calibrated_internal_camera_parameters.cam"
    return tuple(write_pix4d(folder / (file_name(own.id) + name), own) for own in given.cameras)


def opf(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """project.opf and its JSON files."""
    from photocal.exchange.opf_writer import write_opf

    return write_opf(folder, given)


def photomodeler(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A text export and its table of control points."""
    from photocal.exchange.photomodeler_writer import write_photomodeler

    return write_photomodeler(folder / "block.txt", given)


def dbat(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A set-up and its tables."""
    from photocal.exchange.dbat_writer import write_dbat
    from photocal.exchange.reconstruction import as_block

    write_dbat(folder, as_block(given, given.name, 1.0, ()))
    return tuple(Conversion(own) for own in given.cameras)


def jaicov(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """block.ior, block.eor, block.obc, block.phc."""
    from photocal.exchange.jaicov_writer import write_jaicov

    return write_jaicov(folder / "block", given)


def micmac(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Ori-photocal, Ground-Pts3D.xml, GroundMeasure.xml."""
    from photocal.exchange.micmac_writer import write_micmac

    return write_micmac(folder, given)


def patb(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """A table of angles and one of rotation matrices."""
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


def inpho(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Cameras and photos of a project."""
    from photocal.exchange.inpho import write_inpho

    return write_inpho(folder / "orientations.prj", given)


def geojson(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """One collection of features."""
    from photocal.exchange.geographic import write_geojson

    write_geojson(folder / "block.geojson", *_geographic(given, choices))
    return ()


def kml(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """One document."""
    from photocal.exchange.geographic import write_kml

    write_kml(folder / "block.kml", *_geographic(given, choices))
    return ()


def geopackage(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """A layer for each kind of thing."""
    from photocal.exchange.geopackage import write_geopackage

    turn: ToGeographic | None = None
    if choices.origin is not None or given.frame != "local":
        given, turn = _geographic(given, choices)
    write_geopackage(folder / "block.gpkg", given, turn, choices.changed_utc)
    return ()


def _geographic(given: Reconstruction, choices: Choices) -> tuple[Reconstruction, ToGeographic]:
    """A Cartesian block, and the way from its coordinates to longitude, latitude and height."""
    if given.frame != "local":
        if choices.origin is not None:
            raise ConfigurationError(
                f"the block lies in {given.frame}, which tells where it is", remedy="leave out --origin"
            )
        from photocal.exchange.cartesian import to_cartesian, to_wgs84

        return to_cartesian(given), to_wgs84(given)
    if choices.origin is None:
        raise ConfigurationError(
            "where the local frame lies is not given",
            remedy="name its origin: --origin LATITUDE,LONGITUDE,HEIGHT (deg, m above the ellipsoid)",
        )
    return given, topocentric(choices.origin)


def _wkt(frame: str) -> str:
    from pyproj import CRS

    return " ".join(CRS.from_user_input(frame).to_wkt("WKT1_GDAL").split())


def file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"
