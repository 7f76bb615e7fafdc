"""`photocal survey`: control points from static GNSS baselines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer
from photocal.commands.options import AsJson


def survey(
    setup: Annotated[
        Path,
        typer.Argument(
            help="TOML: required_minutes, optional crs; [[known]] name, lat_deg, lon_deg, height_m, sigma_m; "
            "[[baseline]] name, start, end, base, rover (RINEX or flight logs, with base_link, rover_link), "
            "nav, products, base_antenna_m, rover_antenna_m; "
            "[[ppp]] name, rover, nav, products (SP3, CLK), rover_antenna_m; antex with base_antenna, "
            "rover_antenna (types and radomes)."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for points.csv and the summary.")],
    as_json: AsJson = False,
) -> None:
    """Compute static baselines, adjust them as a network and write points with full covariances.

    Baselines with blunders are left out and named. Heights are ellipsoidal unless the system says else.

    Example: `photocal survey control.toml -o control`
    """
    import json
    import tempfile

    from acquire.outputs import output_folder
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.survey import Survey, read_setup, run_survey
    from photocal.navigation.survey_report import survey_figures, survey_text, write_points

    plan = read_setup(setup)
    with tempfile.TemporaryDirectory() as scratch:
        solution, sessions = run_survey(Survey(plan, setup.parent, Rtklib(), Path(scratch)))
    figures = survey_figures(solution, sessions)
    with output_folder(output) as folder:
        figures["points_csv"] = write_points(folder / "points.csv", solution, plan.crs)
        (folder / "survey.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    answer(as_json, lambda: figures, lambda: survey_text(figures))
