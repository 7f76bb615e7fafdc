"""Errors of a project that show before anything is measured: swapped units, axes and zones are tried.

A typing error in a project (a zone, exchanged axes, feet) makes every later figure absurd, and the last of
them says least. So coordinates are compared here with each other; where they contradict, the usual errors
are tried one by one, and the one that makes them agree is named.
"""

import datetime as dt
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.block.folder import read_block, read_relations
from photocal.block.model import Block, ObjectPoints
from photocal.block.network import ELLIPSOIDAL_M, block_frame
from photocal.block.project import Project
from photocal.exchange.source import read_json
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.frames import level_of, reference_frame, require_geoid, system_of, utm_zones
from photocal.geometry.oriented_images import given_places
from photocal.geometry.systems import degrees_outside, heights_at, missing_grids
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import list_images
from photocal.measurement.marks import read_marks
from photocal.measurement.picture_block import better_known, control_points, pictures_of_heads
from photocal.measurement.position_files import map_places
from photocal.measurement.tie_block import intersected, tracks_of, views_of

# How far control may lie from a base station, and from what pictures say of their place.
FAR_FROM_BASE_M, FAR_FROM_PICTURES_M = 50_000.0, 5_000.0
# Pictures show the ground to so many flying heights beside them.
REACH_HEIGHTS, REACH_M = 2.0, 20.0
# Rays of exposures by GNSS and inertial unit meet a point to this, over its distance, and at least in m.
RAYS, RAYS_M = 0.15, 15.0
FEWEST = 3
# What serves without a geoid.
FREED = 'position_sigma_m = "free" in [images], and control alone places the block'
# Principal distances over the width of the picture: of lenses wider than 160 degrees and of telescopes.
NARROWEST, LONGEST = 0.08, 100.0
# Of so many control points some may be wrong.
SOME_WRONG = 1 / 3
# Flights at the edge of a zone are mapped in its neighbour, too.
NEIGHBOURING_DEG = 6.0
_PICTURES = 10
_UNITS = {"feet": 0.3048, "millimetres": 0.001, "centimetres": 0.01, "kilometres": 1000.0}
Place = tuple[float, float, str, float]


def check_project(project: Project) -> None:
    """Complain of a system, of control, of places and of inputs that cannot be right, before any work."""
    given = project.contents.measurements
    if given is not None and given.block is not None:
        return
    _check_cameras(project)
    place = _place(project)
    _check_system(project, place)
    control = control_points(project)
    _check_heights(project, control)
    if place is not None:
        check_place(project.crs, control, (project.control.points, project.path), place)
    if project.crs != "local" and len(control.names):
        _check_frame(project, control, place)
    _check_inputs(project)


def _check_cameras(project: Project) -> None:
    """Complain of cameras whose c is in another unit, or that have taken none of the pictures."""
    for own in project.cameras:
        width, c = max(own.size_px), f"{own.value('c'):g} {own.unit}"
        share = own.value("c") / own.pitch[0] / width
        if not NARROWEST < share < LONGEST:
            raise ConfigurationError(
                f"c = {c} is {share:.2g} times the width of the picture, {width} px",
                "write c in the unit of the camera: px, or mm beside pitch_mm",
                where=f"{project.path}, camera {own.id}",
            )
    known = {own.size_px for own in project.cameras}
    facts = facts_of_pictures(project)
    if known and facts and not any(image.size_px in known for image in facts):
        facts = facts_of_pictures(project, None)
        if not any(image.size_px in known for image in facts):
            name, size = facts[0].name, "{} x {}".format(*facts[0].size_px)
            sizes = ", ".join("{} x {}".format(*own.size_px) for own in project.cameras)
            raise ConfigurationError(
                f"no picture has the size of a camera: {name} has {size} px, size_px is {sizes}",
                "correct size_px, with c, x0 and y0 in px",
                where=project.path,
            )


