"""Coded markers, ArUco and AprilTag: identity, centre and corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.measurement.centre import Centre, measurable
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.square_targets import quadrilateral_centre

DICTIONARIES = (
    *(f"{n}x{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
    "aruco_original",
    "aruco_mip_36h12",
)
# A marker whose picture differs from the ideal one by more than this part of its contrast is none.
WORST_MISFIT = 0.2
LEAST_CONTRAST = 20.0
# A cell of a code has at least so many pixels.
_SMALLEST_CELL_PX = 1.25


@dataclass(frozen=True)
class Marker:
    """A coded marker in an image.

    corners (4, 2): columns and rows, px, clockwise from the marker's own first corner.
    """

    identity: int
    centre: Centre
    corners: Floats


def dictionary(name: str) -> Any:
    """Give a dictionary of markers by its name.

    raises ConfigurationError: for another name.
    """
    import cv2

    if name.lower() not in DICTIONARIES:
        raise ConfigurationError(
            f"marker dictionary {name!r} is not known", remedy=f"use {', '.join(DICTIONARIES)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))


def find_markers(grey: Grey, dictionary_name: str) -> tuple[Marker, ...]:
    """Find the coded markers of a dictionary and measure them."""
    import cv2

    codes, grey = dictionary(dictionary_name), measurable(grey)
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = 0.0
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    # Small cells are read from more samples than they have pixels: their edges lie between pixels.
    parameters.perspectiveRemovePixelPerCell = 8
    cells = int(codes.markerSize) + 2
    # The library takes the shortest outline as a part of the longer side of the image, however large that is.
    parameters.minMarkerPerimeterRate = 4 * cells * _SMALLEST_CELL_PX / max(grey.shape)
    detected: Any = cv2.aruco.ArucoDetector(codes, parameters).detectMarkers(as_eight_bit(grey))
    corners, identities, _ = detected
    if identities is None:
        return ()
    found: dict[int, list[Marker]] = {}
    for identity, quadrilateral in zip(np.ravel(identities), corners, strict=True):
        rough = np.asarray(quadrilateral, dtype=float).reshape(4, 2)
        side = float(np.hypot(*(np.roll(rough, -1, axis=0) - rough).T).min())
        measured = quadrilateral_centre(grey, rough, side / cells)
        if measured is None:
            continue
        centre, refined = measured
        if centre.contrast < LEAST_CONTRAST or centre.noise > WORST_MISFIT * centre.contrast:
            continue
        found.setdefault(int(identity), []).append(Marker(int(identity), centre, refined))
    return tuple(marks[0] for _, marks in sorted(found.items()) if len(marks) == 1)
