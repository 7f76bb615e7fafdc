"""The formats of other programs: what each holds and means, and who writes and reads it.

A new format is a module and an entry of this table; its functions are loaded when they are used.
docs/exchange.md is made of it (`python -m photocal.exchange.formats`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError

if TYPE_CHECKING:
    from photocal.block.model import Block
    from photocal.exchange.reconstruction import Choices, Reconstruction
    from photocal.geometry.conversion import Conversion


Part = Literal["cameras", "orientations", "points", "marks"]
# cartesian: a block in a reference system is taken to its topocentric frame; own: coordinates as they are;
# wgs84: longitude, latitude and ellipsoidal height; none: no places.
Space = Literal["cartesian", "own", "wgs84", "none"]

WHOLE: tuple[Part, ...] = ("cameras", "orientations", "points", "marks")
VISION = "x right, y down, z forward"
PHOTO = "x right, y up, z backwards"
CENTRE, CORNER = "centre of the first pixel", "corner of the first pixel"


@dataclass(frozen=True)
class Format:
    """One format; functions are named as `module:function` within this room, or by a dotted module.

    name: for `photocal export --format`.
    holds: what comes back when it is read; the points of some formats are the surveyed ones only.
    distortion: its direction: added to the projection, or correcting the measurement.
    writes: takes a folder, or the file in it that is named after another colon, a `Reconstruction` and
        `Choices`; gives a `Conversion` for each camera. Empty: it is not exported.
    reads: takes the folder that was written, or the file in it that is named after another colon; gives a
        `Reconstruction`, a block, or names and orientations of images.
    blocks: takes a file of which the name fits one of `opens`; gives the block that `photocal adjust` takes.
    recognises: whether such a file is of this format, where its name does not say it.
    """

    name: str
    title: str
    holds: tuple[Part, ...]
    space: Space
    origin: str
    axes: str
    distortion: Literal["brown-ideal", "brown-observed", "none"]
    units: str
    writes: str
    reads: str
    blocks: str = ""
    opens: tuple[str, ...] = ()
    recognises: str = ""

    def read(self, folder: Path) -> Reconstruction:
        """Read a folder that was written, in a format with `reads`."""
        from photocal.exchange.reconstruction import Reconstruction, of_block, orientations_alone

        module, function, *file = self.reads.split(":")
        content = _loaded(f"{module}:{function}")(folder.joinpath(*file))
        if isinstance(content, Reconstruction):
            return content
        return orientations_alone(*content) if isinstance(content, tuple) else of_block(content)

    def takes(self, path: Path) -> bool:
        """Whether a file is one of this format."""
        named = any(fnmatch(path.name.lower(), pattern.lower()) for pattern in self.opens)
        return named and (not self.recognises or bool(_loaded(self.recognises)(path)))


def _loaded(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    entry: Callable[..., Any] = getattr(
        import_module(module if "." in module else f"photocal.exchange.{module}"), function
    )
    return entry


FORMATS: tuple[Format, ...] = (
    Format("colmap", "COLMAP, text", WHOLE, "cartesian", CORNER, VISION, "brown-ideal",
           "px, m, unit quaternion", "colmap:write_colmap", "colmap:read_colmap", "colmap:read_model_block",
           ("cameras.txt", "images.txt", "points3D.txt")),
    Format("colmap-binary", "COLMAP, binary", WHOLE, "cartesian", CORNER, VISION, "brown-ideal",
           "px, m, unit quaternion", "colmap:export_binary", "colmap:read_colmap",
           "colmap:read_model_block", ("cameras.bin", "images.bin", "points3D.bin")),
    Format("opencv", "OpenCV, YAML or JSON", ("cameras",), "none", CENTRE, VISION, "brown-ideal", "px",
           "opencv:export", "opencv:read_cameras"),
    Format("opensfm", "OpenSfM and ODM, reconstruction", WHOLE, "cartesian",
           "middle of the image, by its larger side", VISION, "brown-ideal",
           "larger side of the image, m, rotation vector", "opensfm:export",
           "opensfm:read_reconstruction:reconstruction.json", "opensfm:read_reconstruction_block",
           ("*.json",)),
    Format("odm", "ODM, gcp_list.txt and geo.txt", ("points", "marks"), "own", CENTRE, "none", "none",
           "px, m", "ground_points:export", ""),
    Format("metashape", "Metashape, camera XML", ("cameras", "orientations", "points", "marks"),
           "cartesian", CORNER, VISION, "brown-ideal", "px, m, 4 x 4 matrix",
           "metashape:write_metashape:cameras.xml", "metashape:read_local:cameras.xml",
           "metashape:read_camera_block", ("*.xml",), "metashape:recognises"),
    Format("metashape-csv", "Metashape, reference tables", ("points",), "own", "none", "none", "none", "m",
           "reference_table:export", ""),
    Format("pix4d", "Pix4D, .cam", ("cameras",), "none", CORNER, VISION, "brown-ideal",
           "mm on a nominal sensor", "pix4d_project:export", ""),
    Format("opf", "Open Photogrammetry Format 1.0", WHOLE, "cartesian", CORNER, PHOTO, "brown-ideal",
           "px, m, deg", "opf:export", "opf:read_opf:project.opf", "opf:read_project_block",
           ("*.opf",)),
    Format("photomodeler", "PhotoModeler, text export", WHOLE, "cartesian", CORNER, PHOTO, "brown-observed",
           "px, mm in the camera, m, deg", "photomodeler:write_photomodeler:block.txt",
           "photomodeler:read_photomodeler:block.txt", "photomodeler:read_photomodeler", ("*.txt",),
           "photomodeler:looks_like_export"),
    Format("dbat", "DBAT, XML set-up", ("cameras", "points", "marks"), "cartesian", CORNER, PHOTO,
           "brown-observed", "px, mm in the camera, m", "dbat:export", "dbat:read_dbat:setup.xml",
           "dbat:read_dbat", ("*.xml",), "dbat:recognises"),
    Format("jaicov", "JAICOV and AICON 3D Studio", WHOLE, "cartesian", "middle of the sensor, y up", PHOTO,
           "brown-ideal", "mm, rad", "jaicov:write_jaicov:block", "jaicov:read_unweighted:block.ior",
           "jaicov:read_jaicov", ("*.ior", "*.eor", "*.obc", "*.phc")),
    Format("micmac", "MicMac, XML", WHOLE, "cartesian", CENTRE, VISION, "brown-ideal", "px, m, matrix",
           "micmac:export", "micmac:read_export"),
    Format("patb", "PATB style, tables", ("orientations",), "own", "none", PHOTO, "none",
           "m; deg or gon, as asked; matrix from camera to object", "orientation_tables:export",
           "orientation_tables:read_matrices:orientations_matrix.txt"),
    Format("inpho", "Inpho, .prj", ("orientations",), "own", CENTRE, PHOTO, "none",
           "mm in the camera, m, matrix from object to camera",
           "orientation_tables:write_inpho:orientations.prj",
           "orientation_tables:read_inpho:orientations.prj"),
    Format("geojson", "GeoJSON", ("orientations", "points"), "wgs84", CENTRE, PHOTO, "none", "deg, m, px",
           "geographic:write_geojson:block.geojson", ""),
    Format("kml", "KML", ("orientations", "points"), "wgs84", CENTRE, PHOTO, "none", "deg, m, px",
           "geographic:write_kml:block.kml", ""),
    Format("geopackage", "GeoPackage", ("orientations", "points", "marks"), "wgs84", CENTRE, PHOTO, "none",
           "deg, m, px", "geographic:export_geopackage", ""),
    Format("photoscan", "PhotoScan and Metashape, project", WHOLE, "own", CORNER, VISION, "brown-ideal",
           "px, m", "", "", "photoscan:read_photoscan", ("*.psz", "*.psx")),
)  # fmt: skip


def exported() -> tuple[str, ...]:
    """Names of the formats that can be written."""
    return tuple(form.name for form in FORMATS if form.writes)


def named(name: str) -> Format:
    """Find a format that can be written; raises ConfigurationError when it is not known."""
    chosen = next((form for form in FORMATS if form.name == name and form.writes), None)
    if chosen is None:
        raise ConfigurationError(f"format {name!r} is not known", f"use {', '.join(exported())}")
    return chosen


def export(form: Format, folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """Write a block in a format.

    raises ConfigurationError, InputMalformedError: when the format has no place for the block, or a choice is
        missing.
    """
    if form.space == "cartesian":
        from photocal.exchange.reconstruction import to_cartesian

        given = to_cartesian(given)
    module, function, *file = form.writes.split(":")
    made: tuple[Conversion, ...] = _loaded(f"{module}:{function}")(folder.joinpath(*file), given, choices)
    return made


def read_any_block(source: Path) -> Block:
    """Read a block folder, also by its `block.toml`, or the set-up file of another program.

    raises PhotocalError: what its reader does.
    """
    from photocal.block.folder import SETUP, read_block

    if source.is_file() and source.name != SETUP:
        return read_foreign_block(source)
    return read_block(source.parent if source.is_file() else source)


def read_foreign_block(path: Path) -> Block:
    """Read a block of another program from one of its files."""
    if not path.exists():
        raise InputNotFoundError("does not exist", "check the path", where=path)
    form = next((form for form in FORMATS if form.takes(path)), None)
    if form is None:
        known = "; ".join(f"{form.title}: {', '.join(form.opens)}" for form in FORMATS if form.opens)
        raise InputMalformedError(
            "holds no block that is known",
            f"name a block folder, or a file of another program ({known})",
            where=path,
        )
    block: Block = _loaded(form.blocks)(path)
    root = os.path.commonpath([Path(file.path).parent for file in block.inputs])
    inputs = (replace(file, path=Path(file.path).relative_to(root).as_posix()) for file in block.inputs)
    return replace(block, inputs=tuple(inputs))


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

One pose belongs to all lines of an image: observations of a rolling shutter are corrected to that of the
middle line, and the command says so.

| name | format | holds | object space | pixel (0, 0) | camera axes | distortion | units | read |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
{table}

`photocal adjust` reads the files of the formats marked "adjust" directly, and projects of PhotoScan and
Metashape (.psz, .psx); where a format has no standard deviations of image coordinates, all of
them get 1 px, and the a posteriori variance factor says what they are worth.
"yes": read by the package; a .cam file needs the image size
beside it, GCP lists go to `photocal measure --gcp`. Of PhotoModeler its tables of 2-D and 3-D points are
read too.

What a format wants and an adjustment does not know is filled in: OPF gets 1970-01-01 as time of exposure
and 8-bit colour images; standard deviations that are not known are written as 0. Control points carry the
standard deviations of the adjusted coordinates.

Damaged files are read or refused in words, within a gigabyte: [evidence](evidence/fuzz_readers.md).
"""
# Read one by one, or with what only their reader is told: ground points, references, image size.
IN_PARTS = ("odm", "metashape-csv", "pix4d")


def page() -> str:
    """Give docs/exchange.md."""
    rows = [
        (
            f"`{form.name}`",
            form.title,
            ", ".join(form.holds),
            _SPACES[form.space],
            form.origin,
            form.axes,
            form.distortion,
            form.units,
            "adjust" if form.opens else "yes" if form.reads or form.name in IN_PARTS else "no",
        )
        for form in FORMATS
        if form.writes
    ]
    return _PAGE.format(table="\n".join("| " + " | ".join(row) + " |" for row in rows))


if __name__ == "__main__":
    print(page(), end="")
