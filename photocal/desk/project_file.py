"""The project file as a form: its fields, what is still asked, and one value changed, all comments kept."""

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomlkit

from photocal.base.checked_toml import checked_tables, parse_toml
from photocal.base.codec import toml_document
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.base.files import rows_text, write_file
from photocal.block.model import ROLES
from photocal.block.project import ASKED, Contents
from photocal.findings.texts import catalogue

# Tables of points that are no larger than this are shown point by point.
MOST_POINTS = 2000


# Keys of the project file in the form: their kind, and what is to be chosen from.
FIELDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "project.name": ("text", ()),
    "project.crs": ("system", ()),
    "project.height": ("height", ("ellipsoidal", "orthometric", "local")),
    "images.lens": ("choice", ("unknown", "given")),
    "images.position_sigma_m": ("triple", ()),
    "rig.camera_to_antenna_m": ("triple", ()),
    "flight.base_position": ("triple", ()),
    "certificate.client": ("text", ()),
    "certificate.operator": ("text", ()),
    "certificate.form": ("choice", ("", "br-md")),
    "certificate.language": ("choice", ("en", "pt-BR")),
}
# Which words of an error, in either language, belong to which field, the surer ones first.
_MENDS = (
    ("project.height", r"\bheight =|heights? (?:are|is|of the kind)|\bheight\b.*(?:filled in|ellipsoidal)"),
    ("project.height", r"altitudes (?:são|do tipo)|\bheight\b.*por preencher"),
    ("project.crs", r"\bcrs\b|\bgrid\b|fetch-grids|\bzone\b|coordinate system|reference system|EPSG"),
    ("project.crs", r"\bgrade\b|\bfuso\b|sistema de coordenadas"),
    ("rig.camera_to_antenna_m", r"camera_to_antenna"),
    ("images.position_sigma_m", r"position_sigma_m"),
    ("flight.base_position", r"base_position|base station"),
    ("points", r"control point|check point|pontos? de (?:apoio|verificação)|\bcontrol\b|\[control\]"),
    ("certificate.particulars", r"particulars"),
)


def field_of(error: str) -> str:
    """Field that an error speaks of; empty where it is none of the form."""
    return next((key for key, words in _MENDS if re.search(words, error)), "")


def with_field(error: str, language: str = "en") -> dict[str, str] | None:
    """Give an error in a language, with the field that it speaks of; None without an error."""
    return {"text": catalogue(language).refused(error), "field": field_of(error)} if error else None


def shown(path: Path, language: str = "en") -> dict[str, Any]:
    """Fields of a project file with their values and comments, and what is wrong with it, in a language."""
    document = toml_document(path)
    problem = ""
    try:
        _check(tomlkit.dumps(document), path)
    except (ConfigurationError, InputNotFoundError) as refusal:
        problem = str(refusal).removeprefix(f"{path}: ")
    return {
        "fields": [*_fields(document)],
        "problem": with_field(problem, language),
        "text": tomlkit.dumps(document),
    }


def _fields(document: Any) -> Iterator[dict[str, Any]]:
    for name, (kind, choices) in FIELDS.items():
        section, key = name.split(".")
        if section not in document and section != "certificate":
            continue
        item = document.get(section, {}).get(key)
        value = None if item is None else item.unwrap() if hasattr(item, "unwrap") else item
        comment = "" if item is None or not hasattr(item, "trivia") else item.trivia.comment.lstrip("# ")
        yield {
            "key": name,
            "kind": kind,
            "choices": list(choices),
            "value": "" if value == ASKED else value,
            "asked": value == ASKED,
            "comment": comment,
        }


def put(path: Path, key: str, value: Any) -> None:
    """Set one key, or remove it (None); comments stay, and an impossible value is not written.

    raises ConfigurationError: for a key that is none of the form, and for an impossible value.
    """
    if key not in FIELDS and key != "certificate.particulars":
        raise ConfigurationError(f"{key} is not a field of the form", "edit the file", where=path)
    document, (section, name) = toml_document(path), key.split(".")
    if section not in document:
        document[section] = tomlkit.table()
    table: Any = document[section]
    if value is None or value == "":
        table.pop(name, None)
    elif name in table:
        table[name] = value
    else:
        table.append(name, value)
    _with_local(table, name, value)
    text = tomlkit.dumps(document)
    _refuse(text, path, name)
    write_file(path, text)


def _with_local(table: Any, name: str, value: Any) -> None:
    """A local system has local heights, and no other: one answer is enough."""
    pair = {"crs": "height", "height": "crs"}.get(name)
    if pair is not None and ("local" in (value, table.get(pair)) and value != table.get(pair)):
        table[pair] = "local" if value == "local" else ASKED


def _refuse(text: str, path: Path, name: str) -> None:
    """Complain of the value that was given, not of what others still lack."""
    if name == "crs":
        _refuse_system(tomlkit.parse(text)["project"].get("crs"), path)
    try:
        _check(_answered(text), path)
    except ConfigurationError as refusal:
        if re.search(rf"\b{name}\b", refusal.what):
            raise


def _answered(text: str) -> str:
    """The same file with something possible where an answer is still asked: it hides no other mistake."""
    document: Any = tomlkit.parse(text)
    project, rig = document.get("project", {}), document.get("rig", {})
    local = "local" in (project.get("crs"), project.get("height"))
    possible = {"crs": "local" if local else "EPSG:4326", "height": "local" if local else "ellipsoidal"}
    for table, answers in ((project, possible), (rig, {"camera_to_antenna_m": [0.0, 0.0, 0.0]})):
        for key, value in answers.items():
            if table.get(key) == ASKED:
                table[key] = value
    return tomlkit.dumps(document)


def _refuse_system(crs: Any, path: Path) -> None:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    # That it is missing is said of every field alike.
    if crs in (None, "local", ASKED):
        return
    try:
        CRS.from_user_input(str(crs))
    except CRSError as refusal:
        raise ConfigurationError(
            f"crs = {str(crs)!r} is not a known system", "search it by name or country", where=path
        ) from refusal


def _check(text: str, path: Path) -> None:
    checked_tables(parse_toml(text), Contents, path, {"folder": path.parent})


def put_role(path: Path, point: str, role: str) -> None:
    """Make a point of a table of control a control or a check point; all else in it stays.

    raises ConfigurationError: for an unknown role. raises InputNotFoundError: for an unknown point.
    """
    if role not in ROLES[:2]:
        raise ConfigurationError(f"{role!r} is not a role", f"take {ROLES[0]} or {ROLES[1]}", where=path)
    text = path.read_text(encoding="utf-8-sig")
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or not {"point", "role"} <= set(rows[0]):
        raise InputMalformedError("has no columns point and role", "add them", where=path)
    name, kind = rows[0].index("point"), rows[0].index("role")
    found = [row for row in rows[1:] if len(row) == len(rows[0]) and row[name] == point]
    if not found:
        raise InputNotFoundError(f"has no point {point}", "choose one of the list", where=path)
    for row in found:
        row[kind] = role
    write_file(path, rows_text(rows[0], rows[1:]))
