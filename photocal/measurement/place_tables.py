"""Tables of points and their places as people write them: heads, units, kinds of heights, cells, rows.

Spreadsheets put a row of units under the heads, leave rows empty and add a mean below; people write degrees
with minutes and seconds, decimal commas and groups of thousands. What is no place is named by its row.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.base.text_tables import TextTable, folded, read_columns, read_under, shortened
from photocal.findings.texts import Catalogue
from photocal.measurement.marks import ControlMarks
from photocal.measurement.position_files import PLACE_HEADS

# Words of heights; beside one of them, or alone, stands what the heights refer to.
_HEIGHT_WORDS = frozenset(folded(word) for word in PLACE_HEADS["Z"] if " " not in folded(word))
_ELLIPSOIDAL = re.compile(r"ell?ip\w*|ellis\w*|h?ell|hae|geometric[ao]")
_ORTHOMETRIC = re.compile(
    r"ort?h\w*|ortom\w*|msl|amsl|nmm|msnm|egm\d+|navd\d*|dhhn\d*|nhn|nap|normal\w*|gebrauchs\w*"
)
# Heads with one of these are of no height.
_NO_HEIGHT = re.compile(
    r"geoid\w*|undulat\w*|ondul\w*|separation|sigma|sd|std\w*|rms\w*|rmse|accuracy|precision|error|erro|cq|"
    r"delta|diff\w*|base|antenna|antena"
)
# Systems of heights that heads name, by their EPSG codes.
_LEVELS = {"egm96": "5773", "egm2008": "3855", "egm08": "3855", "navd88": "5703"}
# Metres of units, as heads and rows of units write them.
FOOT_M, SURVEY_FOOT_M = 0.3048, 1200 / 3937
_UNITS = {
    "mm": 0.001, "cm": 0.01, "m": 1.0, "metros": 1.0, "meters": 1.0, "metres": 1.0,
    **dict.fromkeys(("ft", "feet", "foot", "ift", "intft", "intlft", "internationalft"), FOOT_M),
    **dict.fromkeys(
        ("usft", "ftus", "sft", "ussurveyft", "ussurveyfeet", "ussurveyfoot", "surveyft", "surveyfeet"),
        SURVEY_FOOT_M,
    ),
}  # fmt: skip
# Names of rows that are computed from the others.
_SUMMARIES = frozenset((
    "total", "totals", "sum", "soma", "somme", "suma", "summe", "mean", "average", "avg", "media", "moyenne",
    "mittel", "mittelwert", "promedio", "std", "stdev", "sd", "min", "max", "minimum", "maximum", "desvio",
    "count",
))  # fmt: skip
# What people write where they have no number.
_NOTHING = re.compile(r"[-\u2013\u2014?*.]*|n/?[ad]|none|null|nan|sem|s/h", re.IGNORECASE)
_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?")
_COMMA = re.compile(r"[+-]?(\d+|\d{1,3}(\.\d{3})+),\d+")
_GROUPS_ONLY = re.compile(r"[+-]?\d{1,3}(\.\d{3})+")
# Blanks and apostrophes between groups of three digits.
_BLANKS = re.compile(r"(?<=\d)[\s\u00a0\u202f'\u2019](?=\d{3}(\D|$))")
_SEXAGESIMAL = re.compile(
    r"(?P<before>[NSEWOL])?\s*(?P<sign>[+-])?\s*(?P<deg>\d{1,3})\s*[°ºd:\s-]\s*"
    r"(?:(?P<min>\d{1,2})\s*['′’m:\s-]\s*(?P<sec>\d{1,2}([.,]\d*)?)\s*(\"|''|″|”)?|"
    r"(?P<minutes>\d{1,2}[.,]\d+)\s*['′’m]?)\s*(?P<after>[NSEWOL])?",
    re.IGNORECASE,
)
_DECIMAL = re.compile(
    r"(?P<before>[NSEWOL])?\s*(?P<value>[+-]?\d+([.,]\d*)?)\s*[°º]?\s*(?P<after>[NSEWOL])?", re.IGNORECASE
)


def read_places(
    path: Path, heads: Mapping[str, Sequence[str]], required: Sequence[str], say: Catalogue, *, degrees: bool
) -> tuple[TextTable, Floats, ControlMarks]:
    """Read the points of a table.

    heads: words for the columns point, X, Y and Z, and for others.
    required: columns that it must have, beside these.
    say: language in which other rows with anything in them are named.
    degrees: whether X and Y are longitude and latitude.
    returns: its rows that are points; X, Y, Z of these, (n, 3), in the unit of X and Y, NaN for a height
        that nobody gives; and control without points yet: the system that a column names, rows that are
        refused, unit and heights as heads say them.
    raises InputNotFoundError, InputMalformedError: also when no row is a point with its place.
    """
    height = _height_column(path, heads["Z"])
    table = read_under(path, {**heads, "Z": (height,)}, (*required, "point", *"XYZ"))
    if table.heads["point"] == table.heads["Y"]:
        # N may head numbers and norths.
        raise InputNotFoundError(
            "has no column with the names of the points", "write name at its head", where=path
        )
    rows = list(zip(*(table.texts(name) for name in ("point", *"XYZ")), strict=True))
    filled = [k for k, row in enumerate(rows) if any(row)]
    if filled and _is_units(rows[filled[0]]):
        # As heads have them that state their units themselves.
        first, heads_too = filled.pop(0), dict(table.heads)
        for key, head in table.heads.items():
            unit = table.texts(key)[first].strip("()[]")
            heads_too[key] = f"{head} ({unit})" if _UNITS.get(folded(unit)) else head
        table = replace(table, heads=heads_too)
    stated = {axis: unit_of_head(table.heads[axis]) for axis in "XYZ"}
    columns = [[_BLANKS.sub("", rows[k][1 + n]) for k in filled] for n in range(3)]
    # One hand has written all of them: 913,419 alone would be a group of thousands.
    commas = any(_has_commas(cells, table.separator) for cells in columns[2 if degrees else 0 :])
    parsed = [
        _angles([rows[k][1 + n] for k in filled], table.heads[axis])
        if degrees and n < 2
        else [_value(cell, comma=commas and any("," in cell for cell in columns[n])) for cell in columns[n]]
        for n, axis in enumerate("XYZ")
    ]
    kept, refused = list[int](), list[str]()
    for n, row in enumerate(filled):
        why = _refusal(rows[row], [column[n] for column in parsed])
        if why is None:
            kept.append(n)
        else:
            refused.append(say(f"new.row_{why[0]}", place=table.place(row), **why[1]))
    if not any(parsed[2][n] is not None for n in kept):
        name, *cells = rows[filled[0]] if filled else ("", "", "", "")
        bad = next((n for n, column in enumerate(parsed) if not filled or column[0] is None), 2)
        what = f"{'XYZ'[bad]} of {name or 'the first row'} is {cells[bad]!r}, not a number"
        raise InputMalformedError(
            f"has no row with a point and its place: {what}", "is it the right file?", where=path
        )
    plane = 1.0 if degrees else (stated["X"] or 1.0)
    # Without a height it is NaN.
    places = np.array([[column[n] for column in parsed] for n in kept], dtype=np.float64)
    # In one unit; what states none is in that of the others.
    places[:, 2] *= (stated["Z"] or plane) / plane
    kind, level = _kind_of(height)
    if not kind and _as_ellipsoidal(path, table, [filled[n] for n in kept], places[:, 2]):
        kind = "ellipsoidal"
    only = table.only([filled[n] for n in kept])
    control = ControlMarks(
        _stated_system(path, len(rows), degrees=degrees) or ("EPSG:4326" if degrees else ""),
        refused=tuple(refused),
        unit_m=plane,
        height=kind,
        height_head=height.strip(),
        level=level,
    )
    return only, places, control


def _height_column(path: Path, words: Sequence[str]) -> str:
    """The head of the heights: a word of its own before one that names what they refer to."""
    names = read_columns(path).columns.column_names
    heads = [folded(name) for name in names]
    known = [folded(word) for word in words]
    heads = [head if head in known else shortened(head) for head in heads]
    plain = [k for k, head in enumerate(heads) if head in known and not _kind_of(names[k])[0]]
    plain.sort(key=lambda k: known.index(heads[k]))
    if plain:
        return str(names[plain[0]])
    stated = sorted((name for name in names if _kind_of(name)[0]), key=lambda name: _kind_of(name)[0])
    return str(stated[0] if stated else words[0])


def _kind_of(head: str) -> tuple[str, str]:
    """What heights under a head refer to, and the EPSG code of a system that it names; empty without."""
    words = re.split(r"[\W_]+", folded(re.sub(r"[()\[\]]", " ", head)))
    words = [word for word in words if word and word not in _UNITS]
    marked = [word for word in words if _ELLIPSOIDAL.fullmatch(word) or _ORTHOMETRIC.fullmatch(word)]
    others = [word for word in words if word not in marked]
    if not marked or any(map(_NO_HEIGHT.fullmatch, others)):
        return "", ""
    if not all(
        word in _HEIGHT_WORDS | {"above", "over", "wgs84", "grs80", "level", "de", "del", "la"}
        for word in others
    ):
        return "", ""
    level = next((_LEVELS[word] for word in marked if word in _LEVELS), "")
    return ("ellipsoidal" if any(map(_ELLIPSOIDAL.fullmatch, marked)) else "orthometric"), level


def _as_ellipsoidal(path: Path, table: TextTable, rows: Sequence[int], heights: Floats) -> bool:
    """Whether a column of ellipsoidal heights beside them has the same ones throughout."""
    whole = read_columns(path)
    for name in whole.columns.column_names:
        if _kind_of(name)[0] == "ellipsoidal":
            cells = [str(whole.columns[name][row].as_py() or "").strip() for row in rows]
            beside = _values(cells, table.separator)
            # A millimetre of rounding.
            if all(
                v is not None and abs(v - z) < 0.002 for v, z in zip(beside, heights.tolist(), strict=True)
            ):
                return True
    return False


def _stated_system(path: Path, rows: int, *, degrees: bool) -> str:
    """The system that a column of the table names for all its rows; empty without one of that kind."""
    from pyproj.exceptions import CRSError

    from photocal.geometry.frames import system_of

    try:
        table = read_under(
            path, {"crs": ("cs name", "crs", "coordinate system", "sistema de coordenadas")}, ("crs",)
        )
    except InputNotFoundError:
        return ""
    named = {text for text in table.texts("crs") if text}
    if len(named) != 1 or not rows:
        return ""
    (text,) = named
    try:
        return text if system_of(text).is_geographic == degrees else ""
    except CRSError:
        return ""


def unit_of_head(head: str) -> float | None:
    """Metres of the unit that a head states in brackets or as its last words."""
    inside = re.search(r"[(\[]([^)\]]*)[)\]]", head)
    texts = [inside[1]] if inside else []
    words = folded(head).split()
    texts += [words[-1]] if len(words) > 1 else []
    found = (_UNITS.get(re.sub(r"[\W_]+", "", text).lower()) for text in texts)
    return next((unit for unit in found if unit is not None), None)


def _is_units(row: Sequence[str]) -> bool:
    """Whether a row under the heads has units of the columns in place of values."""
    cells = [folded(cell).replace(" ", "") or cell for cell in row[1:] if cell]
    words = {*_UNITS, "deg", "grad", "graus", "degrees", "°", "(°)", "[°]", "dms", "gms"}
    return bool(cells) and all(cell in words for cell in cells)


def _refusal(row: Sequence[str], values: Sequence[float | None]) -> tuple[str, dict[str, object]] | None:
    """Why a row is no point."""
    name, *cells = row
    if folded(name).split(" ")[0] in _SUMMARIES and not re.search(r"\d", name):
        return "summary", {"name": name}
    lacking = [axis for axis, value in zip("XYZ", values, strict=True) if value is None]
    # A point of the plane has no height.
    if lacking == ["Z"] and name and _NOTHING.fullmatch(cells[2]):
        return None
    if lacking:
        cell = dict(zip("XYZ", cells, strict=True))[lacking[0]]
        figures: dict[str, object] = {"name": name or "?", "axis": lacking[0], "cell": repr(cell)}
        return ("unreadable" if cell else "empty"), figures
    return None if name else ("nameless", {})


def _angles(cells: Sequence[str], head: str) -> list[float | None]:
    """Degrees of a column of longitudes or latitudes; None for cells that are none."""
    # O is Ost in German, and west in languages of Latin.
    west = "WO" if not re.match("lange|laenge|geogr", folded(head)) else "W"
    return [_degrees(cell, west) for cell in cells]


def _values(cells: Sequence[str], separator: str) -> list[float | None]:
    """Numbers of a column; None for cells that are none."""
    plain = [_BLANKS.sub("", cell) for cell in cells]
    return [_value(cell, comma=_has_commas(plain, separator)) for cell in plain]


def _has_commas(cells: Sequence[str], separator: str) -> bool:
    """Whether numbers without blanks have decimal commas that cannot stand between groups of thousands."""
    grouped = separator == ","
    return any(_COMMA.fullmatch(cell) and not (grouped and _GROUPED.fullmatch(cell)) for cell in cells)


def _value(cell: str, *, comma: bool) -> float | None:
    """A number, with a decimal comma or a point, groups of thousands and the unit m behind it."""
    text = re.sub(r"(?<=[\d.,])\s*m$", "", cell)
    if comma:
        if not (_COMMA.fullmatch(text) or _GROUPS_ONLY.fullmatch(text) or re.fullmatch(r"[+-]?\d+", text)):
            return None
        text = text.replace(".", "").replace(",", ".")
    elif _GROUPED.fullmatch(text):
        text = text.replace(",", "")
    if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text):
        return None
    value = float(text)
    # No coordinate is larger.
    return value if math.isfinite(value) and abs(value) < 1e11 else None


def _degrees(cell: str, west: str) -> float | None:
    """Degrees, with minutes and seconds or as a decimal number, and a letter of the hemisphere.

    west: letters of the western one.
    """
    # Seconds of 25d26m53.9s; without the d an s is the south.
    cell = re.sub(r"(?<=[\d.])s", "", cell) if re.match(r"\D*\d+\s*d", cell, re.IGNORECASE) else cell
    if match := _SEXAGESIMAL.fullmatch(cell):
        minutes = float((match["min"] or match["minutes"]).replace(",", "."))
        seconds = float((match["sec"] or "0").replace(",", "."))
        if minutes >= 60 or seconds >= 60:
            return None
        size = float(match["deg"]) + minutes / 60 + seconds / 3600
        value = -size if match["sign"] == "-" else size
    elif match := _DECIMAL.fullmatch(cell):
        value = float(match["value"].replace(",", "."))
        # Nothing is so far: degrees, minutes and seconds written as one number.
        if abs(value) > 180.0:
            minutes, seconds = abs(value) // 100 % 100, abs(value) % 100
            size = abs(value) // 10_000 + minutes / 60 + seconds / 3600
            if minutes >= 60 or seconds >= 60 or size > 180.0:
                return None
            value = -size if value < 0 else size
    else:
        return None
    letters = [letter.upper() for letter in (match["before"], match["after"]) if letter]
    if len(letters) > 1 or (letters and value < 0):
        return None
    return -value if letters and letters[0] in f"S{west}" else value
