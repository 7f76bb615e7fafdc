"""Antenna models in ANTEX files: phase centre offsets and their variation with the zenith angle."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, InputMalformedError, reading


@dataclass(frozen=True)
class AntennaModel:
    """One receiver antenna, calibrated.

    name: type and radome, as in the file.
    offsets_m: by frequency ("G01"), phase centre less antenna reference point, north, east, up.
    zenith_deg (n,): angles of the variations.
    variations_m: by frequency, (n,), without azimuth; added to the distance, as the offset's are.
    """

    name: str
    offsets_m: dict[str, Floats]
    zenith_deg: Floats
    variations_m: dict[str, Floats]

    def correction_m(self, frequency: str, azimuth_deg: float, zenith_deg: float) -> float:
        """What the antenna adds to the distance of a satellite (Rothacher and Schmid 2010, ANTEX 1.4)."""
        azimuth, zenith = np.radians([azimuth_deg, zenith_deg])
        towards = np.array(
            [np.cos(azimuth) * np.sin(zenith), np.sin(azimuth) * np.sin(zenith), np.cos(zenith)]
        )
        variation = np.interp(zenith_deg, self.zenith_deg, self.variations_m[frequency])
        return float(variation - self.offsets_m[frequency] @ towards)


def read_antennas(path: Path) -> dict[str, AntennaModel]:
    """Read the receiver antennas of an ANTEX file by their names; of several, the last.

    raises InputNotFoundError, InputMalformedError: when it cannot be read, or is no ANTEX file.
    """
    with reading(path, "name an ANTEX file, such as igs20.atx of the IGS"):
        lines = path.read_text(encoding="latin-1").splitlines()
    if not any(line[60:].startswith("ANTEX VERSION") for line in lines[:5]):
        raise InputMalformedError("is no ANTEX file", where=path, remedy="name one, such as igs20.atx")
    found: dict[str, AntennaModel] = {}
    starts = [k for k, line in enumerate(lines) if line[60:].startswith("START OF ANTENNA")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        try:
            model = _model(lines[start:end])
        except (ValueError, IndexError) as refusal:
            raise InputMalformedError(
                "is damaged", where=f"{path}, antenna of line {start + 1}", remedy="fetch the file again"
            ) from refusal
        if model is not None:
            found[model.name] = model
    return found


def _model(lines: list[str]) -> AntennaModel | None:
    """Read one antenna; None for a satellite's."""
    offsets: dict[str, Floats] = {}
    variations: dict[str, Floats] = {}
    name, frequency, grid = "", "", np.zeros(0)
    for line in lines:
        label, cells = line[60:].strip(), line[:60].split()
        if label == "TYPE / SERIAL NO":
            # A satellite has its number where a receiver antenna has none or a serial number.
            if line[20:21] in set("GRECJIS") and line[21:23].isdigit():
                return None
            name = " ".join(line[:20].split())
        elif label == "ZEN1 / ZEN2 / DZEN":
            first, last, step = map(float, cells)
            grid = np.arange(first, last + step / 2, step)
        elif label == "START OF FREQUENCY":
            frequency = cells[0]
        elif label == "NORTH / EAST / UP":
            offsets[frequency] = np.array([float(cell) for cell in cells]) / 1e3
        elif frequency and line[:8].strip() == "NOAZI":
            variations[frequency] = np.array([float(cell) for cell in line[8:].split()]) / 1e3
    return AntennaModel(name, offsets, grid, variations)


def antenna_named(antennas: dict[str, AntennaModel], name: str, path: Path) -> AntennaModel:
    """Give the model of an antenna; without its radome where the file knows it with NONE only.

    raises ConfigurationError: when the file has none of that name; says which are alike.
    """
    wanted = " ".join(name.split())
    for key in (wanted, f"{wanted} NONE", f"{wanted.split(' ')[0]} NONE" if wanted else ""):
        if key in antennas:
            return antennas[key]
    alike = difflib.get_close_matches(wanted, list(antennas), 3, 0.4)
    raise ConfigurationError(
        f"antenna {name!r} is not in {path.name}",
        where=path,
        remedy=f"give type and radome as the file has them: {', '.join(alike) or 'none is alike'}",
    )
