"""What the project of another program says of itself, and what is found anew, side by side."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from photocal.adjustment.rig import OF_HEAD
from photocal.base.arrays import Flags, Floats
from photocal.block.results.result import Result
from photocal.exchange.foreign_project import ForeignProject
from photocal.findings.texts import Catalogue, catalogue, finding_text, findings_of, plain
from photocal.geometry.camera import MODELS, PARAMETERS
from photocal.geometry.rotation import matrix_from_angles


def camera_figures(foreign: ForeignProject, result: Result) -> dict[str, Any]:
    """Their parameters of each camera and ours, with sigmas and the difference in ours."""
    figures: dict[str, Any] = {}
    stated = {camera.id: camera for camera in (*foreign.block.cameras, *foreign.cameras)}
    for camera in stated.values():
        ours, promised = result.cameras[camera.id], foreign.camera_sigma.get(camera.id, {})
        figures[camera.id] = {"unit": camera.unit, "model": camera.model, "parameters": {}}
        figures[camera.id]["normalised"] = foreign.normalised
        for name in PARAMETERS:
            if name not in ours.free and not camera.value(name):
                continue
            sigma = ours.sigma_of(name) if name in ours.free else None
            figures[camera.id]["parameters"][name] = {
                "theirs": camera.value(name),
                "their_sigma": promised.get(name),
                "ours": ours.value(name),
                "sigma": sigma,
                "difference_in_sigmas": (ours.value(name) - camera.value(name)) / sigma if sigma else None,
            }
    return figures


def head_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Relative orientation of each head (deg, m): ours with sigmas, and its difference from theirs."""
    given = {
        head.camera: dict(zip(OF_HEAD, head.values.tolist(), strict=True)) for head in foreign.block.heads
    }
    return [
        {
            "camera": head.camera,
            "of": head.of,
            "exposures": head.exposures,
            "rotation_deg": head.rotation_deg,
            "values": {
                key: {
                    "ours": value.value,
                    "sigma": value.sigma,
                    # Turns are measured from the rotation that they have.
                    "difference": value.value - (given[head.camera][key] if key in "xyz" else 0.0),
                }
                for key, value in head.values.items()
                if value.estimated
            },
        }
        for head in result.heads
    ]


def sigma_figures(
    foreign: ForeignProject, result: Result, found: Mapping[str, Floats]
) -> list[dict[str, Any]]:
    """What each group of observations was promised to be, and what its residuals show."""
    tie, seen = ties_of(foreign, result), result.residuals
    rows: list[dict[str, Any]] = []
    for name, rays in (("image coordinates of tie points", tie), ("marks of surveyed points", ~tie)):
        free = float(seen.redundancy[rays].sum())
        if free > 1:
            stated = float(np.sqrt(np.mean(foreign.block.observations.sigma[rays] ** 2)))
            sigma = float(np.sqrt((seen.residual[rays] ** 2).sum() / free))
            rows.append(
                {
                    "group": name,
                    "unit": "px",
                    "n": int(rays.sum()),
                    "stated": stated if foreign.weighted else None,
                    "found": sigma,
                }
            )
    points, known = foreign.block.points, np.isfinite(foreign.position).all(axis=1)
    stated_of = {
        "control": points.sigma[points.of_role("control")],
        "position": foreign.position_sigma[known],
    }
    for kind, sigmas in stated_of.items():
        for axes, where in ((slice(0, 2), "in plane"), (slice(2, 3), "in height")) if len(sigmas) else ():
            # A held coordinate promises nothing that could be kept.
            promised = sigmas[:, axes][np.isfinite(sigmas[:, axes])]
            variance = np.mean(found[kind][axes]) if kind in found else np.nan
            rows.append(
                {
                    "group": f"{kind if kind == 'control' else 'positions'} {where}",
                    "unit": "m",
                    "n": len(sigmas),
                    "stated": float(np.sqrt(np.mean(promised**2))) if len(promised) else None,
                    "found": float(np.sqrt(variance)) if variance > 0 else None,
                }
            )
    return rows


def ties_of(foreign: ForeignProject, result: Result) -> Flags:
    """Which observations are of tie points, shape (n,)."""
    points, seen = foreign.block.points, result.residuals
    role = dict(zip(points.names, points.of_role("tie").tolist(), strict=True))
    return np.array([role[name] for name in seen.point_names])[seen.point]


