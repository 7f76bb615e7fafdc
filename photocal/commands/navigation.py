"""`photocal ppk`, `exposures`, `survey`, `localise`: trajectories, exposures and control points."""

from pathlib import Path
from typing import Annotated

import typer

from photocal.base.console import AsJson, Language, answer, argument, option, spread
from photocal.base.errors import ConfigurationError
from photocal.navigation.options import ExposureOptions, PpkOptions, ReceiverOptions, SiteOptions


@spread
def ppk(
    output: Annotated[Path, option("Folder for trajectory.csv, summary and plot.", "-o", "--output")],
    flight: Annotated[
        list[Path] | None,
        argument("Flight logs with raw frames of both, that follow each other.", metavar="FLIGHT.mcap"),
    ] = None,
    *,
    receivers: ReceiverOptions,
    options: PpkOptions,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Compute the trajectory of a rover from raw observations of rover and base.

    Fixes are validated (ratio, both directions, Doppler velocity, code) and doubtful ones become float;
    float sigmas are rescaled to what both directions show. The columns sen, seu, snu are the roots of the
    covariances with their signs, in metres.

    Example: `photocal ppk FLIGHT.mcap -o ppk`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.navigation.ppk_result import ppk_text
    from photocal.navigation.steps import ppk as computed

    made = computed(flight or (), receivers=receivers, options=options)
    made.write(output)
    say = catalogue(spoken(language))
    answer(as_json, lambda: made.figures, lambda: ppk_text(made.figures, say))


@spread
def exposures(
    output: Annotated[Path, option("Folder for exposures.csv and the rest.", "-o", "--output")],
    flight: Annotated[
        list[Path] | None,
        argument(
            "Flight logs that follow each other, or one PROJECT.toml that names everything.", metavar="FLIGHT"
        ),
    ] = None,
    *,
    options: ExposureOptions,
    receivers: ReceiverOptions,
    lever_arm: Annotated[str | None, typer.Option(hidden=True)] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Compute position and attitude of every exposure, with covariances, and check them.

    Positions come from PPK where the log has raw frames of rover and base, else from the event list, the
    autopilot or the images; images are matched to events by the differences of their times.

    Example: `photocal exposures FLIGHT.mcap --images DIR -o exposures`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.navigation.exposure_run import exposures_text
    from photocal.navigation.steps import exposures as computed

    if lever_arm is not None:
        raise ConfigurationError(
            "--lever-arm went from the antenna to the camera, the reverse of all other inputs",
            "give --camera-to-antenna with all three signs reversed",
            where="--lever-arm",
        )
    figures = computed(flight or (), receivers=receivers, options=options).write(output)
    answer(as_json, lambda: figures, lambda: exposures_text(figures, catalogue(spoken(language))))


def survey(
    setup: Annotated[
        Path,
        argument(
            "TOML: required_minutes, or [[required]] up_to_km, minutes, two_frequencies; optional crs, "
            "outside_area, elevation_deg, systems, two_frequencies; "
            "[[known]] name, lat_deg, lon_deg, height_m, sigma_m, optional frame (IGS20@2026.9); "
            "[[station]] name, file (SINEX or .sum), site, frame; "
            "[[baseline]] name, start, end, base, rover (RINEX or flight logs, with base_link, rover_link), "
            "nav, products, base_antenna_m, rover_antenna_m; "
            "[[ppp]] name, rover, nav, products (SP3, CLK), rover_antenna_m; antex with base_antenna, "
            "rover_antenna (types and radomes).",
            metavar="SURVEY.toml",
        ),
    ],
    output: Annotated[Path, option("Folder for points.csv and the summary.", "-o", "--output")],
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Compute static baselines, adjust them as a network and write points with full covariances.

    Baselines with blunders are left out and named. Heights are ellipsoidal unless the system
    states otherwise.

    Example: `photocal survey control.toml -o control`
    """
    import tempfile

    from photocal.base.checked_toml import read_toml
    from photocal.base.files import output_folder, write_json
    from photocal.findings.texts import catalogue, spoken
    from photocal.navigation.survey import Survey, SurveySetup, run_survey
    from photocal.navigation.survey_report import survey_figures, survey_text, write_points

    plan = read_toml(setup, SurveySetup)
    with tempfile.TemporaryDirectory() as scratch:
        solution, sessions, frames = run_survey(Survey(plan, setup.parent, Path(scratch)))
    figures = survey_figures(solution, sessions, frames)
    with output_folder(output) as folder:
        figures["points_csv"] = write_points(folder / "points.csv", solution, plan.crs)
        write_json(folder / "survey.json", figures, 2)
    say = catalogue(spoken(language))
    answer(as_json, lambda: figures, lambda: survey_text(figures, say))


@spread
def localise(
    local: Annotated[
        Path,
        argument(
            "Points in the local system: point, X, Y, Z, optional sX, sY, sZ, role.", metavar="LOCAL.csv"
        ),
    ],
    mapped: Annotated[
        Path, argument("Points in the map system, as `photocal survey` writes them.", metavar="MAP.csv")
    ],
    output: Annotated[Path, option("Folder for the report and the points.", "-o", "--output")],
    *,
    options: SiteOptions,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Calibrate a site: tie a local system to a map system by the points that both tables name.

    A similarity in plan and a tilted plane of heights, with residuals, a test of each point, and the combined
    factor between ground and map. `points.csv` has the local points in the map system, `local.csv` those of
    the map in the local one.

    Example: `photocal localise site.csv control/points.csv --crs EPSG:31982 -o site`
    """
    from photocal.base.files import output_folder
    from photocal.findings.texts import catalogue, spoken
    from photocal.navigation.site_calibration import (
        calibrate,
        calibration_text,
        read_point_table,
        write_calibration,
    )

    made = calibrate(read_point_table(local), read_point_table(mapped), options)
    say = catalogue(spoken(language))
    with output_folder(output) as folder:
        figures = write_calibration(folder, made, say)
    answer(as_json, lambda: figures, lambda: calibration_text(made, say))
