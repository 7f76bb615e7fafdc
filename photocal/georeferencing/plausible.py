"""Mistakes of a block's ground points, found before anything is adjusted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from photocal.accuracy.findings import Finding
from photocal.accuracy.ground_point_images import control_in_few_images
from photocal.accuracy.ground_points import (
    GroundPoints,
    check_points_used_as_control,
    feet_for_metres,
    heights_all_equal,
    latitude_longitude_swapped,
    name_list,
    wrong_utm_zone,
)
from photocal.adjustment.intersection import intersect
from photocal.adjustment.mounting import body_to_camera
from photocal.block.model import Block, Role
from photocal.block.network import observed_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.rotation import matrix_from_angles

Floats = NDArray[np.float64]

# Farther than any flight is from its ground points, in a local frame.
_FAR_M = 50_000.0


def ground_findings(block: Block) -> tuple[Finding, ...]:
    """Look for mistakes in the control and check points of a block."""
    control, check = _of_role(block, "control"), _of_role(block, "check")
    pairs = tuple(
        (block.images.names[i], block.points.names[j])
        for i, j in zip(block.observations.image, block.observations.point, strict=True)
    )
    said = list(check_points_used_as_control(control, check))
    for name, points in (("control", control), ("check", check)):
        said += [Finding(f.code, f"{name}: {f.text}") for f in heights_all_equal(points)]
    said += control_in_few_images(control.names, pairs, "control")
    said += control_in_few_images(check.names, pairs, "check")
    ground = _joined(control, check)
    if not len(ground.names):
        return tuple(said)
    place = _place_findings(block, ground)
    said += place
    # Distances say nothing where the whole frame is wrong.
    if not place and _metric(block):
        said += feet_for_metres(ground, by_start_values(block))
    return tuple(said)


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
        return (Finding("unknown-frame", f"frame {block.frame!r} is not a coordinate system."),)
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
        return (
            Finding(
                "exposures-outside-frame",
                f"the exposures do not lie in {block.frame}: the coordinate system is not theirs.",
            ),
        )
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
    for code, what, moved in (
        ("east-north-swapped", "when X and Y change places: they are swapped", middle[::-1]),
        ("feet-for-metres-plane", "when they are multiplied by 0.3048: they are in feet", middle * 0.3048),
        ("metres-for-feet", "when they are divided by 0.3048: the exposures are in feet", middle / 0.3048),
    ):
        near = float(np.hypot(*(moved - flight)))
        if near <= _FAR_M:
            text = (
                f"the ground points lie {distance / 1000:.0f} km from the exposures, and "
                f"{near / 1000:.1f} km {what}."
            )
            return (Finding(code, text),)
    return (
        Finding(
            "points-far-from-flight",
            f"the ground points lie {distance / 1000:.0f} km from the exposures: they are in another frame "
            f"or another map zone (looked at: {name_list(list(ground.names))}).",
        ),
    )


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
