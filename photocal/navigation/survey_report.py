"""Results of a control survey: points with full covariances, figures, sentences."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.ellipses import ellipses
from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.files import write_rows
from photocal.base.geodesy import geodetic
from photocal.base.policy import policy
from photocal.geometry.ground_scale import combined_factor, has_scale
from photocal.navigation.baseline_network import NetworkSolution
from photocal.navigation.exposure_files import in_frame
from photocal.navigation.survey_frames import MovedMark
from photocal.navigation.trajectory import enu_axes_at

COLUMNS = ("point", "X", "Y", "Z", "sX", "sY", "sZ", "sXY", "sXZ", "sYZ", "role")


def survey_figures(
    solution: NetworkSolution, sessions: list[dict[str, Any]], frames: Sequence[MovedMark] = ()
) -> dict[str, Any]:
    """Return the figures of a survey, ready for JSON."""
    per_baseline = {
        "residual_enu_m": solution.residuals_m,
        "redundancy_enu": solution.redundancy,
        "detectable_enu_m": solution.detectable_m,
        "external_reliability_enu": solution.distortion,
    }
    figures: dict[str, Any] = as_plain(
        {
            "schema": "photocal.survey/1",
            "marks": _marks(solution),
            "sessions": sessions,
            "frames": [frame.as_json() for frame in frames],
            **picked(solution, "degrees_of_freedom", "sigma0_squared", "blunders", global_test="test"),
            "baselines": [
                {
                    "name": baseline.name,
                    **{key: values[i] for key, values in per_baseline.items()},
                    "effects_of_detectable": _effects(solution, i),
                }
                for i, baseline in enumerate(solution.used)
            ],
        }
    )
    return figures


def _effects(solution: NetworkSolution, row: int) -> list[dict[str, Any]]:
    """Return what undetected errors of a baseline do to the marks, the mark that moves most first."""
    effects = []
    for name, shifts in zip(("east", "north", "up"), solution.effects_m[row], strict=True):
        if np.isfinite(shifts).all():
            order = np.argsort(-np.linalg.norm(shifts, axis=1), kind="stable").tolist()
            marks = {solution.names[k]: shifts[k] for k in order}
            effects.append({"error_of": name, "marks_move_enu_m": marks})
    return effects


def _marks(solution: NetworkSolution) -> list[dict[str, Any]]:
    local = _local_covariances(solution)
    confidence = ellipses(local, policy.confidence)
    columns = {
        "name": solution.names,
        **dict(zip(("lat_deg", "lon_deg", "height_m"), geodetic(solution.xyz_m), strict=True)),
        "sigma_enu_m": _sigma(local),
        "ellipse_95_m": confidence.semi_axes,
        "ellipse_azimuth_deg": np.degrees(confidence.azimuth),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _local_covariances(solution: NetworkSolution) -> Floats:
    turn, n = enu_axes_at(solution.xyz_m), np.arange(len(solution.names))
    blocks = solution.covariance_m2.reshape(len(n), 3, len(n), 3)[n, :, n]
    return np.asarray(turn @ blocks @ np.swapaxes(turn, 1, 2))


def _sigma(covariance: Floats) -> Floats:
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))


def write_points(path: Path, solution: NetworkSolution, crs: str | None) -> dict[str, Any]:
    """Write the block's `points.csv` with full covariances; return the frame of its coordinates."""
    lat, lon, height = geodetic(solution.xyz_m)
    xyz, turn, frame = in_frame(lat, lon, height, np.array([lat[0], lon[0], height[0]]), crs)
    covariance = turn @ _local_covariances(solution) @ np.swapaxes(turn, 1, 2)
    figures = np.hstack([xyz, _sigma(covariance), covariance[:, [0, 0, 1], [1, 2, 2]]]).tolist()
    forms = [".5f"] * 3 + [".6f"] * 3 + [".10f"] * 3
    rows = [
        [name, *map(format, row, forms), "control"] for name, row in zip(solution.names, figures, strict=True)
    ]
    write_rows(path, COLUMNS, rows)
    if crs is not None and has_scale(crs):
        frame |= {"combined_factor": float(combined_factor(crs, xyz.mean(axis=0, keepdims=True))[0])}
    return frame


