"""The search of causes on a block: its network, its control as it was typed, and what it cannot separate.

Mistakes of ground points that are seen in their tables, before anything is adjusted.

What a flight cannot separate: values that could be freed together, and how well each would be known.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from photocal.adjustment.condensed import Condensed
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, TIME, body_to_camera
from photocal.adjustment.readout import READOUT
from photocal.analysis.accuracy import ground_points
from photocal.analysis.georeferencing.methods import Georeferenced, start_near
from photocal.analysis.georeferencing.prepared import as_mounted, without_georeference, without_weak_images
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, PhotocalError
from photocal.block.model import Block, ObjectPoints
from photocal.block.network import NetworkOfBlock, assemble, observed_plane
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import slopes_of
from photocal.geometry.frames import combined_factor, system_of
from photocal.geometry.resection import intersect
from photocal.geometry.rotation import matrix_from_angles
from photocal.hypotheses.causes import coarsely_placed, of_rays, points_of
from photocal.hypotheses.control import slips
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.findings import Slips, no_slips
from photocal.hypotheses.search import SystematicErrors, straightened, systematic_errors
from photocal.hypotheses.table import Fault

# What is asked of a calibration flight: 1 m, 1 degree, 0.1 s, 1 m; the camera: 1 % of c, 0.1 s of readout.
_SCALE_COMMON = np.array([1.0] * 3 + [np.radians(1.0)] * 3 + [0.1] + [1.0] * 3 + [0.0])
_SCALE_CAMERA, _SCALE_READOUT = 0.01, 0.1


@dataclass(frozen=True)
class Separation:
    """How well the flight determines the values that could be freed together.

    sigma (k,): standard deviation when all are free, in m, rad, s and the camera's unit; the prior of 1 m, 1
        degree, 0.1 s, 1 % of c is included.
    groups: names that are not separated from each other; a single name is not determined at all.
    """

    names: tuple[str, ...]
    sigma: Floats
    correlation: Floats
    groups: tuple[tuple[str, ...], ...]


def separation(block: Block, whole: Condensed) -> Separation | None:
    """See what the block would leave open if everything were free; None without positions.

    whole: equations of what its images share, with all of it free.
    """
    if not len(block.positions.image):
        return None
    asked = np.zeros(len(block.mounting.sigma), dtype=bool)
    asked[LEVER], asked[SHIFT] = True, True
    asked[BORESIGHT] = len(block.attitudes.image) > 0
    asked[TIME] = bool(np.any(block.positions.velocity))
    taken = np.flatnonzero(asked)
    sigma = np.zeros(len(asked))
    sigma[taken] = _SCALE_COMMON[taken]
    cameras = tuple(replace(camera, prior_sigma=_scales(camera)) for camera in block.cameras)
    columns = [int(whole.common_columns[k]) for k in taken]
    names = [COMMON[k] for k in taken]
    scale = [float(_SCALE_COMMON[k]) for k in taken]
    for camera, camera_columns in zip(cameras, whole.camera_columns, strict=True):
        for k, column in zip(*camera_columns, strict=True):
            if np.isfinite(camera.prior_sigma[k]):
                names.append(PARAMETERS[k] + (f"[{camera.id}]" if len(cameras) > 1 else ""))
                columns.append(int(column))
                scale.append(float(camera.prior_sigma[k]))
    try:
        mounting = replace(block.mounting, sigma=sigma)
        covariance = whole.covariance(cameras, mounting)[np.ix_(columns, columns)]
    except IllPosedError:
        return None
    deviation = np.sqrt(np.diag(covariance))
    groups = _groups(tuple(names), covariance / np.outer(scale, scale))
    return Separation(tuple(names), deviation, covariance / np.outer(deviation, deviation), groups)


def _scales(camera: Camera) -> Floats:
    """Scales of the estimated ones of c, x0, y0 and the readout; infinite of the others."""
    scale = np.full(len(PARAMETERS), np.inf)
    scale[:3], scale[READOUT] = _SCALE_CAMERA * camera.value("c"), _SCALE_READOUT
    return np.where(camera.estimated, scale, np.inf)


def _groups(names: tuple[str, ...], covariance: Floats) -> tuple[tuple[str, ...], ...]:
    """Names that the undetermined directions tie together."""
    # What has a smaller part in a direction without information has none in it.
    takes_part = 0.1
    variances, vectors = np.linalg.eigh(covariance)
    # A direction is not determined when its standard deviation stays above this share of the scale.
    undetermined = 0.05
    open_ = vectors[:, variances > undetermined**2]
    projector = open_ @ open_.T
    part = np.diag(projector) > takes_part
    linked = (np.abs(projector) > takes_part) & part[:, None] & part[None, :]
    _, label = connected_components(csr_array(linked), directed=False)
    groups: dict[int, list[str]] = {}
    for name, group, has in zip(names, label.tolist(), part.tolist(), strict=True):
        if has:
            groups.setdefault(group, []).append(name)
    return tuple(tuple(group) for group in groups.values())


Place = Callable[[Floats], Floats]


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


def by_navigation_fixes(block: Block) -> bool:
    """Whether nothing but navigation fixes, as pictures state them, places a block."""
    otherwise = len(block.positions.image) > 0 or bool(block.points.of_role("control").any())
    return coarsely_placed(block.images.sigma[:, 3:], otherwise=otherwise)


def causes_of(
    block: Block,
    near: Georeferenced | None = None,
    table: tuple[Fault, ...] = FAULTS,
    found: SystematicErrors | None = None,
) -> tuple[SystematicErrors | None, Separation | None]:
    """Look for what is wrong with a block, and for what it cannot separate; None where it gives no hold.

    near: the block by a method.
    found: what was found in the network of that.
    """
    plain = without_weak_images(block)[0]
    mounted = as_mounted(plain)
    # What images state as positions is another network than the one that was adjusted.
    whole = "integrated" if len(block.positions.image) else "indirect"
    first = None
    if near is not None and near.method == whole and mounted is plain:
        first = near.adjusted
    if first is None:
        found = None
    if block.datum == "free":
        return None, None
    table = of_rays(table) if by_navigation_fixes(block) else table
    if not len(mounted.positions.image):
        mounted = without_georeference(mounted)
    at_once = None
    try:
        if found is None:
            if first is None:
                with because("the block to be tested for causes"):
                    assembly = assemble(mounted)
                    first, at_once = straightened(assembly.network, start_near(assembly, near))
            found = systematic_errors(first, at_once, table)
    except PhotocalError:
        return None, None
    apart = separation(mounted, found.shared)
    if apart is not None and not len(block.positions.image):
        # A lever arm of positions that images state cannot be separated from anything.
        groups = tuple(g for g in apart.groups if not all("lever_arm" in name for name in g))
        apart = replace(apart, groups=groups)
    return found, apart


def typed_slips(typed: Block, names: Sequence[str], places: Floats, to_given: Place) -> Slips:
    """What names the typing errors of a control point, from the coordinates that were typed.

    names, places (n, 3): of the points where they were adjusted, and how these become coordinates as typed.
    """
    row = {name: k for k, name in enumerate(typed.points.names)}
    local = {name: k for k, name in enumerate(names)}

    def of_point(point: str, error: Floats, sigma: Floats) -> tuple[str, ...]:
        """Slips of one point."""
        wanted = to_given((places[local[point]] + error)[None, :])[0]
        return slips(typed.points.values[row[point]], wanted, sigma, typed.frame)

    return Slips(of_point, _combined_factor(typed))


def _combined_factor(typed: Block) -> float:
    """Metres on the map of a block's frame that make one on the ground, in its middle; NaN for no map."""
    places = typed.points.values[typed.points.of_role("control")]
    places = places[np.isfinite(places).all(axis=1)]
    if typed.frame == "local" or not len(places):
        return math.nan
    try:
        return float(combined_factor(typed.frame, places.mean(axis=0)[None])[0])
    except PhotocalError:
        # Degrees and geocentric coordinates have no scale.
        return math.nan


