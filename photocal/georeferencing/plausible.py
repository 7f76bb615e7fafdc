"""Mistakes of a block's ground points, found before anything is adjusted."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from photocal.accuracy.ground_points import (
    FOOT_M,
    GroundPoints,
    check_points_used_as_control,
    control_in_few_images,
    feet_for_metres,
    heights_all_equal,
    latitude_longitude_swapped,
    wrong_utm_zone,
)
from photocal.adjustment.intersection import intersect
from photocal.adjustment.mounting import body_to_camera
from photocal.block.model import Block, Role
from photocal.block.network import observed_plane
from photocal.findings.finding import Finding
from photocal.geometry.distortion import undistorted
from photocal.geometry.rotation import matrix_from_angles

# Farther than any flight is from its ground points, in a local frame.
_FAR_M = 50_000.0


def ground_findings(block: Block) -> tuple[Finding, ...]:
    """Look for mistakes in the control and check points of a block."""
    control, check = _of_role(block, "control"), _of_role(block, "check")
    pairs = tuple(
        (block.images.names[i], block.points.names[j])
        for i, j in zip(block.observations.image, block.observations.point, strict=True)
    )
    listed = list(check_points_used_as_control(control, check))
    for name, points in (("control", control), ("check", check)):
        listed += heights_all_equal(points, name)
    listed += control_in_few_images(control.names, pairs, "control")
    listed += control_in_few_images(check.names, pairs, "check")
    ground = _joined(control, check)
    if not len(ground.names):
        return tuple(listed)
    place = _place_findings(block, ground)
    listed += place
    # Distances say nothing where the whole frame is wrong.
    if not place and _metric(block):
        listed += feet_for_metres(ground, by_start_values(block))
    return tuple(listed)


def _of_role(block: Block, role: Role) -> GroundPoints:
    mine = np.flatnonzero(block.points.of_role(role))
    return GroundPoints(tuple(block.points.names[j] for j in mine), block.points.values[mine])


def _joined(a: GroundPoints, b: GroundPoints) -> GroundPoints:
    return GroundPoints(a.names + b.names, np.vstack([a.xyz_m, b.xyz_m]))


def _metric(block: Block) -> bool:
    if block.frame == "local":
        return True
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return not CRS.from_user_input(block.frame).is_geographic
    except CRSError:
        return False


def _exposures(block: Block) -> Floats:
    """Places of the exposures: observed antenna positions, else the centres of images.csv."""
    return block.positions.values if len(block.positions.image) else block.images.values[:, 3:]


def _place_findings(block: Block, ground: GroundPoints) -> tuple[Finding, ...]:
    exposures = _exposures(block)
    exposures = exposures[np.isfinite(exposures).all(axis=1)]
    if not len(exposures):
        return ()
    if block.frame == "local":
        return _far_in_local_frame(ground, exposures)
    from pyproj import CRS, Transformer
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(block.frame)
    except CRSError:
        return (Finding("unknown-frame", "grave", block.frame),)
    if system.is_geographic:
        # X is longitude (east) and Y latitude (north), as for every other frame.
        return latitude_longitude_swapped(ground.xyz_m[:, 1], ground.xyz_m[:, 0], exposures[:, 1::-1])
    utm = system.utm_zone
    if utm is None:
        return _far_in_local_frame(ground, exposures)
    back = Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    longitude, latitude = back.transform(exposures[:, 0], exposures[:, 1])
    degrees = np.column_stack([latitude, longitude])
    if not np.isfinite(degrees).all():
        return (Finding("exposures-outside-frame", "grave", block.frame),)
    return wrong_utm_zone(ground, int(utm[:-1]), southern=utm[-1] == "S", exposures_deg=degrees)


def _far_in_local_frame(ground: GroundPoints, exposures: Floats) -> tuple[Finding, ...]:
    """Ground points far from the exposures, and the mistake that would bring them near."""
    places = ground.xyz_m[np.isfinite(ground.xyz_m).all(axis=1)]
    if not len(places):
        return ()
    flight, middle = exposures[:, :2].mean(axis=0), places[:, :2].mean(axis=0)
    distance = float(np.hypot(*(middle - flight)))
    if distance <= _FAR_M:
        return ()
    for code, cause, moved in (
        ("east-north-swapped", "near-when-swapped", middle[::-1]),
        ("feet-for-metres-plane", "near-in-feet", middle * FOOT_M),
        ("metres-for-feet", "near-in-metres", middle / FOOT_M),
    ):
        near = float(np.hypot(*(moved - flight)))
        if near <= _FAR_M:
            figures = {"far_km": distance / 1000.0, "near_km": near / 1000.0}
            return (Finding(code, "grave", figures=figures, cause=cause),)
    far = {"far_km": distance / 1000.0, "points": ground.names}
    return (Finding("points-far-from-flight", "grave", figures=far, cause="other-frame"),)


def by_start_values(block: Block) -> GroundPoints:
    """Intersect the rays of all points from the given orientations."""
    plane, _ = observed_plane(block)
    image = block.observations.image
    camera = block.images.camera[image]
    ideal = np.empty_like(plane)
    for k, own in enumerate(block.cameras):
        ideal[camera == k] = undistorted(own, plane[camera == k])
    rotation = matrix_from_angles(block.images.values[:, :3])
    centre = block.images.values[:, 3:].copy()
    if len(block.attitudes.image):
        matrix = body_to_camera(block.mounting, block.mounting.values)
        rotation[block.attitudes.image] = matrix @ block.attitudes.rotation
    centre[block.positions.image] = block.positions.values
    distance = np.array([own.value("c") for own in block.cameras])[camera]
    # Images without start values have nothing to say yet.
    known = np.isfinite(centre[image]).all(axis=1) & np.isfinite(rotation[image]).all(axis=(1, 2))
    xyz = intersect(
        block.observations.point[known],
        len(block.points.names),
        centre[image][known],
        rotation[image][known],
        ideal[known],
        distance[known],
    )
    return GroundPoints(block.points.names, xyz)
