"""Options of `photocal measure`.

Options of `photocal radiometry`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class MeasureOptions(Options):
    """What is measured in the pictures, control and lens, and the methods."""

    gcp: Annotated[
        Path | None,
        Option("Marked control points: gcp_list.txt, Metashape's markers (.xml), OpenSfM's (.json)."),
    ] = None
    marks: Annotated[
        tuple[Path, ...],
        Option("Marks for a project: of Pix4D (.csv, .txt), Metashape (.xml, .csv), OpenSfM, gcp_list.txt."),
    ] = ()
    height: Annotated[str, Option("Height kind of the control points: ellipsoidal or orthometric.")] = ""
    crs: Annotated[str, Option("System of the control points where their file states a wrong one.")] = ""
    gcp_sigma: Annotated[
        str, Option("Sigma of control points, horizontal,vertical, m, where their file has none.")
    ] = "0.02,0.03"
    board: Annotated[str, Option("Calibration board: squares in a row and in a column, such as 10x7.")] = ""
    square_m: Annotated[
        float, Option("Side of a square of the board, m; without it the unit is one square.")
    ] = 1.0
    charuco: Annotated[
        str, Option("Marker dictionary of a ChArUco board, such as 4x4_50 or apriltag_36h11.")
    ] = ""
    field: Annotated[
        str, Option("Field of coded targets without coordinates: their dictionary, such as 4x4_250.")
    ] = ""
    distances: Annotated[
        Path | None,
        Option("Tape distances in a field: CSV from, to, value, sigma (m); 17.1 is corner 1 of target 17."),
    ] = None
    run: Annotated[Path | None, Option("With --field: adjust the block, too, into this folder.")] = None
    c_px: Annotated[float, Option("Principal distance, px; overrides the value in the pictures.")] = 0.0
    focal_mm: Annotated[float, Option("Focal length, mm; overrides the value in the pictures.")] = 0.0
    workers: Annotated[int, Option("Number of processes; 0: one for each core.")] = 0
    cluster: Annotated[
        str, Option("Dask scheduler whose workers share images and cache, such as tls://HOST:8786.")
    ] = ""
    cache: Annotated[
        Path | None, Option("Folder for features and matches; ~/.cache/photocal when not given.")
    ] = None

    def __post_init__(self) -> None:
        """Refuse options that contradict each other."""
        if self.charuco and not self.board:
            raise ConfigurationError("--charuco needs a board", "give --board COLUMNSxROWS")
        if self.cluster and self.workers:
            raise ConfigurationError(
                "--workers and --cluster are both given", "choose processes here or a cluster"
            )

    @property
    def gcp_sigma_m(self) -> tuple[float, float]:
        """Sigma of control points in plane and height, m; ConfigurationError for an invalid text."""
        form = "HORIZONTAL,VERTICAL: metres, such as 0.02,0.03"
        horizontal, vertical = numbers_of(self.gcp_sigma, "--gcp-sigma", form)
        if not (horizontal > 0 and vertical > 0):
            raise ConfigurationError(f"--gcp-sigma {self.gcp_sigma} is not positive", f"give {form}")
        return horizontal, vertical


@dataclass(frozen=True, kw_only=True)
class RadiometryOptions(Options):
    """Pictures of which the radiometry is measured, and what they show."""

    edge: Annotated[Path | None, Option("Picture of a slanted edge: its MTF (ISO 12233).")] = None
    region: Annotated[str | None, Option("COLUMN,ROW,WIDTH,HEIGHT of the edge in it, px.")] = None
    star: Annotated[Path | None, Option("Picture of a Siemens star.")] = None
    place: Annotated[str | None, Option("COLUMN,ROW,RADIUS of the star in it, px.")] = None
    spokes: Annotated[int, Option("Bright sectors of the star.", least=4)] = 36
    gsd_cm: Annotated[float | None, Option("Ground sampling distance at the star, cm.")] = None
    flat: Annotated[
        Path | None, Option("Folder of flat-field pictures, at several exposure times for linearity.")
    ] = None

    def __post_init__(self) -> None:
        """Refuse a star without its place, and what is said of a picture that is not given."""
        if self.star is not None and self.place is None:
            raise ConfigurationError("--star needs --place", remedy="give COLUMN,ROW,RADIUS in pixels")
        if self.edge is None and self.region is not None:
            raise ConfigurationError("--region without --edge", remedy="give the picture of the edge, too")
        if self.star is None and (self.place or self.gsd_cm is not None):
            raise ConfigurationError(
                "--place or --gsd-cm without --star", remedy="give the picture of the star, too"
            )
        if self.gsd_cm is not None and not self.gsd_cm > 0:
            raise ConfigurationError(f"--gsd-cm {self.gsd_cm} is not positive", remedy="give centimetres")
