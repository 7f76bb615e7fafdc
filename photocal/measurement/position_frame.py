"""Positions of pictures in the frame of their caster, taken to the frame and epoch of the project."""

from dataclasses import replace

import numpy as np

from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.findings.finding import Finding
from photocal.geometry.realizations import (
    FrameShift,
    Realization,
    frame_shift,
    known_realization,
    realization,
)
from photocal.measurement.image_facts import ImageFacts

KEY = "position_frame in [images]"


def frames_of(frame: str, crs: str) -> tuple[Realization, Realization]:
    """Give the realizations of positions and of a map system.

    frame: `FRAME[@EPOCH]`.
    raises ConfigurationError: for an unknown frame or one without its epoch, and for a system of none.
    """
    source, target = realization(frame), known_realization(crs)
    if source.moves and np.isnan(source.epoch):
        raise ConfigurationError(
            f"the ground moves in {source.frame}: positions in it need an epoch",
            f'write "{source.frame}@2026.9" with the epoch of the flight in years',
            where=KEY,
        )
    if target is None:
        raise ConfigurationError(
            f"{crs} does not say in which frame and epoch it counts: nothing known leads from {source} there",
            "name a system of the national frame, such as EPSG:31982, or leave the key out",
            where=KEY,
        )
    return source, target


def shift_of_positions(frame: str, crs: str, facts: ImageFacts) -> FrameShift:
    """Give the shift of a picture's position from a frame to that of a map system.

    frame: `FRAME[@EPOCH]`.
    raises ConfigurationError: as of `frames_of`, and where no way is known.
    """
    source, target = frames_of(frame, crs)
    place = geocentric(facts.latitude_deg, facts.longitude_deg, facts.altitude_m)
    shift = frame_shift(place, source, target)
    if shift is None:
        raise ConfigurationError(
            f"nothing known leads from {source} to {crs}",
            "take the positions there by another program, and leave the key out",
            where=KEY,
        )
    return shift


def in_project(facts: ImageFacts, shift: FrameShift) -> ImageFacts:
    """Facts of a picture with its position moved; the uncertainty of the way joins its sigmas."""
    if not facts.has_position:
        return facts
    turn = enu_axes(facts.latitude_deg, facts.longitude_deg)
    place = geocentric(facts.latitude_deg, facts.longitude_deg, facts.altitude_m)
    latitude, longitude, height = geodetic(place + turn.T @ shift.shift_enu_m)
    east, north, up = np.hypot(facts.position_sigma_m, shift.sigma_m).tolist()
    return replace(
        facts,
        latitude_deg=float(latitude),
        longitude_deg=float(longitude),
        altitude_m=float(height),
        position_sigma_m=(east, north, up),
    )


def moved_finding(shift: FrameShift) -> Finding:
    """Say that positions were moved, and by how much."""
    east, north, up = (float(v) for v in shift.shift_enu_m)
    figures = {"source": str(shift.source), "target": str(shift.target), "size_m": shift.size_m}
    more = {"east_m": east, "north_m": north, "up_m": up, "sigma_m": shift.sigma_m, "way": shift.way}
    return Finding("positions-moved", "note", figures={**figures, **more})
