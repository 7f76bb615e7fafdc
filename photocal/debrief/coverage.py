"""What a flight covers before anything is measured: overlap along strips, and holes, on level ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Flags, Floats, Integers
from photocal.block.motion import strips
from photocal.findings.finding import Finding
from photocal.geometry.camera import Camera
from photocal.geometry.oriented_images import oriented_images
from photocal.navigation.exposures import Exposures, orientations
from photocal.navigation.rig import Rig
from photocal.planning.area import LocalPlane
from photocal.planning.flown import FlownBlock, flown_block, gaps, level_ground

# Neighbours along a strip must share so much of what they show: less is no stereoscopic cover.
LEAST_OVERLAP = 0.5
# Good pictures that must show each place inside the flown area, and the share of it that may be without.
LEAST_COVER, _MAY_LACK = 2, 0.002


@dataclass(frozen=True)
class Coverage:
    """The flown block of an uncomplete flight; m are in a plane about its middle, east and north.

    rows: exposures with a position, in the order of time, and the strip of each, from 0.
    good: rows of the block, those with a good picture.
    holes_deg (k, 2): latitude and longitude of places that too few good pictures show, the largest first.
    hole_m2, area_m2: of these places, and of all that was flown over.
    """

    rows: Integers
    strip: Integers
    good: Integers
    block: FlownBlock
    holes_deg: Floats
    hole_m2: float
    area_m2: float


def coverage(exposures: Exposures, usable: Flags, rig: Rig, camera: Camera, ground_m: float) -> Coverage:
    """Lay what exposures show onto level ground.

    usable (n,): exposures with a good picture.
    ground_m: height of the ground, of the same kind as those of the exposures.
    """
    placed = exposures.placed
    rows = np.flatnonzero(placed.placed & np.isfinite(placed.lat_deg))
    latitude, longitude = placed.lat_deg[rows], placed.lon_deg[rows]
    plane = LocalPlane(float(np.median(latitude)), float(np.median(longitude)))
    station = np.column_stack([plane.to_plane(latitude, longitude), placed.height_m[rows]])
    seconds = (exposures.time.ns[rows] - exposures.time.ns[rows[0]]) / 1e9
    velocity = placed.velocity_m_s[rows]
    beside = np.gradient(station, seconds + 1e-6 * np.arange(len(rows)), axis=0)
    velocity = np.where(np.isfinite(velocity), velocity, beside)
    turn = orientations(exposures, rig).rotation[rows].copy()
    # Without attitude the camera looks down, its upper edge ahead.
    s, c = np.sin(course := np.arctan2(velocity[:, 0], velocity[:, 1])), np.cos(course)
    level = np.zeros_like(turn)
    level[:, 0, 0], level[:, 0, 1], level[:, 1, 0], level[:, 1, 1], level[:, 2, 2] = c, -s, s, c, 1.0
    turn = np.where(np.isfinite(turn), turn, level)
    every = oriented_images((camera,), np.zeros(len(rows)), turn, station)
    strip, good = strips(seconds, velocity)[0], np.flatnonzero(usable[rows])
    # The ground below all exposures, but shown by the good ones alone.
    ground = level_ground(every, ground_m)
    whole, block = flown_block(every, strip, ground), flown_block(every.only(good), strip[good], ground)
    block = replace(block, inside=whole.inside)
    area = ground.cell_m**2
    holes = np.array([(east, north) for east, north, _ in gaps(block, LEAST_COVER)]).reshape(-1, 2)
    degrees = np.column_stack(plane.to_degrees(holes)) if len(holes) else holes
    lacking = float(np.sum(block.inside & (block.rays < LEAST_COVER)))
    return Coverage(rows, strip, good, block, degrees, area * lacking, area * float(block.inside.sum()))


def coverage_findings(flown: Coverage, exposures: Exposures) -> list[Finding]:
    """Name strips that must be flown again, and holes."""
    findings, forward = [], flown.block.forward
    for strip in np.unique(flown.block.strip).tolist():
        mine = np.flatnonzero((flown.block.strip == strip) & (forward < LEAST_OVERLAP))
        if len(mine):
            figures = {
                "strip": float(strip + 1),
                "overlap_percent": 100.0 * float(forward[mine].min()),
                "least_percent": 100.0 * LEAST_OVERLAP,
                "events": tuple(str(n) for n in exposures.number[flown.rows[flown.good[mine]]]),
            }
            findings.append(Finding("strip-gap", "grave", str(strip + 1), figures))
    if flown.hole_m2 > _MAY_LACK * flown.area_m2:
        latitude, longitude = flown.holes_deg[0].tolist()
        figures = {
            "hole_m2": flown.hole_m2,
            "percent": 100.0 * flown.hole_m2 / flown.area_m2,
            "latitude_deg": latitude,
            "longitude_deg": longitude,
        }
        findings.append(Finding("coverage-hole", "grave", figures=figures))
    return findings
