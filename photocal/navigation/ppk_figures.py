"""What `ppk.json` says, for those that compute with it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from photocal.base.codec import object_of, parsed_json
from photocal.navigation.common_errors import CommonErrors

FIGURES = "ppk.json"
_REMEDY = "compute the PPK again"


@dataclass(frozen=True)
class BaseFigures:
    """Of the base: by how much its position lies above that of its own code solution, m."""

    up_off_code_solution_m: float | None = None


@dataclass(frozen=True)
class PpkFigures:
    """What later steps take from the figures of a PPK run.

    common: errors that all positions share; None of a rover that stood still.
    record: all figures, as in `ppk.json`.
    """

    fixed_percent: float
    base: BaseFigures = BaseFigures()
    common: CommonErrors | None = None
    record: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, record: dict[str, Any], where: object = FIGURES) -> "PpkFigures":
        """Take them from a record; InputMalformedError for one that lacks something."""
        return object_of(cls, {**record, "record": record}, where, _REMEDY)

    @classmethod
    def read(cls, path: Path) -> "PpkFigures":
        """Read `ppk.json`; errors as of `photocal.base.codec.parsed_json` and `of`."""
        return cls.of(object_of(dict[str, Any], parsed_json(path, _REMEDY), path, _REMEDY), path)
