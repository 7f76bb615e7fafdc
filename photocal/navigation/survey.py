"""A control survey: static baselines computed, adjusted as a network, written as points."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from photocal.navigation.baseline_network import Baseline, Mark, NetworkSolution, adjust_baselines
from photocal.navigation.engine import Engine
from photocal.navigation.exposure_files import projected
from photocal.navigation.ppk import Inputs, options_for, process
from photocal.navigation.rinex import read_observation_file
from photocal.navigation.survey_setup import MeasuredBaseline, SurveySetup
from photocal.navigation.trajectory import enu_axes, enu_offsets, geocentric, geodetic

Floats = NDArray[np.float64]
COLUMNS = ("point", "X", "Y", "Z", "sX", "sY", "sZ", "sXY", "sXZ", "sYZ", "role")


def run_survey(
    setup: SurveySetup, folder: Path, engine: Engine, scratch: Path
) -> tuple[NetworkSolution, list[dict[str, Any]]]:
    """Compute the baselines of a survey one after the other and adjust them.

    Parameters
    ----------
    setup : SurveySetup
        What was measured.
    folder : Path
        Where the files named in it lie.
    engine : Engine
        What computes positions.
    scratch : Path
        Where the engine may leave its files.

    Returns
    -------
    solution : NetworkSolution
    sessions : list of dict
        Times against the required ones, status and length of every baseline.
    """
    control = [_mark(mark) for mark in setup.known]
    known = {mark.name: mark.xyz_m for mark in control}
    baselines, sessions = [], []
    waiting = list(setup.baseline)
    while waiting:
        ready = next((b for b in waiting if b.start in known), None)
        if ready is None:
            raise ConfigurationError(
                f"baseline {waiting[0].name}: no chain of baselines reaches its start {waiting[0].start}",
                remedy="let every baseline start at a known mark or at the end of another one",
            )
        waiting.remove(ready)
        baseline, session = _session(ready, setup, known[ready.start], folder, engine, scratch)
        baselines.append(baseline)
        sessions.append(session)
        known.setdefault(ready.end, known[ready.start] + baseline.vector_m)
    return adjust_baselines(baselines, control), sessions


def _mark(mark: Any) -> Mark:
    xyz = geocentric(np.array([mark.lat_deg]), np.array([mark.lon_deg]), np.array([mark.height_m]))[0]
    axes = enu_axes(mark.lat_deg, mark.lon_deg)
    return Mark(mark.name, xyz, axes.T @ np.diag(np.square(mark.sigma_m)) @ axes)


def _session(
    measured: MeasuredBaseline,
    setup: SurveySetup,
    start_m: Floats,
    folder: Path,
    engine: Engine,
    scratch: Path,
) -> tuple[Baseline, dict[str, Any]]:
    rover, base = (read_observation_file(folder / path) for path in (measured.rover, measured.base))
    inputs = Inputs(rover, base, [folder / p for p in measured.nav], start_m, f"mark {measured.start}")
    options = replace(
        options_for(rover, base),
        rover_antenna_m=measured.rover_antenna_m,
        base_antenna_m=measured.base_antenna_m,
    )
    own = scratch / measured.name
    own.mkdir()
    t = process(inputs, options, "static", engine, own).trajectory
    end = geocentric(t.lat_deg, t.lon_deg, t.height_m)[0]
    axes = enu_axes(float(t.lat_deg[0]), float(t.lon_deg[0]))
    length = float(np.linalg.norm(end - start_m))
    covariance = axes.T @ t.covariance_m2[0] @ axes
    first, last = max(rover.time.ns[0], base.time.ns[0]), min(rover.time.ns[-1], base.time.ns[-1])
    minutes = float(last - first) / 60e9
    session = {
        "name": measured.name,
        "start": measured.start,
        "end": measured.end,
        "status": str(t.status[0]),
        "length_m": length,
        "minutes": minutes,
        "required_minutes": setup.required_minutes,
        "long_enough": minutes >= setup.required_minutes,
    }
    return Baseline(measured.name, measured.start, measured.end, end - start_m, covariance), session


def survey_figures(solution: NetworkSolution, sessions: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of a survey, ready for JSON."""
    sigma0 = solution.sigma0_squared
    return {
        "schema": "photocal.survey/1",
        "marks": len(solution.names),
        "sessions": sessions,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "sigma0_squared": sigma0 if np.isfinite(sigma0) else None,
        "blunders": [vars(blunder) for blunder in solution.blunders],
        "baselines": [
            {
                "name": b.name,
                "residual_enu_m": solution.residuals_m[i].tolist(),
                "redundancy_enu": solution.redundancy[i].tolist(),
                "detectable_enu_m": _finite(solution.detectable_m[i]),
            }
            for i, b in enumerate(solution.used)
        ],
    }


def _finite(values: Floats) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values.tolist()]


def write_points(path: Path, solution: NetworkSolution, crs: str | None) -> dict[str, Any]:
    """Write the block's `points.csv` with full covariances; return the frame of its coordinates."""
    lat, lon, height = geodetic(solution.xyz_m)
    if crs is None:
        origin = np.array([lat[0], lon[0], height[0]])
        xyz = enu_offsets(lat, lon, height, origin)
        turn = np.broadcast_to(enu_axes(float(lat[0]), float(lon[0])), (len(lat), 3, 3))
        frame: dict[str, Any] = {"frame": "local", "origin_lat_lon_height": origin.tolist()}
    else:
        xyz, from_enu = projected(lat, lon, height, crs)
        local = np.array([enu_axes(a, b) for a, b in zip(lat.tolist(), lon.tolist(), strict=True)])
        turn = from_enu @ local
        frame = {"frame": crs}
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for i, name in enumerate(solution.names):
            block = solution.covariance_m2[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            c = turn[i] @ block @ turn[i].T
            sigma = np.sqrt(np.maximum(np.diag(c), 0.0))
            cross = [f"{v:.10f}" for v in (c[0, 1], c[0, 2], c[1, 2])]
            place = [f"{v:.5f}" for v in xyz[i].tolist()]
            writer.writerow([name, *place, *(f"{v:.5f}" for v in sigma.tolist()), *cross, "control"])
    return frame


def survey_text(figures: dict[str, Any]) -> str:
    """Return the summary in words."""
    lines = [f"{figures['marks']} marks, {len(figures['sessions'])} baselines"]
    for s in figures["sessions"]:
        short = "" if s["long_enough"] else f", SHORTER than the required {s['required_minutes']:g} min"
        lines.append(
            f"{s['name']}: {s['start']} to {s['end']}, {s['length_m']:.3f} m, {s['status']}, "
            f"{s['minutes']:.1f} min{short}"
        )
    lines += [
        f"left out: {b['name']} ({b['start']} to {b['end']}), {b['component']} wrong by "
        f"{b['size_m']:+.3f} m, test {b['test']:.1f}; check its antenna heights"
        for b in figures["blunders"]
    ]
    lines.append(f"redundancy {figures['degrees_of_freedom']}")
    if figures["degrees_of_freedom"] == 0:
        lines.append("no redundancy: nothing checks these baselines")
    return "\n".join(lines)
