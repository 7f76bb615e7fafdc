"""The PPK engine: RINEX from raw frames, positions from RINEX.

The engine is RTKLIB 2.4.3 (Takasu and Yasuda 2009) by its programs `convbin` and `rnx2rtkp`, as Debian
packages them. Its fork demo5 fixes more epochs and, on a rover among trees, 2 % of them wrongly.
"""

import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats, Integers, nearest
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError, ProgramMissingError
from photocal.navigation.time import WEEK_NS, GpsTime, exact_ns
from photocal.navigation.trajectory import Geodetic, Trajectory

# As figures name it.
ENGINE = "RTKLIB 2.4.3 (rnx2rtkp)"
FIXED, FLOAT = 1, 2
_LEAST_SIGMA_M = 1e-4
# Multipath and air of lower satellites spoil the search for whole cycles; they take part as floats, which
# place no fix.
SEARCHED_DEG = 20.0
_STATUS = {1: "fixed", 2: "float"}
# What differences do not remove of orbits, troposphere and ionosphere: a millimetre per kilometre at quiet
# times (Odijk 2002, chapter 3).
PER_METRE = 1e-6
# Antennas without calibration: phase centres agree to a millimetre or two at best.
STATIC_FLOOR_M = np.array([0.001, 0.001, 0.002])


@dataclass(frozen=True)
class EngineSolution(Geodetic):
    """Positions of one run of the engine.

    lat_deg, lon_deg, height_m (n,): geodetic position, ellipsoidal height.
    quality (n,): 1 fixed, 2 float, 5 single, as the engine numbers them.
    covariance_m2 (n, 3, 3): east, north, up, as the engine claims it.
    ratio (n,): ratio test.
    velocity_m_s (n, 3): east, north, up; NaN where the engine gave none.
    """

    time: GpsTime
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    quality: Integers
    covariance_m2: Floats
    ratio: Floats
    velocity_m_s: Floats

    def __len__(self) -> int:
        return len(self.time)

    def at(self, time: GpsTime, tolerance_ns: int = 20_000_000) -> Integers:
        """Return the row for each instant, -1 where there is none."""
        row = nearest(self.time.ns, time.ns)
        return np.where(np.abs(self.time.ns[row] - time.ns) <= tolerance_ns, row, -1)


def read_solution(path: Path) -> EngineSolution:
    """Read a position file (geodetic, time as week and seconds)."""
    # Columns of RTKLIB's position file before the velocities.
    columns = 15
    lines = [line.split() for line in path.read_text("latin-1").splitlines() if line and line[0] != "%"]
    rows = [line for line in lines if len(line) >= columns]
    if not rows:
        raise IllPosedError(
            "the engine found no position",
            "check that ephemerides and observations are of the same time",
            where=path.stem,
        )
    velocity = np.full((len(rows), 3), np.nan)
    try:
        week = np.array([int(row[0]) for row in rows], np.int64)
        tow_ns = np.array([exact_ns(row[1]) for row in rows], np.int64)
        table = np.array([[float(v) for v in row[2:columns]] for row in rows])
        np.asarray_chkfinite(table[:, 5:11])
        for number, row in enumerate(rows):
            if len(row) >= columns + 3:
                velocity[number] = [float(v) for v in row[columns : columns + 3]]
    except (ValueError, OverflowError) as cause:
        raise InputMalformedError(
            f"is not a position file with times as week and seconds ({cause})",
            "take one with GPS weeks and seconds (out-timeform = tow)",
            where=path,
        ) from cause
    quality = table[:, 3].astype(np.int64)
    sn, se, su, sne, seu, sun = table[:, 5:11].T
    # The engine prints four decimals: a sigma of zero is one below them.
    sn, se, su = (np.maximum(v, _LEAST_SIGMA_M) for v in (sn, se, su))
    covariance = np.empty((len(rows), 3, 3))
    covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2] = se**2, sn**2, su**2
    # The engine prints the root of a covariance, with the covariance's sign.
    for i, j, root in ((0, 1, sne), (0, 2, seu), (1, 2, sun)):
        covariance[:, i, j] = covariance[:, j, i] = np.sign(root) * root**2
    covariance = _possible(covariance, quality)
    return EngineSolution(
        GpsTime(week * WEEK_NS + tow_ns),
        table[:, 0],
        table[:, 1],
        table[:, 2],
        quality,
        covariance,
        table[:, 12],
        velocity[:, [1, 0, 2]],
    )


