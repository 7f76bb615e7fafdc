"""What fills each row of the ministry's technical report: computed, given, or not determined.

Sheets to print for the field and the laboratory: stations, flight, targets, pictures and distances.
"""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Literal

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.findings.digits import MINUS, power_of_ten, symbol, unit_power
from photocal.findings.document import (
    Column,
    Document,
    KeyValues,
    Paragraph,
    PicturePart,
    Piece,
    Section,
    TablePart,
)
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.report.certificate_metadata import Metadata
from photocal.report.derived_figures import DerivedFigures, verdict
from photocal.report.stored_analysis import AnalysedRun

Origin = Literal["computed", "given", "fixed", "not_determined"]
Filled = tuple[str, Origin] | None
LAYOUT = Path(__file__).with_name("ministry_aerial_survey.csv")


@dataclass(frozen=True)
class Context:
    """What the rows are filled from."""

    run: AnalysedRun
    particulars: Metadata
    facts: DerivedFigures
    say: Catalogue

    @property
    def camera(self) -> Camera:
        """The camera concerned."""
        return self.run.result.cameras[self.facts.camera_id]


def _given(text: str) -> Filled:
    return (text, "given") if text else None


def _number(value: float | None, digits: int, origin: Origin, c: Context) -> Filled:
    if value is None:
        return None
    text = c.say.as_given(value) if origin == "given" else c.say.significant(value, digits)
    return text, origin


def _of_flight(value: float | None, name: str, digits: int, c: Context) -> Filled:
    return _number(value, digits, "computed" if name in c.facts.computed else "given", c)


def _of_pictures(key: str, typed: str, scale: float, digits: int) -> Callable[[Context], Filled]:
    """What a person typed, else what the pictures of the flight say."""

    def fill(c: Context) -> Filled:
        """Give the value of the row and where it came from."""
        given, spread = getattr(c.particulars.campaign, typed), c.particulars.flown_spread.get(key)
        if given is not None or spread is None:
            return _number(given, digits, "given", c)
        least, most = (c.say.significant(scale * value, 3) for value in (spread[0], spread[2]))
        return (f"{least} (EXIF)" if least == most else f"{least} – {most} (EXIF)"), "given"

    return fill


def _rtk(c: Context) -> Filled:
    flown = c.particulars.flown_spread.get("height_m")
    if flown is None:
        return c.say("ministry.rtk"), "fixed"
    least, most = (c.say.fixed(height, 1) for height in (flown[0], flown[2]))
    return c.say("ministry.rtk_flown", advice=c.say("ministry.rtk"), least=least, most=most), "computed"


def _verdict(c: Context) -> Filled:
    outcome = verdict(c.facts.limits)
    return None if outcome == "not_determined" else (c.say(f"acceptance.{outcome}"), "computed")


def _sensor_dimension(c: Context) -> Filled:
    size = c.particulars.camera.sensor_size_mm
    if size is not None:
        return " × ".join(c.say.as_given(side) for side in size), "given"
    if c.facts.pixel_mm is None:
        return None
    return " × ".join(c.say.fixed(n * p, 2) for n, p in _sides(c)), "computed"


def _sides(c: Context) -> list[tuple[int, float]]:
    pitch = c.camera.pitch if c.camera.unit == "mm" else (c.facts.pixel_mm or 0.0,) * 2
    return list(zip(c.camera.size_px, pitch, strict=True))


def _pixels(c: Context) -> Filled:
    given = c.particulars.camera.effective_pixels
    if given is not None:
        return f"{c.say.as_given(given / 1e6)} M", "given"
    return f"{c.say.fixed(c.camera.size_px[0] * c.camera.size_px[1] / 1e6, 2)} M", "computed"


def _image_side(axis: int) -> Callable[[Context], Filled]:
    def fill(c: Context) -> Filled:
        """Give the value of the row and where it came from."""
        if c.facts.pixel_mm is None:
            return f"{c.camera.size_px[axis]} px", "computed"
        pixels, pitch = _sides(c)[axis]
        return f"{c.say.fixed(pixels * pitch, 3)} mm; {pixels} px", "computed"

    return fill


