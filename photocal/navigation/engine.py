"""The PPK engine: RINEX from raw frames, positions from RINEX.

The engine is RTKLIB 2.4.3 (Takasu and Yasuda 2009) by its programs `convbin` and `rnx2rtkp`, as Debian
packages them. Its fork demo5 fixes more epochs and, on a rover among trees, 2 % of them wrongly.
"""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, ProgramMissingError
from photocal.navigation.engine_output import (
    EngineSolution,
    SatelliteResiduals,
    read_satellite_residuals,
    read_solution,
)
from photocal.navigation.time import GpsTime

Mode = Literal["kinematic", "static", "single", "ppp-static"]
Direction = Literal["forward", "backward", "combined"]
_SYSTEMS = {"G": 1, "S": 2, "R": 4, "E": 8, "J": 16, "C": 32}


@dataclass(frozen=True)
class ProcessingOptions:
    """How positions are computed.

    systems: letters of the satellite systems.
    two_frequencies: whether L2 is used beside L1.
    elevation_deg: satellites below are left out.
    ratio: least ratio of the second best to the best ambiguities for a fix.
    rover_antenna_m, base_antenna_m: heights of the antenna reference points above the marks; None: as in the
        RINEX header.
    precise: whether orbits and clocks come from products (SP3, CLK) instead of broadcast ephemerides.
    antex: models of the antennas; with products also of the satellites'; None: without.
    rover_antenna, base_antenna: names in that file; empty: without a model.
    """

    systems: str
    two_frequencies: bool
    elevation_deg: float = 15.0
    ratio: float = 3.0
    rover_antenna_m: float | None = None
    base_antenna_m: float | None = None
    precise: bool = False
    antex: Path | None = None
    rover_antenna: str = ""
    base_antenna: str = ""


@dataclass(frozen=True)
class Rtklib:
    """RTKLIB's command line programs: what converts and computes."""

    name: str = "RTKLIB 2.4.3 (rnx2rtkp)"

    def convert(self, raw: bytes, form: str, stem: Path, near: GpsTime | None = None) -> tuple[Path, Path]:
        """Write observations and ephemerides as RINEX beside `stem` from intact frames, by `convbin`.

        form: as `convbin` calls it.
        near: settles the week of RTCM.
        """
        # A file that would be empty is not written.
        source = stem.with_suffix(f".{form}")
        source.write_bytes(raw)
        observations, navigation = stem.with_suffix(".obs"), stem.with_suffix(".nav")
        arguments = ["-r", form, "-v", "3.03", "-od", "-os", "-o", observations, "-n", navigation]
        if near is not None:
            date, time = near.iso()[0].split(" ")
            arguments += ["-tr", date.replace("-", "/"), time[:8]]
        _run("convbin", [*map(str, arguments), str(source)])
        return observations, navigation

    def solve(
        self,
        mode: Mode,
        direction: Direction,
        files: list[Path],
        options: ProcessingOptions,
        base_m: Floats | None,
        folder: Path,
    ) -> EngineSolution:
        """Compute positions from rover, base and navigation files with `rnx2rtkp`."""
        settings = folder / f"{mode}-{direction}.conf"
        settings.write_text(configuration(mode, direction, options))
        output = folder / f"{files[0].stem}-{mode}-{direction}.pos"
        arguments = ["-k", str(settings), "-o", str(output)]
        if mode == "ppp-static":
            # Multipath lasts about a minute: more epochs tell nothing new, but the engine would think so.
            arguments += ["-ti", "30"]
        if base_m is not None:
            arguments += ["-r", *(f"{v:.4f}" for v in base_m)]
        _run("rnx2rtkp", [*arguments, *map(str, files)])
        if not output.exists():
            raise IllPosedError(
                f"the engine found no position ({mode}, {direction})",
                "check that ephemerides and observations are of the same time",
                where=files[0],
            )
        return read_solution(output)

    def satellite_residuals(self, mode: Mode, rover: Path, folder: Path) -> SatelliteResiduals:
        """Return the satellites of the forward run with the base that `solve` has done in the folder."""
        return read_satellite_residuals(folder / f"{rover.stem}-{mode}-forward.pos.stat")


def configuration(mode: Mode, direction: Direction, options: ProcessingOptions) -> str:
    """Return the engine's configuration file, also for a run by hand."""
    systems = sum(_SYSTEMS.get(letter, 0) for letter in options.systems)
    settings = {
        "pos1-posmode": mode,
        "pos1-frequency": "l1+2" if options.two_frequencies else "l1",
        "pos1-soltype": direction,
        "pos1-elmask": f"{options.elevation_deg:g}",
        "pos1-ionoopt": "brdc",
        "pos1-tropopt": "saas",
        "pos1-sateph": "precise" if options.precise else "brdc",
        "pos1-dynamics": "off",
        "pos1-navsys": str(systems),
        "pos2-armode": "continuous",
        "pos2-gloarmode": "on",
        "pos2-arthres": f"{options.ratio:g}",
        "out-solformat": "llh",
        "out-outhead": "on",
        "out-outvel": "on",
        "out-timesys": "gpst",
        "out-timeform": "tow",
        "out-timendec": "9",
        "out-degform": "deg",
        "out-height": "ellipsoidal",
        "out-solstatic": "all",
    }
    for antenna, name, height_m in (
        ("ant1", options.rover_antenna, options.rover_antenna_m),
        ("ant2", options.base_antenna, options.base_antenna_m),
    ):
        # With the type "*" the engine takes type and height from the header and passes over the height here.
        settings[f"{antenna}-anttype"] = name or ("*" if height_m is None else "")
        settings[f"{antenna}-antdelu"] = f"{height_m or 0.0:.4f}"
    if options.antex is not None:
        settings |= {"pos1-posopt2": "on", "file-rcvantfile": str(options.antex.resolve())}
        if options.precise:
            settings |= {"pos1-posopt1": "on", "file-satantfile": str(options.antex.resolve())}
    if mode in ("kinematic", "static") and direction == "forward":
        settings["out-outstat"] = "residual"
    if mode == "ppp-static":
        # Two frequencies remove the ionosphere; the wet troposphere is an unknown, the earth's tides and the
        # turn of the satellites against the antenna are not. An ambiguity that is not fixed stays a constant.
        settings |= {"pos1-ionoopt": "dual-freq", "pos1-tropopt": "est-ztd", "pos1-tidecorr": "on"}
        settings |= {"pos1-posopt3": "on", "pos2-armode": "off", "stats-prnbias": "0"}
    if mode == "single":
        # Without a base there is nothing that removes the ionosphere's and troposphere's common part.
        settings["pos1-frequency"] = "l1"
    return "".join(f"{key}={value}\n" for key, value in settings.items())


def _run(program: str, arguments: list[str]) -> None:
    path = shutil.which(program)
    if path is None:
        raise ProgramMissingError(
            f"the program {program} is not installed", "install RTKLIB (Debian: apt-get install rtklib)"
        )
    done = subprocess.run([path, *arguments], capture_output=True, check=False)  # noqa: S603
    if done.returncode != 0:
        lines = done.stderr.decode("latin-1").replace("\r", "\n").strip().splitlines()
        raise IllPosedError(f"{program} failed: {lines[-1] if lines else done.returncode}")
