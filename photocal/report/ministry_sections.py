"""Sections of a certificate that the ministry's report and a client's file ask for."""

from __future__ import annotations

from photocal.findings.catalogue import Catalogue
from photocal.findings.digits import as_given, significant
from photocal.findings.finding import Finding
from photocal.findings.texts import finding_text
from photocal.report.certificate_metadata import Metadata
from photocal.report.derived_figures import DerivedFigures, Limit, verdict
from photocal.report.document import (
    Column,
    KeyValues,
    Paragraph,
    Piece,
    Section,
    Signature,
    Statement,
    Table,
    Tone,
    columns,
)
from photocal.report.ministry_rows import Context, corners, entries, read_layout

TONES: dict[str, Tone] = {"acceptable": "good", "new_calibration": "bad", "not_determined": "note"}


def acceptance(title: str, facts: DerivedFigures, final: Finding, say: Catalogue) -> Section:
    """Set the figures against the ministry's limits."""
    heads = columns(say, "acceptance", "quantity<", "value", "limit", "unit<", "met=")
    rows = tuple(_limit_row(limit, say) for limit in facts.limits)
    note = say("acceptance.note", dz=_centimetres(facts.dz_cm, say), gsd=_centimetres(facts.gsd_cm, say))
    return Section(
        title, (acceptance_statement(facts, final, say), Table(say("acceptance.table"), heads, rows, note))
    )


def acceptance_statement(facts: DerivedFigures, final: Finding, say: Catalogue) -> Statement:
    """Say whether the ministry's limits are kept; that is green only where the verdict is."""
    found = verdict(facts.limits)
    missing = [say(f"acceptance.{limit.key}") for limit in facts.limits if limit.met is None]
    text = say(f"acceptance.{found}_text", missing=", ".join(missing) or say("word.none"))
    if found == "acceptable" and final.severity != "passed":
        text += say("acceptance.withheld" if final.severity == "grave" else "acceptance.reserved")
        return Statement("note", say(f"acceptance.{found}"), text)
    return Statement(TONES[found], say(f"acceptance.{found}"), text)


def _limit_row(limit: Limit, say: Catalogue) -> tuple[str, ...]:
    met = {True: say("word.yes"), False: say("word.no"), None: say("ministry.not_determined")}[limit.met]
    return (
        say(f"acceptance.{limit.key}"),
        _maybe(limit.value, say),
        _maybe(limit.limit, say),
        limit.unit,
        met,
    )


def _maybe(value: float | None, say: Catalogue) -> str:
    return significant(value, 4, say.mark) if value is not None else say("ministry.not_determined")


def _centimetres(value: float | None, say: Catalogue) -> str:
    return _maybe(value, say) if value is None else f"{_maybe(value, say)} cm"


def findings(title: str, found: tuple[Finding, ...], say: Catalogue) -> Section:
    """List what the plausibility checks found."""
    text = Paragraph(say("plausibility.text"))
    if not found:
        return Section(title, (text, Paragraph(say("plausibility.none"))))
    heads = columns(say, "plausibility", "severity<", "finding<")
    rows = tuple((say(f"plausibility.{f.severity}"), finding_text(f, say)) for f in found)
    return Section(title, (text, Table(say("plausibility.table"), heads, rows, widths=(0.16, 0.84))))


def equipment(title: str, particulars: Metadata, say: Catalogue) -> Section:
    """List the positioning system and its offsets, the equipment and the validity."""
    missing = say("ministry.not_determined")
    validity, system = particulars.validity, particulars.gnss_ins
    until = say.date(validity.until) if validity.until else missing
    rows = (
        (say("equipment.receiver"), system.receiver or missing),
        (say("equipment.valid_until"), until),
        (say("equipment.conditions"), validity.conditions or missing),
    )
    pieces: list[Piece] = [KeyValues(rows), _offsets(particulars, say)]
    if particulars.equipment:
        keys = ("name", "manufacturer", "serial", "use", "calibration")
        heads = columns(say, "equipment", *(f"{key}<" for key in keys))
        listed = tuple(tuple(getattr(item, key) or missing for key in keys) for item in particulars.equipment)
        pieces.append(Table(say("equipment.table"), heads, listed, widths=(0.2, 0.18, 0.14, 0.22, 0.26)))
    return Section(title, tuple(pieces))


def _offsets(particulars: Metadata, say: Catalogue) -> Piece:
    system, missing = particulars.gnss_ins, say("ministry.not_determined")
    if system.lever_arm_cm is None and system.boresight_deg is None:
        return KeyValues(((say("equipment.offsets"), missing),))
    axes = ("X / ω", "Y / φ", "Z / κ")
    heads = [*columns(say, "equipment", "offset<"), *map(Column, axes), *(Column(f"σ {a}") for a in axes)]
    table = (
        (say("equipment.lever_arm"), system.lever_arm_cm, system.lever_arm_sigma_cm),
        (say("equipment.boresight"), system.boresight_deg, system.boresight_sigma_deg),
    )
    rows = tuple(
        (label, *(as_given(v, say.mark) if v is not None else say("word.none") for v in _six(values, sigmas)))
        for label, values, sigmas in table
    )
    return Table(say("equipment.offsets"), tuple(heads), rows)


def _six(
    values: tuple[float, float, float] | None, sigmas: tuple[float, float, float] | None
) -> tuple[float | None, ...]:
    return (*(values or (None,) * 3), *(sigmas or (None,) * 3))


def technical_report(title: str, context: Context) -> Section:
    """Fill the ministry's form."""
    say = context.say
    heads = columns(say, "ministry", "item<", "field<", "value<", "origin<")
    rows = []
    for entry in entries(read_layout(), context):
        row = entry.row
        # Only the letters of the form name an item; "table 1" or "planimetric" say where it stands.
        letter = row.item.split()[0]
        item = f"{row.section} {letter}" if len(letter) == 1 and letter.isalpha() else row.section
        label = row.labels[say.language] + (f" [{row.unit}]" if row.unit else "")
        rows.append((item, label, entry.value, say(f"ministry.origin_{entry.origin}")))
    corner_heads = columns(say, "ministry", "corner<", "column [px]", "line [px]", "x [mm]", "y [mm]")
    return Section(
        title,
        (
            Paragraph(say("ministry.text")),
            Table(say("ministry.table"), heads, tuple(rows), widths=(0.11, 0.31, 0.44, 0.14)),
            Table(say("ministry.corner_table"), corner_heads, corners(context), say("ministry.corner_note")),
        ),
    )


def signature(title: str, particulars: Metadata, say: Catalogue) -> Section:
    """Make the place to sign."""
    responsible, place = particulars.responsible, particulars.document.place
    day = say.date(particulars.date)
    lines = (
        responsible.name or say("signature.name"),
        responsible.title or say("signature.title"),
        responsible.registration or say("signature.registration"),
    )
    where = f"{place}, {day}" if place else day
    pieces = (Paragraph(say("ministry.responsibility")), Paragraph(where), Signature(lines))
    if not responsible.key:
        return Section(title, pieces)
    return Section(title, (*pieces, Paragraph(say("signature.key", fingerprint=responsible.key))))
