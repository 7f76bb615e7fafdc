"""From events to exposures: where the camera was, how it was turned, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from photocal.geometry.body import object_to_body
from photocal.navigation.events import Events
from photocal.navigation.image_metadata import ImageMetadata
from photocal.navigation.interpolation import LARGEST_GAP_S, Placed
from photocal.navigation.matching import Matching, match
from photocal.navigation.mrk import moved
from photocal.navigation.time import GpsTime

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Exposures:
    """One row per event.

    Parameters
    ----------
    time : GpsTime (n,)
        Moments of exposure.
    number : int64 (n,)
        Count of the device.
    placed : Placed
        Position (of the camera, once `at_camera` was applied), velocity, covariance, status.
    angles : float64 (n, 3)
        Roll, pitch, yaw of the body, rad; NaN where unknown.
    image : list of str (n,)
        Name of the image; empty where none matched.
    height_kind : str
        What the heights are above.
    """

    time: GpsTime
    number: NDArray[np.int64]
    placed: Placed
    angles: Floats
    image: list[str]
    height_kind: str

    def __len__(self) -> int:
        return len(self.time)

    def reason(self, row: int) -> str:
        """Return why an event has no position, empty where it has one."""
        if self.placed.placed[row]:
            return ""
        gap = float(self.placed.gap_s[row])
        if not np.isfinite(gap):
            return "outside the trajectory"
        return f"epochs around it are {gap:.1f} s apart (at most {LARGEST_GAP_S:g} s)"


def at_camera(exposures: Exposures, lever_m: Floats, lever_sigma_m: Floats, angle_sigma: Floats) -> Exposures:
    """Return the exposures at the camera instead of the antenna.

    Parameters
    ----------
    exposures : Exposures
        At the antenna.
    lever_m, lever_sigma_m : float64 (3,)
        From the antenna to the camera in body axes (forward, right, down) and its standard deviations.
    angle_sigma : float64 (3,)
        Standard deviations of roll, pitch, yaw, rad.

    Returns
    -------
    Exposures
        With the covariance of lever arm and attitude added: C + R' S R + J A J' (law of propagation;
        J = R' [l]x D with D the turn of the body per angle).

    Raises
    ------
    ConfigurationError
        When an event that has a position has no attitude: the lever arm cannot be turned.
    """
    there = exposures.placed.placed
    lacking = there & ~np.isfinite(exposures.angles).all(axis=1)
    if lacking.any():
        raise ConfigurationError(
            f"{int(lacking.sum())} exposures have no attitude to turn the lever arm with",
            remedy="record ATTITUDE, or give no lever arm",
        )
    body, turn = object_to_body(np.where(np.isfinite(exposures.angles), exposures.angles, 0.0))
    back = np.swapaxes(body, 1, 2)
    p = exposures.placed
    offset = np.einsum("nij,j->ni", back, lever_m)
    lat, lon, height = p.lat_deg.copy(), p.lon_deg.copy(), p.height_m.copy()
    lat[there], lon[there], height[there] = moved(lat[there], lon[there], height[there], offset[there])
    x, y, z = lever_m
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # R turns by exp(-[t]x): R' l changes by R' [t]x l = -R' [l]x t, t = D times the change of the angles.
    jacobian = -back @ skew @ turn
    covariance = p.covariance_m2 + back @ np.diag(lever_sigma_m**2) @ body
    covariance = covariance + jacobian @ np.diag(angle_sigma**2) @ np.swapaxes(jacobian, 1, 2)
    return replace(
        exposures,
        placed=replace(p, lat_deg=lat, lon_deg=lon, height_m=height, covariance_m2=covariance),
    )


@dataclass(frozen=True)
class CameraMatch:
    """The images of one camera and the events that they belong to."""

    camera: str
    names: list[str]
    matching: Matching


def match_images(
    images: list[ImageMetadata], events: Events, largest_offset_s: float
) -> tuple[list[str], list[CameraMatch]]:
    """Match images to events, camera by camera.

    Returns
    -------
    names : list of str (n,)
        Image of each event, empty where none matched.
    cameras : list of CameraMatch
        Clock and rest of each camera.

    Raises
    ------
    ConfigurationError
        When an image tells no time.
    """
    timeless = [image.name for image in images if image.time_s is None]
    if timeless:
        raise ConfigurationError(
            f"{len(timeless)} images tell no time, the first is {timeless[0]}",
            remedy="take them out of the folder or write DateTimeOriginal into their EXIF",
        )
    names = [""] * len(events)
    found = []
    event_s = (events.time.ns - events.time.ns[0]) / 1e9
    origin_s = float(events.time.to_utc().ns[0]) / 1e9
    for camera in dict.fromkeys(image.camera for image in images):
        own = [image for image in images if image.camera == camera]
        image_s = np.array([float(image.time_s or 0.0) - origin_s for image in own])
        resolution = max(image.resolution_s for image in own)
        matching = match(image_s, event_s, resolution_s=resolution, largest_offset_s=largest_offset_s)
        for i, e in zip(matching.image.tolist(), matching.event.tolist(), strict=True):
            names[e] = f"{names[e]} {own[i].name}".strip()
        found.append(CameraMatch(camera, [image.name for image in own], matching))
    return names, found
