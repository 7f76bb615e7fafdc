"""The steps `ppk` and `exposures`: from receivers and images to a trajectory and to exposures."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_folder, write_json
from photocal.base.operating_system import cache_folder
from photocal.base.progress_bars import progress
from photocal.block.project import read_project
from photocal.measurement.match_images import MatchingPlan
from photocal.navigation.common_errors import parse_weather
from photocal.navigation.engine import Mode
from photocal.navigation.exposure_files import write_run
from photocal.navigation.exposure_run import ExposureChoices, ExposureRun, choices_of_project, run_exposures
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.options import ExposureOptions, PpkOptions, ReceiverOptions
from photocal.navigation.ppk import options_for, process, with_antennas
from photocal.navigation.ppk_inputs import Sources, gather_inputs
from photocal.navigation.ppk_result import Ppk
from photocal.navigation.rig import CameraOnBody, camera_axes

Paths = str | Path | Sequence[str | Path]


@dataclass(frozen=True)
class ExposuresOfFlight:
    """Position and attitude of every exposure of a flight, and what was noticed on the way.

    Attributes
    ----------
    run
        Exposures at the antenna and at the camera, trajectory, images and findings.
    rig
        Lever arm, boresight and axes by which they came from the antenna to the camera.
    camera
        Id of the camera in `images.csv`.
    crs
        System of `images.csv`; None for local coordinates.
    """

    run: ExposureRun
    rig: CameraOnBody
    camera: str
    crs: str | None

    def __repr__(self) -> str:
        """Say in one line how many there are, and in what system."""
        return f"{self.run.exposures!r}; camera {self.camera}, {self.crs or 'local coordinates'}"

    def write(self, folder: str | Path) -> dict[str, Any]:
        """Write `exposures.csv`, `images.csv`, GeoPackage and picture; give the figures of `exposures.json`.

        Parameters
        ----------
        folder
            Folder to write.

        Returns
        -------
        dict
            Figures by which the exposures are judged.
        """
        with output_folder(Path(folder)) as aside:
            figures = write_run(aside, self.run, self.rig, self.camera, self.crs)
            write_json(aside / "exposures.json", figures, 2)
        return figures


def ppk(
    flight: Paths = (), *, receivers: ReceiverOptions | None = None, options: PpkOptions | None = None
) -> Ppk:
    """Compute the trajectory of a rover from raw observations of rover and base.

    Fixes are validated (ratio, both directions, Doppler velocity, code) and doubtful ones become float; float
    sigmas are rescaled to what both directions and the residuals of the codes show.

    Parameters
    ----------
    flight
        Flight logs with raw frames of both receivers, that follow each other.
    receivers
        RINEX files in place of the log, and what is known of the base.
    options
        Antennas, elevation mask (degrees) and motion.

    Returns
    -------
    Ppk
        Trajectory and figures.

    Raises
    ------
    ConfigurationError
        When a required input is not given.
    IllPosedError
        Without overlap, with too few epochs, without ephemerides, or with a wrong position of the base.
    ProgramMissingError
        When RTKLIB is not installed.

    References
    ----------
    T. Takasu, A. Yasuda: Development of the low-cost RTK-GPS receiver with an open source program package
    RTKLIB. International Symposium on GPS/GNSS, Jeju 2009.

    Examples
    --------
    >>> import photocal
    >>> made = photocal.ppk("flight/flight.mcap")
    >>> made.figures["fixed_percent"] > 95.0
    True
    >>> made.write("ppk")
    """
    asked = options or PpkOptions()
    sources = sources_of(flight, receivers or ReceiverOptions(), asked.crs)
    with tempfile.TemporaryDirectory() as scratch:
        inputs = gather_inputs(sources, Path(scratch))
        rover, base = inputs.rover, inputs.base
        heights = asked.rover_antenna_height, asked.base_antenna_height
        plain = options_for(rover, base, *heights, asked.elevation)
        modelled = with_antennas(plain, asked.antex, (rover, asked.rover_antenna), (base, asked.base_antenna))
        mode: Mode = "static" if asked.static else "kinematic"
        return process(inputs, modelled, mode, Path(scratch))


def exposures(
    flight: Paths = (), *, receivers: ReceiverOptions | None = None, options: ExposureOptions | None = None
) -> ExposuresOfFlight:
    """Compute position and attitude of every exposure, with covariances, and check them.

    Positions come from PPK where the log has raw frames of rover and base, else from the event list, the
    autopilot or the images; images are matched to events by the differences of their times.

    Parameters
    ----------
    flight
        Flight logs that follow each other, or one `project.toml` that names everything.
    receivers
        RINEX files in place of the log, and what is known of the base.
    options
        Images and events, delay (s), lever arm (m), boresight (degrees), and what checks the exposures.

    Returns
    -------
    ExposuresOfFlight
        Exposures, images and findings.

    Raises
    ------
    ConfigurationError
        When the log has neither events nor images, or no positions.

    Examples
    --------
    >>> import photocal
    >>> images = photocal.ExposureOptions(images="flight/times.csv")
    >>> made = photocal.exposures("flight/flight.mcap", options=images)
    >>> made.run.exposures
    Exposures: 10 events, 10 with position, 10 with attitude, 10 with images; heights ellipsoidal
    >>> sorted(made.write("exposures")["cameras"][0]["unmatched_images"])
    []
    """
    asked, logs = options or ExposureOptions(), _paths(flight)
    project = [path for path in logs if path.suffix == ".toml"]
    if project and len(logs) > 1:
        raise ConfigurationError(
            "a project file cannot be combined with logs", "give it alone", where=project[0]
        )
    camera, crs = asked.camera, asked.crs
    if project:
        named = read_project(project[0])
        choices, camera = choices_of_project(named), named.camera.id
        crs = None if named.crs == "local" else named.crs
    else:
        choices = ExposureChoices(
            sources_of(logs, receivers or ReceiverOptions(), asked.crs),
            None if asked.images is None else Path(asked.images),
            None if asked.mrk is None else Path(asked.mrk),
            asked.edge,
            asked.delay,
            asked.delay_sigma,
            rig_of(asked),
            asked.clock_offset,
        )
    choices = replace(choices, oriented=None if asked.oriented is None else Path(asked.oriented))
    if asked.check_images:
        plan = MatchingPlan(cache_folder())
        choices = replace(choices, ties=(plan, progress))
    with tempfile.TemporaryDirectory() as scratch:
        return ExposuresOfFlight(run_exposures(choices, Path(scratch)), choices.rig, camera, crs)


def sources_of(flight: Paths, receivers: ReceiverOptions, crs: str | None = None) -> Sources:
    """Give where the observations come from; ConfigurationError for texts that are no numbers.

    crs: system of the control.
    """
    sigma, weather = receivers.base_sigma, receivers.weather
    return Sources(
        FlightLog(_paths(flight)),
        None if receivers.rover is None else Path(receivers.rover),
        None if receivers.base is None else Path(receivers.base),
        tuple(receivers.nav),
        receivers.base_position,
        receivers.rover_link,
        receivers.base_link,
        base_sigma_m=None if sigma is None else np.array(numbers_of(sigma, "--base-sigma", "E,N,U: metres")),
        weather=None if weather is None else parse_weather(weather, "--weather"),
        base_frame=receivers.base_frame,
        crs=crs,
    )


def rig_of(asked: ExposureOptions) -> CameraOnBody:
    """Give lever arm, boresight and camera axes in numbers; ConfigurationError for texts that are none."""
    lever, attitude = asked.camera_to_antenna, asked.attitude_sigma
    return CameraOnBody(
        None if lever is None else _triple(lever, "--camera-to-antenna"),
        _triple(asked.camera_to_antenna_sigma, "--camera-to-antenna-sigma"),
        None if attitude is None else _radians(attitude, "--attitude-sigma"),
        _radians(asked.boresight, "--boresight"),
        _radians(asked.boresight_sigma, "--boresight-sigma"),
        camera_axes(tuple(asked.camera_axes.split(","))),
    )


def _triple(text: str, option: str) -> Floats:
    return np.array(numbers_of(text, option, "A,B,C: three numbers in the unit of the help"))


def _radians(text: str, option: str) -> Floats:
    return np.asarray(np.radians(_triple(text, option)))


def _paths(given: Paths) -> tuple[Path, ...]:
    return (Path(given),) if isinstance(given, str | Path) else tuple(map(Path, given))