def _check_frame(project: Project, control: ObjectPoints, place: Place | None) -> None:
    """Open what the system needs, a geoid that is not here among it, before hours of measuring."""
    images = project.contents.images
    sigma = None if images is None else images.position_sigma_m
    facts = [picture for picture in facts_of_pictures(project) if picture.has_position]
    stated = any(picture.position_sigma_m[2] < ELLIPSOIDAL_M for picture in facts)
    typed = bool(facts) and isinstance(sigma, tuple) and sigma[2] < ELLIPSOIDAL_M
    precise = project.contents.flight is not None or typed or (stated and sigma != "free")
    middle = np.nanmedian(control.values, axis=0)
    here = middle[None] if np.isfinite(middle).all() else np.zeros((0, 3))
    try:
        if precise:
            require_geoid(project.crs, project.height, _with_heights(project.crs, place))
        frame = reference_frame(project.crs, project.height, middle)
        frame.to_local(here)
    except ConfigurationError as refusal:
        raise ConfigurationError(refusal.what, refusal.remedy, where=project.path) from refusal
    except InputMalformedError as refusal:
        lacks = missing_grids(project.crs, around(*place[:2]) if place is not None else None)
        if not lacks:
            raise
        level = project.crs.split("+")[0]
        raise ConfigurationError(
            f"crs = {project.crs!r} needs {', '.join(lacks)}, which is not installed",
            f"photocal fetch-grids {project.crs} installs it; without it: crs = {level!r} and {FREED}",
            where=project.path,
        ) from refusal


def around(latitude: float, longitude: float) -> tuple[float, float, float, float]:
    """West, south, east and north of the area about a place in which grids are looked up, deg."""
    far_deg = 0.2
    return longitude - far_deg, latitude - far_deg, longitude + far_deg, latitude + far_deg


def middle_of(placed: Sequence[ImageFacts]) -> tuple[float, float]:
    """Latitude and longitude of the middle of pictures that state their places, deg."""
    latitude, longitude = np.median([(image.latitude_deg, image.longitude_deg) for image in placed], axis=0)
    return float(latitude), float(longitude)


def _with_heights(crs: str, place: Place | None) -> str:
    """Systems of heights that would say what orthometric ones refer to."""
    systems = [("3855", "EGM2008 height")] if place is None else heights_at(*place[:2])
    offers = " or ".join(f'"{crs}+{code}" ({name})' for code, name in systems)
    return f"name a compound system: {offers}; or {FREED}"


def _check_inputs(project: Project) -> None:
    """Open every table that a later stage reads: what is wrong with one is reported now."""
    control, certificate = project.control, project.contents.certificate
    if control.marks is not None and control.marks.exists():
        read_marks(control.marks)
    if control.distances is not None and project.contents.measurements is None:
        points = control_points(project)
        read_relations(control.distances, "distance", points.names)
    if project.contents.images is not None:
        pictures_of_heads(project)
    if certificate.particulars is not None:
        from photocal.report.certificate_metadata import read_particulars

        read_particulars(certificate.particulars, dt.date.min)
    if certificate.plan is not None:
        read_json(certificate.plan)


def _place(project: Project) -> Place | None:
    """Latitude, longitude (deg), what says so, and how far control may lie from there."""
    flight = project.contents.flight
    if flight is not None and flight.base_position is not None:
        latitude, longitude, _ = flight.base_position
        return latitude, longitude, "base_position in [flight]", FAR_FROM_BASE_M
    placed = [facts for facts in facts_of_pictures(project) if facts.has_position]
    if not placed:
        return None
    return *middle_of(placed), "the pictures' positions", FAR_FROM_PICTURES_M


def picture_places(project: Project) -> Floats:
    """Positions that the pictures state, in the project's system; none in a local one."""
    facts = facts_of_pictures(project, None)
    if project.crs == "local" or not facts:
        return np.empty((0, 3))
    return map_places(facts, project.crs)


def facts_of_pictures(project: Project, most: int | None = _PICTURES) -> list[ImageFacts]:
    """Read what the first pictures of a project say of themselves; none without pictures."""
    images = project.contents.images
    if images is None or images.folder is None:
        return []
    facts = []
    paths = list_images(images.folder)
    known = better_known(project, paths)
    for path in paths[:most]:
        try:
            facts.append(known(read_facts(path)))
        except PhotocalError:
            continue
    return facts


def _check_system(project: Project, place: Place | None) -> None:
    if project.crs != "local" and (wrong := unfit(project.crs, catalogue("en"))):
        raise ConfigurationError(f"crs = {project.crs!r}{wrong}", _proposal(place), where=project.path)


def unfit(crs: str, say: Catalogue) -> str:
    """Say why no control can be adjusted in a system; nothing for a map system in metres."""
    from pyproj.exceptions import CRSError

    try:
        system = system_of(crs)
    except CRSError:
        return say("new.unfit_unknown")
    level = level_of(system)
    if level.is_geocentric:
        return say("new.unfit_geocentric", name=level.name)
    if level.is_geographic:
        return say("new.unfit_degrees", name=level.name)
    if (unit := level.axis_info[0].unit_name) != "metre":
        return say("new.unfit_unit", name=level.name, unit=unit)
    return ""


