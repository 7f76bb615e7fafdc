"""`photocal ppk`, `exposures`, `survey`: trajectories, exposures and control points from raw observations."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from photocal.base.console import AsJson, answer, argument, numbers_of, option, progress

if TYPE_CHECKING:
    from photocal.base.arrays import Floats

Rover = Annotated[Path | None, option("RINEX observations of the rover.")]
Base = Annotated[Path | None, option("RINEX observations of the base.")]
Navigation = Annotated[
    list[str] | None,
    option("RINEX navigation file; may be repeated. `base`: those that the base's link recorded."),
]
BasePosition = Annotated[
    str | None,
    option("LAT,LON,H of the base: degrees, ellipsoidal height in metres; or a CSRS-PPP or SINEX file."),
]
BaseSigma = Annotated[str | None, option("Standard deviations E,N,U of the base's position, metres.")]
BaseWeather = Annotated[
    str | None, option("TEMPERATURE,HUMIDITY[,PRESSURE] at the base: degrees Celsius, percent, hPa.")
]
RoverLink = Annotated[str, option("Link of the rover in the flight log.")]
BaseLink = Annotated[str, option("Link of the base in the flight log.")]


def ppk(
    output: Annotated[Path, option("Folder for trajectory.csv, summary and plot.", "-o", "--output")],
    flight: Annotated[
        list[Path] | None, argument("Flight logs with raw frames of both, that follow each other.")
    ] = None,
    rover: Rover = None,
    base: Base = None,
    nav: Navigation = None,
    base_position: BasePosition = None,
    base_sigma: BaseSigma = None,
    weather: BaseWeather = None,
    rover_link: RoverLink = "rover",
    base_link: BaseLink = "base",
    rover_antenna_height: Annotated[
        float | None, option("Antenna reference point above the rover's mark, metres; without: RINEX header.")
    ] = None,
    base_antenna_height: Annotated[
        float | None, option("Antenna reference point above the base's mark, metres; without: RINEX header.")
    ] = None,
    antex: Annotated[
        Path | None, option("Antenna models: an ANTEX file, such as igs20.atx of the IGS.")
    ] = None,
    rover_antenna: Annotated[
        str, option("Type and radome of the rover's antenna in it; none: without a model.")
    ] = "",
    base_antenna: Annotated[str, option("The base's; without: as the RINEX header names it.")] = "",
    elevation: Annotated[float, option("Least elevation of satellites, degrees.")] = 15.0,
    static: Annotated[bool, option("The rover stood still: one position.", "--static")] = False,
    as_json: AsJson = False,
) -> None:
    """Compute the trajectory of a rover from raw observations of rover and base.

    Fixes are validated (ratio, both directions, Doppler velocity, code) and doubtful ones become float;
    float sigmas are rescaled to what both directions show. The columns sen, seu, snu are the roots of the
    covariances with their signs, in metres.

    Example: `photocal ppk FLIGHT.mcap -o ppk`
    """
    import tempfile

    from photocal.base.files import output_folder
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.flight_log import FlightLog
    from photocal.navigation.ppk import options_for, process, with_antennas
    from photocal.navigation.ppk_inputs import Sources, gather_inputs
    from photocal.navigation.ppk_report import ppk_figures, ppk_text, write_ppk

    engine = Rtklib()
    logs = tuple(flight or ())
    sources = Sources(
        FlightLog(logs), rover, base, tuple(nav or ()), base_position, rover_link, base_link
    ).with_base(base_sigma, weather)
    with tempfile.TemporaryDirectory() as scratch:
        inputs, remarks = gather_inputs(sources, engine, Path(scratch))
        options = options_for(inputs.rover, inputs.base, rover_antenna_height, base_antenna_height, elevation)
        options = with_antennas(options, antex, (inputs.rover, rover_antenna), (inputs.base, base_antenna))
        result = process(inputs, options, "static" if static else "kinematic", engine, Path(scratch))
    figures = ppk_figures(result, remarks)
    with output_folder(output) as folder:
        write_ppk(folder, result, figures)
    answer(as_json, lambda: figures, lambda: ppk_text(figures))


def exposures(
    output: Annotated[Path, option("Folder for exposures.csv and the rest.", "-o", "--output")],
    flight: Annotated[
        list[Path] | None,
        argument("Flight logs that follow each other, or one PROJECT.toml that names everything."),
    ] = None,
    images: Annotated[Path | None, option("Folder of the images, or a table image,taken[,camera].")] = None,
    mrk: Annotated[Path | None, option("The vehicle's own event list (Timestamp.MRK).")] = None,
    edge: Annotated[str, option("Edge of the time marks: rising or falling.")] = "rising",
    delay: Annotated[float, option("From the event to the exposure, seconds.")] = 0.0,
    delay_sigma: Annotated[float, option("Its standard deviation from exposure to exposure, seconds.")] = 0.0,
    camera_to_antenna: Annotated[
        str | None,
        option(
            "Lever arm: X,Y,Z from the camera's projection centre to the antenna, metres forward, "
            "right, down (above is negative)."
        ),
    ] = None,
    camera_to_antenna_sigma: Annotated[str, option("Its standard deviations, metres.")] = "0.01,0.01,0.01",
    lever_arm: Annotated[str | None, typer.Option(hidden=True)] = None,
    attitude_sigma: Annotated[str | None, option("Standard deviations of roll, pitch, yaw, degrees.")] = None,
    boresight: Annotated[
        str, option("Turn from nominal to true camera axes, about camera x, y, z, degrees.")
    ] = "0,0,0",
    boresight_sigma: Annotated[str, option("Its standard deviations, degrees.")] = "0,0,0",
    camera_axes: Annotated[
        str, option("Body directions of camera x (right), y (up in the image), z (backwards).")
    ] = "right,forward,up",
    clock_offset: Annotated[
        float, option("Largest offset between the camera's clock and the log's, seconds.")
    ] = 60.0,
    camera: Annotated[str, option("Id of the camera in images.csv.")] = "camera",
    crs: Annotated[str | None, option("System of images.csv, such as EPSG:32722; without: local.")] = None,
    oriented: Annotated[
        Path | None, option("Run folder of an adjustment of these images: its positions check the exposures.")
    ] = None,
    check_images: Annotated[
        bool, option("Orient the images by tie points and compare their rotations.", "--check-images")
    ] = False,
    rover: Rover = None,
    base: Base = None,
    nav: Navigation = None,
    base_position: BasePosition = None,
    base_sigma: BaseSigma = None,
    weather: BaseWeather = None,
    rover_link: RoverLink = "rover",
    base_link: BaseLink = "base",
    as_json: AsJson = False,
) -> None:
    """Compute position and attitude of every exposure, with covariances, and check them.

    Positions come from PPK where the log has raw frames of rover and base, else from the event list, the
    autopilot or the images; images are matched to events by the differences of their times.

    Example: `photocal exposures FLIGHT.mcap --images DIR -o exposures`
    """
    import tempfile
    from dataclasses import replace

    import numpy as np

    from photocal.base.errors import ConfigurationError
    from photocal.base.files import output_folder, write_json
    from photocal.measurement.match_images import MatchingPlan
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.exposure_files import write_run
    from photocal.navigation.exposure_report import exposures_text
    from photocal.navigation.exposure_run import Choices, choices_of_project, run_exposures
    from photocal.navigation.flight_log import FlightLog
    from photocal.navigation.image_checks import TieMatching
    from photocal.navigation.ppk_inputs import Sources
    from photocal.navigation.rig import Rig
    from photocal.navigation.rig import camera_axes as axes_of
    from photocal.project import read_project

    if lever_arm is not None:
        raise ConfigurationError(
            "--lever-arm led from the antenna to the camera, the other way round than everywhere else",
            "give --camera-to-antenna with all three signs turned",
            where="--lever-arm",
        )
    logs = tuple(flight or ())
    project = [path for path in logs if path.suffix == ".toml"]
    if project and len(logs) > 1:
        raise ConfigurationError("a project file stands for itself", "give it alone", where=project[0])
    if project:
        named = read_project(project[0])
        choices, camera = choices_of_project(named), named.camera.id
        crs = None if named.crs == "local" else named.crs
    else:
        if edge not in ("rising", "falling"):
            raise ConfigurationError(f"{edge!r} is no edge", "rising or falling", where="--edge")
        rig = Rig(
            None if camera_to_antenna is None else _triple(camera_to_antenna, "--camera-to-antenna"),
            _triple(camera_to_antenna_sigma, "--camera-to-antenna-sigma"),
            None if attitude_sigma is None else np.radians(_triple(attitude_sigma, "--attitude-sigma")),
            np.radians(_triple(boresight, "--boresight")),
            np.radians(_triple(boresight_sigma, "--boresight-sigma")),
            axes_of(tuple(camera_axes.split(","))),
        )
        sources = Sources(
            FlightLog(logs), rover, base, tuple(nav or ()), base_position, rover_link, base_link
        ).with_base(base_sigma, weather)
        choices = Choices(sources, images, mrk, edge, delay, delay_sigma, rig, clock_offset)
    choices = replace(choices, oriented=oriented)
    if check_images:
        plan = MatchingPlan()
        choices = replace(choices, ties=TieMatching(plan, progress))
    with tempfile.TemporaryDirectory() as scratch:
        run = run_exposures(choices, Rtklib(), Path(scratch))
    with output_folder(output) as folder:
        figures = write_run(folder, run, choices.rig, camera, crs)
        write_json(folder / "exposures.json", figures, 2)
    answer(as_json, lambda: figures, lambda: exposures_text(figures))


def _triple(text: str, option: str) -> "Floats":
    import numpy as np

    return np.array(numbers_of(text, option, "A,B,C: three numbers in the unit of the help"))


def survey(
    setup: Annotated[
        Path,
        argument(
            "TOML: required_minutes, optional crs; [[known]] name, lat_deg, lon_deg, height_m, sigma_m; "
            "[[baseline]] name, start, end, base, rover (RINEX or flight logs, with base_link, rover_link), "
            "nav, products, base_antenna_m, rover_antenna_m; "
            "[[ppp]] name, rover, nav, products (SP3, CLK), rover_antenna_m; antex with base_antenna, "
            "rover_antenna (types and radomes)."
        ),
    ],
    output: Annotated[Path, option("Folder for points.csv and the summary.", "-o", "--output")],
    as_json: AsJson = False,
) -> None:
    """Compute static baselines, adjust them as a network and write points with full covariances.

    Baselines with blunders are left out and named. Heights are ellipsoidal unless the system says else.

    Example: `photocal survey control.toml -o control`
    """
    import tempfile

    from photocal.base.checked_toml import read_toml
    from photocal.base.files import output_folder, write_json
    from photocal.navigation.engine import Rtklib
    from photocal.navigation.survey import Survey, SurveySetup, run_survey
    from photocal.navigation.survey_report import survey_figures, survey_text, write_points

    plan = read_toml(setup, SurveySetup)
    with tempfile.TemporaryDirectory() as scratch:
        solution, sessions = run_survey(Survey(plan, setup.parent, Rtklib(), Path(scratch)))
    figures = survey_figures(solution, sessions)
    with output_folder(output) as folder:
        figures["points_csv"] = write_points(folder / "points.csv", solution, plan.crs)
        write_json(folder / "survey.json", figures, 2)
    answer(as_json, lambda: figures, lambda: survey_text(figures))