def _mounting(key: str, unit: str, scale: float, names: str) -> Callable[[Context], Filled]:
    """Offsets that were given, else those that the adjustment estimated; None for those that it held."""

    def fill(c: Context) -> Filled:
        """Give the value of the row and where it came from."""
        system, mounting = c.particulars.gnss_ins, c.run.result.mounting or {}
        values, sigmas = getattr(system, f"{key}_{unit}"), getattr(system, f"{key}_sigma_{unit}")
        origin: Origin = "given"
        if values is None or sigmas is None:
            axes = [mounting[name] for name in (f"{key}_{axis}" for axis in "xyz") if name in mounting]
            if len(axes) != 3 or not any(axis.estimated for axis in axes):
                return None
            values, sigmas = ([scale * getattr(axis, part) for axis in axes] for part in ("value", "sigma"))
            origin = "computed"
        printed = [c.say.measured(v, s) for v, s in zip(values, sigmas, strict=True)]
        return "; ".join(f"d{n} {_with_sigma(*m)}" for n, m in zip(names, printed, strict=True)), origin

    return fill


def _with_sigma(value: str, sigma: str, exponent: int) -> str:
    text = f"{value} ± {sigma}" if sigma else value
    return f"({text}) × {power_of_ten(exponent, '')}" if exponent else text


def _method(c: Context) -> Filled:
    given = c.particulars.campaign.method
    text = c.say("ministry.method")
    return (f"{given}; {text}", "given") if given else (text, "computed")


def _test_field(c: Context) -> Filled:
    campaign = c.particulars.campaign
    if not campaign.test_field:
        return None
    vertices = [
        f"{name} ({c.say.fixed(lat, 5)}; {c.say.fixed(lon, 5)})" for name, lat, lon in campaign.vertices
    ]
    return "; ".join([campaign.test_field, *vertices]), "given"


def _count(values: list[float], c: Context) -> Filled:
    """Sum over the surveyed points; a network without them has tie points, of which none need be a target."""
    pairs = zip(c.run.result.points.role, values, strict=True)
    total = int(sum(value for role, value in pairs if role in ("control", "check")))
    return (str(total), "computed") if total else None


def _iop(c: Context) -> Filled:
    pixel = c.facts.pixel_mm if c.camera.unit == "px" else 1.0
    unit, scale = ("mm", pixel) if pixel is not None else ("px", 1.0)
    parts = []
    for name in c.camera.free:
        power = c.camera.lens.power(name)
        factor = scale**power
        printed = c.say.measured(c.camera.value(name) * factor, c.camera.sigma_of(name) * factor)
        parts.append(f"{symbol(name)} {_with_sigma(*printed)} {unit_power(unit, power)}".rstrip())
    return ("; ".join(parts), "computed") if parts else None


def _correlation(c: Context) -> Filled:
    names, matrix = c.camera.free, c.camera.correlation_of(c.camera.free).tolist()
    pairs = [(abs(matrix[i][j]), i, j) for i in range(len(names)) for j in range(i)]
    if not pairs:
        return None
    _, i, j = max(pairs)
    pair = f"{symbol(names[j])}–{symbol(names[i])} {c.say.fixed(matrix[i][j], 2)}"
    return c.say("ministry.correlation", section=c.say("correlation.section"), pair=pair), "computed"


def _limit(*keys: str) -> Callable[[Context], Filled]:
    def fill(c: Context) -> Filled:
        """Give the value of the row and where it came from."""
        chosen = [limit for limit in c.facts.limits if limit.key in keys]
        values, bounds = [limit.value for limit in chosen], [limit.limit for limit in chosen]
        if None in values or None in bounds:
            return None
        texts = [
            "; ".join(c.say.significant(v, 4) for v in column if v is not None)
            for column in (values, bounds[:1])
        ]
        kept = "≤" if all(limit.met for limit in chosen) else ">"
        return f"{texts[0]} {kept} {texts[1]}", "computed"

    return fill


def _eo_quality(c: Context) -> Filled:
    e = c.particulars.exterior_orientation
    if not (e.rmse_m is None or e.mean_m is None or e.rmse_arcsec is None or e.mean_arcsec is None):
        rows = ((e.rmse_m, e.rmse_arcsec), (e.mean_m, e.mean_arcsec))
        return _eo_rows([[c.say.as_given(v) for v in (*m, *a)] for m, a in rows], c), "given"
    d = None if c.run.analysis is None else c.run.analysis.exterior_difference
    if d is None:
        return None
    texts = [
        [*(c.say.fixed(v, 4) for v in metres), *(c.say.fixed(v, 1) for v in seconds)]
        for metres, seconds in ((d.rmse_m, d.rmse_arcsec), (d.mean_m, d.mean_arcsec))
    ]
    return _eo_rows(texts, c), "computed"


def _eo_rows(texts: list[list[str]], c: Context) -> str:
    return "; ".join(
        f"{c.say(key)} X {t[0]} m, Y {t[1]} m, Z {t[2]} m, ω {t[3]}″, φ {t[4]}″, κ {t[5]}″"
        for key, t in zip(("ministry.rmse", "ministry.mean"), texts, strict=True)
    )


