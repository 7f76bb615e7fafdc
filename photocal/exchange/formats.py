"""The formats of other programs: what each holds and means, and who detects, reads and writes it.

A new format is one module and one entry of formats.toml; another package adds one by an entry point of the
group `photocal.formats` that names a `Format`. Functions are loaded when they are used. What follows, with
the table filled in, is docs/exchange.md (`python -m photocal.exchange.formats`).

# Formats of other programs

Made by `python -m photocal.exchange.formats > docs/exchange.md`; `photocal export RUN --format NAME -o DIR`
writes them. Here the centre of the upper-left pixel is (0, 0), x runs right, y down; camera axes are x
right, y up, z backwards. Only the package `photocal.exchange` converts half pixels and signs.

"brown-ideal": the distortion is added to the projection; "brown-observed": it corrects the measurement.
Between formats of one direction nothing is lost. Between the two, a fit over the whole image replaces the
polynomial, and the command prints its rms and largest residual in px. "none": the file cannot store a
distortion.

A block in a coordinate reference system goes to Cartesian formats in the topocentric frame (east, north, up)
at its middle, where it was adjusted, so that residuals of image coordinates do not change; tables of
orientations and ODM's lists keep map coordinates and angles.

These formats have one exterior orientation for all lines of an image. Observations of a rolling shutter are
therefore corrected to the orientation of the middle line, and the command reports it.

| name | format | holds | object space | pixel (0, 0) | camera axes | distortion | units | read |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
{table}

`photocal adjust` reads the files of the formats marked "adjust" directly, and projects of PhotoScan and
Metashape (.psz, .psx); where a format has no standard deviations of image coordinates, all of them get 1 px,
and the a posteriori variance factor shows their actual precision. "yes": read by functions of
`photocal.exchange`; a .cam file needs the image size as well, and GCP lists are read by `photocal measure
--gcp`. PhotoModeler's tables of 2-D and 3-D points are read, too.

`photocal adopt` compares its figures with the quality report of a project, if there is one. The readers for
ODM (`report.pdf`, `stats.json`) and MicMac (Tapas, GCPBascule and Campari, kept as `campari.log`) were tested
with real reports, that for COLMAP (`model_analyzer.txt`) was written from its source code. No real report of
Pix4D (XML, HTML, PDF) or Metashape (PDF) was available: their tables are read by the column names that
published readers use, and unknown parts are left out. Of Pix4D's other files, `tp_orima.txt`, `tp_pix4d.txt`
and the rig parameters are not read: they repeat other files, and no description of their columns was
available.

Values that a format requires but an adjustment does not have are filled in: OPF gets 1970-01-01 as time of
exposure and 8-bit colour images; standard deviations that are not known are written as 0. Control points have
the standard deviations of the adjusted coordinates.

## Projects that `photocal adopt` adjusts again

- **Pix4D**: `params` with cameras, `_error`, `offset.xyz`, `tp_bingo`, control and `wkt.prj`; rigs by their
  poses. Weights of exactly 1 are manual tie points; check points are those of the project file (NAME.p4d
  beside the folder NAME) and of the report (`report/NAME_report`, XML, HTML, text or PDF).
- **Metashape**: projects, camera XML with markers and references. Markers whose reference is switched off are
check points, and so are those that the processing report (PDF, text) lists as such.
- **ODM, OpenSfM**: `reconstruction.json` with tracks and rigs. Names of `gcp_list.txt` that begin with check
  or chk, and points of the role `metrics_only`, are check points. Reports: `stats.json`, `report.pdf`.
- **COLMAP**: text and binary models, rigs and frames, `gcp_list.txt`. Report: what model_analyzer prints.
- **BAL**, Bundle Adjustment in the Large (`problem-*.txt`, also as .bz2 or .gz), which `photocal adjust`
  reads, too. Each image has its own camera of the model `rational`, whose c, K1 and K2 are f, k1 and k2; the
  datum is free. The format has neither the size of images nor a unit of lengths: images are as large as
  their observations reach, and lengths are called metres.
- **MicMac**: `Ori-*`, points and measures; `Check-Pts3D.xml` has check points. Report: what Campari prints.

From a report `adopt` reads the names of check points, sigmas of the camera, and the figures to compare. It is
searched for in the folder of the project and in `report` or `odm_report` next to it.

Map coordinates are transformed from their system: `wkt.prj` of Pix4D, the reference of Metashape, the first
line of `gcp_list.txt`. The files do not state the kind of the heights: heights are used unchanged, and the
certificate says so; within one block this has no measurable effect. Without a system, coordinates are used as
Cartesian, with a message where they are large enough to be map coordinates.

Left out and named: points whose rays have a parallax below 5 px (heads of one exposure are centimetres
apart), images with fewer than four rays and cameras without any, rays that do not fit. A camera without
distortion and with its principal point in the middle was never calibrated: it is named, and estimated.

Damaged files are read, or refused with a message, within a gigabyte of memory:
[evidence](evidence/fuzz_readers.md).
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from importlib import import_module, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from photocal.base import extensions
from photocal.base.errors import (
    ConfigurationError,
    InputMalformedError,
    InputNotFoundError,
    PhotocalError,
)

if TYPE_CHECKING:
    from photocal.block.model import Block
    from photocal.exchange.exporting import Choices
    from photocal.exchange.foreign_project import ForeignProject
    from photocal.geometry.conversion import Conversion


Part = Literal["cameras", "orientations", "points", "marks"]
# cartesian: a block in a reference system is taken to its topocentric frame; own: coordinates as they are;
# wgs84: longitude, latitude and ellipsoidal height; none: no places.
Space = Literal["cartesian", "own", "wgs84", "none"]


@dataclass(frozen=True)
class Format:
    """One format; its functions are those of one module, which is named in full.

    name: for `photocal export --format`.
    holds: what comes back when it is read; the points of some formats are the surveyed ones only.
    distortion: its direction: added to the projection, or correcting the measurement.
    reads: takes one of its files, gives a `ForeignProject`. Empty: it is not read.
    writes: takes a folder, or the file in it that is named after a colon, a `Block` and `Choices`;
        gives a `Conversion` for each camera. Empty: it is not exported.
    opens: patterns of the names of files that `photocal adjust` takes.
    search: pattern of the file that stands for a whole project in a folder; the first of `opens` without it.
    detects: whether such a file is of this format, where its name does not say it.
    """

    name: str
    module: str
    title: str
    holds: tuple[Part, ...]
    space: Space
    origin: str
    axes: str
    distortion: Literal["brown-ideal", "brown-observed", "none"]
    units: str
    reads: str = ""
    writes: str = ""
    opens: tuple[str, ...] = ()
    search: str = ""
    detects: str = ""

    def detect(self, path: Path) -> bool:
        """Whether a file is one of this format that `photocal adjust` takes."""
        named = any(fnmatch(path.name.lower(), pattern.lower()) for pattern in self.opens)
        return named and self.fits(path)

    def fits(self, path: Path) -> bool:
        """Whether a file of such a name is one of this format."""
        return not self.detects or bool(self._function(self.detects)(path))

    def read(self, path: Path) -> ForeignProject:
        """Read a project from one of its files, or from the folder that has it."""
        if path.is_dir():
            path = next((file for file in self.found(path) if self.fits(file)), path)
        given = self._read(path)
        # Files that were read are named within the folder that has them all.
        files = given.block.inputs
        root = os.path.commonpath([Path(file.path).parent for file in files]) if files else ""
        inputs = (replace(file, path=Path(file.path).relative_to(root).as_posix()) for file in files)
        return replace(given, block=replace(given.block, inputs=tuple(inputs)))

    def _read(self, path: Path) -> ForeignProject:
        try:
            given: ForeignProject = self._function(self.reads)(path)
        except PhotocalError:
            raise
        except Exception as failure:
            if self in FORMATS:
                raise
            raise InputMalformedError(
                f"could not be read as {self.title} ({type(failure).__name__}: {failure})",
                f"is it complete? If so, ask the makers of {self.module}",
                where=path,
            ) from failure
        return given

    def found(self, folder: Path) -> list[Path]:
        """Files named as a project is: what lies least deep is the project, what lies deeper its parts."""
        patterns = (self.search,) if self.search else self.opens[:1]
        files = (file for pattern in patterns for file in folder.rglob(_in_any_case(pattern)))
        return sorted(files, key=lambda file: (len(file.parts), file.name))

    def write(self, folder: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
        """Write a block.

        raises ConfigurationError, InputMalformedError: when the format has no place for the block, or a
            choice is missing.
        """
        if self.space == "cartesian":
            from photocal.exchange.exporting import to_cartesian

            given = to_cartesian(given)
        name, *file = self.writes.split(":")
        made: tuple[Conversion, ...] = self._function(name)(folder.joinpath(*file), given, choices)
        return made

    def _function(self, name: str) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(import_module(self.module), name)
        return function


def _in_any_case(pattern: str) -> str:
    """A pattern of names whose letters may be capitals: copies of other systems have them."""
    letters = re.compile(r"\[[^]]*\]|[a-zA-Z]")
    return letters.sub(lambda at: at[0] if at[0][0] == "[" else f"[{at[0].lower()}{at[0].upper()}]", pattern)


def _shipped() -> Iterator[Format]:
    """Give the formats of the table."""
    content = resources.files(__package__).joinpath("formats.toml").read_text(encoding="utf-8")
    for entry in tomllib.loads(content)["format"]:
        keys: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in entry.items()}
        yield Format(**keys)


# In the order in which a folder is searched for a project.
FORMATS = tuple(_shipped())


def added() -> tuple[Format, ...]:
    """Formats that other packages add; raises ConfigurationError for an entry point that gives none."""
    return tuple(extensions.brought(extensions.FORMATS, Format).values())


def known() -> tuple[Format, ...]:
    """All formats, those of other packages first: who installs one wants it to be used."""
    return (*added(), *FORMATS)


def exported() -> tuple[str, ...]:
    """Names of our formats that can be written."""
    return tuple(form.name for form in FORMATS if form.writes)


def named(name: str) -> Format:
    """Find a format that can be written; raises ConfigurationError when it is not known."""
    ours = {form.name: form for form in FORMATS if form.writes}
    if name in ours:
        return ours[name]
    theirs = {form.name: form for form in added() if form.writes}
    if name not in theirs:
        raise ConfigurationError(f"format {name!r} is not known", f"use {', '.join([*ours, *theirs])}")
    return theirs[name]


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
    return read_foreign_file(path).block


def read_foreign_file(path: Path) -> ForeignProject:
    """Read a project of another program from one of its files."""
    if not path.exists():
        raise InputNotFoundError("does not exist", "check the path", where=path)
    form = next((form for form in known() if form.detect(path)), None)
    if form is None:
        names = "; ".join(f"{form.title}: {', '.join(form.opens)}" for form in known() if form.opens)
        raise InputMalformedError(
            "has no block in a known format",
            f"name a block folder, or a file of another program ({names})",
            where=path,
        )
    return _measured(form, path)


def _measured(form: Format, path: Path) -> ForeignProject:
    given = form.read(path)
    if not len(given.block.observations.image):
        raise InputMalformedError("has no measurements of points", "export them too", where=path)
    return given


def read_foreign_project(path: Path) -> ForeignProject:
    """Read a project, its observations in px: a folder, or one of the files that `photocal adjust` takes.

    raises InputNotFoundError: when nothing in it is known.
    raises PhotocalError: for what cannot be read.
    """
    from numpy import isnan

    from photocal.exchange.foreign_project import in_pixels

    given = _of_folder(path) if path.is_dir() else read_foreign_file(path)
    # Positions are a datum, too.
    datum = given.block.datum if isnan(given.position).all() else "control"
    return replace(given, block=replace(in_pixels(given.block), datum=datum))


def _of_folder(folder: Path) -> ForeignProject:
    refusal: PhotocalError | None = None
    forms = [form for form in known() if form.reads and "marks" in form.holds]
    for form in forms:
        for file in form.found(folder):
            try:
                if form.fits(file):
                    return _measured(form, file)
            except PhotocalError as failure:
                refusal = refusal or failure
    if refusal is not None:
        raise refusal
    if any(folder.rglob("Ori-PerspCentral-*.xml")):
        raise InputNotFoundError(
            "has orientations of MMVII, whose form is not read",
            "give the Ori-* folder of mm3d; points and measurements of MMVII are read by photocal new",
            where=folder,
        )
    raise InputNotFoundError(
        "has no project in a known format",
        f"name the folder of a project of another program ({'; '.join(form.title for form in forms)})",
        where=folder,
    )


_SPACES = {
    "cartesian": "Cartesian, m",
    "own": "the block's own",
    "wgs84": "WGS 84 (a local frame with --origin)",
    "none": "none",
}
# Read file by file, or with options that only their reader takes: ground points, references, image size.
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
    text = str(__doc__)
    table = "\n".join("| " + " | ".join(row) + " |" for row in rows)
    return text[text.index("# Formats") :].format(table=table)


if __name__ == "__main__":
    print(page(), end="")
