"""Results of an experiment: JSON, text, tables and plots of the RMSE at the check points."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.maps import save_figures
from photocal.base.arrays import as_plain
from photocal.base.files import output_folder, rows_text, write_json
from photocal.georeferencing.differences import Differences, cells, rms
from photocal.georeferencing.experiment import LeftOut, Outcome, Pair, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SHOWN = (("plane", "#1f4e9c", "o"), ("Z", "#b06a2a", "s"))
SCHEMA = "photocal.experiment/2"
_AXES = ("x", "y", "z")


def rmse_plot(outcome: Outcome) -> "Figure | None":
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


def control_plot(outcome: Outcome) -> "Figure | None":
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


def to_json(outcome: Outcome) -> dict[str, Any]:
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
    return {key: as_plain(part) for key, part in content.items()}


def to_text(outcome: Outcome) -> str:
    """Write an experiment's results for people."""
    lines = [
        f"check points, {SIGN}; RMSE and predicted sigma in m, t of the mean (* biased)",
        f"{'run':<40}{'control':>8}{'check':>6}{'X':>9}{'Y':>9}{'Z':>9}   {'sX':>8}{'sY':>8}{'sZ':>8}   t",
    ]
    for run in outcome.runs:
        if run.check is None:
            lines.append(f"{run.name:<40}{run.control:>8}  failed: {run.failure}")
            continue
        t = " ".join(f"{b.t:.2f}{'*' if b.significant else ''}" for b in run.bias)
        left = f"{run.name:<40}{run.control:>8}{len(run.check.names):>6}{cells(run.check.rmse)}"
        lines.append(f"{left}   {cells(run.check.predicted, '8.4f')}   {t}")
    lines += ["", f"{'run':<40}{'image residuals px':>20}   exterior orientation, RMSE in m and deg"]
    for run in (run for run in outcome.runs if run.check):
        x, y = run.residuals_px.tolist()
        turned = np.full(6, np.nan) if run.exposures is None else run.exposures.rmse
        lines.append(f"{run.name:<40}{x:11.3f}{y:9.3f}   {cells(turned[3:])}{cells(np.degrees(turned[:3]))}")
    if outcome.pairs:
        lines += ["", "pair by pair: RMSE of the differences at check points, m"]
    for pair in outcome.pairs:
        lines.append(f"{pair.first.name} - {pair.second.name:<28}{cells(pair.check)}")
    if outcome.left_out:
        lines += ["", "leave one out: d, w"]
    for case in outcome.left_out:
        if case.failure:
            lines.append(f"  {case.method:<12}{case.point:<12}{case.failure}")
            continue
        values, tested = cells(case.d, "+.4f", " "), cells(case.w, ".2f", " ")
        lines.append(f"  {case.method:<12}{case.point:<12}{values}   {tested}")
    return "\n".join(lines)


def write_experiment(outcome: Outcome, folder: Path) -> tuple[str, ...]:
    """Write the results of an experiment; raises OutputError when the folder cannot be written."""
    texts = {"runs.csv": _csv([_flat(run) for run in outcome.runs])}
    if outcome.pairs:
        texts["pairs.csv"] = _csv([_pair(pair) for pair in outcome.pairs])
    if outcome.left_out:
        texts["leave_one_out.csv"] = _csv([_left(case) for case in outcome.left_out])
    with output_folder(folder) as aside:
        write_json(aside / "experiment.json", to_json(outcome))
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        drawn = {"rmse.pdf": rmse_plot(outcome), "rmse_by_control.pdf": control_plot(outcome)}
        figures = save_figures(aside, drawn)
    return ("experiment.json", *texts, *figures)


def _run(run: Run) -> dict[str, Any]:
    return {
        **_flat(run),
        "points": []
        if run.check is None
        else [
            {"point": name, "d_m": d, "sigma_m": s}
            for name, d, s in zip(run.check.names, run.check.d, run.check.product_sigma, strict=True)
        ],
    }


def _flat(run: Run) -> dict[str, Any]:
    none = np.full(3, np.nan)
    rmse, sigma = (none, none) if run.check is None else (run.check.rmse, run.check.predicted)
    row: dict[str, Any] = {
        "interior": run.interior,
        "use": run.use,
        "pattern": run.pattern,
        "method": run.method,
        "control": run.control,
        "check": 0 if run.check is None else len(run.check.names),
    }
    row |= {f"rmse_{axis}_m": v for axis, v in zip(_AXES, rmse, strict=True)}
    row |= {"rmse_plane_m": np.hypot(*rmse[:2]), "rmse_3d_m": np.sqrt(np.sum(rmse**2))}
    row |= {f"predicted_{axis}_m": v for axis, v in zip(_AXES, sigma, strict=True)}
    for k, axis in enumerate(_AXES):
        bias = run.bias[k] if run.bias else None
        row[f"t_{axis}"] = None if bias is None else bias.t
        row[f"biased_{axis}"] = None if bias is None else bias.significant
        row[f"rmse_without_trend_{axis}_m"] = run.without_trend[k] if run.without_trend else None
    row |= {f"residual_{a}_px": v for a, v in zip(_AXES, run.residuals_px, strict=False)}
    poses = np.full(6, np.nan) if run.exposures is None else run.exposures.rmse
    row |= {f"exterior_rmse_{a}_m": v for a, v in zip(_AXES, poses[3:], strict=True)}
    angles = zip(("omega", "phi", "kappa"), np.degrees(poses[:3]), strict=True)
    row |= {f"exterior_rmse_{a}_deg": v for a, v in angles}
    row["errors_over_prediction"] = None if run.check is None else run.check.ratio
    return row | {"variance_factor": run.variance_factor, "failure": run.failure}


def _pair(pair: Pair) -> dict[str, Any]:
    row: dict[str, Any] = {name: getattr(pair.first, name) for name in ("use", "pattern", "method")}
    row |= {"first": pair.first.interior, "second": pair.second.interior}
    for part, values in (("check", pair.check), ("all", pair.all)):
        row |= {f"{part}_rmse_{a}_m": v for a, v in zip(_AXES, values, strict=True)}
    return row


def _left(case: LeftOut) -> dict[str, Any]:
    row: dict[str, Any] = {"method": case.method, "point": case.point}
    for prefix, values, unit in (("d", case.d, "_m"), ("s", case.sigma, "_m"), ("w", case.w, "")):
        row |= {f"{prefix}{a}{unit}": v for a, v in zip(_AXES, values, strict=True)}
    return row | {"failure": case.failure}


def _csv(rows: list[dict[str, Any]]) -> str:
    return rows_text(list(rows[0]), [list(as_plain(row).values()) for row in rows])
