"""Positions of pictures that stand in a table beside them: an event list, geo.txt, a reference table.

Positions of pictures in the frame of their caster, taken to the frame and epoch of the project.
"""

import datetime as dt
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.base.geodesy import enu_axes, enu_offsets, geocentric, geodetic
from photocal.base.layers import SUFFIXES as LAYERS
from photocal.base.layers import file_of
from photocal.base.text_tables import folded, read_columns, read_under, refuse
from photocal.base.time_scales import WEEK_S
from photocal.exchange.ground_points import read_geo
from photocal.exchange.reference_table import read_references
from photocal.exchange.source import read_text
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.geometry.frames import level_of, system_of
from photocal.geometry.realizations import (
    FrameShift,
    Realization,
    frame_shift,
    known_realization,
    realization,
)
from photocal.measurement.event_matching import match_images
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.image_metadata import image_of
from photocal.measurement.listed_positions import (
    ListedPositions,
    judge_listed,
    listed_events,
    read_event_lines,
    read_solution_events,
)

Given = Callable[[ImageFacts], ImageFacts]
# Heads of the columns of places as people write them; the last ones of X and Y are of degrees.
_LONGITUDE = ("lon", "long", "longitude", "longitud", "longitudine", "lng", "lambda", "λ", "länge")
_LATITUDE = ("lat", "latitude", "latitud", "latitudine", "phi", "φ", "breite")
_HEIGHT = (
    "z", "h", "height", "elevation", "altitude", "alt", "elev", "cota", "elevação", "altura",
    "ellipsoidal height", "orthometric height", "altitude elipsoidal", "ortho. height", "ellip. height",
    "altitude ortométrica", "altitude geométrica", "elevación", "altitud", "höhe", "hoehe", "z/altitude",
    "hgt", "quota", "altezza", "hauteur", "level", "up", "wysokość", "rzędna", "wys",
)  # fmt: skip
_METRES = {
    "X": (
        "x", "e", "east", "easting", "este", "leste", "est", "rechtswert", "ost", "x/easting", "ostwert",
        "wschód",
    ),
    "Y": (
        "y", "n", "north", "northing", "norte", "nord", "hochwert", "y/northing", "nordwert",
        "północ",
    ),
}  # fmt: skip
# One sigma for both axes of the plane.
_PLANE_SIGMA = ("horizontal accuracy", "accuracy horz", "hrms", "lateral rms")
_DEGREES = {"X": _LONGITUDE, "Y": _LATITUDE}
PLACE_HEADS = {
    "X": (*_METRES["X"], *_LONGITUDE),
    "Y": (*_METRES["Y"], *_LATITUDE),
    "Z": _HEIGHT,
    "sX": ("sx", "se", "sigma_x", "sigma_e", "accuracy_x", "easting rms", "std e", *_PLANE_SIGMA),
    "sY": ("sy", "sn", "sigma_y", "sigma_n", "accuracy_y", "northing rms", "std n", *_PLANE_SIGMA),
    "sZ": (
        "sz",
        "sh",
        "su",
        "sigma_z",
        "sigma_h",
        "accuracy_z",
        "vertical accuracy",
        "accuracy vert",
        "vrms",
        "elevation rms",
        "height rms",
        "std u",
        "std z",
    ),
}
IMAGE_HEADS = (
    "image", "imagem", "photo", "foto", "picture", "file", "filename", "arquivo", "imagen", "immagine",
    "bild", "cliché", "zdjęcie", "nome da imagem", "nome imagem", "photo name", "bildname",
)  # fmt: skip


# Heads of a table of events; counts of these may stand under heads of points, names of points may not.
_EVENT_HEADS = {
    **PLACE_HEADS,
    **_DEGREES,
    "time": (
        "time", "gps time", "gpst", "utc", "utc time", "timestamp", "datetime", "date time", "hora", "tempo",
        "tow", "sow", "time of week", "gps tow", "gps sow", "seconds of week", "seconds", "zeit", "heure",
    ),
    "date": ("date", "data", "fecha", "datum"),
    "week": ("week", "gps week", "wn", "semana", "semana gps"),
}  # fmt: skip
_COUNTS = ("id", "no", "nr", "number", "num", "numero", "index", "event", "count", "seq")
_POINTS = ("name", "nome", "point", "ponto", "label", "gcp", "station", "target", "marco", "pt", "point id")


