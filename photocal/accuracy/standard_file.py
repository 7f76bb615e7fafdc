"""Accuracy standards: how they are found and read."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Literal

from pydantic import Field

from acquire.checked_toml import Table, checked_tables, parse_toml
from drivers.errors import ConfigurationError, InputNotFoundError
from photocal.accuracy.standard import (
    Basis,
    ClassLimit,
    Component,
    Figure,
    LimitTable,
    PublishedLimit,
    ScaleStandard,
    Standard,
    ValueStandard,
)

SHIPPED = ("decree-89817", "pec-pcd", "asprs-2024")


class _TableFile(Table):
    product: str
    component: Component
    basis: Basis
    pec: dict[str, float | str]
    ep: dict[str, float | str]
    source: str
    source_note: str = ""
    second_hand: bool
    published: list[tuple[str, float, float, float, float]] = Field(default=[])


class _ScaleFile(Table):
    id: str
    kind: Literal["scale"]
    title: str
    authority: str
    fraction_within_pec: float
    note: str = ""
    table: list[_TableFile]


class _FigureFile(Table):
    value: float
    source: str
    source_note: str = ""
    second_hand: bool


class _ValueFile(Table):
    id: str
    kind: Literal["value"]
    title: str
    authority: str
    note: str = ""
    minimum_points: _FigureFile
    maximum_points: _FigureFile
    survey_accuracy_included: _FigureFile
    mean_share_of_target: _FigureFile
    survey_share_of_target: _FigureFile
    blunder_over_target: _FigureFile


def load_standard(name: str) -> Standard:
    """Find and read a standard.

    name: name of a shipped standard (`decree-89817`, `pec-pcd`, `asprs-2024`), or the path of a TOML file of
        the same form.
    raises InputNotFoundError: when there is neither a shipped standard nor a file of that name.
    raises ConfigurationError: when the file has not the form of a standard.
    """
    if name in SHIPPED:
        shipped = resources.files("photocal.accuracy.standards") / f"{name}.toml"
        return parse_standard(shipped.read_text(encoding="utf-8"), name)
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        raise InputNotFoundError(
            f"unknown standard {name!r}", remedy=f"take {', '.join(SHIPPED)}, or the path of a TOML file"
        )
    try:
        return parse_standard(path.read_text(encoding="utf-8"), name)
    except UnicodeDecodeError as refusal:
        raise ConfigurationError("is not UTF-8 text", where=name) from refusal


def parse_standard(text: str, where: str) -> Standard:
    """Read a standard from the text of its TOML file."""
    try:
        content = parse_toml(text)
        if content.get("kind") == "value":
            return _value_standard(checked_tables(content, _ValueFile, where))
        return _scale_standard(checked_tables(content, _ScaleFile, where))
    except tomllib.TOMLDecodeError as refusal:
        raise ConfigurationError(f"is not TOML ({refusal})", where=where) from refusal
    except (ValueError, ZeroDivisionError) as refusal:
        raise ConfigurationError(f"a limit is not a number ({refusal})", where=where) from refusal


def _scale_standard(content: _ScaleFile) -> ScaleStandard:
    return ScaleStandard(
        content.id,
        content.title,
        content.fraction_within_pec,
        tuple(_table(table) for table in content.table),
        " ".join(content.note.split()),
    )


def _table(table: _TableFile) -> LimitTable:
    # Millimetres at map scale become metres on the ground at a denominator of 1.
    factor = Fraction(1, 1000) if table.basis == "scale" else Fraction(1)
    if list(table.pec) != list(table.ep):
        raise ValueError(f"pec and ep of {table.product!r} have not the same classes")
    units = tuple(
        ClassLimit(name, _metres(table.pec[name], factor), _metres(table.ep[name], factor))
        for name in table.pec
    )
    published = tuple(
        PublishedLimit(scale, interval, ClassLimit(name, pec, ep))
        for name, scale, interval, pec, ep in table.published
    )
    return LimitTable(
        table.product,
        table.component,
        table.basis,
        units,
        published,
        table.source,
        table.source_note,
        table.second_hand,
    )


def _metres(value: float | str, factor: Fraction) -> float:
    # Through the printed decimals: 0.3 mm is 3/10 mm, not the nearest binary number.
    metres = float(Fraction(str(value)) * factor)
    if not metres > 0.0:
        raise ValueError(f"{value} is not positive")
    return metres


def _value_standard(content: _ValueFile) -> ValueStandard:
    def figure(entry: _FigureFile) -> Figure:
        return Figure(entry.value, entry.source, entry.source_note, entry.second_hand)

    return ValueStandard(
        content.id,
        content.title,
        figure(content.minimum_points),
        figure(content.maximum_points),
        figure(content.survey_accuracy_included),
        figure(content.mean_share_of_target),
        figure(content.survey_share_of_target),
        figure(content.blunder_over_target),
        " ".join(content.note.split()),
    )
