"""Plots of an experiment: RMSE at the check points by run, and against the number of control points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from photocal.georeferencing.differences import Differences
from photocal.georeferencing.experiment import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AXES = (("plane", "#1f4e9c", "o"), ("Z", "#b06a2a", "s"))


def rmse_plot(outcome: Outcome) -> Figure | None:
    """Draw the RMSE at the check points of every run, with the predicted sigma as a line across each bar."""
    from matplotlib.figure import Figure

    runs = [(run, run.check) for run in outcome.runs if run.check is not None and run.check.names]
    if not runs:
        return None
    figure = Figure(figsize=(max(6.0, 0.55 * len(runs) + 2.0), 4.2), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(runs), dtype=np.float64)
    rmse = np.array([check.rmse for _, check in runs])
    sigma = np.array([check.predicted for _, check in runs])
    for k, (axis, colour) in enumerate(zip("XYZ", ("#1f4e9c", "#7aa6d8", "#b06a2a"), strict=True)):
        x = place + 0.27 * (k - 1)
        axes.bar(x, rmse[:, k], 0.25, color=colour, label=f"RMSE {axis}")
        axes.hlines(sigma[:, k], x - 0.125, x + 0.125, color="black", linewidth=1.0)
    axes.set_xticks(place, [run.name for run, _ in runs], rotation=60, ha="right", fontsize=7)
    axes.set_ylabel("RMSE at the check points (m)")
    axes.set_title("Black lines: predicted standard deviation", fontsize=8, loc="left")
    axes.legend(fontsize=7)
    return figure


def control_plot(outcome: Outcome) -> Figure | None:
    """Draw the RMSE at the check points against the number of control points, predicted sigma broken."""
    from matplotlib.figure import Figure

    kinds: dict[tuple[str, str, str], list[tuple[int, Differences]]] = {}
    for run in outcome.runs:
        if run.check is not None and run.check.names:
            kinds.setdefault((run.method, run.interior, run.use), []).append((run.control, run.check))
    curves = {kind: runs for kind, runs in kinds.items() if len({control for control, _ in runs}) > 1}
    if not curves:
        return None
    figure = Figure(figsize=(max(4.5, 3.2 * len(curves)), 3.4), layout="constrained")
    panels = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    for axes, (kind, runs) in zip(panels, curves.items(), strict=True):
        # Patterns with as many points stand at the same place: each is a mark, the line follows their mean.
        count = np.array([control for control, _ in runs])
        figures = {"RMSE": [one.rmse for _, one in runs], "sigma": [one.predicted for _, one in runs]}
        places = np.unique(count)
        for name, colour, mark in _AXES:
            for what, style in (("RMSE", "-"), ("sigma", "--")):
                table = np.array(figures[what])
                values = np.hypot(table[:, 0], table[:, 1]) if name == "plane" else table[:, 2]
                means = [float(np.sqrt(np.mean(values[count == n] ** 2))) for n in places]
                axes.plot(places, means, style, color=colour, linewidth=1.2, label=f"{what} {name}")
                if what == "RMSE":
                    axes.plot(count, values, mark, color=colour, markersize=4)
        axes.set_xlabel("control points")
        axes.set_title(" ".join(part for part in kind if part and part != "as-given"), fontsize=8, loc="left")
        axes.set_ylim(0.0, None)
        axes.grid(visible=True, linewidth=0.3)
    panels[0].set_ylabel("at the check points (m)")
    panels[0].legend(fontsize=7)
    return figure