class UnbelievableListError(InputMalformedError):
    """A table of positions that was read, and cannot be right."""


# Longitude, latitude (deg), height and three sigmas (east, north, up), m.
_Place = tuple[float, ...]


Origin = tuple[float, float, float]


def local_places(facts: Sequence[ImageFacts], at: Origin | None = None) -> tuple[Floats, Origin]:
    """Projection centres in a topocentric frame (east, north, up) at their median.

    A picture from elsewhere in the folder does not tilt it.

    at: latitude, longitude, degrees, and height, m, of its origin, where that is given.
    """
    known = np.array([f.has_position for f in facts])
    geographic = np.array([[f.latitude_deg, f.longitude_deg, f.altitude_m] for f in facts])
    if not known.any():
        return np.full((len(facts), 3), np.nan), (float("nan"),) * 3
    latitude, longitude, height = np.median(geographic[known], axis=0)
    # Rounded, so that the origin can be written and read without loss.
    origin = at or (round(float(latitude), 6), round(float(longitude), 6), float(round(float(height))))
    places = np.full((len(facts), 3), np.nan)
    places[known] = (geocentric(*geographic[known].T) - geocentric(*origin)) @ enu_axes(*origin[:2]).T
    return places, origin


def map_places(facts: Sequence[ImageFacts], crs: str) -> Floats:
    """Projection centres in a system, to start from.

    The images' heights are of no known kind, so they are taken as they are: between ellipsoid and geoid lie
    up to 100 m, which start values bear and observations would not.
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    places = np.full((len(facts), 3), np.nan)
    known = np.array([f.has_position for f in facts], dtype=np.bool_)
    if not known.any():
        return places
    longitude, latitude, altitude = np.array(
        [(f.longitude_deg, f.latitude_deg, f.altitude_m) for f in facts]
    )[known].T
    try:
        way = Transformer.from_crs("EPSG:4326", level_of(system_of(crs)).to_2d(), always_xy=True)
        east, north = way.transform(longitude, latitude, errcheck=True)
    except ProjError as refusal:
        raise ConfigurationError(
            f"positions of the images cannot be transformed to {crs} ({refusal})",
            "name a system that covers the place",
        ) from refusal
    places[known] = np.column_stack([east, north, altitude])
    return places


@dataclass(frozen=True)
class PlacesOfPictures:
    """Positions of a table; called with the facts of a picture it puts its own in place of theirs.

    places: by the names of the pictures, as the table has them.
    by: what tells which is whose: "name", "number", "time", or the "order" alone.
    rival: how many pictures the best other alignment of times places.
    left: lines of events without a picture, where numbers or times tell.
    """

    places: Mapping[str, _Place]
    by: str = "name"
    rival: int = 0
    left: tuple[str, ...] = ()

    def __call__(self, facts: ImageFacts) -> ImageFacts:
        """Facts with the position of the table, where it has one."""
        return _placed(facts, _of(facts.name, self.places, self._alike))

    @cached_property
    def _alike(self) -> dict[str, _Place]:
        return {_called(name): place for name, place in self.places.items()}

    def has(self, name: str) -> bool:
        """Whether a picture has a position in it."""
        return _of(name, self.places, self._alike) is not None


def read_positions(path: Path, pictures: Sequence[ImageFacts]) -> PlacesOfPictures:
    """Read positions of pictures.

    A table names the pictures, with their suffix or without. The events of a list (`Timestamp.MRK`, RTKLIB's
    `_events.pos`, a table of times and places) go to the pictures whose names carry their numbers, or whose
    times fit; in their order when there are as many and times do not tell.

    raises InputNotFoundError, InputMalformedError: also when no picture has a position in it.
    """
    if path.suffix.lower() in (".mrk", ".pos") or is_event_table(path):
        return _of_events(path, pictures)
    names = [image.name for image in pictures]
    if file_of(path).suffix.lower() not in LAYERS and read_text(path).lstrip().startswith(
        ("#Label", "#CoordinateSystem")
    ):
        crs, rows = read_references(path)
        places = _in_degrees(crs, {row.name: (*row.xyz, *row.sigma) for row in rows}, path)
    else:
        try:
            heads = {"image": (*IMAGE_HEADS, "label", "name", "nome"), **PLACE_HEADS}
            # Nothing names the system of eastings that are given with them.
            degrees = _has(path, _DEGREES)
            table = read_under(path, heads | (_DEGREES if degrees else {}), ("image", *"XYZ"))
        except PhotocalError:
            crs, images = _latitudes_first(path, names) or read_geo(path)
            # Of the plane and of the height.
            listed = {name: (*row[:3], row[6], *row[6:]) for name, row in images.items()}
        else:
            crs = "EPSG:4326" if degrees else ""
            values = np.hstack([table.matrix("XYZ"), table.matrix(("sX", "sY", "sZ"), empty=np.nan)])
            listed = dict(zip(table.unique_names("image"), map(tuple, values.tolist()), strict=True))
        places = _in_degrees(crs, listed, path)
    given = PlacesOfPictures(places)
    if not any(map(given.has, names)):
        first = next(iter(places), "nothing")
        raise InputMalformedError(
            f"has none of the {len(names)} pictures (it has {first}, the first is {min(names, default='')})",
            "name the pictures as their files",
            where=path,
        )
    values = np.array(list(places.values())).reshape(-1, 6)
    lines, none = tuple(f"picture {name}" for name in places), np.full(len(places), -1)
    _require_credible(
        ListedPositions(lines, np.full(len(places), np.nan), values[:, [1, 0, 2]], values[:, 3:], none), path
    )
    return given


def _latitudes_first(path: Path, names: Sequence[str]) -> tuple[str, dict[str, list[float]]] | None:
    """Rows without a head as Pix4D has them: picture, latitude, longitude, height and accuracies.

    returns: as `read_geo`; None for other rows, such as marks of points that are numbers.
    """
    # The width of a flight, degrees.
    wide = 1.0
    called, rows = {_called(name) for name in names}, dict[str, list[float]]()
    for line in read_text(path).splitlines():
        image, *cells = (cell.strip() for cell in re.split(r"[,;\t]", line))
        try:
            values = [float(cell) for cell in cells if cell]
        except ValueError:
            return None
        if len(values) < 3 or image in rows or not (abs(values[0]) <= 90 and abs(values[1]) <= 180):
            return None
        # More are angles.
        accuracies = values[3:5] if len(values) > 4 else [np.nan, np.nan]
        rows[image] = [values[1], values[0], values[2], np.nan, np.nan, np.nan, *accuracies]
    known = any(_called(image) in called for image in rows)
    if not known or (np.ptp([row[:2] for row in rows.values()], axis=0) >= wide).any():
        return None
    return "EPSG:4326", rows


def _require_credible(listed: ListedPositions, path: Path) -> None:
    """Refuse a list that cannot be right, with what is wrong in which lines."""
    # One place may have several pictures.
    wrong = [one for one in judge_listed(listed).findings if one.code != "events-twice"]
    if wrong:
        raise UnbelievableListError(
            finding_text(wrong[0], catalogue("en"), plain).rstrip("."),
            "correct these lines or remove them; leave the cells of unknown sigmas empty",
            where=path,
        )


def in_degrees(path: Path, besides: Collection[str] = ()) -> bool:
    """Whether the heads of a table say that its places are longitudes and latitudes, and nothing else.

    besides: heads of other matters than places.
    """
    metres = {key: [word for word in words if word not in besides] for key, words in _METRES.items()}
    return _has(path, _DEGREES) and not _has(path, metres)


def _has(path: Path, heads: Mapping[str, Sequence[str]]) -> bool:
    table = read_under(path, heads, ())
    return all(map(table.has, heads))


def _of(name: str, places: Mapping[str, _Place], alike: Mapping[str, _Place]) -> _Place | None:
    called = _called(name)
    return (
        places.get(name)
        or places.get(Path(name).stem)
        or alike.get(called)
        or alike.get(called.rpartition(".")[0])
    )


def _called(name: str) -> str:
    """The name of a picture in small letters, without its folders."""
    return re.split(r"[\\/]", name)[-1].casefold()


def _placed(facts: ImageFacts, place: _Place | None) -> ImageFacts:
    if place is None:
        return facts
    longitude, latitude, height, *sigma = place
    return replace(
        facts,
        longitude_deg=longitude,
        latitude_deg=latitude,
        altitude_m=height,
        position_sigma_m=(sigma[0], sigma[1], sigma[2]),
        altitude_kind="table",
        table_apart_m=_apart_m(facts, latitude, longitude),
    )


def _apart_m(facts: ImageFacts, latitude: float, longitude: float) -> float:
    """Distance in plane between what a table and a picture state; NaN where the picture states none."""
    if not facts.has_position:
        return np.nan
    origin = np.array([facts.latitude_deg, facts.longitude_deg, facts.altitude_m])
    there = enu_offsets(np.array([latitude]), np.array([longitude]), origin[2:], origin)
    return float(np.hypot(there[0, 0], there[0, 1]))


def is_event_table(path: Path) -> bool:
    """Whether a table lists times with longitudes and latitudes, and names neither pictures nor points."""
    # Nobody surveys points that are numbered as fast as a camera takes pictures, s.
    slowest_s = 30.0
    try:
        heads = read_under(path, {"image": IMAGE_HEADS, "point": _COUNTS, **_EVENT_HEADS}, ())
        if not all(map(heads.has, ("time", *"XYZ"))) or heads.has("image") or not in_degrees(path):
            return False
        if any(folded(head) in _POINTS for head in read_columns(path).columns.column_names):
            return False
        if not heads.has("point"):
            return True
        time_s = _event_table(path).time_s
    except PhotocalError:
        return False
    return len(time_s) > 1 and float(np.median(np.diff(time_s))) < slowest_s


def _event_table(path: Path) -> ListedPositions:
    """Read a table of times and places."""
    table = read_under(path, _EVENT_HEADS, ("time", *"XYZ"))
    dates = table.texts("date") if table.has("date") else ("",) * len(table)
    time_s = np.array([_moment(*told) for told in zip(dates, table.texts("time"), strict=True)])
    refuse(table, np.isnan(time_s), "the time cannot be read", "write it as 2026-05-14 12:30:05.250")
    if table.has("week"):
        # Times of week are written in milliseconds, too.
        time_s = time_s / (1e3 if time_s.max(initial=0.0) > WEEK_S else 1.0) + table.numbers("week") * WEEK_S
    values = np.hstack([table.matrix("YXZ"), table.matrix(("sX", "sY", "sZ"), empty=np.nan)])
    lines = tuple(table.place(row).rpartition(", ")[2] for row in range(len(table)))
    return ListedPositions(lines, time_s, values[:, :3], values[:, 3:], np.full(len(lines), -1))


def _moment(date: str, time: str) -> float:
    """Seconds of a number, or of a date and time; NaN where they cannot be read."""
    try:
        value = float(time)
    except ValueError:
        stamp = f"{date} {time}".strip().replace("/", "-").removesuffix("Z").removesuffix(" UTC")
        stamp = re.sub(
            r"^(\d\d)-(\d\d)-(\d{4})", r"\3-\2-\1", stamp if "-" in stamp else f"1970-01-01 {stamp}"
        )
        try:
            return dt.datetime.fromisoformat(stamp).replace(tzinfo=dt.UTC).timestamp()
        except ValueError:
            return np.nan
    # Computers write milliseconds, microseconds and nanoseconds, too.
    while 1e11 < value < np.inf:
        value /= 1e3
    return value if np.isfinite(value) else np.nan


def _listed(path: Path) -> ListedPositions:
    """The events of a list of any kind that can be believed."""
    if path.suffix.lower() == ".mrk":
        listed = listed_events(*read_event_lines(read_text(path).splitlines(), path))
    elif path.suffix.lower() == ".pos":
        listed = read_solution_events(read_text(path).splitlines(), path)
    else:
        listed = _event_table(path)
    if not listed.lines:
        raise InputMalformedError(
            "has no events", "is it a Timestamp.MRK or an _events.pos file?", where=path
        )
    _require_credible(listed, path)
    return listed


def _of_events(path: Path, pictures: Sequence[ImageFacts]) -> PlacesOfPictures:
    listed = _listed(path)
    lines, number = listed.lines, listed.number.tolist()
    places = [tuple(row) for row in np.hstack([listed.place[:, [1, 0, 2]], listed.sigma_m]).tolist()]
    row_of = dict(zip(number[::-1], range(len(lines))[::-1], strict=True))
    # Cameras count with numbers of four digits.
    counts = {one.name: map(int, re.findall(r"(?<!\d)\d{4}(?!\d)", Path(one.name).stem)) for one in pictures}
    by_number = {name: row_of[k] for name, of_name in counts.items() for k in of_name if k in row_of}
    again = [k for k, count in enumerate(number) if places[row_of[count]] != places[k]]
    if by_number and again:
        count, before = number[again[0]], lines[row_of[number[again[0]]]]
        raise InputMalformedError(
            f"has another position for event {count} than {before}: two flights in one list?",
            "give each flight its own list",
            where=f"{path}, {lines[again[0]]}",
        )
    own = np.flatnonzero(judge_listed(listed).kept)
    reason, by_time, rival = "", dict[str, int](), 0
    try:
        images = [image_of(Path(one.name), one) for one in pictures]
        named, cameras = match_images(images, listed.time_s[own], listed.place[own], np.inf)
    except PhotocalError as refusal:
        reason = refusal.what
    else:
        by_time = {name: row for row, some in zip(own.tolist(), named, strict=True) for name in some}
        rival = sum(camera.rival for camera in cameras)
    if by_number:
        _require_times(by_number, by_time, lines, path)
    if taken := by_number or by_time:
        used = set(taken.values())
        left = tuple(lines[row] for row in own.tolist() if row not in used)
        named_by = ("number", 0) if by_number else ("time", rival)
        return PlacesOfPictures({name: places[row] for name, row in taken.items()}, *named_by, left)
    return PlacesOfPictures(_in_order(places, own, listed, pictures, reason, path), "order")


def _require_times(
    by_number: Mapping[str, int], by_time: Mapping[str, int], lines: Sequence[str], path: Path
) -> None:
    """Refuse numbers that belong to other pictures by their times: a list that was counted anew."""
    # One picture may have a wrong time.
    fewest = 2
    picture_of = {row: name for name, row in by_time.items()}
    apart = sorted(name for name, row in by_number.items() if picture_of.get(row, name) != name)
    if len(apart) >= fewest:
        row = by_number[apart[0]]
        raise InputMalformedError(
            f"has the number of {apart[0]} with the time of {picture_of[row]}, and so it is with "
            f"{len(apart)} of {len(by_number)} pictures: lines were lost or added, and the list was counted "
            "anew",
            "use the event list as the vehicle wrote it",
            where=f"{path}, {lines[row]}",
        )


def _in_order(
    places: Sequence[_Place],
    own: Integers,
    listed: ListedPositions,
    pictures: Sequence[ImageFacts],
    reason: str,
    path: Path,
) -> dict[str, _Place]:
    """Places in the order of pictures whose times do not tell, where their number does."""
    stamps = [image.time_s for image in (image_of(Path(one.name), one) for one in pictures)]
    timed = np.array([np.nan if stamp is None else stamp for stamp in stamps])
    if len(own) != len(pictures):
        why = reason if np.isfinite(timed).all() else "whose names have no number of an event"
        raise InputMalformedError(
            f"lists {len(own)} events for {len(pictures)} pictures, {why}",
            "leave in both what belongs together: in their order each picture gets an event",
            where=path,
        )
    names = [image.name for image in pictures]
    order = sorted(range(len(names)), key=lambda k: (np.nan_to_num(timed[k]), names[k]))
    apart = listed.time_s[own] - timed[order]
    # Whole seconds, and how much clocks scatter beside them.
    most_s = 2.0
    spread = float(np.ptp(apart))
    if spread > most_s:
        raise InputMalformedError(
            f"lists as many events as there are pictures, but in their order their times differ by up to "
            f"{spread:.1f} s: {reason}",
            "leave in both what belongs together: in their order each picture gets an event",
            where=path,
        )
    return {names[k]: places[row] for k, row in zip(order, own.tolist(), strict=True)}


def _in_degrees(crs: str, listed: Mapping[str, tuple[float, ...]], path: Path) -> dict[str, _Place]:
    """The same with longitude and latitude; heights as they are."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    malformed = InputMalformedError.at(path)
    if not crs:
        raise malformed("does not state its system", "name its columns latitude and longitude")
    values = np.array(list(listed.values()), dtype=float).reshape(-1, 6)
    try:
        way = Transformer.from_crs(level_of(system_of(crs)).to_2d(), "EPSG:4326", always_xy=True)
        values[:, 0], values[:, 1] = way.transform(values[:, 0], values[:, 1], errcheck=True)
    except ProjError as refusal:
        raise malformed(f"its system {crs} cannot be used ({refusal})") from refusal
    return {name: tuple(row) for name, row in zip(listed, values.tolist(), strict=True)}