def position_figures(
    foreign: ForeignProject, result: Result, sigmas: Sequence[dict[str, Any]]
) -> dict[str, Any] | None:
    """The shift that all positions have in common, adjusted minus given; its sigma as positions are found."""
    worse = max(
        [1.0]
        + [
            row["found"] / row["stated"]
            for row in sigmas
            if row["group"].startswith("positions") and row["found"] and row["stated"]
        ]
    )
    mounting = result.mounting
    known = np.isfinite(foreign.position).all(axis=1)
    if mounting is None or not known.any():
        return None
    # The shift belongs to the observed positions: observed = true + shift.
    shift = {axis: -mounting[f"shift_{axis}"].value for axis in "xyz"}
    sigma = {axis: worse * mounting[f"shift_{axis}"].sigma for axis in "xyz"}
    theirs = np.mean((foreign.block.images.values[:, 3:] - foreign.position)[known], axis=0)
    return {
        "images": int(known.sum()),
        "estimated": bool(mounting["shift_x"].estimated),
        "common_shift_m": shift,
        "sigma_m": sigma,
        "theirs_m": dict(zip("xyz", theirs.tolist(), strict=True)),
    }


def control_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Adjusted minus surveyed at control and check points, theirs and ours, and what the adjustment promises.

    `sigma_m`: of what is adjusted, at check points with the survey where that is stated.
    """
    given = foreign.block.points
    survey = dict(zip(given.names, given.values, strict=True))
    sigma = dict(zip(given.names, np.where(np.isfinite(given.sigma), given.sigma, 0.0), strict=True))
    rows = []
    for k, (name, role) in enumerate(zip(result.points.names, result.points.role, strict=True)):
        if role == "tie":
            continue
        theirs = foreign.adjusted.get(name)
        rows.append(
            {
                "point": name,
                "role": role,
                "rays": int(result.points.rays[k]),
                "theirs_m": None if theirs is None else (theirs - survey[name]).tolist(),
                "ours_m": (result.points.values[k] - survey[name]).tolist(),
                "sigma_m": np.hypot(result.points.sigma[k], sigma[name] * (role == "check")).tolist(),
            }
        )
    return rows


def exterior_figures(foreign: ForeignProject, result: Result) -> dict[str, Any] | None:
    """How far our orientations lie from theirs, and the sigmas that both promise (medians)."""
    theirs, values = foreign.block.images.values, result.images.values
    if np.isnan(theirs).any():
        return None
    away = values[:, 3:] - theirs[:, 3:]
    turn = matrix_from_angles(values[:, :3]) @ np.swapaxes(matrix_from_angles(theirs[:, :3]), 1, 2)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    covariance = result.images.covariance
    ours = None if covariance is None else np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 3:])
    promised = foreign.pose_sigma[np.isfinite(foreign.pose_sigma).all(axis=1)]
    return {
        "position_rms_m": np.sqrt(np.mean(away**2, axis=0)).tolist(),
        "rotation_rms_deg": float(np.degrees(np.sqrt(np.mean(angle**2)))),
        "their_position_sigma_m": np.median(promised[:, 3:], axis=0).tolist() if len(promised) else None,
        "our_position_sigma_m": None if ours is None else np.median(ours, axis=0).tolist(),
    }


def _parameter(camera: dict[str, Any], name: str, figures: dict[str, Any], say: Catalogue) -> str:
    """A line of a camera, its distortion as the program has it."""
    power = -MODELS[camera["model"]].power(name) if camera["normalised"] else 0
    distances = camera["parameters"].get("c", {"theirs": 1.0, "ours": 1.0})
    theirs_by, by = (distances[whose] ** max(power, 0) for whose in ("theirs", "ours"))
    promised = figures["their_sigma"] and figures["their_sigma"] * theirs_by
    sigma = figures["sigma"] and figures["sigma"] * by
    theirs = rounded(figures["theirs"] * theirs_by, promised or sigma)
    theirs += f" +- {promised:.2g}" if promised else ""
    ours = rounded(figures["ours"] * by, sigma) + (f" +- {sigma:.2g}" if sigma else say("adopted.held"))
    away = say("adopted.apart", sigmas=f"{figures['difference_in_sigmas']:+.2f}") if sigma else ""
    return f"  {name:<4}" + f"{theirs:>28}{ours:>28}{away:>14}".replace(".", say.mark)


def rounded(value: float, sigma: float | None) -> str:
    """Write a number to the second digit of its standard deviation; one that is nothing beside it is 0."""
    if not sigma:
        return f"{value:.6g}"
    last = math.floor(math.log10(sigma)) - 1
    if abs(value) < 0.5 * 10.0**last:
        return "0"
    return f"{value:.{max(math.floor(math.log10(abs(value))) - last + 1, 1)}g}"


def _report_lines(figures: dict[str, Any] | None, say: Catalogue) -> list[str]:
    """Write them side by side."""
    if figures is None:
        return []
    lines = [say("adopted.report", file=figures["file"], program=figures["program"])]
    for row in figures["rows"]:
        theirs, ours = (
            "-" if row[key] is None else f"{say.row([row[key]], '.4g')} {row['unit']}".strip()
            for key in ("theirs", "ours")
        )
        lines.append(f"  {say.stored(row['what']):<44}{theirs:>14}{ours:>14}")
    return lines


def adoption_text(figures: dict[str, Any], say: Catalogue | None = None) -> str:
    """Write it for people, side by side."""
    say = say or catalogue("en")
    joint = say("join.figures")
    counts = {key: figures[key] for key in ("program", "images", "points", "observations")}
    lines = [
        say.told("adopted.head", **counts, factor=float(figures["sigma0_squared"] or 0)),
        *(say("adopted.note", text=say.stored(remark)) for remark in figures["remarks"]),
    ]
    for name, camera in figures["cameras"].items():
        unit = camera["unit"] + (say("adopted.divided") if camera["normalised"] else "")
        lines.append(say("adopted.camera", camera=name, unit=unit))
        lines += [_parameter(camera, key, parameter, say) for key, parameter in camera["parameters"].items()]
    for head in figures["heads"]:
        turns, places = (
            joint.join(
                f"{factor * value['difference']:+.2f} +- {factor * value['sigma']:.2f}"
                for key, value in head["values"].items()
                if key.startswith("turn") == turning
            ).replace(".", say.mark)
            for turning, factor in ((True, 3600.0), (False, 1000.0))
        )
        who = {key: head[key] for key in ("camera", "of", "exposures")}
        lines.append(say("adopted.head_of", **who, turns=turns, places=places))
    lines += [_group_line(row, say) for row in figures["sigmas"]]
    lines += _report_lines(figures.get("report"), say)
    shift = figures["positions"]
    if shift is not None and shift["estimated"]:
        both = ((shift["common_shift_m"][a], shift["sigma_m"][a]) for a in "xyz")
        text = joint.join(f"{value:+.3f} +- {sigma:.3f}" for value, sigma in both).replace(".", say.mark)
        # A common shift of the positions is reported as one of the datum from here on, in its standard
        # deviations.
        shifted = 3.0
        large = any(abs(shift["common_shift_m"][a]) > shifted * shift["sigma_m"][a] for a in "xyz")
        verdict = say("adopted.datum" if large else "adopted.same_datum")
        lines.append(say("adopted.shift", figures=text, verdict=verdict))
    for row in figures["control"]:
        theirs, ours = (
            "-" if row[key] is None else ", ".join(f"{1e3 * v:+.0f}" for v in row[key])
            for key in ("theirs_m", "ours_m")
        )
        promised = ", ".join(f"{1e3 * v:.0f}" for v in row["sigma_m"])
        told = {"role": say.stored(row["role"]), "point": row["point"], "rays": row["rays"]}
        lines.append(say("adopted.point", **told, theirs=theirs, ours=ours, sigma=promised))
    found = findings_of(figures["findings"], "adoption.json")
    lines += [say("adopted.hidden", text=finding_text(finding, say, plain)) for finding in found]
    return "\n".join(lines)


def _group_line(row: dict[str, Any], say: Catalogue) -> str:
    """Say what a group of observations was promised to be, and what its residuals show."""
    stated, found, unit = row["stated"], row["found"], row["unit"]
    shown = "-" if found is None else f"{say.row([found], '.3g')} {unit}"
    times = "" if not stated or found is None else say.told("adopted.times", ratio=found / stated)
    promised = (
        say("adopted.unstated") if stated is None else say.told("adopted.stated", value=stated, unit=unit)
    )
    group = say.stored(row["group"])
    return say("adopted.group", group=group, n=row["n"], stated=promised, found=shown, times=times)
