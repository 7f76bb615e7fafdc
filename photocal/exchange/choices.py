"""What the writers of some formats must be told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Angle = Literal["deg", "gon"]


@dataclass(frozen=True)
class Origin:
    """Where a local frame touches the ellipsoid.

    height_m: ellipsoidal.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True)
class Choices:
    """What some formats must be told.

    angle_unit: for tables of angles.
    origin: of a local frame, for geographic formats.
    changed_utc: time that a file may note as that of its making.
    """

    angle_unit: Angle | None = None
    origin: Origin | None = None
    changed_utc: str = "1970-01-01T00:00:00.000Z"


def file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"
