"""Mistakes of ground points that are seen in their tables, before anything is adjusted."""

from typing import Any

import numpy as np

from photocal.accuracy import ground_points
from photocal.adjustment.mounting import body_to_camera
from photocal.base.arrays import Floats
from photocal.block.model import Block, Role
from photocal.block.network import observed_plane
from photocal.findings.finding import Finding
from photocal.geometry.distortion import slopes_of
from photocal.geometry.resection import intersect
from photocal.geometry.rotation import matrix_from_angles


def ground_findings(block: Block) -> tuple[Finding, ...]:
    """Look for mistakes in the control and check points of a block."""
    control, check = _of_role(block, "control"), _of_role(block, "check")
    surveyed = block.observations.rows(~block.points.of_role("tie")[block.observations.point])
    pairs = tuple(
        (block.images.names[i], block.points.names[j])
        for i, j in zip(surveyed.image, surveyed.point, strict=True)
    )
    listed = list(ground_points.check_points_used_as_control(control, check))
    for name, points in (("control", control), ("check", check)):
        listed += ground_points.heights_all_equal(points, name)
    listed += ground_points.control_in_few_images(control.names, pairs, "control")
    listed += ground_points.control_in_few_images(check.names, pairs, "check")
    ground = ground_points.GroundPoints(control.names + check.names, np.vstack([control.xyz_m, check.xyz_m]))
    if not len(ground.names):
        return tuple(listed)
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = None if block.frame == "local" else CRS.from_user_input(block.frame)
    except CRSError:
        return (*listed, Finding("unknown-frame", "grave", block.frame))
    place = _place_findings(block, ground, system)
    listed += place
    # Distances say nothing where the whole frame is wrong.
    if not place and (system is None or not system.is_geographic):
        listed += ground_points.feet_for_metres(ground, by_start_values(block))
    return tuple(listed)


def _of_role(block: Block, role: Role) -> ground_points.GroundPoints:
    indices = np.flatnonzero(block.points.of_role(role))
    names = tuple(block.points.names[j] for j in indices)
    return ground_points.GroundPoints(names, block.points.values[indices])


def _place_findings(block: Block, ground: ground_points.GroundPoints, system: Any) -> tuple[Finding, ...]:
    # Observed antenna positions, else the centres of images.csv.
    exposures = block.positions.values if len(block.positions.image) else block.images.values[:, 3:]
    exposures = exposures[np.isfinite(exposures).all(axis=1)]
    if not len(exposures):
        return ()
    if system is None:
        return _far_in_local_frame(ground, exposures)
    from pyproj import Transformer

    if system.is_geographic:
        # X is longitude (east) and Y latitude (north), as for every other frame.
        return ground_points.latitude_longitude_swapped(
            ground.xyz_m[:, 1], ground.xyz_m[:, 0], exposures[:, 1::-1]
        )
    utm = system.utm_zone
    if utm is None:
        return _far_in_local_frame(ground, exposures)
    back = Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    longitude, latitude = back.transform(exposures[:, 0], exposures[:, 1])
    degrees = np.column_stack([latitude, longitude])
    if not np.isfinite(degrees).all():
        return (Finding("exposures-outside-frame", "grave", block.frame),)
    return ground_points.wrong_utm_zone(ground, int(utm[:-1]), southern=utm[-1] == "S", exposures_deg=degrees)


def _far_in_local_frame(ground: ground_points.GroundPoints, exposures: Floats) -> tuple[Finding, ...]:
    """Ground points far from the exposures, and the mistake that would bring them near."""
    # Farther than any flight is from its ground points, in a local frame.
    far_m = 50_000.0
    places = ground.xyz_m[np.isfinite(ground.xyz_m).all(axis=1)]
    if not len(places):
        return ()
    flight, middle = exposures[:, :2].mean(axis=0), places[:, :2].mean(axis=0)
    distance = float(np.hypot(*(middle - flight)))
    if distance <= far_m:
        return ()
    for code, cause, moved in (
        ("east-north-swapped", "near-when-swapped", middle[::-1]),
        ("feet-for-metres-plane", "near-in-feet", middle * ground_points.FOOT_M),
        ("metres-for-feet", "near-in-metres", middle / ground_points.FOOT_M),
    ):
        near = float(np.hypot(*(moved - flight)))
        if near <= far_m:
            figures = {"far_km": distance / 1000.0, "near_km": near / 1000.0}
            return (Finding(code, "grave", figures=figures, cause=cause),)
    far = {"far_km": distance / 1000.0, "points": ground.names}
    return (Finding("points-far-from-flight", "grave", figures=far, cause="other-frame"),)


def by_start_values(block: Block) -> ground_points.GroundPoints:
    """Intersect the rays of all points from the given orientations."""
    plane, _ = observed_plane(block)
    image = block.observations.image
    slopes = slopes_of(block.cameras, block.images.camera[image], plane)
    rotation = matrix_from_angles(block.images.values[:, :3])
    centre = block.images.values[:, 3:].copy()
    if len(block.attitudes.image):
        matrix = body_to_camera(block.mounting, block.mounting.values)
        rotation[block.attitudes.image] = matrix @ block.attitudes.rotation
    centre[block.positions.image] = block.positions.values
    # Images without start values have nothing to say yet.
    known = np.isfinite(centre[image]).all(axis=1) & np.isfinite(rotation[image]).all(axis=(1, 2))
    xyz = intersect(
        block.observations.point[known],
        len(block.points.names),
        centre[image][known],
        rotation[image][known],
        slopes[known],
        np.ones(known.sum()),
    )
    return ground_points.GroundPoints(block.points.names, xyz)
