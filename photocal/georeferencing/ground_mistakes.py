"""Mistakes of ground points: seen in their tables, or contradicting the others, with the likely slip."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats
from scipy.linalg import block_diag

from photocal.accuracy import ground_points
from photocal.adjustment.adjust import adjust
from photocal.adjustment.factored import factored
from photocal.adjustment.joint import joint_covariance
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import body_to_camera
from photocal.adjustment.network import covariance_matrices
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import PhotocalError
from photocal.block.model import Block, Role
from photocal.block.network import assemble, observed_plane
from photocal.findings.finding import Finding
from photocal.geometry.distortion import slopes_of
from photocal.geometry.resection import intersect
from photocal.geometry.rotation import matrix_from_angles
from photocal.georeferencing.methods import checkable, local_origin, with_roles, without_georeference

# Farther than any flight is from its ground points, in a local frame.
_FAR_M = 50_000.0
Place = Callable[[Floats], Floats]

# With fewer control points a contradiction cannot be laid at the door of one of them.
_FEWEST = 4
_MOST_REMOVED = 3
_SIGNIFICANCE = 0.001
# Less than this many times the stated sigma is a poor point, not a wrong one.
_WRONG = 10.0
# A slip explains a coordinate when it comes this near, in standard deviations.
_NEAR = 4.0
# Weak observations of what control would have determined: share of c; lever arm (m), boresight (rad), time
# offset (s); the shift is free.
_LOOSE_C, _LOOSE = 0.02, np.array([1.0] * 3 + [0.1] * 3 + [1.0])


def ground_findings(block: Block) -> tuple[Finding, ...]:
    """Look for mistakes in the control and check points of a block."""
    control, check = _of_role(block, "control"), _of_role(block, "check")
    pairs = tuple(
        (block.images.names[i], block.points.names[j])
        for i, j in zip(block.observations.image, block.observations.point, strict=True)
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
    places = ground.xyz_m[np.isfinite(ground.xyz_m).all(axis=1)]
    if not len(places):
        return ()
    flight, middle = exposures[:, :2].mean(axis=0), places[:, :2].mean(axis=0)
    distance = float(np.hypot(*(middle - flight)))
    if distance <= _FAR_M:
        return ()
    for code, cause, moved in (
        ("east-north-swapped", "near-when-swapped", middle[::-1]),
        ("feet-for-metres-plane", "near-in-feet", middle * ground_points.FOOT_M),
        ("metres-for-feet", "near-in-metres", middle / ground_points.FOOT_M),
    ):
        near = float(np.hypot(*(moved - flight)))
        if near <= _FAR_M:
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


@dataclass(frozen=True)
class Mistyped:
    """A control point whose coordinates do not fit the others.

    d, sigma (3,): computed from the other points minus given, and its standard deviation, m.
    slips: the likely slips, "code axis given wanted"; empty when none explains it.
    """

    point: str
    d: Floats
    sigma: Floats
    slips: tuple[str, ...]


def mistyped_control(
    block: Block, given: Floats, to_given: Place = lambda local: local, system: str = "local"
) -> tuple[Block, tuple[Mistyped, ...]]:
    """Find control points that contradict the other ones."""
    control = np.flatnonzero(block.points.of_role("control"))
    if len(control) < _FEWEST:
        return block, ()
    try:
        rows, computed, covariance, common = _by_the_images(block, control)
    except PhotocalError:
        return block, ()
    if len(rows) < _FEWEST:
        return block, ()
    d = computed - block.points.values[rows]
    removed = contradicting(d, covariance, common)
    listed = []
    for k in removed:
        error, spread = _beside_others(d, covariance, common, removed, k)
        stated = block.points.sigma[rows[k]]
        stated = np.where(np.isfinite(stated), stated, np.inf)
        sigma = np.sqrt(np.diag(spread))
        if not np.any((np.abs(error) > _WRONG * stated) & (np.abs(error) > _NEAR * sigma)):
            return block, ()
        wanted = to_given((block.points.values[rows[k]] + error)[None, :])[0]
        slips = _slips(given[rows[k]], wanted, sigma, system)
        listed.append(Mistyped(block.points.names[rows[k]], error, sigma, slips))
    left = control[~np.isin(control, rows[list(removed)])]
    return (checkable(with_roles(block, left)) if listed else block), tuple(listed)


def contradicting(d: Floats, covariance: Floats, common: Floats) -> tuple[int, ...]:
    """Choose the fewest points without which the differences agree; none where that is not clear."""
    removed: tuple[int, ...] = ()
    n = len(d)
    chi_squared = _misfit(d, covariance, common, removed)
    while True:
        freedom = 3 * (n - len(removed)) - common.shape[1]
        rest = freedom - 3
        if freedom > 0 and chi_squared <= stats.chi2.isf(_SIGNIFICANCE, freedom):
            return removed
        if rest < 1 or len(removed) == _MOST_REMOVED:
            return ()
        tries = sorted(
            (_misfit(d, covariance, common, (*removed, k)), k) for k in range(n) if k not in removed
        )
        (best, k), (second, _) = tries[:2]
        # Errors that the sigmas do not know stretch everything: what stands out does so against the rest.
        known = best <= stats.chi2.isf(_SIGNIFICANCE, rest)
        scale = 1.0 if known else best / rest
        limit = stats.chi2.isf(_SIGNIFICANCE, 3) / 3 if known else stats.f.isf(_SIGNIFICANCE / n, 3, rest)
        if (chi_squared - best) / 3.0 / scale <= limit:
            return removed
        if second - best < stats.chi2.isf(_SIGNIFICANCE, 3) * scale:
            return ()
        removed, chi_squared = (*removed, k), best


def _equations(
    d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Equations of unit weight for the errors of points left out and the common part."""
    of_errors = np.eye(d.size).reshape(d.size, -1, 3)[:, list(removed)].reshape(d.size, -1)
    root = np.linalg.cholesky(covariance)
    return np.linalg.solve(root, np.hstack([of_errors, common])), np.linalg.solve(root, d.ravel())


