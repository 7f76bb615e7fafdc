"""Geoid and datum grids of PROJ: which are here, which a reference system needs, and how they come here."""

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from photocal.base.errors import ConfigurationError, OutputError

if TYPE_CHECKING:
    from pyproj.transformer import TransformerGroup

Area = tuple[float, float, float, float]


def grids_here() -> list[str]:
    """Names of the grids that PROJ finds on this machine."""
    from pyproj import datadir

    folders = {*datadir.get_data_dir().split(os.pathsep), _user_folder()}
    paths = (path for folder in folders for path in Path(folder).glob("*"))
    return sorted({path.name for path in paths if path.suffix in (".tif", ".gtx")})


def _user_folder(*, create: bool = False) -> str:
    from pyproj import _context

    return str(_context.get_user_data_dir(create=create))


def missing_grids(crs: str, area: Area | None = None) -> list[str]:
    """Name the grids that the best way from GNSS coordinates to a system needs and that are not here.

    area: west, south, east, north, degrees; the whole area of the system when not given.
    raises ConfigurationError: when there is no such system.
    """
    group = _ways(crs, area)
    best = [operation for operation in group.unavailable_operations[:1] if not group.best_available]
    return sorted({grid.short_name for operation in best for grid in operation.grids if not grid.available})


def fetch_grids(crs: str, area: Area | None = None) -> tuple[str, ...]:
    """Download the missing grids of a system into the user's folder of PROJ, and name them.

    raises OutputError: when the network or the folder refuses.
    """
    missing = missing_grids(crs, area)
    if missing:
        folder = Path(_user_folder(create=True))
        try:
            _ways(crs, area).download_grids(folder, open_license=True)
        except OSError as refusal:
            raise OutputError(
                f"{', '.join(missing)} cannot be fetched ({refusal})",
                "connect to the network, or copy these files of the PROJ data there",
                where=folder,
            ) from None
    return tuple(missing)


def _ways(crs: str, area: Area | None) -> "TransformerGroup":
    from pyproj.aoi import AreaOfInterest
    from pyproj.exceptions import CRSError
    from pyproj.transformer import TransformerGroup

    interest: Any = None if area is None else AreaOfInterest(*area)
    with warnings.catch_warnings():
        # It warns of what is missing: that is the question here.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return TransformerGroup(
                "EPSG:4979", crs, always_xy=True, area_of_interest=interest, allow_ballpark=False
            )
        except CRSError as refusal:
            raise ConfigurationError(
                f"there is no reference system {crs!r}", "name one such as EPSG:31982+5773"
            ) from refusal
