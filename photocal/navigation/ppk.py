"""Post-processed kinematic positioning: from base and rover to a judged trajectory."""

import filecmp
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Flags, Floats
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.navigation.common_errors import common_errors
from photocal.navigation.engine import (
    Direction,
    EngineSolution,
    Mode,
    ProcessingOptions,
    in_order,
    solve,
    static_position,
    trajectory_of,
)
from photocal.navigation.fix_validation import judge
from photocal.navigation.ppk_inputs import Inputs, Sources, gather_inputs
from photocal.navigation.ppk_result import Ppk
from photocal.navigation.precise_results import (
    ObservationFile,
    antenna_named,
    count_ephemerides,
    read_antennas,
)
from photocal.navigation.satellite_residuals import code_errors, satellite_residuals
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import enu_axes_at

# The engine uses base observations up to 30 s old.
_BASE_AGE_NS = 30_000_000_000
SYSTEMS = "GREJC"


def between_directions(
    combined: EngineSolution, forward: EngineSolution, backward: EngineSolution
) -> tuple[EngineSolution, Flags]:
    """Replace combined positions that lie apart from both directions."""
    # The engine now and then inverts a covariance that has lost its digits; its combination is then up to
    # some decimetres off although both directions agree.
    origin = combined.place[0]
    here, fore, back = (s.offsets(origin) for s in (combined, forward, backward))
    f, b = forward.at(combined.time), backward.at(combined.time)
    # A direction with the worse status was not used.
    both = (f >= 0) & (b >= 0) & (forward.quality[f] == backward.quality[b])
    # Positions are printed to 0.1 mm, and a mean weighted by full matrices may leave the line between both.
    rounding_m = 0.005
    apart = np.linalg.norm(fore[f] - back[b], axis=1) + rounding_m
    off = both & (np.linalg.norm(here - fore[f], axis=1) > apart)
    off &= np.linalg.norm(here - back[b], axis=1) > apart
    if not off.any():
        return combined, off
    f, b = f[off], b[off]
    variance = [
        np.trace(s.covariance_m2[rows], axis1=1, axis2=2) for s, rows in ((forward, f), (backward, b))
    ]
    share = (variance[1] / (variance[0] + variance[1]))[:, None]
    mean = share * fore[f] + (1 - share) * back[b]
    larger = (variance[0] >= variance[1])[:, None, None]
    covariance = combined.covariance_m2.copy()
    covariance[off] = np.where(larger, forward.covariance_m2[f], backward.covariance_m2[b])
    place = combined.place
    place[off] = np.column_stack(geodetic(mean @ enu_axes(*origin[:2]) + geocentric(*origin)))
    lat, lon, height = place.T
    return replace(combined, lat_deg=lat, lon_deg=lon, height_m=height, covariance_m2=covariance), off


def options_for(
    rover: ObservationFile,
    base: ObservationFile,
    rover_antenna_m: float | None = None,
    base_antenna_m: float | None = None,
    elevation_deg: float = 15.0,
) -> ProcessingOptions:
    """Choose systems and frequencies that both receivers observed.

    raises IllPosedError: when they share no satellite system.
    """
    shared = "".join(letter for letter in SYSTEMS if letter in rover.systems & base.systems)
    if not shared:
        raise IllPosedError(
            f"rover ({'+'.join(sorted(rover.systems))}) and base ({'+'.join(sorted(base.systems))}) observed "
            "no common satellite system"
        )
    two = "2" in rover.bands & base.bands
    return ProcessingOptions(
        shared, two, elevation_deg, rover_antenna_m=rover_antenna_m, base_antenna_m=base_antenna_m
    )


def with_antennas(
    options: ProcessingOptions,
    antex: Path | None,
    rover: tuple[ObservationFile, str],
    base: tuple[ObservationFile, str] | None,
) -> ProcessingOptions:
    """Return options with the models of the antennas, each by a given name or that of its RINEX header.

    rover, base: observations and given name; "none" for an antenna without a model.
    raises ConfigurationError: for an antenna that is not stated, or that the file does not have; for names
        without a file.
    """
    sides = {"rover": rover} | ({} if base is None else {"base": base})
    if antex is None:
        for side, (_, given) in sides.items():
            if given:
                raise ConfigurationError(
                    f"the {side}'s antenna {given} needs a file of antenna models", "give ANTEX, too"
                )
        return options
    models, changed = read_antennas(antex), dict[str, Any](antex=antex)
    for side, (observed, given) in sides.items():
        if given.lower() == "none":
            continue
        if not (given or observed.antenna):
            raise ConfigurationError(
                f"the antenna of the {side} is not stated",
                'name its type and radome as the ANTEX file does, or "none" for one without a model',
                where=observed.path,
            )
        changed[f"{side}_antenna"] = antenna_named(models, given or observed.antenna, antex)
        # The engine reads the header's height only together with the header's type.
        if getattr(options, f"{side}_antenna_m") is None:
            changed[f"{side}_antenna_m"] = observed.antenna_m
    return replace(options, **changed)


