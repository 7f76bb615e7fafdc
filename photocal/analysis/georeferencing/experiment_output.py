"""Results of an experiment: JSON, text, tables and plots of the RMSE at the check points."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.analysis.accuracy.discrepancies import SIGN
from photocal.analysis.accuracy.maps import save_figures
from photocal.analysis.accuracy.output import localised, told_table
from photocal.analysis.accuracy.variance_analysis import (
    VarianceEffect,
    analyse_rmse,
    variance_record,
    variance_tables,
)
from photocal.analysis.georeferencing.comparison import Differences, rms
from photocal.analysis.georeferencing.experiment import (
    ExperimentOutcome,
    ExperimentRun,
    RunPair,
    WithoutControlPoint,
)
from photocal.analysis.georeferencing.prior_sigma import (
    prior_plot,
    prior_record,
    prior_rows,
    prior_tables,
    support_rows,
    support_table,
)
from photocal.base.arrays import as_plain, picked
from photocal.base.files import output_folder, write_json, write_rows
from photocal.findings.document import Section, table, text
from photocal.findings.texts import Catalogue

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SHOWN = (("plane", "#1f4e9c", "o"), ("Z", "#b06a2a", "s"))
SCHEMA = "photocal.experiment/2"
_AXES = ("x", "y", "z")


def rmse_plot(outcome: ExperimentOutcome) -> "Figure | None":
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


def control_plot(outcome: ExperimentOutcome) -> "Figure | None":
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
        figures = {"RMSE": [check.rmse for _, check in runs], "sigma": [check.predicted for _, check in runs]}
        places = np.unique(count)
        for name, colour, mark in _SHOWN:
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


def to_json(outcome: ExperimentOutcome) -> dict[str, Any]:
    """Give an experiment's results as a JSON value."""
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "sign": SIGN,
        "runs": [_run(run) for run in outcome.runs],
        "pairs": [_pair(pair) for pair in outcome.pairs],
        "leave_one_out": [_left(case) for case in outcome.left_out],
        "leave_one_out_rmse_m": {
            method: rms([case.d for case in outcome.left_out if case.method == method and not case.failure])
            for method in dict.fromkeys(case.method for case in outcome.left_out)
        },
    }
    content["supports"] = support_rows(outcome.supports)
    content["variance"] = variance_record(_variance(outcome))
    content["prior"] = prior_record(outcome.priors)
    return {key: as_plain(part) for key, part in content.items()}


def _variance(outcome: ExperimentOutcome) -> dict[str, tuple[VarianceEffect, ...]]:
    """Part the variance of the RMSE at check points by what was varied; empty where nothing repeats it."""
    runs = [(run, run.check.rmse) for run in outcome.runs if run.check is not None and run.check.names]
    keys = ("interior", "use", "pattern", "method")
    factors = {key: [str(getattr(run, key)) for run, _ in runs] for key in keys}
    found = analyse_rmse(factors, np.array([values for _, values in runs]).reshape(-1, 3))
    return {f"RMSE {name}": effects for name, effects in found.items()}


def to_text(outcome: ExperimentOutcome, say: Catalogue) -> str:
    """Write an experiment's results for people."""
    runs, poses = [], []
    for run in outcome.runs:
        if run.check is None:
            runs.append((run.name, str(run.control), *[""] * 7, say("experiment.failed", reason=run.failure)))
            continue
        t = " ".join(f"{b.t:.2f}{'*' if b.significant else ''}" for b in run.bias)
        figures = _cells((*run.check.rmse, *run.check.predicted), ".4f")
        runs.append((run.name, str(run.control), str(len(run.check.names)), *figures, t))
        exterior = _cells((*run.exposures[3:], *np.degrees(run.exposures[:3])), ".4f")
        poses.append((run.name, *_cells(run.residuals_px, ".3f"), *exterior))
    pairs = [(f"{a.name} - {b.name}", *_cells(check, ".4f")) for a, b, check, _ in outcome.pairs]
    left = [
        (case.method, case.point, *([*[""] * 6, case.failure] if case.failure else _left_cells(case)))
        for case in outcome.left_out
    ]
    caption = say("experiment.runs", sign=say("shown.sign"))
    tables = (
        told_table("experiment.runs", runs, say, caption=caption),
        told_table("experiment.poses", poses, say),
        table(say("experiment.pairs"), ("", *"XYZ"), localised(pairs, say)),
        told_table("experiment.left", left, say),
        support_table(outcome.supports, say),
        *variance_tables(_variance(outcome), say),
        *(prior_tables(outcome.priors, say) if outcome.priors else ()),
    )
    return text([Section("", tuple(made for made in tables if made.rows))])


