"""Control of a new project settled before any work: system, kind of heights, frame of the marks, slips."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.policy import policy
from photocal.block.model import NO_POINTS, ObjectPoints
from photocal.exchange.parts import Mark
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.frames import code_of, level_of, system_of, utm_zones
from photocal.geometry.systems import (
    MapSystem,
    at_place,
    called,
    exchanged_in,
    heights_at,
    is_meant,
    missing_grids,
)
from photocal.measurement.control_review import alone, heights_apart, listed, stray_points, stray_text, twins
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.mark_frames import (
    AS_STORED,
    FrameChoice,
    MarkFrame,
    choose_frame,
    inside,
)
from photocal.measurement.marks import ControlMarks, in_map_system, named_after, unit_m
from photocal.measurement.place_tables import FOOT_M, SURVEY_FOOT_M
from photocal.measurement.position_files import map_places
from photocal.run.project_checks import FAR_FROM_PICTURES_M, around, check_place, middle_of, unfit

HEIGHTS = ("ellipsoidal", "orthometric", "local")
# Control so far from other control is in another system, m.
ELSEWHERE_M = 1000.0


@dataclass
class NewProject:
    """A project that is written, with its control as written.

    path, changes: its file, and what has changed in one that was there.
    say: language of what is known, missing, doubtful and asked.
    known, missing, doubtful, asked: what the folder has, what would help, what looks like a typing error, and
        what must be said before it can be run.
    crs, height: empty where they are still to be said.
    height_is_assumed: nobody says it, and no figure depends on it.
    level: EPSG code of the system of heights that a table names.
    frame: of the pictures that the marks were made in.
    offers: frames that a person may choose from, where it is not plain that they are the stored ones.
    rows, rows_used: of a list with a row for each mark.
    refused: its rows that are not used, with the reason.
    assumed: points whose sigmas nobody states.
    """

    points: ObjectPoints = NO_POINTS
    marks: tuple[Mark, ...] = ()
    crs: str = ""
    height: str = ""
    height_is_assumed: bool = False
    level: str = ""
    frame: MarkFrame = AS_STORED
    offers: tuple[dict[str, Any], ...] = ()
    rows: int = 0
    rows_used: int = 0
    refused: list[str] = field(default_factory=list)
    assumed: frozenset[str] = frozenset()
    known: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    doubtful: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    path: Path = Path()
    changes: tuple[str, ...] = ()
    say: Catalogue = field(default_factory=lambda: catalogue("en"))

    def __post_init__(self) -> None:
        """Refuse a kind of heights that is none."""
        if self.height and self.height not in HEIGHTS:
            raise ConfigurationError(
                f"heights of the kind {self.height!r} are not known",
                f"give {', '.join(HEIGHTS[:2])} or {HEIGHTS[2]}",
                where="--height",
            )

    @property
    def fixing(self) -> int:
        """Control points that two pictures and more show."""
        count = Counter(mark.point for mark in self.marks)
        roles = self.points.of_role("control")
        return sum(count[name] >= 2 for name, used in zip(self.points.names, roles, strict=True) if used)


def settle(
    made: NewProject,
    given: ControlMarks | None,
    frame: MarkFrame | None,
    facts: Sequence[ImageFacts],
    folder: Mapping[str, Path],
    *,
    flown: bool,
    others: Collection[str] = (),
) -> None:
    """Settle what control of a folder is.

    made: with the system and the kind of heights as far as a person says them.
    frame: of the pictures that the marks were made in, where a person says it.
    folder: where the pictures lie, by name.
    flown: whether a flight log has positions.
    others: pictures of the same names that are not used, with the names of their folders.
    """
    placed, say = [image for image in facts if image.has_position], made.say
    if given is not None:
        given = _as_stated(given, placed, made)
        made.points, made.assumed = given.points, given.assumed
        made.doubtful += given.doubtful
        made.rows, made.refused, made.level = given.rows, list(given.refused), given.level
        _with_names(made, given, folder, others)
        renamed = replace(given, marks=named_after(given.marks, [image.name for image in facts], others))
        _with_marks(made, renamed, frame, facts, folder)
    matters = bool(placed) or flown
    # Nothing that is asked may be of no use.
    placeable = matters or made.fixing >= policy.fewest_control
    _with_system(made, "" if given is None else given.crs, placed, placeable=placeable)
    _with_heights(made, placed, matters=matters, flown=flown)
    if made.points.names:
        _with_place(made, given, placed)
        if not placed and exchanged_in(made.crs, made.points.values[:, :2]):
            made.doubtful.append(say("new.axes_exchanged", crs=made.crs))
        strays = stray_points(made.points, made.crs)
        made.doubtful += [stray_text(stray, say) for stray in strays.values()]
        here = made.points.only(~np.isin(np.arange(len(made.points.names)), list(strays)))
        told_of = (*twins(here, say), *heights_apart(here, say), *alone(made.marks, made.points, say))
        made.doubtful += [say("new.control_known", text=line) for line in told_of]
        if not matters and made.fixing < policy.fewest_control:
            made.missing.append(say("new.few_placing", n=made.fixing, fewest=policy.fewest_control))
    made.doubtful += [say("new.not_used", text=say.refused(line)) for line in made.refused]


def _as_stated(given: ControlMarks, placed: Sequence[ImageFacts], made: NewProject) -> ControlMarks:
    """Control with the unit, the order and the kind of heights that its table states, or pictures show."""
    points, say, file = given.points, made.say, given.file.name
    if given.crs_file is not None and not made.crs:
        made.known.append(
            say("new.crs_file", crs=given.crs, name=system_of(given.crs).name, file=given.crs_file.name)
        )
    if given.height:
        named = {"head": given.height_head, "file": file}
        if not made.height:
            made.height = given.height
            made.known.append(say("new.height_head", kind=say(f"new.kind.{given.height}"), **named))
        elif made.height != given.height and made.height in HEIGHTS[:2]:
            kind, other = (say(f"new.kind.{kind}") for kind in (made.height, given.height))
            made.doubtful.append(say("new.height_contradicts", kind=kind, other=other, **named))
    if given.unit_m != 1.0:
        factor = np.where([[name in given.assumed] for name in points.names], 1.0, given.unit_m)
        metres = replace(points, values=points.values * given.unit_m, sigma=points.sigma * factor)
        if _in_metres(metres, made.crs or given.crs, placed):
            points = metres
            made.known.append(say("new.units_taken", file=file, unit=_unit_named(given.unit_m, say)))
    if given.unordered and (shown := _exchanged(points, made.crs or given.crs, placed)):
        points = replace(points, values=points.values[:, [1, 0, 2]])
        made.known.append(say(f"new.order_turned_{shown}", file=file))
    return replace(given, points=points)


def _exchanged(points: ObjectPoints, crs: str, placed: Sequence[ImageFacts]) -> str:
    """What shows that north stands before east: positions or the area of the system; empty for nothing."""
    from pyproj.exceptions import CRSError

    turned = replace(points, values=points.values[:, [1, 0, 2]])
    try:
        if placed:
            system = zone_of(placed) if crs in ("", "local") else crs
            shown = _lies_among(turned, placed, system) and not _lies_among(points, placed, system)
            return "pictures" if shown else ""
        return "area" if exchanged_in(crs, points.values[:, :2]) else ""
    except CRSError:
        return ""


def _unit_named(metres: float, say: Catalogue) -> str:
    named = {FOOT_M: "new.unit_foot", SURVEY_FOOT_M: "new.unit_survey_foot"}
    return say(named[metres]) if metres in named else say("new.unit_of", metres=say.as_given(metres))


def _in_metres(metres: ObjectPoints, crs: str, placed: Sequence[ImageFacts]) -> bool:
    """Whether points are to be taken to metres: a map in feet takes them as they are."""
    from pyproj.exceptions import CRSError

    if crs == "local":
        return True
    if crs:
        try:
            return unit_m(system_of(crs)) == 1.0
        except CRSError:
            return False
    return bool(placed and _system_of(metres, placed))


def _with_place(made: NewProject, given: ControlMarks | None, placed: Sequence[ImageFacts]) -> None:
    """Name the slip of all points where they contradict the places of the pictures, which stops a run."""
    if not placed:
        return
    place = (*middle_of(placed), "the pictures' positions", FAR_FROM_PICTURES_M)
    file = None if given is None else given.file
    try:
        check_place(made.crs or zone_of(placed), made.points, (file, Path("project.toml")), place)
    except ConfigurationError as slip:
        # Where the system is still asked for it may be any.
        if made.crs or not slip.what.startswith("the control points lie"):
            made.doubtful.append(str(slip))


def _with_names(
    made: NewProject, given: ControlMarks, folder: Mapping[str, Path], others: Collection[str]
) -> None:
    """Name points without coordinates, and marks that pictures of several folders may have."""
    say = made.say
    if given.without_coordinates:
        count = Counter(given.without_coordinates)
        made.doubtful.append(say("new.marked_unknown", names=listed(list(count), say)))
    namesakes = {name.partition("/")[2]: name.partition("/")[0] for name in others}
    unclear = {mark.image for mark in given.marks if mark.image in namesakes}
    if unclear:
        first = min(unclear)
        told = {"names": listed(sorted(unclear), say), "other": namesakes[first]}
        here = folder[first].parent.name if first in folder else ""
        made.doubtful.append(say("new.same_names", here=here, **told))


def _with_marks(
    made: NewProject,
    given: ControlMarks,
    frame: MarkFrame | None,
    facts: Sequence[ImageFacts],
    folder: Mapping[str, Path],
) -> None:
    """Take the marks in pictures that are there, in the grid that these are stored in."""
    pictures, say = {image.name: image for image in facts}, made.say
    marks = given.marks
    absent = Counter(mark.image for mark in marks if mark.image not in pictures)
    if absent:
        every = len({mark.image for mark in marks})
        counts = {"n": len(absent), "all": every, "marks": absent.total(), "all_marks": len(marks)}
        made.doubtful.append(say("new.absent", names=listed(list(absent), say), **counts))
    here, again = dict[tuple[str, str], Mark](), list[Mark]()
    for mark in marks:
        if mark.image not in pictures:
            continue
        # A picture may stand there under two names, with its ending and without.
        if here.setdefault((mark.image, mark.point), mark) is not mark:
            again.append(mark)
    if frame is not None:
        made.frame = frame
    elif here:
        found = choose_frame(list(here.values()), pictures, folder)
        if (not found.sure or found.chosen != AS_STORED) and not found.fractions:
            made.offers = found.offers(list(here.values()), pictures)
        if found.fractions and not found.sure:
            made.asked.append(say("new.fractions_asked", n=len(here)))
            made.refused += [say("new.mark_fraction", **_names(mark)) for mark in here.values()]
            here = {}
        else:
            # Some point has marks in two pictures, so that it can have a place.
            useful = max(Counter(mark.point for mark in here.values()).values()) > 1
            made.frame = _frame(made, found, useful=useful)
    stored = made.frame.stored(list(here.values()), pictures)
    kept = tuple(mark for mark in stored if inside(mark, pictures[mark.image].size_px))
    made.refused += [
        say("new.mark_outside", **_names(mark), x=f"{mark.x:.6g}", y=f"{mark.y:.6g}")
        for mark in stored
        if not inside(mark, pictures[mark.image].size_px)
    ]
    made.refused += [say("new.mark_again", **_names(mark)) for mark in again]
    if given.rows:
        made.refused += [say("new.mark_absent", **_names(mark)) for mark in marks if mark.image in absent]
    made.marks, made.rows_used = kept, len(kept) if given.rows else 0


def _names(mark: Mark) -> dict[str, object]:
    return {"place": mark.place, "point": mark.point, "image": mark.image}


def _frame(made: NewProject, choice: FrameChoice, *, useful: bool) -> MarkFrame:
    """Say which pictures the marks were made in, or ask."""
    own, best = choice.fit_of(AS_STORED), choice.fits[0]
    if choice.sure and choice.chosen == AS_STORED:
        return AS_STORED
    say = made.say
    agree = {"n": choice.pairs, "percent": say.fixed(100 * best.miss, 1)} if choice.pairs else None
    fits = say("new.marks_inside") if agree is None else say("new.marks_agree", **agree)
    frame = choice.chosen.said(say)
    if choice.fractions:
        made.known.append(say("new.marks_fractions", frame=frame, fits=fits))
        return choice.chosen
    as_stored = say("new.marks_outside", n=own.outside) if own.outside else say("new.marks_unfit")
    if not np.isnan(own.miss):
        percent = say.fixed(100 * own.miss, 1)
        as_stored = say("new.marks_differ", text=as_stored, n=choice.pairs, percent=percent)
    if choice.sure:
        made.known.append(say("new.marks_converted", frame=frame, fits=fits, as_stored=as_stored))
        return choice.chosen
    if own.outside and not useful:
        made.doubtful.append(say("new.marks_harmless", text=as_stored))
    elif own.outside:
        offers = ", ".join(
            f'"{fit.frame}"' for fit in choice.fits if fit.frame != AS_STORED and not fit.outside
        )
        made.asked.append(say("new.marks_asked", text=as_stored, offers=offers or say("new.marks_such")))
    elif not np.isnan(own.miss):
        made.doubtful.append(say("new.marks_doubtful", text=as_stored))
    return AS_STORED


def _with_system(made: NewProject, written: str, placed: Sequence[ImageFacts], *, placeable: bool) -> None:
    """Settle the coordinate system: of the control if there is any, else of the pictures."""
    _out_of_degrees(made, written)
    points, text, say = made.points, made.crs or written, made.say
    local = say("new.or_local")
    if not points.names:
        if text and text != "local":
            made.crs = _resolved(made, text, placed, placeable=placeable)
        elif placed and not text:
            made.crs = zone_of(placed)
        else:
            made.crs = text or "local"
    elif text:
        made.crs = _resolved(made, text, placed, placeable=placeable)
    elif _is_geocentric(points.values):
        made.crs = _resolved(made, "EPSG:4978", placed, placeable=placeable)
    elif placed and _turned(points.values[:, :2], placed) is not None:
        made.crs = _resolved(made, "EPSG:4326", placed, placeable=placeable)
    elif placed:
        made.crs = _system_of(points, placed)
        if not made.crs:
            offers = at_place(*middle_of(placed), points.values[:, :2])
            told = _offered(offers, say) or say("new.crs_such", crs=zone_of(placed))
            made.asked.append(say("new.crs_asked", offers=told, or_local=local))
    elif placeable:
        made.asked.append(say("new.crs_asked", offers=say("new.crs_plain"), or_local=local))
    else:
        made.crs = "local"
        made.missing.append(say("new.crs_needless"))


def _out_of_degrees(made: NewProject, written: str) -> None:
    """Take points whose table says that they are in degrees to the map system that a person names."""
    from pyproj import Transformer
    from pyproj.exceptions import CRSError

    xy, named = made.points.values[:, :2], called(made.crs, None) if made.crs else ()
    if not made.crs or not written or not _in_degrees(xy):
        return
    try:
        given = system_of(written)
        meant = len(named) == 1 and is_meant(made.crs, named[0])
        system = system_of(named[0].code if meant else made.crs)
    except CRSError:
        return
    plane = level_of(system).to_2d() if system.is_compound else system
    if not given.is_geographic or not plane.is_projected:
        return
    way = Transformer.from_crs(given.to_2d(), plane, always_xy=True)
    places = np.column_stack(way.transform(*xy.T))
    if np.isfinite(places[np.isfinite(xy).all(axis=1)]).all():
        values = np.column_stack([places, made.points.values[:, 2]])
        made.points = replace(made.points, values=values)
        made.known.append(made.say("new.crs_degrees", crs=made.crs))


def _in_degrees(xy: Floats) -> bool:
    """Whether all places that are known may be longitudes and latitudes."""
    known = xy[np.isfinite(xy).all(axis=1)]
    return bool(len(known)) and bool((np.abs(known) <= [180.0, 90.0]).all())


def _is_geocentric(places: Floats) -> bool:
    """Whether all places lie on the earth as geocentric coordinates: none of a map does, by its heights."""
    # From the poles to the equator with heights up to 10 km, and no height of a map, m.
    least_m, most_m, highest_m = 6.35e6, 6.39e6, 1e4
    radius = np.linalg.norm(places, axis=1)
    on_earth = (radius > least_m) & (radius < most_m) & (np.abs(places[:, 2]) > highest_m)
    return bool(len(places) and on_earth.all())


def _resolved(made: NewProject, text: str, placed: Sequence[ImageFacts], *, placeable: bool) -> str:
    """Give the code of a system that somebody has named; empty, and asked for, where it is not clear."""
    from pyproj.exceptions import CRSError

    if text.strip().lower() == "local":
        return "local"
    xy, say = made.points.values[:, :2], made.say
    degrees = _in_degrees(xy)
    try:
        system = system_of(text)
    except CRSError:
        system = None
    if system is not None and (not system.is_geographic or degrees):
        points = made.points
        if system.is_geographic and placed and _turned(xy, placed):
            points = replace(points, values=points.values[:, [1, 0, 2]])
            made.known.append(say("new.crs_turned"))
        try:
            listed_there = ControlMarks(text, points, (), assumed=made.assumed)
            moved = in_map_system(listed_there) if len(xy) else None
        except PhotocalError as refusal:
            made.asked.append(say("new.crs_refused", text=refusal))
            return ""
        if moved is None:
            return ("" if system.is_compound else code_of(system)) or text
        if wrong := unfit(moved.crs, say):
            local = say("new.or_local")
            made.asked.append(say("new.crs_unfit", text=text, wrong=wrong, or_local=local))
            return ""
        made.points, known = moved.points, set(moved.points.names)
        made.refused += moved.refused
        made.marks = tuple(
            mark for mark in made.marks if mark.point in known or mark.point not in points.names
        )
        made.height = "ellipsoidal" if system.is_geocentric else made.height
        made.known += _moved(system, moved.crs, say)
        return moved.crs
    offers = called(text, xy if len(xy) else None)
    if len(offers) == 1 and is_meant(text, offers[0]):
        made.known.append(say("new.crs_meant", text=text, system=offers[0]))
        return offers[0].code
    if placed and len(xy):
        near = at_place(*middle_of(placed), xy)
        offers = tuple(system for system in offers if system in near) or near
    if not placeable:
        made.missing.append(say("new.crs_unknown_needless", text=text, offers=_offered(offers, say)))
        return "local"
    told = _offered(offers, say) or say("new.crs_write")
    made.asked.append(say("new.crs_unknown", text=text, offers=told, or_local=say("new.or_local")))
    return ""


def _moved(system: Any, crs: str, say: Catalogue) -> list[str]:
    """Say that points were taken to another kind of system, or to another unit."""
    if system.is_geocentric:
        return [say("new.crs_geocentric", crs=crs)]
    if unit_m(system) != 1.0:
        return [say("new.crs_in_unit", crs=crs, unit=system.axis_info[0].unit_name)]
    return []


def _offered(offers: Sequence[MapSystem], say: Catalogue) -> str:
    """Candidates with their areas of use, as what may be written; empty without any."""
    named = [f'"{one.code}" ({one.name}; {one.area.split(".")[0][:60]})' for one in offers]
    return f" {say('new.or').join(named)}" if named else ""


def _with_heights(made: NewProject, placed: Sequence[ImageFacts], *, matters: bool, flown: bool) -> None:
    """Settle the kind of the heights, and the grid that it needs."""
    control, own, say = bool(made.points.names), _heights_of(made.crs), made.say
    if made.crs == "local":
        made.height = "local"
    elif own and made.height == "ellipsoidal":
        made.asked.append(say("new.height_own", crs=made.crs, own=own, level=_level(made.crs)))
        made.height = ""
    elif own:
        made.height = "orthometric"
        if not matters and (lacks := missing_grids(made.crs, None)):
            made.known.append(say("new.grid_needless", names=", ".join(lacks), crs=made.crs, own=own))
            made.crs = _level(made.crs)
    elif made.height == "local":
        made.crs = "local"
    elif not made.height and not control:
        made.height = "ellipsoidal"
    elif not made.height and not matters:
        made.height, made.height_is_assumed = "orthometric", True
        made.missing.append(say("new.height_taken"))
    elif not made.height:
        made.asked.append(say("new.height_asked") if made.crs else say("new.height_asked_local"))
    precise = flown or any(np.isfinite(image.position_sigma_m).all() for image in placed)
    if made.height == "orthometric" and made.crs and precise:
        _with_geoid(made, placed)


def _heights_of(crs: str) -> str:
    """Name of the heights that a system has of its own; empty for one of the plane."""
    if not crs or crs == "local":
        return ""
    system = system_of(crs)
    return str(system.sub_crs_list[1].name) if system.is_compound else ""


def _level(crs: str) -> str:
    """The plane of a compound system, by its code."""
    plane = level_of(system_of(crs))
    return code_of(plane) or str(plane.to_wkt())


def _with_geoid(made: NewProject, placed: Sequence[ImageFacts]) -> None:
    """Ask for the system of orthometric heights that precise positions are compared with, or for its grid."""
    if not placed:
        return
    latitude, longitude = middle_of(placed)
    area = around(latitude, longitude)
    say, without = made.say, made.say("new.without_grid")

    def grid(crs: str) -> str:
        """Say whether the grids of a system are here."""
        lacks = missing_grids(crs, area)
        names = ", ".join(lacks)
        return say("new.grid_missing", names=names, crs=crs) if lacks else say("new.grid_here")

    if made.level and not system_of(made.crs).is_compound:
        made.crs = f"{made.crs}+{made.level}"
    if system_of(made.crs).is_compound:
        if lacks := missing_grids(made.crs, area):
            names = ", ".join(lacks)
            made.doubtful.append(say("new.grid_doubtful", names=names, crs=made.crs, without=without))
        return
    offers = say("new.or").join(
        f'"{made.crs}+{code}" ({name}; {grid(f"{made.crs}+{code}")})'
        for code, name in heights_at(latitude, longitude)
    )
    made.asked.append(say("new.heights_asked", offers=offers, without=without))
    made.crs = ""


def _turned(places: Floats, placed: Sequence[ImageFacts]) -> bool | None:
    """Whether degrees near the pictures have latitude first; None for what is not near either way."""
    # A site is narrower, deg.
    near_deg = 0.2
    latitude, longitude = middle_of(placed)
    away = [
        np.abs(np.nanmedian(places, axis=0) - at).max()
        for at in ((longitude, latitude), (latitude, longitude))
    ]
    return None if min(away) > near_deg else away[1] < away[0]


def zone_of(placed: Sequence[ImageFacts]) -> str:
    """UTM zone of the middle of the pictures."""
    return utm_zones(*np.mean([(image.latitude_deg, image.longitude_deg) for image in placed], axis=0))[0]


def _system_of(points: ObjectPoints, placed: Sequence[ImageFacts]) -> str:
    """The zone of the pictures, when the control points lie among them in it; else empty."""
    zone = zone_of(placed)
    return zone if _lies_among(points, placed, zone) else ""


def _lies_among(points: ObjectPoints, placed: Sequence[ImageFacts], crs: str) -> bool:
    """Whether control points lie among the pictures in a system."""
    try:
        places = map_places(placed, crs)
    except PhotocalError:
        return False
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    # Control this near to the pictures' positions is in their zone, m beyond their width.
    reach_m = 200.0
    reach = np.linalg.norm(high - low) + reach_m
    away = np.linalg.norm(np.nanmedian(points.values[:, :2], axis=0) - (low + high) / 2)
    return bool(away < reach)