def process(inputs: Inputs, options: ProcessingOptions, mode: Mode, folder: Path) -> Ppk:
    """Compute and judge the trajectory.

    raises IllPosedError: without overlap, with too few epochs, without ephemerides, or with a wrong position
        of the base.
    """
    refuse_apart(inputs.rover, inputs.base)
    if not any(count_ephemerides(path) for path in inputs.navigation):
        raise IllPosedError(
            "no ephemerides: positions cannot be computed",
            "record RXM-SFRBX or give a RINEX navigation file with --nav",
            where=", ".join(path.name for path in inputs.navigation) or inputs.rover.path.name,
        )
    off_m = _base_off_code(inputs, options, folder)
    files = [inputs.rover.path, inputs.base.path, *inputs.navigation]
    gaps = _base_gaps(inputs)
    rover_alone = [inputs.rover.path, *inputs.navigation]

    def run(direction: Direction) -> EngineSolution:
        """Solve in one direction, or with both combined."""
        return solve(mode, direction, files, options, inputs.base_m, folder)

    at_once = 2
    # The engine's runs are programs of their own: two at a time keep two cores busy.
    with ThreadPoolExecutor(at_once) as pool:
        if mode == "static":
            both, whole = pool.map(run, ("combined", "forward"))
            combined = static_position(_differential(whole, inputs), _differential(both, inputs))
            judgement, count, trajectory = None, 0, trajectory_of(combined, 0.0, inputs.base_m)
            satellites = satellite_residuals(mode, inputs.rover.path, folder)
        else:
            alone = pool.submit(solve, "single", "forward", rover_alone, options, None, folder)
            both, forward, backward = pool.map(run, ("combined", "forward", "backward"))
            code, forward, backward = alone.result(), in_order(forward), in_order(backward)
            combined, replaced = between_directions(_differential(both, inputs), forward, backward)
            satellites = satellite_residuals(mode, inputs.rover.path, folder)
            lasting = code_errors(satellites)
            judgement = judge(combined, forward, backward, code, options.ratio, lasting)
            count = int(replaced.sum())
            velocity, sigma = judgement.velocity_m_s, judgement.velocity_sigma_m_s
            trajectory = trajectory_of(judgement.solution, sigma, inputs.base_m, velocity)
    common = common_errors(trajectory, satellites, inputs.base_m, inputs.base_sigma_m, inputs.weather)
    return Ppk(inputs, options, mode, combined, judgement, trajectory, off_m, gaps, count, common)


def solved(sources: Sources, folder: Path) -> Ppk:
    """Process a rover in motion against its base; the engine's files stand in the folder."""
    inputs = gather_inputs(sources, folder)
    options = options_for(inputs.rover, inputs.base, sources.rover_antenna_m, sources.base_antenna_m)
    return process(inputs, options, "kinematic", folder)


def refuse_apart(rover: ObservationFile, base: ObservationFile) -> None:
    """Refuse observations that do not overlap or hardly so."""
    # Fewer common epochs solve nothing: the files belong to two flights.
    least_epochs = 10
    if rover.path.exists() and filecmp.cmp(rover.path, base.path):
        raise ConfigurationError(
            "rover and base have the same observations",
            "take the base's recording of the flight",
            where=rover.path,
        )
    first, last = int(base.time.ns[0]) - _BASE_AGE_NS, int(base.time.ns[-1]) + _BASE_AGE_NS
    common = int(((rover.time.ns >= first) & (rover.time.ns <= last)).sum())
    spans = "; ".join(
        f"{name} {file.time[[0]].iso()[0]} to {file.time[[-1]].iso()[0]}"
        for name, file in (("rover", rover), ("base", base))
    )
    if common == 0:
        raise IllPosedError(
            f"base and rover do not overlap in time: {spans} (GPS time)",
            "take the base's recording of the flight",
        )
    if common < least_epochs:
        raise IllPosedError(
            f"only {common} epochs of the rover have a base, at least {least_epochs} are needed: {spans} "
            "(GPS time)",
            "take the base's recording of the whole flight",
        )


def _base_off_code(inputs: Inputs, options: ProcessingOptions, folder: Path) -> Floats:
    """Return the base's position less its own code solution (east, north, up); refuse a wrong one."""
    # A code position of hours is good to metres.
    base_limit_m = 10.0
    alone = [inputs.base.path, *inputs.navigation]
    code = solve("single", "forward", alone, options, None, folder)
    apart = enu_axes_at(inputs.base_m) @ (inputs.base_m - np.median(code.xyz_m, axis=0))
    off = float(np.linalg.norm(apart))
    if off > base_limit_m:
        raise IllPosedError(
            f"the base's position ({inputs.base_source}) is {off:.1f} m from its own code solution, more "
            f"than {base_limit_m:g} m",
            "check coordinates, reference system and height kind of the base",
            where=inputs.base.path.name,
        )
    return np.asarray(apart)


def _differential(solution: EngineSolution, inputs: Inputs) -> EngineSolution:
    """Return what was computed with the base, in the order of time."""
    chosen = solution.rows(solution.quality <= 5)
    if not (chosen.quality <= 2).any():
        raise IllPosedError(
            "the engine found no position with the base",
            "check that both observed the same satellites and signals",
            where=inputs.rover.path.name,
        )
    return in_order(chosen)


def _base_gaps(inputs: Inputs) -> list[tuple[GpsTime, float]]:
    time = inputs.base.time.ns
    inside = time[
        (time >= inputs.rover.time.ns[0] - _BASE_AGE_NS) & (time <= inputs.rover.time.ns[-1] + _BASE_AGE_NS)
    ]
    steps = np.diff(inside) / 1e9
    # Every epoch that the rover has and the base lacks is a gap, unless the base is slower on purpose.
    usual = max(inputs.rover.interval_s, float(np.min(steps, initial=np.inf)))
    long = np.flatnonzero(steps > 1.5 * usual)
    order = long[np.argsort(-steps[long], kind="stable")]
    return [(GpsTime(inside[[i]]), float(steps[i])) for i in order.tolist()]