def survey_text(figures: dict[str, Any]) -> str:
    """Return the summary in words."""
    lines = [f"{len(figures['marks'])} marks, {len(figures['sessions'])} sessions"]
    for s in figures["sessions"]:
        short = _missing(s)
        way = f": {s['start']} to {s['end']}, {s['length_m']:.3f} m" if s["start"] else ""
        lines.append(f"{s['name']}{way}, {s['status']}, {s['minutes']:.1f} min{short}")
    lines += map(_frame_text, figures["frames"])
    named = {s["name"]: s for s in figures["sessions"]}
    for b in figures["blunders"]:
        heights = named.get(b["name"], {})
        advice = (
            f"; check its antenna heights (base {heights['base_antenna_m']:.3f} m, "
            f"rover {heights['rover_antenna_m']:.3f} m)"
            if b["component"] == "height" and heights
            else "; check which marks were occupied and the times"
        )
        lines.append(
            f"left out: {b['name']} ({b['start']} to {b['end']}), {b['component']} wrong by "
            f"{b['size_m']:+.3f} m (sigma {b['size_sigma_m']:.3f} m), test {b['test']:.1f}{advice}"
        )
    for mark in figures["marks"]:
        sigma = " ".join(f"{1e3 * v:.1f}" for v in mark["sigma_enu_m"])
        major, minor = (1e3 * v for v in mark["ellipse_95_m"])
        lines.append(
            f"{mark['name']}: sigma E N U {sigma} mm, ellipse (95 %) {major:.1f} x {minor:.1f} mm towards "
            f"{mark['ellipse_azimuth_deg']:.0f} deg"
        )
    factor = figures.get("points_csv", {}).get("combined_factor")
    if factor is not None:
        lines.append(
            f"combined factor {factor:.8f}: a distance on the ground is {1e6 * (factor - 1):+.0f} ppm longer "
            f"in {figures['points_csv']['frame']}"
        )
    lines.append(f"redundancy {figures['degrees_of_freedom']}")
    lines += _reliability_text(figures)
    test = figures["global_test"]
    if test is None:
        lines.append("no redundancy: nothing checks these baselines")
    elif not test["accepted"]:
        lines.append(
            f"global test failed: variance factor {figures['sigma0_squared']:.2f}; the baselines' sigmas are "
            f"{'too small' if figures['sigma0_squared'] > 1 else 'too large'}"
        )
    return "\n".join(lines)


def _missing(session: dict[str, Any]) -> str:
    """Return what a session lacks of what is asked of it."""
    if session["required_minutes"] is None:
        return ", longer than the lengths in [[required]]: the time is not judged"
    short = (
        "" if session["long_enough"] else f", SHORTER than the required {session['required_minutes']:g} min"
    )
    return short + ("" if session["enough_frequencies"] else ", ONE FREQUENCY where two are required")


def _frame_text(frame: dict[str, Any]) -> str:
    if "shift_enu_m" not in frame:
        return (
            f"WARNING {frame['mark']} refers to {frame['from']}, the survey to {frame['to']}: no "
            "transformation between them is known, it was not moved"
        )
    east, north, up = frame["shift_enu_m"]
    return (
        f"{frame['mark']}: moved from {frame['from']} to {frame['to']} by E {east:+.3f}, N {north:+.3f}, "
        f"U {up:+.3f} m, sigma {frame['sigma_m']:.3f} m ({frame['way']})"
    )


def _reliability_text(figures: dict[str, Any]) -> list[str]:
    """Return the undetected error that would move a mark most."""
    moves = [
        (float(np.linalg.norm(shift)), mark, b["name"], effect["error_of"])
        for b in figures["baselines"]
        for effect in b["effects_of_detectable"]
        for mark, shift in list(effect["marks_move_enu_m"].items())[:1]
    ]
    if not moves:
        return []
    size, mark, baseline, component = max(moves)
    where = f"{component} of {baseline}"
    return [f"the largest error that the tests may miss, in {where}, moves {mark} by {1e3 * size:.0f} mm"]
