"""Exposures against positions of another source, as a check of times and lever arm."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Floats
from drivers.errors import IllPosedError
from photocal.findings.finding import Finding, untested
from photocal.geometry.similarity import similarity
from photocal.navigation.exposures import Exposures
from photocal.navigation.position_comparison import (
    AXES,
    AXIS_NAMES,
    TIME,
    PositionComparison,
    PositionPairs,
    compare_positions,
)
from photocal.navigation.rig import Rig
from photocal.navigation.trajectory import enu_offsets


def judge_positions(source: str, ours: Exposures, theirs: Floats, rig: Rig, free: str) -> Finding:
    """Hold exposures against positions of another source."""
    code, beside = "positions", {"source": source, "free": free}
    p = ours.placed
    known = p.placed & np.isfinite(theirs).all(axis=1)
    if known.sum() < 8:
        return untested(code, "few-common", {**beside, "n": float(known.sum())})
    origin = np.array([np.mean(c[known]) for c in (p.lat_deg, p.lon_deg, p.height_m)])
    here = enu_offsets(p.lat_deg[known], p.lon_deg[known], p.height_m[known], origin)
    there = _aligned(theirs[known], here) if free == "similarity" else _offsets(theirs[known], origin)
    body = ours.carrier if ours.carrier is not None else ours.attitude
    if there is None:
        return untested(code, "on-one-line", beside)
    velocity = p.velocity_m_s[known]
    turn = np.swapaxes(body.rotation[known], 1, 2)
    lever_sigma = None if rig.lever_m is None else rig.lever_sigma_m
    pairs = PositionPairs(
        here, there, velocity, turn, rig.lever_m, free, rig.time_offset_sigma_s, lever_sigma
    )
    try:
        found = compare_positions(pairs)
    except IllPosedError as refusal:
        return untested(code, "ill-posed", {**beside, "reason": str(refusal)})
    return _judged(found, beside, rig.lever_m)


def _judged(found: PositionComparison, beside: dict[str, str], lever_m: Floats | None) -> Finding:
    best, seen = found.best, bool(np.isfinite(found.detectable_s))
    figures: dict[str, Any] = {
        **beside,
        "exposures": found.n,
        "rms_enu_m": found.rms_m.tolist(),
        "shift_enu_m": found.shift_m.tolist(),
        "detectable_time_offset_s": found.detectable_s if seen else None,
        "detectable_ms": found.detectable_s * 1e3 if seen else None,
        "numbers": tuple(f"{v:.3f}" for v in found.rms_m),
    }
    if best is None:
        return Finding("positions", "passed", figures=figures, clauses=("would-show" if seen else "one-way",))
    figures |= {"explanation": best.name, "value": best.value.tolist(), "sigma": best.sigma.tolist()}
    figures["as_good"] = list(found.same)
    clauses = []
    if best.name == TIME:
        figures |= {"late_ms": abs(best.value[0]) * 1e3, "late_sigma_ms": best.sigma[0] * 1e3}
        clauses.append("later" if best.value[0] > 0 else "earlier")
    elif best.name == AXES:
        figures["exchanged"] = _axes(best.axes)
        clauses.append("fits")
    else:
        parts = zip(best.value, AXIS_NAMES, strict=True)
        figures["lever"] = tuple(f"mm {1e3 * v:+.0f} {name}" for v, name in parts)
        clauses.append("wrong-by" if lever_m is not None else "there-is")
    if found.exchange is not None and best is not found.exchange:
        figures["exchanged_axes"] = found.exchange.axes
        figures["exchanged"] = _axes(found.exchange.axes)
        clauses.append("or-exchanged")
    elif found.same:
        figures["same"] = found.same
        clauses.append("as-good")
    return Finding(best.name, "grave", figures=figures, clauses=tuple(clauses))


def _axes(text: str) -> tuple[str, ...]:
    return tuple(f"m {part}" for part in text.split(", "))


def _offsets(place: Floats, origin: Floats) -> Floats:
    return enu_offsets(place[:, 0], place[:, 1], place[:, 2], origin)


def _aligned(theirs: Floats, ours: Floats) -> Floats | None:
    found = similarity(theirs, ours)
    return None if found is None else found.applied(theirs)
