"""RTKLIB's programs, run as a person would."""

from __future__ import annotations

import datetime as dt
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acquire.simulate.gnss.flights import AXES, BASE_M, SECOND, Flight, Floats, Times


@dataclass(frozen=True)
class Rinex:
    """Files that convbin made of the streams."""

    rover: Path
    base: Path
    base_of_rtcm: Path
    navigation: Path
    navigation_of_rtcm: Path


def to_rinex(flight: Flight, folder: Path, *options: str) -> Rinex:
    if shutil.which("convbin") is None or shutil.which("rnx2rtkp") is None:
        pytest.skip("RTKLIB (rnx2rtkp, convbin) is not installed")
    made: dict[str, Path] = {}
    near = dt.datetime(1980, 1, 6) + dt.timedelta(seconds=flight.session.span_gps_ns[0] // SECOND)
    for name, form, stream in (
        ("rover", "ubx", flight.rover),
        ("base", "ubx", flight.base_ubx),
        ("rtcm", "rtcm3", flight.base_rtcm),
    ):
        source = folder / f"{name}.{form}"
        source.write_bytes(stream.data)
        made[name] = folder / f"{name}.obs"
        subprocess.run(
            ["convbin", "-r", form, "-v", "3.03", "-od", "-os", *options]
            + (["-tr", near.strftime("%Y/%m/%d"), near.strftime("%H:%M:%S")] if form == "rtcm3" else [])
            + ["-o", str(made[name]), "-n", str(made[name].with_suffix(".nav")), str(source)],
            check=True,
            capture_output=True,
        )
    return Rinex(
        made["rover"],
        made["base"],
        made["rtcm"],
        made["rover"].with_suffix(".nav"),
        made["rtcm"].with_suffix(".nav"),
    )


@dataclass(frozen=True)
class Solution:
    """What rnx2rtkp wrote: times, geocentric positions, quality (1 fixed, 2 float, 5 single)."""

    time: Times
    position_m: Floats
    quality: NDArray[np.int64]

    def error_enu(self, truth: Callable[[Times], Floats]) -> Floats:
        return (self.position_m - truth(self.time)) @ AXES.T


SETTINGS = {
    "pos1-frequency": "l1+l2",
    "pos1-elmask": "15",
    "pos1-ionoopt": "brdc",
    "pos1-tropopt": "saas",
    "pos1-sateph": "brdc",
    "pos1-navsys": "9",
    "pos2-armode": "continuous",
    "pos2-arthres": "3",
    # Whole cycles of the same satellites are searched for as `photocal ppk` does.
    "pos2-arelmask": "20",
    "out-solformat": "xyz",
    "out-timesys": "gpst",
    "out-timeform": "tow",
    "out-timendec": "9",
}


def positions(files: list[Path], folder: Path, mode: str, soltype: str = "forward") -> Solution:
    """Run rnx2rtkp as a person would, with its own coordinates of the base."""
    settings = SETTINGS | {"pos1-posmode": mode, "pos1-soltype": soltype}
    options = folder / "options.conf"
    options.write_text("".join(f"{key}={value}\n" for key, value in settings.items()))
    output = folder / f"{mode}-{soltype}.pos"
    subprocess.run(
        ["rnx2rtkp", "-k", str(options), "-o", str(output)]
        + (["-r", *(f"{v:.4f}" for v in BASE_M)] if mode == "kinematic" else [])
        + [str(file) for file in files],
        check=True,
        capture_output=True,
    )
    rows = [line.split() for line in output.read_text().splitlines() if not line.startswith("%")]
    time = [int(r[0]) * 604_800 * SECOND + round(float(r[1]) * 1e9) for r in rows]
    return Solution(
        np.array(time, np.int64),
        np.array([[float(v) for v in r[2:5]] for r in rows]),
        np.array([int(r[5]) for r in rows], np.int64),
    )
