"""How large an error must be to be found: its noncentrality in an adjustment of one's own, to first order.

An error of the observations that the unknowns cannot follow raises the weighted sum of squared residuals by
lambda = e' (P - P A (A' P A)^-1 A' P) e. A test of one unknown at 0.1 % finds lambda = 17.07 in 80 % of cases
(Baarda 1968).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.independent.flights import (
    ATTITUDE_DEG,
    BORESIGHT_SIGMA_DEG,
    CONTROL_M,
    GNSS_M,
    LEVER_M,
    Design,
    Errors,
    World,
    expected,
)
from tests.independent.optics import Floats

FOUND = 17.07
# Steps of the differences: rad, m, px or what a lens term makes of it at the corner.
_TURN, _MOVE = 1e-6, 1e-4
_TERM = {"c": 1e-2, "x0": 1e-2, "y0": 1e-2, "K1": 1e-13, "K2": 1e-20, "K3": 1e-27, "P1": 1e-11, "P2": 1e-11}


def scaled(errors: Errors, factor: float) -> Errors:
    """The same error so many times as large."""
    made: dict[str, Any] = {}
    for name in ("lever_arm_m", "datum_m"):
        made[name] = tuple([factor * v for v in getattr(errors, name)])
    for name in (
        "time_offset_s",
        "plane_scale",
        "control_scale",
        "c_step",
        "c_stated",
        "readout_s",
        "refraction",
    ):
        made[name] = factor * getattr(errors, name)
    made["lens"] = tuple((term, factor * value) for term, value in errors.lens)
    for name in ("control", "position"):
        made[name] = tuple((k, tuple(factor * v for v in wrong)) for k, wrong in getattr(errors, name))
    return replace(errors, **made)


def detectable(truth: World, design: Design, errors: Errors) -> float:
    """Give by how much an error must be multiplied to be found in 80 % of cases."""
    return float(np.sqrt(FOUND / noncentrality(truth, design, errors)))


def noncentrality(truth: World, design: Design, errors: Errors) -> float:
    """Give by how much an error raises the weighted sum of squared residuals."""
    control = truth.of_role("control")
    clean = expected(truth, design, Errors())
    wrong = expected(truth, design, errors)
    if errors.c_stated:
        lens = replace(truth.lens, c=truth.lens.c / (1.0 + errors.c_stated))
        wrong = expected(replace(truth, lens=lens), design, errors)
    of_rays = (wrong.pixels - clean.pixels) / design.sigma_px
    # A block that states another arm takes its antennas for those of that arm.
    x, y, z = (np.array(errors.stated_lever_m) - LEVER_M).tolist()
    antenna = wrong.antenna - expected(truth, design, Errors(lever_arm_m=(x, y, z))).antenna
    of_poses = np.hstack([antenna / GNSS_M, np.zeros((len(antenna), 3))]) * design.gnss
    of_control = (wrong.surveyed - clean.surveyed)[control] / CONTROL_M
    return _left(truth, design, of_rays, of_poses, of_control)


def _left(truth: World, design: Design, of_rays: Floats, of_poses: Floats, of_control: Floats) -> float:
    """Weighted squares that no unknown takes up; unknowns: poses, common values, then points."""
    n, points = len(truth.centre), len(truth.role)
    own, of_point, common, by_common = _derivatives(truth, design)
    pose_own, pose_common = _of_poses(truth, design, by_common)
    held = 3 * (design.boresight == "held") if design.gnss else 3
    size = 6 * n + common.shape[2]
    normal, right = np.zeros((size, size)), np.zeros(size)
    aside = np.zeros((points, 3, size))
    of_points, point_right = np.zeros((points, 3, 3)), np.zeros((points, 3))
    for k, i, j in zip(range(len(truth.image)), truth.image, truth.point, strict=True):
        at = np.r_[6 * i : 6 * i + 6, 6 * n : size]
        rows = np.hstack([own[k], common[k]])
        normal[np.ix_(at, at)] += rows.T @ rows
        right[at] += rows.T @ of_rays[k]
        aside[j][:, at] += of_point[k].T @ rows
        of_points[j] += of_point[k].T @ of_point[k]
        point_right[j] += of_point[k].T @ of_rays[k]
    for i in range(n if design.gnss else 0):
        at = np.r_[6 * i : 6 * i + 6, 6 * n : size]
        rows = np.hstack([pose_own[i], pose_common])
        normal[np.ix_(at, at)] += rows.T @ rows
        right[at] += rows.T @ of_poses[i]
    for row, j in enumerate(truth.of_role("control")):
        of_points[j] += np.diag(1.0 / np.square(CONTROL_M))
        point_right[j] += of_control[row] / CONTROL_M
    # The boresight comes last: stated it has its sigma, held it is no unknown.
    at = slice(size - 3, size)
    if design.boresight == "stated":
        normal[at, at] += np.eye(3) / np.radians(BORESIGHT_SIGMA_DEG) ** 2
    keep = np.arange(size - held)
    seen = np.flatnonzero(np.bincount(truth.point, minlength=points) > 0)
    inverse = np.linalg.inv(of_points[seen])
    wide = aside[seen][:, :, keep]
    weighted = np.einsum("pab,pbs->pas", inverse, wide)
    reduced = normal[np.ix_(keep, keep)] - np.einsum("pas,pat->st", wide, weighted)
    reduced_right = right[keep] - np.einsum("pas,pa->s", weighted, point_right[seen])
    taken = float(reduced_right @ np.linalg.solve(reduced, reduced_right))
    taken += float(np.einsum("pa,pab,pb->", point_right[seen], inverse, point_right[seen]))
    return float(sum(np.sum(part**2) for part in (of_rays, of_poses, of_control))) - taken


def _derivatives(truth: World, design: Design) -> tuple[Floats, Floats, Floats, int]:
    """Of each ray by its pose (6), its point (3) and the common values; how many of these are of lenses."""

    def rays(changed: World) -> Floats:
        """Pixels in sigmas."""
        return expected(changed, design, Errors()).pixels / design.sigma_px

    def slope(name: str, axis: int, step: float) -> Floats:
        """Central difference of all rays by one column of the truth."""
        sides = []
        for sign in (1.0, -1.0):
            value = np.array(getattr(truth, name), dtype=float)
            value[..., axis] += sign * step
            given: Any = tuple(value.tolist()) if name == "boresight_deg" else value
            sides.append(rays(replace(truth, **{name: given})))
        return (sides[0] - sides[1]) / (2.0 * step)

    def by_term(name: str) -> Floats:
        """Central difference by a term of the lens."""
        step = _TERM[name]
        value = getattr(truth.lens, name)
        sides = [rays(replace(truth, lens=replace(truth.lens, **{name: value + s}))) for s in (step, -step)]
        # In units of the step's effect: the columns are of one size.
        return (sides[0] - sides[1]) / 2.0

    turns = [slope("angles", axis, _TURN) for axis in range(3)]
    own = np.stack([*turns, *(slope("centre", axis, _MOVE) for axis in range(3))], axis=2)
    of_point = np.stack([slope("points", axis, _MOVE) for axis in range(3)], axis=2)
    terms = [by_term(name) for name in design.estimate if name in _TERM]
    bore = [slope("boresight_deg", axis, 1e-4) * np.degrees(1.0) for axis in range(3)]
    return own, of_point, np.stack([*terms, *bore], axis=2), len(terms)


def _of_poses(truth: World, design: Design, terms: int) -> tuple[Floats, Floats]:
    """Of antenna and attitude of each exposure by its pose; by the common values they do not change."""
    n = len(truth.centre)
    made = np.zeros((n, 6, 6))
    for axis in range(3):
        for sign in (1.0, -1.0):
            angles = truth.angles.copy()
            angles[:, axis] += sign * _TURN
            antenna = expected(replace(truth, angles=angles), design, Errors()).antenna
            made[:, :3, axis] += sign * antenna / (2.0 * _TURN) / GNSS_M
        made[:, axis, 3 + axis] = 1.0 / GNSS_M[axis]
        made[:, 3 + axis, axis] = 1.0 / np.radians(ATTITUDE_DEG)
    return made, np.zeros((6, terms + 3))
