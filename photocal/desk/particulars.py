"""What only people know of a certificate, as a form: its fields, their values, and the file they stand in."""

import datetime as dt
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from photocal.base.errors import ConfigurationError
from photocal.base.files import output_file
from photocal.report.certificate_metadata import Metadata, read_particulars

NAME = "particulars.toml"
# Sections and keys of the form, in its order; the file may have more, which stay.
FORM = {
    "document": ("place", "comments"),
    "camera": ("model", "manufacturer", "serial", "lens_type", "lens_serial"),
    "campaign": ("method", "test_field", "platform"),
    "conditions": (
        *("temperature_c", "relative_humidity_percent", "pressure_hpa", "focus", "aperture"),
        *("stabilisation", "firmware", "in_camera_correction", "state"),
    ),
    "validity": ("until", "conditions"),
    "responsible": ("name", "title", "registration"),
    "laboratory": ("name", "address", "traceability"),
}
_NUMBERS = ("temperature_c", "relative_humidity_percent", "pressure_hpa")
_DAYS = ("until",)


def fields(path: Path | None, told: Mapping[str, Mapping[str, str | float]]) -> list[dict[str, Any]]:
    """Every field with what was typed, and with what the pictures say where nothing was."""
    typed = _tables(path)
    return [
        {
            "key": f"{section}.{key}",
            "section": section,
            "kind": "number" if key in _NUMBERS else "date" if key in _DAYS else "text",
            "value": _shown(typed.get(section, {}).get(key)),
            "told": _shown(told.get(section, {}).get(key)),
        }
        for section, keys in FORM.items()
        for key in keys
    ]


def _shown(value: Any) -> str:
    return "" if value is None else str(value)


def _tables(path: Path | None) -> dict[str, Any]:
    if path is None or not path.is_file():
        return {}
    unwrapped: dict[str, Any] = tomlkit.parse(path.read_text(encoding="utf-8-sig")).unwrap()
    return unwrapped


def written(path: Path | None, given: Mapping[str, str]) -> str:
    """Text of the file with the values of the form: empty ones are taken out, all others and comments stay.

    raises ConfigurationError: for a key that is none of the form, and for what is no number or no day.
    """
    there = path is not None and path.is_file()
    document = tomlkit.parse(path.read_text(encoding="utf-8-sig")) if there and path else tomlkit.document()
    for name, text in given.items():
        section, _, key = name.partition(".")
        if key not in FORM.get(section, ()):
            raise ConfigurationError(f"{name} is no particular of the form", "use the page")
        if section not in document:
            if not text.strip():
                continue
            document[section] = tomlkit.table()
        table: Any = document[section]
        if not text.strip():
            table.pop(key, None)
        else:
            table[key] = _value(name, key, text.strip())
    return tomlkit.dumps(document)


def _value(name: str, key: str, text: str) -> Any:
    try:
        if key in _NUMBERS:
            return float(text.replace(",", "."))
        if key in _DAYS:
            return dt.date.fromisoformat(text)
    except ValueError:
        form = "a number" if key in _NUMBERS else "a day, such as 2027-05-31"
        raise ConfigurationError(f"{name} = {text!r} is not {form}", "correct it") from None
    return text


def write(path: Path, text: str, day: dt.date) -> None:
    """Write the file, when the whole of it can be read; raises ConfigurationError otherwise."""
    with output_file(path) as aside:
        aside.write_text(text, encoding="utf-8", newline="\n")
        read(aside, day)


def read(path: Path, day: dt.date, **more: Any) -> Metadata:
    """Read it as a certificate does."""
    return read_particulars(path, day, **more)
