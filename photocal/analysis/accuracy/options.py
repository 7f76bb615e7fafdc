"""Options of a judgement by accuracy standards."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from photocal.base.options import Option, Options

if TYPE_CHECKING:
    from photocal.analysis.accuracy.standard import Question, Standard


@dataclass(frozen=True, kw_only=True)
class JudgementOptions(Options):
    """Standards, scale and tests by which check points are judged."""

    standard: Annotated[
        tuple[str, ...],
        Option("decree-89817, pec-pcd, asprs-2024 or a TOML file; may be repeated. Without: all three."),
    ] = ()
    scale: Annotated[str | None, Option("Map scale to judge at, such as 1:1000.")] = None
    interval: Annotated[float | None, Option("Contour interval in metres to judge at.")] = None
    confidence: Annotated[
        float, Option("Level of the tests: two-sided for the bias, one-sided for the precision.")
    ] = 0.90
    survey_horizontal: Annotated[
        float | None, Option("Horizontal (radial) RMSE of the survey of the check points, metres.")
    ] = None
    survey_vertical: Annotated[
        float | None, Option("Vertical RMSE of the survey of the check points, metres.")
    ] = None
    target_horizontal: Annotated[float | None, Option("Required horizontal (radial) RMSE, metres.")] = None
    target_vertical: Annotated[float | None, Option("Required vertical RMSE, metres.")] = None
    gsd: Annotated[
        float | None,
        Option("Ground sampling distance, metres, to count points within one and two; a block has its own."),
    ] = None

    def question(self) -> "Question":
        """Give the question; raises ConfigurationError for an invalid scale."""
        from photocal.analysis.accuracy.standard import Question, parse_scale

        return Question(
            None if self.scale is None else parse_scale(self.scale),
            self.interval,
            self.confidence,
            self.survey_horizontal,
            self.survey_vertical,
            self.target_horizontal,
            self.target_vertical,
            self.gsd,
        )

    def standards(self) -> "tuple[Standard, ...]":
        """Read the standards, all shipped ones where none is named; InputNotFoundError for an unknown one."""
        from photocal.analysis.accuracy.standard import SHIPPED, load_standard

        return tuple(load_standard(name) for name in self.standard or SHIPPED)


@dataclass(frozen=True, kw_only=True)
class MapOptions(Options):
    """Pictures and maps of the discrepancies."""

    figures: Annotated[
        Path | None, Option("With --discrepancies: folder for residual map and histograms (PDF).")
    ] = None
    geopackage: Annotated[Path | None, Option("With --discrepancies: GeoPackage to write, for QGIS.")] = None
    crs: Annotated[
        str | None, Option("Projected system of E and N for the GeoPackage, such as EPSG:31982.")
    ] = None