def _cells(values: Iterable[float], form: str) -> list[str]:
    return [f"{value:{form}}" for value in values]


def _left_cells(case: WithoutControlPoint) -> list[str]:
    return [*_cells(case.d, "+.4f"), *_cells(case.w, ".2f"), ""]


def write_experiment(outcome: ExperimentOutcome, folder: Path) -> None:
    """Write the results of an experiment; raises OutputError when the folder cannot be written."""
    tables = {
        "runs.csv": [_flat(run) for run in outcome.runs],
        "supports.csv": support_rows(outcome.supports),
        "priors.csv": prior_rows(outcome.priors),
        "pairs.csv": [_pair(pair) for pair in outcome.pairs],
        "leave_one_out.csv": [_left(case) for case in outcome.left_out],
    }
    with output_folder(folder) as aside:
        write_json(aside / "experiment.json", to_json(outcome))
        for name, rows in tables.items():
            if rows:
                write_rows(aside / name, list(rows[0]), [list(as_plain(row).values()) for row in rows])
        drawn = {"rmse.pdf": rmse_plot(outcome), "rmse_by_control.pdf": control_plot(outcome)}
        drawn["priors.pdf"] = prior_plot(outcome.priors)
        save_figures(aside, drawn)


def _run(run: ExperimentRun) -> dict[str, Any]:
    return {
        **_flat(run),
        "points": []
        if run.check is None
        else [
            {"point": name, "d_m": d, "sigma_m": s}
            for name, d, s in zip(run.check.names, run.check.d, run.check.product_sigma, strict=True)
        ],
    }


def _flat(run: ExperimentRun) -> dict[str, Any]:
    check, none = run.check, [None] * 3
    rmse, sigma = (np.full((2, 3), np.nan)) if check is None else (check.rmse, check.predicted)
    row = picked(run, "interior", "use", "pattern", "method", "control")
    row |= {"check": 0 if check is None else len(check.names), **_by_axis("rmse_{}_m", rmse)}
    row |= {"rmse_plane_m": np.hypot(*rmse[:2]), "rmse_3d_m": np.sqrt(np.sum(rmse**2))}
    row |= _by_axis("predicted_{}_m", sigma)
    for axis, bias, left in zip(_AXES, run.bias or none, run.without_trend or none, strict=True):
        row |= {f"t_{axis}": bias and bias.t, f"biased_{axis}": bias and bias.significant}
        row[f"rmse_without_trend_{axis}_m"] = left
    row |= _by_axis("residual_{}_px", run.residuals_px) | _by_axis("exterior_rmse_{}_m", run.exposures[3:])
    row |= _by_axis("exterior_rmse_{}_deg", np.degrees(run.exposures[:3]), ("omega", "phi", "kappa"))
    row["errors_over_prediction"] = check and check.ratio
    return row | picked(run, "variance_factor", "failure")


def _by_axis(name: str, values: Iterable[float], axes: tuple[str, ...] = _AXES) -> dict[str, Any]:
    return {name.format(axis): value for axis, value in zip(axes, values, strict=False)}


def _pair(pair: RunPair) -> dict[str, Any]:
    first, second, check, every = pair
    row = picked(first, "use", "pattern", "method", first="interior") | {"second": second.interior}
    return row | _by_axis("check_rmse_{}_m", check) | _by_axis("all_rmse_{}_m", every)


def _left(case: WithoutControlPoint) -> dict[str, Any]:
    figures = _by_axis("d{}_m", case.d) | _by_axis("s{}_m", case.sigma) | _by_axis("w{}", case.w)
    return {**picked(case, "method", "point"), **figures, "failure": case.failure}
