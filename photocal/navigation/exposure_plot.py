"""Track, height and timing of exposures as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Floats
from photocal.navigation.exposure_run import ExposureRun
from photocal.navigation.interpolation import LARGEST_GAP_S
from photocal.navigation.trajectory import enu_offsets

COLOURS = {"fixed": "tab:green", "float": "tab:orange", "single": "tab:red"}
_SHOWN_GAP_S = 60.0


def plot_exposures(run: ExposureRun, path: Path) -> None:
    """Draw where the exposures lie on the track, their heights, the timing, and the epochs around them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    track, height, timing, gaps = figure.subplots(2, 2).ravel()
    minutes = (run.exposures.time.ns - run.exposures.time.ns[0]) / 60e9
    if run.exposures.placed.placed.any():
        _places(run, minutes, track, height)
    _timing(run, minutes, timing)
    _gaps(run, minutes, gaps)
    figure.savefig(path, dpi=120)


def _places(run: ExposureRun, minutes: Floats, track: Any, height: Any) -> None:
    p, t = run.exposures.placed, run.trajectory
    rows = p.placed
    origin = np.array([np.mean(p.lat_deg[rows]), np.mean(p.lon_deg[rows]), np.mean(p.height_m[rows])])
    if t is not None:
        east, north, _ = enu_offsets(t.lat_deg, t.lon_deg, t.height_m, origin).T
        track.plot(east, north, "-", lw=0.5, color="0.7", zorder=0)
        since = (t.time.ns - run.exposures.time.ns[0]) / 60e9
        near = (since >= minutes[0]) & (since <= minutes[-1])
        height.plot(since[near], t.height_m[near], "-", lw=0.5, color="0.7", zorder=0)
    east, north, _ = enu_offsets(p.lat_deg, p.lon_deg, p.height_m, origin).T
    sigma = np.sqrt(np.maximum(p.covariance_m2[:, 2, 2], 0.0))
    for status, colour in COLOURS.items():
        own = rows & (p.status == status)
        if own.any():
            track.plot(east[own], north[own], ".", ms=4, color=colour, label=f"{status} {int(own.sum())}")
            bars = np.nan_to_num(sigma[own])
            height.errorbar(minutes[own], p.height_m[own], bars, fmt=".", ms=4, lw=0.8, color=colour)
    track.legend()
    track.set(xlabel="east / m", ylabel="north / m", title="Exposures", aspect="equal")
    kind = "ellipsoidal" if run.exposures.height_kind.startswith("ell") else "kind: see summary"
    height.set(xlabel="time / min", ylabel=f"height / m ({kind})", title="Height with its sigma")


def _timing(run: ExposureRun, minutes: Floats, timing: Any) -> None:
    if run.cameras:
        for found in run.cameras:
            m = found.matching
            timing.plot(minutes[m.event], m.residual_s * 1e3, ".", ms=4, label=found.camera)
        timing.axhline(0.0, color="0.7", lw=0.8, zorder=0)
        timing.legend()
        title, label = "Event less image, offset and drift removed", "residual / ms"
    else:
        timing.plot(minutes[1:], np.diff(run.exposures.time.ns) / 1e9, ".", ms=4)
        timing.set_ylim(bottom=0.0)
        title, label = "From exposure to exposure", "interval / s"
    timing.set(xlabel="time / min", ylabel=label, title=title)


def _gaps(run: ExposureRun, minutes: Floats, gaps: Any) -> None:
    gap = run.exposures.placed.gap_s
    beyond = ~(gap <= _SHOWN_GAP_S)
    gaps.plot(minutes[~beyond], gap[~beyond], ".", ms=4)
    if beyond.any():
        gaps.plot(
            minutes[beyond],
            np.full(int(beyond.sum()), _SHOWN_GAP_S),
            "^",
            ms=4,
            color="tab:red",
            label=f"over {_SHOWN_GAP_S:g} s, or outside the trajectory",
        )
    gaps.axhline(LARGEST_GAP_S, color="k", lw=0.8, label=f"{LARGEST_GAP_S:g} s: placed below")
    gaps.set_ylim(0.0, max(2 * LARGEST_GAP_S, 1.1 * float(np.max(np.minimum(gap, _SHOWN_GAP_S)))))
    gaps.ticklabel_format(useOffset=False)
    gaps.legend()
    gaps.set(xlabel="time / min", ylabel="epochs apart / s", title="Epochs around each event")