def _possible(covariance: Floats, quality: Integers) -> Floats:
    """Replace matrices that are no covariances by that of the nearest epoch of the same quality.

    The engine loses digits when it fixes ambiguities: variances below zero are printed as 0, with
    covariances beside them that no variances could have.
    """
    printed = np.diagonal(covariance, axis1=1, axis2=2).min(axis=1) > _LEAST_SIGMA_M**2
    sound = printed & (np.linalg.eigvalsh(covariance)[:, 0] > _LEAST_SIGMA_M**2 / 100)
    for value in np.unique(quality[~sound]):
        lost, good = (np.flatnonzero((quality == value) & which) for which in (~sound, sound))
        if not len(good):
            # The correlation of the errors is unknown; the printed sigmas are all there is.
            covariance[lost] = covariance[lost] * np.eye(3)
            continue
        covariance[lost] = covariance[good[nearest(good, lost)]]
    return covariance


def static_position(forward: EngineSolution, combined: EngineSolution) -> EngineSolution:
    """Return the last epoch of a static run, which contains all before it, with a realistic covariance.

    The engine's sigmas of a long static run fall below a millimetre while its position still wanders with
    multipath: the root mean square of the way that the estimates of both directions lie from it is added.
    """
    last = forward.rows(np.array([len(forward) - 1]))
    steady = combined.rows(combined.quality == last.quality[0])
    apart = steady.offsets(last.place[0])
    wander = np.sqrt(np.mean(apart**2, axis=0)) if len(apart) else np.zeros(3)
    spread = np.maximum(wander, STATIC_FLOOR_M)
    return replace(last, covariance_m2=last.covariance_m2 + np.diag(spread**2))


def in_order(solution: EngineSolution) -> EngineSolution:
    """Return the epochs in the order of time, each once."""
    _, first = np.unique(solution.time.ns, return_index=True)
    return solution.rows(first)


def trajectory_of(
    solution: EngineSolution, velocity_sigma: float, base_m: Floats, velocity: Floats | None = None
) -> Trajectory:
    """Return the engine's positions as a trajectory."""
    apart = PER_METRE * np.linalg.norm(solution.xyz_m - base_m, axis=1)
    differential = 2
    apart[solution.quality > differential] = 0.0
    status = np.array([_STATUS.get(q, "single") for q in solution.quality.tolist()], "U6")
    return Trajectory(
        solution.time,
        solution.lat_deg,
        solution.lon_deg,
        solution.height_m,
        status,
        solution.covariance_m2 + apart[:, None, None] ** 2 * np.eye(3),
        np.full((len(solution), 3), np.nan) if velocity is None else velocity,
        velocity_sigma,
    )


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

    def __post_init__(self) -> None:
        # The highest tripods and poles, m; what is higher is a length in another unit.
        highest_m = 10.0
        for role, height in (("rover", self.rover_antenna_m), ("base", self.base_antenna_m)):
            if height is not None and not abs(height) <= highest_m:
                raise ConfigurationError(
                    f"the antenna of the {role} is {height:g} m above its mark, more than {highest_m:g} m",
                    "give the height in metres; for a higher mast give the position of the antenna",
                )


def to_rinex(raw: bytes, form: str, stem: Path, near: GpsTime | None = None) -> tuple[Path, Path]:
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
        "pos2-arelmask": f"{SEARCHED_DEG:g}",
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