def _misfit(d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...]) -> float:
    """Least d' C^-1 d with the common part free and some points left out."""
    a, y = _equations(d, covariance, common, removed)
    return float(np.sum((y - a @ np.linalg.lstsq(a, y, rcond=None)[0]) ** 2))


def _beside_others(
    d: Floats, covariance: Floats, common: Floats, removed: tuple[int, ...], k: int
) -> tuple[Floats, Floats]:
    """Error of a point that was left out, by the others, and its covariance."""
    a, y = _equations(d, covariance, common, removed)
    normal = np.linalg.pinv(a.T @ a, hermitian=True)
    columns = slice(3 * removed.index(k), 3 * removed.index(k) + 3)
    return np.asarray((normal @ a.T @ y)[columns]), np.asarray(normal[columns, columns])


def _by_the_images(block: Block, control: Integers) -> tuple[Integers, Floats, Floats, Floats]:
    """Places of control points without control: rows, places, covariance with the survey, common part."""
    alone = checkable(with_roles(block, np.zeros(0, dtype=np.int64)))
    cameras = []
    for camera in alone.cameras:
        prior = camera.prior_sigma.copy()
        prior[0] = min(prior[0], _LOOSE_C * camera.value("c"))
        cameras.append(replace(camera, prior_sigma=prior))
    alone = replace(alone, cameras=tuple(cameras))
    placed = len(alone.positions.image) > 0 or np.isfinite(alone.images.sigma[:, 3:]).all(axis=1).any()
    if placed:
        sigma = alone.mounting.sigma.copy()
        sigma[: len(_LOOSE)] = np.minimum(sigma[: len(_LOOSE)], _LOOSE)
        # A shift is what all control points have in common; drifts and scales need control.
        sigma[len(_LOOSE) :] = 0.0
        alone = replace(alone, mounting=replace(alone.mounting, sigma=sigma))
    else:
        alone = replace(without_georeference(alone), datum="free")
    assembly = assemble(alone)
    with because("control points predicted without themselves"):
        solution = adjust(assembly.network)
    seen = np.flatnonzero(np.isin(assembly.points, control))
    names = [assembly.network.point_names[j] for j in seen]
    at = factored(assembly.network, solution.state)
    covariance = joint_covariance(at, [("point", name) for name in names])[1]
    rows = assembly.points[seen]
    computed = solution.points[seen] + local_origin(assembly)
    stated = np.where(np.isfinite(block.points.sigma[rows]), block.points.sigma[rows], 1e3)
    cross = np.zeros((len(rows), 3)) if block.points.cross is None else block.points.cross[rows]
    # A held coordinate has no error, but rounding.
    survey = covariance_matrices(np.maximum(stated, 1e-4), cross)
    relative = computed - computed.mean(axis=0)
    shift = np.tile(np.eye(3), (len(rows), 1))
    turns = np.cross(np.eye(3)[None, :, :], relative[:, None, :]).transpose(0, 2, 1).reshape(-1, 3)
    common = shift if placed else np.hstack([shift, turns, relative.reshape(-1, 1)])
    return rows, computed, covariance + block_diag(*survey), common


