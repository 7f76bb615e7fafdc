"""Results of a control survey: points with full covariances, figures, sentences."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.ellipses import ellipses
from photocal.base.files import write_rows
from photocal.base.geodesy import geodetic
from photocal.base.policy import policy
from photocal.findings.texts import Catalogue
from photocal.geometry.frames import combined_factor, has_scale
from photocal.navigation.baseline_network import NetworkSolution
from photocal.navigation.exposure_files import in_frame
from photocal.navigation.trajectory import enu_axes_at

COLUMNS = ("point", "X", "Y", "Z", "sX", "sY", "sZ", "sXY", "sXZ", "sYZ", "role")


def survey_figures(
    solution: NetworkSolution, sessions: list[dict[str, Any]], frames: Sequence[dict[str, Any]] = ()
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
            "frames": list(frames),
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
    semi_axes, azimuth = ellipses(local, policy.confidence)
    columns = {
        "name": solution.names,
        **dict(zip(("lat_deg", "lon_deg", "height_m"), geodetic(solution.xyz_m), strict=True)),
        "sigma_enu_m": _sigma(local),
        "ellipse_95_m": semi_axes,
        "ellipse_azimuth_deg": np.degrees(azimuth),
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


def survey_text(figures: dict[str, Any], say: Catalogue) -> str:
    """Return the summary in words."""
    lines = [say("surveyed.head", marks=len(figures["marks"]), sessions=len(figures["sessions"]))]
    for s in figures["sessions"]:
        ends = (
            {"start": s["start"], "end": s["end"], "length": say.fixed(s["length_m"], 3)}
            if s["start"]
            else None
        )
        way = "" if ends is None else say("surveyed.way", **ends)
        told = {"name": s["name"], "status": s["status"], "minutes": say.fixed(s["minutes"], 1)}
        lines.append(say("surveyed.session", way=way, short=_missing(s, say), **told))
    # No recorded orbits were to be had when this was made.
    lines += [say("surveyed.untried")] * any(s["status"] == "precise point" for s in figures["sessions"])
    lines += [_frame_text(frame, say) for frame in figures["frames"]]
    lines += [_blunder_text(b, figures["sessions"], say) for b in figures["blunders"]]
    for mark in figures["marks"]:
        lines.append(
            say(
                "surveyed.mark",
                name=mark["name"],
                sigma=" ".join(say.fixed(1e3 * v, 1) for v in mark["sigma_enu_m"]),
                major=say.fixed(1e3 * mark["ellipse_95_m"][0], 1),
                minor=say.fixed(1e3 * mark["ellipse_95_m"][1], 1),
                azimuth=say.fixed(mark["ellipse_azimuth_deg"], 0),
            )
        )
    factor = figures.get("points_csv", {}).get("combined_factor")
    if factor is not None:
        frame, ppm = figures["points_csv"]["frame"], f"{1e6 * (factor - 1):+.0f}"
        lines.append(say("surveyed.factor", factor=say.fixed(factor, 8), ppm=ppm, frame=frame))
    lines.append(say("surveyed.redundancy", n=figures["degrees_of_freedom"]))
    lines += _reliability_text(figures, say)
    test, factor = figures["global_test"], figures["sigma0_squared"]
    if test is None:
        lines.append(say("surveyed.unchecked"))
    elif not test["accepted"]:
        how = say("surveyed.too_small" if factor > 1 else "surveyed.too_large")
        lines.append(say("surveyed.failed", factor=say.fixed(factor, 2), how=how))
    return "\n".join(lines)


def _blunder_text(b: dict[str, Any], sessions: list[dict[str, Any]], say: Catalogue) -> str:
    """Return which baseline was left out, and what to look for."""
    heights = {s["name"]: s for s in sessions}.get(b["name"], {})
    advice = say("surveyed.times")
    if b["component"] == "height" and heights:
        antennas = {role: say.fixed(heights[f"{role}_antenna_m"], 3) for role in ("base", "rover")}
        advice = say("surveyed.heights", **antennas)
    figures = {"size": f"{b['size_m']:+.3f}", "sigma": f"{b['size_sigma_m']:.3f}", "test": f"{b['test']:.1f}"}
    return say(
        "surveyed.left_out",
        **{key: b[key] for key in ("name", "start", "end")},
        **{key: figure.replace(".", say.mark) for key, figure in figures.items()},
        component=say(f"surveyed.{b['component']}"),
        advice=advice,
    )


def _missing(session: dict[str, Any], say: Catalogue) -> str:
    """Return what a session lacks of what is asked of it."""
    if session["required_minutes"] is None:
        return say("surveyed.unjudged")
    minutes = say.as_given(session["required_minutes"])
    short = "" if session["long_enough"] else say("surveyed.short", minutes=minutes)
    return short + ("" if session["enough_frequencies"] else say("surveyed.one_frequency"))


def _frame_text(frame: dict[str, Any], say: Catalogue) -> str:
    told = {"mark": frame["mark"], "before": frame["from"], "after": frame["to"]}
    if "shift_enu_m" not in frame:
        return say("surveyed.not_moved", **told)
    shifts = (f"{v:+.3f}".replace(".", say.mark) for v in frame["shift_enu_m"])
    shift = dict(zip(("east", "north", "up"), shifts, strict=True))
    sigma = say.fixed(frame["sigma_m"], 3)
    return say("surveyed.moved", way=frame["way"], sigma=sigma, **told, **shift)


def _reliability_text(figures: dict[str, Any], say: Catalogue) -> list[str]:
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
    told = {"mark": mark, "baseline": baseline, "component": say(f"surveyed.{component}")}
    return [say("surveyed.worst", size=say.fixed(1e3 * size, 0), **told)]
