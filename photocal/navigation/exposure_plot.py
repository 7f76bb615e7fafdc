"""Track, height and timing of exposures as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.navigation.exposure_run import ExposureRun
from photocal.navigation.trajectory import enu_offsets


def plot_exposures(run: ExposureRun, path: Path) -> None:
    """Draw where the exposures lie on the track, their heights, and the residuals of the clocks."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    p = run.exposures.placed
    rows = p.placed
    figure = Figure(figsize=(11, 8), layout="constrained")
    track, height, timing, gaps = figure.subplots(2, 2).ravel()
    if rows.any():
        origin = np.array([np.mean(p.lat_deg[rows]), np.mean(p.lon_deg[rows]), np.mean(p.height_m[rows])])
        minutes = (run.exposures.time.ns - run.exposures.time.ns[0]) / 60e9
        t = run.trajectory
        if t is not None:
            east, north, _ = enu_offsets(t.lat_deg, t.lon_deg, t.height_m, origin).T
            track.plot(east, north, "-", lw=0.5, color="0.7")
        east, north, _ = enu_offsets(p.lat_deg[rows], p.lon_deg[rows], p.height_m[rows], origin).T
        track.plot(east, north, ".", ms=3)
        height.plot(minutes[rows], p.height_m[rows], ".", ms=3)
        gaps.plot(minutes, np.minimum(p.gap_s, 60), ".", ms=3)
    for found in run.cameras:
        timing.plot(found.matching.event, found.matching.residual_s * 1e3, ".", ms=3, label=found.camera)
    track.set(xlabel="east / m", ylabel="north / m", title="Exposures", aspect="equal")
    height.set(xlabel="time / min", ylabel=f"height / m ({run.exposures.height_kind[:11]})", title="Height")
    timing.set(xlabel="event", ylabel="residual / ms", title="Image less event")
    gaps.set(xlabel="time / min", ylabel="epochs apart / s", title="Epochs around each event")
    figure.savefig(path, dpi=120)
