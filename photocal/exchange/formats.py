"""The formats of other programs: what each holds and means, and who writes and reads it.

The table is the one place that says it; docs/exchange.md is made of it
(`python -m photocal.exchange.formats`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drivers.errors import ConfigurationError
from photocal.exchange import readers, writers
from photocal.exchange.convert import Conversion
from photocal.exchange.reconstruction import Reconstruction
from photocal.exchange.writers import Choices, Writer

Part = Literal["cameras", "orientations", "points", "marks"]
# cartesian: a block in a reference system is taken to its topocentric frame; own: coordinates as they are;
# wgs84: longitude, latitude and ellipsoidal height; none: no places.
Space = Literal["cartesian", "own", "wgs84", "none"]
Reader = Callable[[Path], Reconstruction]

WHOLE: tuple[Part, ...] = ("cameras", "orientations", "points", "marks")
VISION = "x right, y down, z forward"
PHOTO = "x right, y up, z backwards"
CENTRE, CORNER = "centre of the first pixel", "corner of the first pixel"


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    name : str
        For `photocal export --format`.
    title : str
        Program and form.
    holds : tuple of {"cameras", "orientations", "points", "marks"}
        What comes back when it is read; the points of some formats are the surveyed ones only.
    space : {"cartesian", "own", "wgs84", "none"}
        Object coordinates.
    origin : str
        What has the pixel coordinates (0, 0).
    axes : str
        Of the camera.
    distortion : {"brown-ideal", "brown-observed", "none"}
        Its direction: added to the projection, or correcting the measurement.
    read : callable or None
        Takes the folder, or the file, that was written.
    """

    name: str
    title: str
    holds: tuple[Part, ...]
    space: Space
    origin: str
    axes: str
    distortion: Literal["brown-ideal", "brown-observed", "none"]
    units: str
    write: Writer
    read: Reader | None


FORMATS: tuple[Format, ...] = (
    Format("colmap", "COLMAP, text", WHOLE, "cartesian", CORNER, VISION, "brown-ideal",
           "px, m, unit quaternion", writers.colmap, readers.colmap),
    Format("colmap-binary", "COLMAP, binary", WHOLE, "cartesian", CORNER, VISION, "brown-ideal",
           "px, m, unit quaternion", writers.colmap_binary, readers.colmap),
    Format("opencv", "OpenCV, YAML or JSON", ("cameras",), "none", CENTRE, VISION, "brown-ideal", "px",
           writers.opencv, readers.opencv),
    Format("opensfm", "OpenSfM and ODM, reconstruction", WHOLE, "cartesian",
           "middle of the image, by its larger side", VISION, "brown-ideal",
           "larger side of the image, m, rotation vector", writers.opensfm, readers.opensfm),
    Format("odm", "ODM, gcp_list.txt and geo.txt", ("points", "marks"), "own", CENTRE, "none", "none",
           "px, m", writers.odm, None),
    Format("metashape", "Metashape, camera XML", ("cameras", "orientations", "points", "marks"), "cartesian",
           CORNER, VISION, "brown-ideal", "px, m, 4 x 4 matrix", writers.metashape, readers.metashape),
    Format("metashape-csv", "Metashape, reference tables", ("points",), "own", "none", "none", "none", "m",
           writers.metashape_csv, None),
    Format("pix4d", "Pix4D, .cam", ("cameras",), "none", CORNER, VISION, "brown-ideal",
           "mm on a nominal sensor", writers.pix4d, None),
    Format("opf", "Open Photogrammetry Format 1.0", WHOLE, "cartesian", CORNER, PHOTO, "brown-ideal",
           "px, m, deg", writers.opf, readers.opf),
    Format("photomodeler", "PhotoModeler, text export", WHOLE, "cartesian", CORNER, PHOTO, "brown-observed",
           "px, mm in the camera, m, deg", writers.photomodeler, readers.photomodeler),
    Format("dbat", "DBAT, XML set-up", ("cameras", "points", "marks"), "cartesian", CORNER, PHOTO,
           "brown-observed", "px, mm in the camera, m", writers.dbat, readers.dbat),
    Format("jaicov", "JAICOV and AICON 3D Studio", WHOLE, "cartesian", "middle of the sensor, y up", PHOTO,
           "brown-ideal", "mm, rad", writers.jaicov, readers.jaicov),
    Format("micmac", "MicMac, XML", WHOLE, "cartesian", CENTRE, VISION, "brown-ideal", "px, m, matrix",
           writers.micmac, readers.micmac),
    Format("patb", "PATB style, tables", ("orientations",), "own", "none", PHOTO, "none",
           "m; deg or gon, as asked; matrix from camera to object", writers.patb, readers.patb),
    Format("inpho", "Inpho, .prj", ("orientations",), "own", CENTRE, PHOTO, "none",
           "mm in the camera, m, matrix from object to camera", writers.inpho, readers.inpho),
    Format("geojson", "GeoJSON", ("orientations", "points"), "wgs84", CENTRE, PHOTO, "none", "deg, m, px",
           writers.geojson, None),
    Format("kml", "KML", ("orientations", "points"), "wgs84", CENTRE, PHOTO, "none", "deg, m, px",
           writers.kml, None),
    Format("geopackage", "GeoPackage", ("orientations", "points", "marks"), "wgs84", CENTRE, PHOTO, "none",
           "deg, m, px", writers.geopackage, None),
)  # fmt: skip