def _place_date(c: Context) -> Filled:
    place = c.particulars.document.place
    return (f"{place}, {c.say.date(c.particulars.date)}", "given") if place else None


def _responsible(c: Context) -> Filled:
    r = c.particulars.responsible
    return _given(", ".join(part for part in (r.name, r.title, r.registration) if part))


# The rows that are not one of the particulars as it was given.
FILLERS: dict[str, Callable[[Context], Filled]] = {
    "verdict": _verdict,
    "responsibility": lambda c: (c.say("ministry.responsibility"), "fixed"),
    "sensor_systems": lambda c: (c.facts.camera_id, "computed"),
    "sensor_dimension": _sensor_dimension,
    "effective_pixels": _pixels,
    "pixel_size": lambda c: _number(c.facts.pixel_mm, 4, "computed" if c.camera.unit == "mm" else "given", c),
    "nominal_focal_length": lambda c: _number(c.particulars.camera.nominal_focal_length_mm, 4, "given", c),
    "image_orientation": lambda c: (c.say("ministry.orientation"), "computed"),
    "image_size_x": _image_side(0),
    "image_size_y": _image_side(1),
    "corner_table": lambda c: (c.say("ministry.corners"), "computed"),
    "rtk_advice": _rtk,
    "lever_arm": _mounting("lever_arm", "cm", 100.0, "XYZ"),
    "boresight": _mounting("boresight", "deg", 1.0, "ωφκ"),
    "calibration": lambda c: (c.say("ministry.calibration"), "computed"),
    "method": _method,
    "test_field": _test_field,
    "photos": lambda c: (str(len(c.run.result.images)), "computed"),
    "flying_height": lambda c: _of_flight(c.facts.height_m, "height", 4, c),
    "gsd": lambda c: _of_flight(c.facts.gsd_cm, "gsd", 3, c),
    "calibrated_focal_length": lambda c: _number(c.facts.focal_mm, 6, "computed", c),
    "iso": _of_pictures("iso", "iso", 1.0, 6),
    "exposure_time": _of_pictures("exposure_ms", "exposure_time_s", 1e-3, 3),
    "targets": lambda c: _count([1.0] * len(c.run.result.points.role), c),
    "readings": lambda c: _count(c.run.result.points.rays.tolist(), c),
    "software": lambda c: (f"{c.run.result.software.name} {c.run.result.software.version}", "computed"),
    "iop_table": _iop,
    "air_base": lambda c: _of_flight(c.facts.base_m, "base", 4, c),
    "correlation_matrix": _correlation,
    "residual_plot": lambda c: (c.say("ministry.plot", section=c.say("residuals.section")), "computed"),
    "image_rmse": _limit("image_x", "image_y"),
    "planimetric_rmse": _limit("planimetric"),
    "altimetric_rmse": _limit("altimetric"),
    "eo_quality": _eo_quality,
    "references": lambda c: (
        "; ".join([c.say("ministry.references"), *c.particulars.document.references]),
        "fixed",
    ),
    "place_date": _place_date,
    "responsible": _responsible,
}


def corners(c: Context) -> tuple[tuple[str, ...], ...]:
    """Corners of the image: number, column and line (px), x and y (mm, from the image centre, y up)."""
    width, height = c.camera.size_px
    places = (("1", 0, 0), ("2", 0, height), ("3", width, height), ("4", width, 0))
    (_, px), (_, py) = _sides(c)
    rows = []
    for name, column, line in places:
        x, y = (column - width / 2) * px, (height / 2 - line) * py
        known = c.facts.pixel_mm is not None
        rows.append((name, str(column), str(line), *(c.say.fixed(v, 4) if known else MINUS for v in (x, y))))
    return tuple(rows)


# A row of the form: where it stands (section, item), its key, what it is called in each language, its unit,
# and which of the particulars it repeats, if it does; filled in also its value, and the origin of that.
FormRow = Mapping[str, str]


def read_layout() -> tuple[FormRow, ...]:
    """Read the rows of the form, not filled in yet."""
    with LAYOUT.open(encoding="utf-8", newline="") as stream:
        return tuple(csv.DictReader(stream))


def entries(layout: tuple[FormRow, ...], context: Context) -> tuple[FormRow, ...]:
    """Fill every row."""
    missing: tuple[str, Origin] = context.say("ministry.not_determined"), "not_determined"
    filled = ((row, *(_filled(row, context) or missing)) for row in layout)
    return tuple({**row, "value": value, "origin": origin} for row, value, origin in filled)


def _filled(row: FormRow, c: Context) -> Filled:
    return _given(attrgetter(row["given"])(c.particulars)) if row["given"] else FILLERS[row["key"]](c)


