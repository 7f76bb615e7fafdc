"""Long study: are float positions of PPK as good as their sigmas say? Recordings whose truth is known.

Writes `docs/evidence/ppk_floats.md`. No ambiguity is fixed: every epoch is float. Recordings are taken whole
and in pieces, since what lasts longer than a recording neither of its directions shows.

Run: `make evidence`, or `python -m tests.evidence.ppk_floats`.
"""

from __future__ import annotations

import gzip
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Wire
from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.navigation.engine import (
    FIXED,
    FLOAT,
    Direction,
    EngineSolution,
    in_order,
    solve,
    to_rinex,
)
from photocal.navigation.fix_validation import judge
from photocal.navigation.ppk import options_for, process
from photocal.navigation.ppk_inputs import Inputs
from photocal.navigation.precise_results import read_observation_file
from photocal.navigation.satellite_residuals import code_errors, satellite_residuals
from tests.photocal.navigation.conftest import frames_of

Floats = NDArray[np.float64]
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "ppk_floats.md"
DATA = Path(os.environ.get("PHOTOCAL_SHARED", Path(__file__).parents[3] / "shared")) / "data"
# Earth-centred, of the folders' READMEs: base and rover of GEONET, bases of the two days in Galway.
GEONET_BASE = np.array([-3978241.958, 3382840.234, 3649900.853])
GEONET_ROVER = np.array([-3976219.1880, 3382371.6059, 3652511.1427])
STILL_BASE = np.array([3774089.2120, -601661.6157, 5089321.2474])
MOVING_BASE = np.array([3774696.5547, -596647.9083, 5089485.6511])
# A ratio that no ambiguities have.
NEVER = 1e9
DIRECTIONS: tuple[Direction, ...] = ("combined", "forward", "backward")
# Length and number of pieces, from the begin on.
PIECES = {
    "two mosaic-X5, 1 m, 1 Hz": ((60, 4),),
    "M8P, standing, 1 Hz": ((120, 9), (300, 4)),
    "M8P, moving, 1 Hz": ((300, 3),),
}


@dataclass(frozen=True)
class Recording:
    """Observations of both, ephemerides, where the base was, and where the rover (None: by its fixes)."""

    rover: Path
    base: Path
    navigation: list[Path]
    base_m: Floats
    rover_m: Floats | None = None


def recordings(folder: Path) -> Iterator[tuple[str, Recording]]:
    """Give the recordings by name."""
    known, geonet = DATA / "gnss-rinex-static-known", DATA / "gnss-rtklib-testdata" / "rinex"
    base_m, rover_m = (position(known / f"{who}_position.txt") for who in ("base", "rover"))
    files = known / "rover.obs", known / "base.obs", [known / "base.nav"]
    yield "two mosaic-X5, 1 m, 1 Hz", Recording(*files, base_m, rover_m)
    first, second = (geonet / f"{name}0920.05o" for name in ("0759", "3040"))
    ephemerides = sorted(geonet.glob("*.05n"))
    yield "GEONET, 3 km, 30 s", Recording(first, second, ephemerides, GEONET_BASE, GEONET_ROVER)
    for name, rover, base, base_m in (
        ("M8P, standing, 1 Hz", "rover-20181004-1237", "base-20181004-1236", STILL_BASE),
        ("M8P, moving, 1 Hz", "rover-20181009-1221", "base-20181009-1220", MOVING_BASE),
    ):
        made = [converted(stream, folder) for stream in (rover, base)]
        yield name, Recording(made[0][0], made[1][0], [nav for _, nav in made], base_m)


def position(path: Path) -> Floats:
    """Read latitude, longitude and height."""
    lat, lon, height = map(float, path.read_text().split())
    return np.asarray(geocentric(lat, lon, height))


def converted(name: str, folder: Path) -> tuple[Path, Path]:
    """Convert what is whole of a recorded receiver."""
    frames = frames_of(gzip.decompress((DATA / "gnss-ubx-m8p-base-rover" / f"{name}.ubx.gz").read_bytes()))
    raw = b"".join(f.data for f in frames if f.wire == Wire.UBX and f.kind in (0x0213, 0x0215))
    return to_rinex(raw, "ubx", folder / name)


