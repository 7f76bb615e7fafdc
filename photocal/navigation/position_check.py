"""Exposures against positions of another source, as a check of times and lever arm."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError
from photocal.geometry.similarity import similarity
from photocal.navigation.check import Check
from photocal.navigation.exposures import Exposures
from photocal.navigation.position_comparison import (
    AXES,
    AXIS_NAMES,
    LEVER,
    TIME,
    PositionComparison,
    PositionPairs,
    compare_positions,
)
from photocal.navigation.rig import Rig
from photocal.navigation.trajectory import enu_offsets

Floats = NDArray[np.float64]


def judge_positions(source: str, ours: Exposures, theirs: Floats, rig: Rig, free: str) -> Check:
    """Hold exposures against positions of another source."""
    compared = f"{source} against the exposures, less a common {free}"
    p = ours.placed
    known = p.placed & np.isfinite(theirs).all(axis=1)
    if known.sum() < 8:
        return Check("positions", "not possible", compared, f"{int(known.sum())} common exposures", {})
    origin = np.array([np.mean(c[known]) for c in (p.lat_deg, p.lon_deg, p.height_m)])
    here = enu_offsets(p.lat_deg[known], p.lon_deg[known], p.height_m[known], origin)
    there = _aligned(theirs[known], here) if free == "similarity" else _offsets(theirs[known], origin)
    body = ours.carrier if ours.carrier is not None else ours.attitude
    if there is None:
        return Check("positions", "not possible", compared, "the exposures lie on one line", {})
    velocity = p.velocity_m_s[known]
    turn = np.swapaxes(body.rotation[known], 1, 2)
    lever_sigma = None if rig.lever_m is None else rig.lever_sigma_m
    pairs = PositionPairs(
        here, there, velocity, turn, rig.lever_m, free, rig.time_offset_sigma_s, lever_sigma
    )
    try:
        found = compare_positions(pairs)
    except IllPosedError as refusal:
        return Check("positions", "not possible", compared, str(refusal), {})
    return _verdict(found, compared, rig.lever_m)


def _verdict(found: PositionComparison, compared: str, lever_m: Floats | None) -> Check:
    best = found.best
    figures: dict[str, Any] = {
        "exposures": found.n,
        "rms_enu_m": found.rms_m.tolist(),
        "shift_enu_m": found.shift_m.tolist(),
        "detectable_time_offset_s": found.detectable_s if np.isfinite(found.detectable_s) else None,
    }
    rms = " ".join(f"{v:.3f}" for v in found.rms_m)
    if best is None:
        limit = (
            f"a time offset over {found.detectable_s * 1e3:.1f} ms would show"
            if np.isfinite(found.detectable_s)
            else "a time offset cannot show: the flight has one direction"
        )
        return Check("positions", "passed", compared, f"differences of {rms} m rms (E N U); {limit}", figures)
    figures |= {"explanation": best.name, "value": best.value.tolist(), "sigma": best.sigma.tolist()}
    figures["as_good"] = list(found.same)
    if best.name == TIME:
        text = (
            f"exposures are {abs(best.value[0]) * 1e3:.1f} ms (sigma {best.sigma[0] * 1e3:.1f} ms) "
            f"{'later' if best.value[0] > 0 else 'earlier'} than stamped: check the delay"
        )
    elif best.name == AXES:
        text = f"axes of the lever arm are exchanged or have a wrong sign: {best.axes} m fits"
    else:
        parts = ", ".join(f"{v * 1e3:+.0f} mm {name}" for v, name in zip(best.value, AXIS_NAMES, strict=True))
        known = "the lever arm is wrong by" if lever_m is not None else "there is a lever arm of"
        text = f"{known} {parts}"
    names = {TIME: "a time offset", LEVER: "another lever arm", AXES: "exchanged axes of the lever arm"}
    if found.exchange is not None and best is not found.exchange:
        figures["exchanged_axes"] = found.exchange.axes
        text += f"; with exchanged axes or signs it would be {found.exchange.axes} m"
    elif found.same:
        text += "; " + " or ".join(names[name] for name in found.same) + " would explain it as well"
    return Check(best.name, "failed", compared, text, figures)


def _offsets(place: Floats, origin: Floats) -> Floats:
    return enu_offsets(place[:, 0], place[:, 1], place[:, 2], origin)


def _aligned(theirs: Floats, ours: Floats) -> Floats | None:
    found = similarity(theirs, ours)
    return None if found is None else found.applied(theirs)