def _proposal(place: Place | None) -> str:
    if place is None:
        return 'write the map system of the control points, such as "EPSG:31982"'
    return f"write a map system, such as {utm_zones(*place[:2])[0]} for the place of {place[2]}"


def _check_heights(project: Project, control: ObjectPoints) -> None:
    """Heights that nobody has surveyed."""
    used = control.of_role("control") & np.isfinite(control.sigma[:, 2])
    heights = control.values[used, 2]
    if project.crs == "local" or len(heights) < FEWEST or np.ptp(heights) > 0:
        return
    raise ConfigurationError(
        f"the heights of all {len(heights)} control points are {heights[0]:g}, which is improbable",
        "give their heights, or leave sZ empty: then they are used in plan only",
        where=project.control.points,
    )


def check_place(crs: str, control: ObjectPoints, files: tuple[Path | None, Path], place: Place) -> None:
    """Complain of a system, and of control in it, that contradict a place that is known in degrees.

    files: that of the control, and that of the system.
    """
    if crs == "local":
        return
    latitude, longitude, what, far = place
    if not len(control.names):
        _check_area(crs, files[1], place)
        return
    known = np.isfinite(control.values[:, :2]).all(axis=1)
    stated = np.where(known, _away(latitude, longitude, crs, control.values[:, :2]), 0.0)
    off = stated > far
    # A few that are wrong are left out by name; the others place the block.
    if off.sum() <= SOME_WRONG * known.sum():
        return
    places, (table, file) = control.values[off, :2], files
    which = [name for name, wrong in zip(control.names, off, strict=True) if wrong]
    points = "the control points" if off[known].all() else f"control points {', '.join(which)}"
    tried: list[tuple[str, Path | None, float, float, str, Floats]] = [
        (f"E and N of {points} are exchanged", table, latitude, longitude, crs, places[:, ::-1])
    ]
    wrong = ConfigurationError.at(table)
    if (np.abs(places) <= (180, 90)).all():
        raise wrong(
            f"{points} are in degrees, crs is in metres",
            f"transform them to {crs}, or let photocal new do it",
        )
    for unit, factor in _UNITS.items():
        tried.append((f"{points} are in {unit}", table, latitude, longitude, crs, places * factor))
    if abs(longitude) <= 90:
        cause = f"latitude and longitude of {what} are exchanged"
        tried.append((cause, file, longitude, latitude, crs, places))
    for word, north, east in (
        ("latitude", -1.0, 1.0),
        ("longitude", 1.0, -1.0),
        ("latitude and longitude", -1.0, -1.0),
    ):
        cause = f"the sign of the {word} of {what} or of {points} is wrong"
        tried.append((cause, file, north * latitude, east * longitude, crs, places))
    for zone in _neighbours(crs, latitude, longitude):
        cause = f"crs = {crs!r} is not the zone of {points}: that is {zone}"
        tried.append((cause, file, latitude, longitude, zone, places))
    for cause, where, north, east, system, there in tried:
        if (where is table or off[known].all()) and (_away(north, east, system, there) <= far).all():
            raise ConfigurationError(cause, f"then they fit {what}: correct it", where=where)
    # Single typing errors are named beside the others' residuals.
    if (usual := np.median(stated[known])) > far:
        raise wrong(
            f"the control points lie {usual / 1000:.0f} km from {what}, and no exchange of axes, signs, "
            "units or zones explains it",
            "check crs, control and positions",
        )


def _check_area(crs: str, file: Path, place: Place) -> None:
    """Complain of a system of another part of the world, where no control says that it is meant."""
    latitude, longitude, what, _ = place
    off = float(degrees_outside(crs, np.array([latitude]), np.array([longitude]))[0])
    if off > NEIGHBOURING_DEG:
        raise ConfigurationError(
            f"crs = {crs!r} is the system of another place: its area ends {off:.0f} degrees from {what}",
            _proposal(place),
            where=file,
        )


def _away(latitude: float, longitude: float, crs: str, places: Floats) -> Floats:
    """Distances in the plane of a system, m (n,); infinite where the system does not reach."""
    fact = ImageFacts("", (1, 1), latitude_deg=latitude, longitude_deg=longitude, altitude_m=0.0)
    try:
        distance = np.hypot(*(map_places([fact], crs)[0, :2] - places).T)
    except PhotocalError:
        return np.full(len(places), np.inf)
    return np.where(np.isfinite(distance), distance, np.inf)