def _slips(given: Floats, wanted: Floats, sigma: Floats, system: str) -> tuple[str, ...]:
    """Name the slips of the pen that made the given coordinates of the wanted ones, see `Mistyped`."""
    tolerance = _NEAR * sigma
    wrong = np.abs(given - wanted) > tolerance
    for a, b in ((0, 1), (0, 2), (1, 2)):
        changed = given.copy()
        changed[[a, b]] = given[[b, a]]
        if wrong[a] and wrong[b] and np.all(np.abs(changed - wanted) <= tolerance):
            return (f"exchanged {'XYZ'[a]} {'XYZ'[b]}",)
    zone = _zone_slip(given, wanted, tolerance, system)
    if zone:
        return (f"zone X {zone}",)
    near = tolerance.tolist()
    slips = [(k, _digit_slip(float(given[k]), float(wanted[k]), near[k])) for k in np.flatnonzero(wrong)]
    if not all(slip for _, slip in slips):
        return ()
    return tuple(f"{slip[0]} {'XYZ'[k]} {' '.join(slip[1:])}" for k, slip in slips)


def _digit_slip(given: float, wanted: float, tolerance: float) -> tuple[str, ...]:
    """Two digits swapped, one digit or the sign wrong, feet for metres: code, given, nearly wanted value."""
    text = f"{given:.3f}"
    places = [i for i, mark in enumerate(text) if mark.isdigit()]
    for i, j in pairwise(places):
        marks = list(text)
        marks[i], marks[j] = marks[j], marks[i]
        swapped = "".join(marks)
        if swapped != text and abs(float(swapped) - wanted) <= tolerance:
            return "digits-exchanged", text, swapped
    if abs(-given - wanted) <= tolerance:
        return "sign", text, f"{-given:.3f}"
    if abs(given * 0.3048 - wanted) <= tolerance:
        return "feet", text, f"{given * 0.3048:.3f}"
    for i in places:
        for digit in "0123456789":
            other = f"{text[:i]}{digit}{text[i + 1 :]}"
            if digit != text[i] and abs(float(other) - wanted) <= tolerance:
                return "one-digit", text, other
    return ()


def _zone_slip(given: Floats, wanted: Floats, tolerance: Floats, system: str) -> str:
    """Name the map zone in which the given coordinates are the wanted ones; empty when there is none."""
    if system == "local" or not np.isfinite(wanted).all():
        return ""
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    horizontal = CRS.from_user_input(system).to_2d()
    zone, ellipsoid = horizontal.utm_zone, horizontal.ellipsoid
    if zone is None or ellipsoid is None:
        return ""
    axes = f"+a={ellipsoid.semi_major_metre} +b={ellipsoid.semi_minor_metre}"
    utm = f"+proj=utm {axes} {'+south' if zone[-1] == 'S' else ''} +units=m +no_defs +zone="
    for step in (-1, 1):
        number = (int(zone[:-1]) - 1 + step) % 60 + 1
        way = Transformer.from_crs(f"{utm}{number}", f"{utm}{zone[:-1]}", always_xy=True)
        try:
            x, y = way.transform(given[0], given[1])
        except ProjError:
            continue
        if abs(x - wanted[0]) <= tolerance[0] + 0.05 and abs(y - wanted[1]) <= tolerance[1] + 0.05:
            return str(number)
    return ""