def slips_of(block: Block, assembly: NetworkOfBlock) -> Slips:
    """The same for the network of a block."""
    network = assembly.network
    return typed_slips(block, network.point_names, network.points.values, assembly.frame.to_given)


def mistyped_of(found: SystematicErrors | None, named: Slips = no_slips) -> tuple[Mistyped, ...]:
    """Control points that contradict the others, with the slips that explain them."""
    if found is None or not found.adequate:
        return ()
    listed = list[Mistyped]()
    for error in found.errors:
        if error.cause is None or error.cause.fault.each != "point":
            continue
        for k, point in enumerate(points_of(found.first.network, error.cause)):
            own = error.hypothesis.estimates[3 * k : 3 * k + 3]
            d, sigma = -np.array([e.correction for e in own]), np.array([e.sigma for e in own])
            listed.append(Mistyped(point, d, sigma, named.of_point(point, d, sigma)))
    return tuple(listed)


def ground_findings(block: Block) -> tuple[Finding, ...]:
    """Look for mistakes in the control and check points of a block."""
    given = block.points
    control, check, ground = (
        given.only(role) for role in (given.of_role("control"), given.of_role("check"), ~given.of_role("tie"))
    )
    surveyed = block.observations.rows(~given.of_role("tie")[block.observations.point])
    pairs = tuple(
        (block.images.names[i], block.points.names[j])
        for i, j in zip(surveyed.image, surveyed.point, strict=True)
    )
    listed = list(ground_points.check_points_used_as_control(control, check))
    for name, points in (("control", control), ("check", check)):
        listed += ground_points.heights_all_equal(points, name)
    listed += ground_points.control_in_few_images(control.names, pairs, "control")
    listed += ground_points.control_in_few_images(check.names, pairs, "check")
    if not len(ground.names):
        return tuple(listed)
    from pyproj.exceptions import CRSError

    try:
        system = None if block.frame == "local" else system_of(block.frame)
    except CRSError:
        return (*listed, Finding("unknown-frame", "grave", block.frame))
    place = _place_findings(block, ground, system)
    listed += place
    # Distances say nothing where the whole frame is wrong.
    if not place and (system is None or not system.is_geographic):
        listed += ground_points.feet_for_metres(ground, by_start_values(block))
    return tuple(listed)


def _place_findings(block: Block, ground: ObjectPoints, system: Any) -> tuple[Finding, ...]:
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
            ground.values[:, 1], ground.values[:, 0], exposures[:, 1::-1]
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


def _far_in_local_frame(ground: ObjectPoints, exposures: Floats) -> tuple[Finding, ...]:
    """Ground points far from the exposures, and the mistake that would bring them near."""
    # Farther than any flight is from its ground points, in a local frame.
    far_m = 50_000.0
    places = ground.values[np.isfinite(ground.values).all(axis=1)]
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


def by_start_values(block: Block) -> ObjectPoints:
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
    return ObjectPoints(block.points.names, xyz)