def _neighbours(crs: str, latitude: float, longitude: float) -> Iterator[str]:
    """Zones at the place: of the same datum, and of WGS 84, north and south."""
    datum = system_of(crs).name.split(" / ")[0]
    for name in dict.fromkeys((datum, "WGS 84")):
        for sign in (1, -1):
            yield from utm_zones(sign * latitude, longitude, name)


def check_near(project: Project, control: ObjectPoints, places: Floats) -> None:
    """Complain of control that no picture can show, for it lies away from all positions."""
    places = places[np.isfinite(places).all(axis=1)]
    points = control.values[control.of_role("control")]
    if not len(places) or not len(points):
        return
    height = float(np.median(places[:, 2]) - np.median(points[:, 2]))
    reach = REACH_HEIGHTS * abs(height) + REACH_M
    gap = np.linalg.norm(points[:, None, :2] - places[None, :, :2], axis=2).min(axis=1)
    if gap.min() > reach:
        raise ConfigurationError(
            f"the control points lie away from the pictures: the nearest is {gap.min():.0f} m from the "
            f"nearest position, {height:.0f} m below it",
            "are they of this flight, and in the datum of crs?",
            where=project.control.points,
        )


def check_rays(block: Block, control_file: Path | None, *, alike: bool = False) -> None:
    """Complain of control far from where rays of oriented exposures meet, with the slip that explains it."""
    frame = block_frame(block)
    rows = np.flatnonzero(~block.points.of_role("tie") & np.isfinite(block.points.values).all(axis=1))
    seen = block.observations
    which, tracks = tracks_of(seen, np.isin(seen.point, rows))
    if not len(rows):
        return
    wrong = ConfigurationError.at(control_file)
    if not len(which):
        raise wrong(
            f"none of the {len(rows)} surveyed points is measured in an image",
            f"are the names the same? The table has {block.points.names[rows[0]]}",
        )
    met = given_places(frame, intersected(views_of(block, frame), tracks))
    good = np.isfinite(met).all(axis=1) & (tracks.rays >= 2)
    if good.sum() < FEWEST:
        return
    met, survey, roles = met[good], block.points.values[which[good]], which[good]
    centre = np.nanmedian(block.images.values[:, 3:], axis=0)
    limit = max(RAYS_M, RAYS * float(np.median(np.linalg.norm(met - centre, axis=1))))
    miss = float(np.median(np.linalg.norm(survey - met, axis=1)))
    if miss <= limit:
        return
    slips = [(c, float(np.median(np.linalg.norm(x - met, axis=1)))) for c, x in _slips(survey)]
    # A hypothesis must leave so much less than the contradiction.
    explains = 0.2
    for most in (limit, explains * miss):
        for cause, left in slips:
            if left <= most and left < explains * miss:
                remedy = f"then they lie {left:.1f} m from the rays, not {miss:.0f} m"
                raise wrong(cause, remedy)
    shifted = survey + np.median(met - survey, axis=0)
    if np.median(np.linalg.norm(shifted - met, axis=1)) <= max(limit, explains * miss):
        if not alike:
            return
        east, north, up = np.median(survey - met, axis=0)
        raise wrong(
            f"all control points lie {east:+.0f} m east, {north:+.0f} m north and {up:+.0f} m up of the "
            "intersections of their rays",
            "check base_position, the datum of control and crs, and the coordinates of the control points",
        )
    raise wrong(
        f"the control points lie {miss:.0f} m from the intersections of their rays",
        f"check crs, datum and names, first of {block.points.names[roles[0]]}",
    )


def explained(project: Project, failure: PhotocalError) -> PhotocalError:
    """Give what made a stage fail, where the block of a flight shows it; else the failure itself."""
    if project.contents.flight is None or not (project.output / "block" / "block.toml").exists():
        return failure
    try:
        check_rays(read_block(project.output / "block"), project.control.points, alike=True)
    except PhotocalError as cause:
        return cause
    return failure


def _slips(survey: Floats) -> list[tuple[str, Floats]]:
    """What people mistake, with the coordinates as they would be without it."""
    scaled = [
        slip
        for unit, factor in _UNITS.items()
        for slip in (
            (f"the heights of the control points are in {unit}", survey * [1, 1, factor]),
            (f"the control points are in {unit}", survey * factor),
        )
    ]
    return [
        ("E and N of the control points are exchanged", survey[:, [1, 0, 2]]),
        *scaled,
        ("the heights of the control points have the wrong sign", survey * [1, 1, -1]),
    ]
