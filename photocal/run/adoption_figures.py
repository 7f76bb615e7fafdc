"""Side by side: what another program says of a project, and what its adjustment anew finds."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Flags, Floats
from photocal.exchange.foreign_project import ForeignProject
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import matrix_from_angles
from photocal.results.result import Result

# A common shift of the positions is told as one of the datum from here on, in its standard deviations.
SHIFTED = 3.0


def camera_figures(foreign: ForeignProject, result: Result) -> dict[str, Any]:
    """Their parameters of each camera and ours, with sigmas and the difference in ours."""
    figures: dict[str, Any] = {}
    stated = {own.id: own for own in (*foreign.block.cameras, *foreign.cameras)}
    for own in stated.values():
        ours, promised = result.cameras[own.id], foreign.camera_sigma.get(own.id, {})
        figures[own.id] = {"unit": own.unit, "model": own.model, "parameters": {}}
        for name in PARAMETERS:
            if name not in ours.free and not own.value(name):
                continue
            sigma = ours.sigma_of(name) if name in ours.free else None
            figures[own.id]["parameters"][name] = {
                "theirs": own.value(name),
                "their_sigma": promised.get(name),
                "ours": ours.value(name),
                "sigma": sigma,
                "difference_in_sigmas": (ours.value(name) - own.value(name)) / sigma if sigma else None,
            }
    return figures


def sigma_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """What each group of observations was promised to be, and what its residuals show."""
    tie, seen = ties_of(result), result.residuals
    rows: list[dict[str, Any]] = []
    for name, mine in (("image coordinates of tie points", tie), ("marks of surveyed points", ~tie)):
        free = float(seen.redundancy[mine].sum())
        if free > 1:
            stated = float(np.sqrt(np.mean(foreign.block.observations.sigma[mine] ** 2)))
            found = float(np.sqrt((seen.residual[mine] ** 2).sum() / free))
            rows.append(
                {
                    "group": name,
                    "unit": "px",
                    "n": int(mine.sum()),
                    "stated": stated if foreign.weighted else None,
                    "found": found,
                }
            )
    points = foreign.block.points
    control = np.flatnonzero(points.of_role("control"))
    if len(control):
        place = dict(zip(result.points.names, result.points.values, strict=True))
        error = np.array([place[points.names[k]] - points.values[k] for k in control])
        for name, axes in (("control in plane", slice(0, 2)), ("control in height", slice(2, 3))):
            rows.append(_group(name, error[:, axes], points.sigma[control][:, axes]))
    known = np.isfinite(foreign.position).all(axis=1)
    if known.any():
        error = (result.images.values[:, 3:] - foreign.position)[known]
        error -= np.mean(error, axis=0)
        for name, axes in (("positions in plane", slice(0, 2)), ("positions in height", slice(2, 3))):
            rows.append(_group(name, error[:, axes], foreign.position_sigma[known][:, axes]))
    return rows


def ties_of(result: Result) -> Flags:
    """Which observations are of tie points, shape (n,)."""
    seen = result.residuals
    roles = dict(zip(result.points.names, result.points.role, strict=True))
    tie = np.array([roles.get(name, "tie") == "tie" for name in seen.point_names])
    return np.asarray(tie[seen.point])


def _group(name: str, error: Floats, stated: Floats) -> dict[str, Any]:
    """A group whose residuals stand for its errors: all others outnumber it."""
    usable = np.isfinite(stated) & np.isfinite(error)
    rms = float(np.sqrt(np.mean(error[usable] ** 2))) if usable.any() else None
    typical = float(np.sqrt(np.mean(stated[usable] ** 2))) if usable.any() else None
    return {"group": name, "unit": "m", "n": len(error), "stated": typical, "found": rms}


def position_figures(foreign: ForeignProject, result: Result) -> dict[str, Any] | None:
    """The shift that all positions have in common, adjusted minus given."""
    mounting = result.mounting
    known = np.isfinite(foreign.position).all(axis=1)
    if mounting is None or not known.any():
        return None
    # The shift belongs to the observed positions: observed = true + shift.
    shift = {axis: -mounting[f"shift_{axis}"].value for axis in "xyz"}
    sigma = {axis: mounting[f"shift_{axis}"].sigma for axis in "xyz"}
    theirs = np.mean((foreign.block.images.values[:, 3:] - foreign.position)[known], axis=0)
    return {
        "images": int(known.sum()),
        "estimated": bool(mounting["shift_x"].estimated),
        "common_shift_m": shift,
        "sigma_m": sigma,
        "theirs_m": dict(zip("xyz", theirs.tolist(), strict=True)),
    }


def control_figures(foreign: ForeignProject, result: Result) -> list[dict[str, Any]]:
    """Adjusted minus surveyed at control and check points, theirs and ours."""
    survey = dict(zip(foreign.block.points.names, foreign.block.points.values, strict=True))
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


def adoption_text(figures: dict[str, Any]) -> str:
    """Write it for people, side by side."""
    size = f"{figures['images']} images, {figures['points']} points, {figures['observations']} observations"
    lines = [
        f"{figures['program']}: {size}, sigma0^2 {figures['sigma0_squared'] or 0:.3f}",
        *(f"note: {remark}" for remark in figures["remarks"]),
    ]
    for name, camera in figures["cameras"].items():
        lines.append(
            f"camera {name} ({camera['unit']})          theirs            ours +- sigma     difference"
        )
        for key, one in camera["parameters"].items():
            sigma = one["sigma"]
            theirs = f"{one['theirs']:.8g}" + (f" +- {one['their_sigma']:.2g}" if one["their_sigma"] else "")
            ours = f"{one['ours']:.8g}" + (f" +- {sigma:.2g}" if sigma else " held")
            away = "" if sigma is None else f"{one['difference_in_sigmas']:+.2f} sd"
            lines.append(f"  {key:<4}{theirs:>28}{ours:>28}{away:>14}")
    for row in figures["sigmas"]:
        stated = "not stated" if row["stated"] is None else f"stated {row['stated']:.3g} {row['unit']}"
        kept = (
            "" if not row["stated"] or row["found"] is None else f": {row['found'] / row['stated']:.2f} times"
        )
        found = "-" if row["found"] is None else f"{row['found']:.3g} {row['unit']}"
        lines.append(f"{row['group']} ({row['n']}): {stated}, found {found}{kept}")
    shift = figures["positions"]
    if shift is not None and shift["estimated"]:
        text = ", ".join(f"{shift['common_shift_m'][a]:+.3f} +- {shift['sigma_m'][a]:.3f}" for a in "xyz")
        large = any(abs(shift["common_shift_m"][a]) > SHIFTED * shift["sigma_m"][a] for a in "xyz")
        verdict = "positions and control are not of one datum" if large else "not significant"
        lines.append(f"all positions, adjusted minus given: {text} m (X, Y, Z): {verdict}")
    for row in figures["control"]:
        cells = [
            "-" if row[key] is None else ", ".join(f"{1e3 * v:+.0f}" for v in row[key])
            for key in ("theirs_m", "ours_m")
        ]
        lines.append(
            f"{row['role']} {row['point']} ({row['rays']} rays): theirs {cells[0]}; ours {cells[1]} mm"
        )
    lines += [f"hidden: {sentence}" for sentence in figures["hidden"]]
    return "\n".join(lines)
