"""What a project file says of a flight, as the choices of PPK and exposures."""

from __future__ import annotations

import numpy as np

from photocal.navigation.exposure_run import Choices
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.rig import Rig, rig_of_mounting
from photocal.navigation.troposphere import measured_weather
from photocal.project import Project


def choices_of_project(project: Project) -> Choices:
    """Return what `[flight]`, `[images]` and `[rig]` ask for.

    Raises
    ------
    ConfigurationError
        Without `[flight]`, or when camera axes are impossible.
    """
    flight = project.flight
    position = flight.base_position
    sources = Sources(
        FlightLog(flight.logs),
        flight.rover_rinex,
        flight.base_rinex,
        tuple(map(str, flight.navigation)),
        None if position is None else ",".join(repr(float(v)) for v in position),
        flight.rover,
        flight.base,
        flight.vehicle,
        flight.rover_antenna_height_m,
        flight.base_antenna_height_m,
        None if flight.base_sigma_m is None else np.array(flight.base_sigma_m),
        measured_weather(flight.weather),
    )
    images = project.contents.images
    keys = project.contents.rig
    rig = (
        Rig()
        if keys is None
        else rig_of_mounting(keys.mounting(), np.radians(np.asarray(keys.attitude_sigma_deg, np.float64)))
    )
    return Choices(
        sources,
        None if images is None else images.folder or images.times,
        edge=flight.edge,
        delay_s=flight.delay_s,
        rig=rig,
        largest_offset_s=flight.clock_offset_s,
    )