def piece(path: Path, target: Path, begin_s: float, length_s: float) -> Path:
    """Write the epochs of a RINEX file from some seconds after its first on."""
    head, *epochs = path.read_text(encoding="ascii").split("\n> ")
    hours, minutes, seconds = np.array([text.split()[3:6] for text in epochs], float).T
    after = 3600 * hours + 60 * minutes + seconds
    after -= after[0] + begin_s
    kept = [text for text, s in zip(epochs, after.tolist(), strict=True) if 0 <= s < length_s]
    target.write_text("\n> ".join([head, *kept]).rstrip("\n") + "\n", encoding="ascii")
    return target


def fixes(recording: Recording, folder: Path) -> EngineSolution:
    """Give the validated fixes of a recording."""
    rover, base = read_observation_file(recording.rover), read_observation_file(recording.base)
    inputs = Inputs(rover, base, recording.navigation, recording.base_m, "")
    found = process(inputs, options_for(rover, base), "kinematic", folder).judgement
    assert found is not None
    return found.solution.rows(found.solution.quality == FIXED)


def row(name: str, recording: Recording, rover: Path, known: EngineSolution | None, bands: int) -> str:
    """Return a line of the table: a recording or a piece of it, nothing fixed."""
    observed = read_observation_file(rover), read_observation_file(recording.base)
    options = replace(options_for(*observed), two_frequencies=bands > 1, ratio=NEVER)
    files, base_m = [rover, recording.base, *recording.navigation], recording.base_m
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        runs = {
            direction: in_order(solve("kinematic", direction, files, options, base_m, folder))
            for direction in DIRECTIONS
        }
        code = solve("single", "forward", [rover, *recording.navigation], options, None, folder)
        codes = code_errors(satellite_residuals("kinematic", rover, folder))
    both = runs["combined"].rows(runs["combined"].quality == FLOAT)
    judged = [judge(both, runs["forward"], runs["backward"], code, NEVER, c) for c in (None, codes)]
    at = np.zeros(len(both), np.int64) if known is None else known.at(both.time)
    chosen = at >= 0
    if chosen.sum() < 10:
        return ""
    there = np.array([recording.rover_m]) if known is None else known.xyz_m[at[chosen]]
    lat, lon, _ = geodetic(there[0])
    error = (both.xyz_m[chosen] - there) @ enu_axes(lat, lon).T
    sigmas = both.sigma_m, *(each.solution.sigma_m for each in judged)
    cells = [_three(error), *(_three(error / sigma[chosen]) for sigma in sigmas)]
    sys.stderr.write(f"\r{name}   ")
    return f"| {name} | {bands} | {chosen.sum()} | {' | '.join(cells)} |"


def _three(values: Floats) -> str:
    return " ".join(f"{v:.2f}" for v in np.sqrt(np.mean(values**2, axis=0)).tolist())


def rows() -> Iterator[str]:
    """Give the lines of all recordings and of their pieces."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, recording in recordings(folder):
            known = fixes(recording, folder) if recording.rover_m is None else None
            for bands in (1, 2) if recording.rover_m is not None else (1,):
                yield row(name, recording, recording.rover, known, bands)
            for length_s, count in PIECES.get(name, ()):
                for k in range(count):
                    part = piece(recording.rover, folder / "piece.obs", k * length_s, length_s)
                    yield row(f"{name}, {length_s} s from {k * length_s} s", recording, part, known, 1)


def main() -> None:
    """Write the table."""
    lines = [
        "# Float sigmas: recordings whose truth is known, nothing fixed",
        "",
        "Root mean squares east, north, up. Truth: the known position of the rover, or its validated",
        "fixes. `by the directions`: sigmas from the difference of forward and backward runs. `stated`:",
        "these, enlarged by the lasting errors that residuals of the codes show",
        "(`photocal/navigation/float_errors.py`), which has no constant of its own. 1: errors are as large",
        "as stated. A row is one session, whose errors are correlated. Made by",
        "`python -m tests.evidence.ppk_floats`.",
        "",
        "| recording | frequencies | epochs | error, m | error/sigma, engine | by the directions | stated |",
        "|---|---|---|---|---|---|---|",
        *filter(None, rows()),
    ]
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stderr.write("\n")


if __name__ == "__main__":
    main()
