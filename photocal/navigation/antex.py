"""Which antennas an ANTEX file has models of: phase centres, which the engine applies."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import ConfigurationError, InputMalformedError, reading


def read_antennas(path: Path) -> tuple[str, ...]:
    """Read the names (type and radome) of the receiver antennas whose models an ANTEX file has."""
    with reading(path, "name an ANTEX file, such as igs20.atx of the IGS"):
        lines = path.read_text(encoding="latin-1").splitlines()
    if not any(line[60:].startswith("ANTEX VERSION") for line in lines[:5]):
        raise InputMalformedError("is no ANTEX file", where=path, remedy="name one, such as igs20.atx")
    found = []
    starts = [k for k, line in enumerate(lines) if line[60:].startswith("START OF ANTENNA")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        try:
            name = _name(lines[start:end])
        except (ValueError, IndexError) as refusal:
            raise InputMalformedError(
                "is damaged", where=f"{path}, antenna of line {start + 1}", remedy="fetch the file again"
            ) from refusal
        if name is not None:
            found.append(name)
    return tuple(found)


def _name(lines: list[str]) -> str | None:
    """Read one antenna, its numbers, too, which the engine uses; None for a satellite's."""
    name, frequency = "", ""
    for line in lines:
        label, cells = line[60:].strip(), line[:60].split()
        if label == "TYPE / SERIAL NO":
            # A satellite has its number where a receiver antenna has none or a serial number.
            if line[20:21] in set("GRECJIS") and line[21:23].isdigit():
                return None
            name = " ".join(line[:20].split())
        elif label == "START OF FREQUENCY":
            frequency = cells[0]
        elif label in ("ZEN1 / ZEN2 / DZEN", "NORTH / EAST / UP"):
            _ = [float(cell) for cell in cells]
        elif frequency and line[:8].strip() == "NOAZI":
            _ = [float(cell) for cell in line[8:].split()]
    return name


def antenna_named(antennas: Sequence[str], name: str, path: Path) -> str:
    """Give the name of an antenna's model; without its radome where the file knows it with NONE only."""
    wanted = " ".join(name.split())
    for key in (wanted, f"{wanted} NONE", f"{wanted.split(' ')[0]} NONE" if wanted else ""):
        if key in antennas:
            return key
    alike = difflib.get_close_matches(wanted, antennas, 3, 0.4)
    raise ConfigurationError(
        f"antenna {name!r} is not in {path.name}",
        where=path,
        remedy=f"give type and radome as the file has them: {', '.join(alike) or 'none is alike'}",
    )
