"""Sheets to print for the field and the laboratory: stations, flight, targets, pictures and distances."""

import json
from collections.abc import Sequence
from pathlib import Path

from photocal.base.errors import ConfigurationError, InputMalformedError
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
            "is no plan", where=path, remedy="name plan.geojson of `photocal plan`"
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
