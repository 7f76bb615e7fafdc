"""Options of `photocal radiometry`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


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
        Path | None, Option("Folder of pictures of an even surface, at several exposure times for linearity.")
    ] = None

    def __post_init__(self) -> None:
        """Refuse a star without its place."""
        if self.star is not None and self.place is None:
            raise ConfigurationError("--star needs --place", remedy="give COLUMN,ROW,RADIUS in pixels")