KEY = "position_frame in [images]"


def frames_of(frame: str, crs: str) -> tuple[Realization, Realization]:
    """Give the realizations of positions and of a map system.

    frame: `FRAME[@EPOCH]`.
    raises ConfigurationError: for an unknown frame or one without its epoch, and for a system of none.
    """
    source, target = realization(frame), known_realization(crs)
    if source.moves and source.epoch is None:
        raise ConfigurationError(
            f"positions in {source.frame} change with time and need an epoch",
            f'write "{source.frame}@2026.9" with the epoch of the flight in years',
            where=KEY,
        )
    if target is None:
        raise ConfigurationError(
            f"{crs} does not state its frame and epoch: no transformation is known from {source} there",
            "name a system of the national frame, such as EPSG:31982, or leave the key out",
            where=KEY,
        )
    return source, target


def shift_of_positions(frame: str, crs: str, facts: ImageFacts) -> FrameShift:
    """Give the shift of a picture's position from a frame to that of a map system.

    frame: `FRAME[@EPOCH]`.
    raises ConfigurationError: as of `frames_of`, and where no way is known.
    """
    source, target = frames_of(frame, crs)
    place = geocentric(facts.latitude_deg, facts.longitude_deg, facts.altitude_m)
    shift = frame_shift(place, source, target)
    if shift is None:
        raise ConfigurationError(
            f"no transformation is known from {source} to {crs}",
            "transform the positions with another program, and leave the key out",
            where=KEY,
        )
    return shift


def in_project(facts: ImageFacts, shift: FrameShift) -> ImageFacts:
    """Facts of a picture with its position moved; the uncertainty of the transformation enters its sigmas."""
    if not facts.has_position:
        return facts
    turn = enu_axes(facts.latitude_deg, facts.longitude_deg)
    place = geocentric(facts.latitude_deg, facts.longitude_deg, facts.altitude_m)
    latitude, longitude, height = geodetic(place + turn.T @ shift.shift_enu_m)
    east, north, up = np.hypot(facts.position_sigma_m, shift.sigma_m).tolist()
    return replace(
        facts,
        latitude_deg=float(latitude),
        longitude_deg=float(longitude),
        altitude_m=float(height),
        position_sigma_m=(east, north, up),
    )


def moved_finding(shift: FrameShift) -> Finding:
    """Say that positions were moved, and by how much."""
    east, north, up = (float(v) for v in shift.shift_enu_m)
    figures = {"source": str(shift.source), "target": str(shift.target), "size_m": shift.size_m}
    more = {"east_m": east, "north_m": north, "up_m": up, "sigma_m": shift.sigma_m, "way": shift.way}
    return Finding("positions-moved", "note", figures={**figures, **more})