# Sheets by what they are for; their words stand in the catalogue under forms.NAME, lines with bars between.
FORMS = ("station", "flight", "targets", "laboratory", "rover")
# Empty rows of each table of a sheet; those of places and of pictures come from the plan.
ROWS = {"station.table": 3, "flight.table": 9, "targets.table": 20, "laboratory.distances": 10}
ROLLS_DEG = (0, 90, 180, 270)
STATIONS = 3
_SKETCH = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 160 45"><g fill="none" stroke="#4d565e" '
    'stroke-width=".3"><rect x=".5" y=".5" width="159" height="44"/><path d="M150 16V5m-2 4 2-4 2 4"/>'
    "</g></svg>"
)
# A place of the plan: name, role, latitude and longitude.
Place = tuple[str, str, float, float]
Cells = tuple[str, ...]


def planned_places(path: Path) -> tuple[Place, ...]:
    """Read control and check points of plan.geojson; raises InputMalformedError for another file."""
    try:
        features = json.loads(path.read_bytes())["features"]
        return tuple(
            (properties["name"], properties["kind"], *feature["geometry"]["coordinates"][1::-1])
            for feature in features
            if (properties := feature["properties"])["kind"] in ("control", "check")
        )
    except (OSError, ValueError, KeyError, TypeError) as refusal:
        raise InputMalformedError(
            "is not a plan", where=path, remedy="name plan.geojson of `photocal plan`"
        ) from refusal


def field_forms(
    wanted: Sequence[str], places: Sequence[Place], say: Catalogue, stations: int = STATIONS
) -> Document:
    """Make the sheets that are asked for, a station sheet for each place.

    places: of control and check points; without, one station sheet and one list are left empty.
    stations: places of the camera before the test field, each with four rolls (Brown 1989).
    raises ConfigurationError: for a form that there is none of.
    """
    unknown = [name for name in wanted if name not in FORMS]
    if unknown:
        raise ConfigurationError(f"no form {unknown[0]!r}", remedy=f"choose among {', '.join(FORMS)}")
    cells: list[Cells] = [
        (name, say(f"forms.{role}"), say.fixed(latitude, 7), say.fixed(longitude, 7))
        for name, role, latitude, longitude in places
    ]
    sections = []
    for name in wanted:
        of_sheet: list[Cells] = (cells or [("",) * 4]) if name == "station" else [()]
        sections += [_sheet(name, place, cells, stations, say) for place in of_sheet]
    return Document(
        say.language,
        say("forms.title"),
        say("forms.subtitle"),
        "",
        KeyValues(()),
        (),
        (),
        tuple(sections),
        {word: say(f"word.{word}") for word in ("table", "figure", "page", "of", "contents")},
        sheets=True,
    )


def _sheet(
    name: str,
    place: Cells,
    places: list[Cells],
    stations: int,
    say: Catalogue,
) -> Section:
    key, title = f"forms.{name}", say(f"forms.{name}.title")
    known: list[tuple[str, str]] = []
    if place:
        title = f"{title} {place[0]}".strip()
        known = list(zip(say("forms.place").split("|"), place, strict=True))
    empty = [(label, "") for label in say(f"{key}.lines").split("|")]
    pieces: list[Piece] = [Paragraph(say(f"{key}.text")), KeyValues((*known, *empty))]
    if name == "laboratory":
        rolls: list[Cells] = [(f"{k}", f"{roll}°") for k in range(1, stations + 1) for roll in ROLLS_DEG]
        pieces.append(_table("laboratory.pictures", rolls, say))
        pieces.append(_table("laboratory.distances", [], say))
    elif name == "rover":
        rows: list[Cells] = [
            (series, str(k), point) for series in "123" for k in range(1, 6) for point in "12"
        ]
        pieces.append(_table("rover.sets", rows, say))
    else:
        pieces.append(_table(f"{name}.table", places if name == "targets" else [], say))
    if place:
        pieces.append(PicturePart(f"sketch-{place[0]}", say("forms.sketch"), say("forms.sketch"), _SKETCH))
    return Section(title, tuple(pieces))


def _table(key: str, rows: list[Cells], say: Catalogue) -> TablePart:
    """A table with some cells filled in, or as many empty rows as it has room for."""
    heads = say(f"forms.{key}.columns").split("|")
    filled = rows or [()] * ROWS[key]
    cells = tuple((*row, *[""] * (len(heads) - len(row))) for row in filled)
    columns = tuple(Column(head, align="left") for head in heads)
    return TablePart(say(f"forms.{key}.caption"), columns, cells, widths=(1.0,) * len(heads))