def named(name: str) -> Format:
    """Find a format.

    Raises
    ------
    ConfigurationError
        When it is not known.
    """
    found = next((form for form in FORMATS if form.name == name), None)
    if found is None:
        known = ", ".join(form.name for form in FORMATS)
        raise ConfigurationError(f"format {name!r} is not known", remedy=f"use {known}")
    return found


def export(form: Format, folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """Write a block in a format.

    Parameters
    ----------
    folder : Path
        Exists.

    Returns
    -------
    tuple of Conversion
        What the change of model cost each camera; empty for formats without cameras.

    Raises
    ------
    ConfigurationError, InputMalformedError
        When the format has no place for the block, or a choice is missing.
    """
    if form.space == "cartesian":
        from photocal.exchange.cartesian import to_cartesian

        given = to_cartesian(given)
    return form.write(folder, given, choices)


_SPACES = {
    "cartesian": "Cartesian, m",
    "own": "the block's own",
    "wgs84": "WGS 84 (a local frame with --origin)",
    "none": "none",
}
_PAGE = """# Formats of other programs

Made by `python -m photocal.exchange.formats > docs/exchange.md`; `photocal export RUN --format NAME -o DIR`
writes them. Here the centre of the upper-left pixel is (0, 0), x runs right, y down; camera axes are x
right, y up, z backwards; `exchange` owns every half pixel and every sign.

"brown-ideal": the distortion is added to the projection; "brown-observed": it corrects the measurement.
Between formats of one direction nothing is lost; between the two a fit over the whole image replaces the
polynomial, and the command says its rms and largest residual in px. "none": the distortion has no place in
the file.

A block in a coordinate reference system goes to Cartesian formats in the topocentric frame (east, north,
up) at its middle, where it was adjusted, so that reprojection residuals stay what they are; tables of
orientations and ODM's lists keep map coordinates and angles.

{table}

`photocal adjust` reads the files of the formats marked "adjust" directly, and PhotoScan projects (.psz);
where a format has no standard deviations of image coordinates, all of them get 1 px, and the a posteriori
variance factor says what they are worth. "yes": read by the package; a .cam file needs the image size
beside it, GCP lists go to `photocal measure --gcp`. Of PhotoModeler its tables of 2-D and 3-D points are
read too.

What a format wants and an adjustment does not know is filled in: OPF gets 1970-01-01 as time of exposure
and 8-bit colour images; standard deviations that are not known are written as 0. Control points carry the
standard deviations of the adjusted coordinates.
"""
# What `photocal adjust` takes: see `foreign`.
ADJUSTED = (
    "colmap", "colmap-binary", "opensfm", "metashape", "opf", "photomodeler", "dbat", "jaicov",
)  # fmt: skip

# Read one by one, or with what only their reader is told: ground points, references, image size.
IN_PARTS = ("odm", "metashape-csv", "pix4d")


def page() -> str:
    """Give docs/exchange.md."""
    head = (
        "name",
        "format",
        "holds",
        "object space",
        "pixel (0, 0)",
        "camera axes",
        "distortion",
        "units",
        "read",
    )
    rows = [head, ("---",) * len(head)]
    rows += [
        (
            f"`{form.name}`",
            form.title,
            ", ".join(form.holds),
            _SPACES[form.space],
            form.origin,
            form.axes,
            form.distortion,
            form.units,
            "adjust" if form.name in ADJUSTED else "yes" if form.read or form.name in IN_PARTS else "no",
        )
        for form in FORMATS
    ]
    return _PAGE.format(table="\n".join("| " + " | ".join(row) + " |" for row in rows))


if __name__ == "__main__":
    print(page(), end="")
