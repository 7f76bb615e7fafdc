"""Sections of a certificate that the ministry's report, a laboratory's accreditation and a client ask for."""

import math
from collections.abc import Mapping
from typing import Any, get_args

from photocal.base.arrays import picked
from photocal.findings.digits import decimals_of
from photocal.findings.document import (
    Column,
    KeyValues,
    Paragraph,
    Piece,
    Section,
    Signature,
    Statement,
    TablePart,
    Tone,
    said_table,
)
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, finding_text
from photocal.planning.flown_output import flown_section
from photocal.report.camera_sections import critical_t
from photocal.report.certificate_metadata import ConditionKeys, FlownCount, Metadata, Source
from photocal.report.derived_figures import DerivedFigures, verdict
from photocal.report.ministry_rows import Context, corners, entries, read_layout
from photocal.report.stored_analysis import AnalysedRun

# Contributions that a person may enter, in the order of the budget; type B.
ENTERED: tuple[Source, ...] = ("control", "datum", "temperature", "refocus", "model")
TONES: dict[str, Tone] = {"acceptable": "good", "new_calibration": "bad", "not_determined": "note"}


def laboratory(title: str, particulars: Metadata, number: str, say: Catalogue) -> Section:
    """List what clause 7.8 asks of a certificate, item by item."""
    lab, conditions, given = particulars.laboratory, particulars.conditions, particulars.camera
    air = {
        "temperature": (conditions.temperature_c, "°C"),
        "humidity": (conditions.relative_humidity_percent, "%"),
        "pressure": (conditions.pressure_hpa, "hPa"),
    }
    values = {
        "laboratory": ", ".join(part for part in (lab.name, lab.address) if part),
        "place": lab.place_of_work or particulars.document.place,
        "number": number,
        "customer": ", ".join(part for part in (particulars.document.client, lab.client_contact) if part),
        "item": " ".join(part for part in (given.manufacturer, given.model, given.serial) if part),
        "lens": " ".join(part for part in (given.lens_type, given.lens_serial) if part),
        "state": conditions.state,
        "received": say.date(lab.received) if lab.received else "",
        "measured": say.date(lab.measured) if lab.measured else "",
        "issued": say.date(particulars.date),
        **{key: "" if v is None else f"{say.as_given(v)} {unit}" for key, (v, unit) in air.items()},
        **picked(conditions, "focus", "aperture", "stabilisation", "firmware"),
        "correction": conditions.in_camera_correction,
        **_told_by_pictures(conditions),
        **picked(lab, "traceability", "deviations", "external"),
        "decision_rule": lab.decision_rule or say("laboratory.rule"),
        "authorised": particulars.responsible.name,
    }
    stated = tuple((say(f"laboratory.{key}"), value) for key, value in values.items() if value)
    lacking = [say(f"laboratory.{key}") for key, value in values.items() if not value]
    unstated = [Paragraph(say("laboratory.unstated", names=", ".join(lacking)))] if lacking else []
    notes = Paragraph(f"{say('laboratory.relates_only')} {say('laboratory.reproduction')}")
    return Section(title, (KeyValues(stated), *unstated, notes))


def _told_by_pictures(conditions: ConditionKeys) -> dict[str, str]:
    """Rows that stand there when the pictures, or a person, tell them."""
    names = ("exposure", "shutter", "sensor_temperature", "lens_temperature", "positions")
    return {name: text for name in names if (text := getattr(conditions, name))}


def radiometry(title: str, particulars: Metadata, say: Catalogue) -> tuple[Section, ...]:
    """Give the radiometric annex, where anything of it was measured."""
    rows = radiometry_rows(particulars.radiometry, say)
    return (Section(title, (KeyValues(rows), Paragraph(say("radiometry.note")))),) if rows else ()


def radiometry_rows(figures: Mapping[Any, float], say: Catalogue) -> tuple[tuple[str, str], ...]:
    """Name figures of `photocal radiometry`, each with its unit."""
    units = {"deg": "°", "cycles_px": say("radiometry.cycles"), "cm": "cm"}
    rows = []
    for key, value in figures.items():
        unit = next((text for end, text in units.items() if key.endswith(end)), "")
        rows.append((say(f"radiometry.{key}"), f"{say.as_given(value)} {unit}".strip()))
    return tuple(rows)


def flown_block(title: str, particulars: Metadata, say: Catalogue) -> tuple[Section, ...]:
    """Set what was flown beside what was planned or, without a plan, stated for the campaign."""
    flown, stated, counts = particulars.flown_spread, particulars.campaign, particulars.flown
    if not flown:
        return ()
    gsd_m = None if stated.gsd_cm is None else stated.gsd_cm / 100.0
    wanted = {"height_m": stated.flying_height_m, "gsd_m": gsd_m, "forward_overlap": stated.forward_overlap}
    wanted |= dict(particulars.planned)
    counted = {name: f"{counts.get(name, math.nan):.0f}" for name in get_args(FlownCount)}
    return (flown_section(title, flown, wanted, counted, say),)


def uncertainty(title: str, run: AnalysedRun, particulars: Metadata, say: Catalogue) -> Section:
    """Give the budget of each principal distance and its expanded uncertainty.

    JCGM 100:2008, 5.1.2 (combination), G.4.1 (effective degrees of freedom, Welch and Satterthwaite), 6.2
    (expansion). The adjustment's own part is scaled by the a posteriori factor where that is above 1, or by
    what images say of each other, see `Run.stated`.
    """
    pieces = tuple(
        _budget(name, run, particulars, say)
        for name, camera in run.result.cameras.items()
        if "c" in camera.free
    )
    return Section(title, pieces or (Paragraph(say("uncertainty.none")),))


def combined(parts: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Combine standard uncertainties with their degrees of freedom: u, effective degrees, k for 95 %."""
    u = math.sqrt(sum(part**2 for part, _ in parts))
    weights = sum(part**4 / nu for part, nu in parts if math.isfinite(nu) and nu > 0.0)
    freedom = u**4 / weights if weights > 0.0 else math.inf
    return u, freedom, critical_t(math.floor(min(freedom, 1e6)))


def _budget(camera_id: str, run: AnalysedRun, particulars: Metadata, say: Catalogue) -> TablePart:
    result, camera = run.result, run.result.cameras[camera_id]
    stated, whose = run.stated(camera_id)
    adjusted_sigma = max(math.sqrt(max(result.sigma0_squared or 1.0, 1.0)) * camera.sigma_of("c"), stated)
    factor = adjusted_sigma / camera.sigma_of("c") if camera.sigma_of("c") > 0.0 else 1.0
    datum, what_of_datum, datum_is_known = _of_common_height(camera_id, run, particulars, say)
    entered: dict[Source, float] = {**particulars.uncertainty.of_c}
    if datum is not None:
        entered["datum"] = datum
    # What images say together depends on their number, not on that of the rays.
    images = max(
        int((result.images.camera == list(result.cameras).index(camera_id)).sum()) - len(camera.free), 1
    )
    parts = [(adjusted_sigma, float(result.degrees_of_freedom if whose == "formal" else images))]
    parts += [(entered[key], math.inf) for key in ENTERED if key in entered]
    total, freedom, k = combined(parts)

    def row(key: str, kind: str, u: float | None) -> tuple[str, ...]:
        """Write one contribution to the uncertainty with its share."""
        if u is None:
            return say(f"uncertainty.{key}"), kind, say("laboratory.not_stated"), ""
        share = 100.0 * u**2 / total**2 if total > 0.0 else 0.0
        return say(f"uncertainty.{key}"), kind, say.significant(u, 2), say.fixed(share, 1)

    rows = [row("adjustment", "A", adjusted_sigma), *(row(key, "B", entered.get(key)) for key in ENTERED)]
    if what_of_datum:
        at = 1 + ENTERED.index("datum")
        label, kind, u, share = rows[at]
        rows[at] = (f"{label}, {what_of_datum}", kind, "" if datum is None else u, share)
    rows.append(row("combined", "", total))
    c, u, _ = say.measured(camera.value("c"), k * total)
    note = say(
        "uncertainty.note" if datum_is_known else "uncertainty.note_open",
        c=c,
        u=u,
        unit=camera.unit,
        k=say.fixed(k, 2),
        nu=f"{math.floor(freedom)}" if math.isfinite(freedom) else "∞",
        factor=say.fixed(factor, max(decimals_of(factor), 2)),
    )
    heads = ("source<", "type=", Column("u", camera.unit), "share [%]")
    return said_table(say, "uncertainty.table", heads, rows, note, camera=camera_id)


def _of_common_height(
    camera_id: str, run: AnalysedRun, particulars: Metadata, say: Catalogue
) -> tuple[float | None, str, bool]:
    """What an error that all GNSS heights share does to c.

    returns: its standard uncertainty, in the unit of the camera, None without one, or where somebody states
        it; what it is, beside the source; and whether nothing of it is unknown: no residual shows such an
        error, so that without it no probability may be claimed.
    """
    placed = any(group.name in ("position", "exposure") for group in run.result.groups)
    if not placed or "datum" in particulars.uncertainty.of_c:
        return None, "", True
    by_height = run.analysis.c_by_height if run.analysis else {}
    if camera_id not in by_height:
        return None, "", False
    per_metre, common = by_height[camera_id], particulars.uncertainty.common_height_m
    if per_metre is None:
        return None, say("uncertainty.in_adjustment"), True
    centimetres = say.as_given(round(100.0 * common, 3))
    return abs(per_metre) * common, say("uncertainty.common_height", cm=centimetres), True


def acceptance(title: str, facts: DerivedFigures, final: Finding, say: Catalogue) -> Section:
    """Set the figures against the ministry's limits."""
    heads = ("quantity<", "value", "limit", "unit<", "met=")
    met = {True: say("word.yes"), False: say("word.no"), None: say("ministry.not_determined")}
    rows = (
        (
            say(f"acceptance.{limit.key}"),
            *(_maybe(value, say) for value in (limit.value, limit.limit)),
            limit.unit,
            met[limit.met],
        )
        for limit in facts.limits
    )
    note = say("acceptance.note", dz=_centimetres(facts.dz_cm, say), gsd=_centimetres(facts.gsd_cm, say))
    table = said_table(say, "acceptance.table", heads, rows, note)
    return Section(title, (acceptance_statement(facts, final, say), table))


def acceptance_statement(facts: DerivedFigures, final: Finding, say: Catalogue) -> Statement:
    """Say whether the ministry's limits are kept; that is green only where the verdict is."""
    outcome = verdict(facts.limits)
    missing = [say(f"acceptance.{limit.key}") for limit in facts.limits if limit.met is None]
    text = say(f"acceptance.{outcome}_text", missing=", ".join(missing) or say("word.none"))
    if outcome == "acceptable" and final.severity != "passed":
        text += say("acceptance.withheld" if final.severity == "grave" else "acceptance.reserved")
        return Statement("note", say(f"acceptance.{outcome}"), text)
    return Statement(TONES[outcome], say(f"acceptance.{outcome}"), text)


def _maybe(value: float | None, say: Catalogue) -> str:
    return say.significant(value, 4) if value is not None else say("ministry.not_determined")


def _centimetres(value: float | None, say: Catalogue) -> str:
    return _maybe(value, say) if value is None else f"{_maybe(value, say)} cm"


def findings(title: str, plausibility: tuple[Finding, ...], say: Catalogue) -> Section:
    """List what the plausibility checks found."""
    text = Paragraph(say("plausibility.text"))
    if not plausibility:
        return Section(title, (text, Paragraph(say("plausibility.none"))))
    rows = ((say(f"plausibility.{f.severity}"), finding_text(f, say)) for f in plausibility)
    heads = ("severity<", "finding<")
    return Section(title, (text, said_table(say, "plausibility.table", heads, rows, widths=(0.16, 0.84))))


def equipment(title: str, particulars: Metadata, say: Catalogue) -> tuple[Section, ...]:
    """List the positioning system and its offsets, the equipment and the validity.

    Nothing of it is listed where nothing was stated, unless the ministry's form asks for it.
    """
    missing = say("ministry.not_determined")
    validity, system = particulars.validity, particulars.gnss_ins
    until = say.date(validity.until) if validity.until else ""
    values = {"receiver": system.receiver, "valid_until": until, "conditions": validity.conditions}
    offsets = system.lever_arm_cm is not None or system.boresight_deg is not None
    asked = bool(particulars.document.form)
    if not (asked or offsets or particulars.equipment or any(values.values())):
        return ()
    rows = tuple(
        (say(f"equipment.{key}"), value or missing) for key, value in values.items() if value or asked
    )
    pieces: list[Piece] = [KeyValues(rows)] if rows else []
    pieces += [_offsets(particulars, say)] if offsets or asked else []
    if particulars.equipment:
        keys = ("name", "manufacturer", "serial", "use", "calibration")
        listed = ([getattr(item, key) or missing for key in keys] for item in particulars.equipment)
        heads, widths = [f"{key}<" for key in keys], (0.2, 0.18, 0.14, 0.22, 0.26)
        pieces.append(said_table(say, "equipment.table", heads, listed, widths=widths))
    return (Section(title, tuple(pieces)),)


def _offsets(particulars: Metadata, say: Catalogue) -> Piece:
    system, missing = particulars.gnss_ins, say("ministry.not_determined")
    if system.lever_arm_cm is None and system.boresight_deg is None:
        return KeyValues(((say("equipment.offsets"), missing),))
    axes = ("X / ω", "Y / φ", "Z / κ")
    heads: tuple[str | Column, ...] = ("offset<", *map(Column, axes), *(Column(f"σ {a}") for a in axes))
    none = (None,) * 3
    table = {
        "lever_arm": (*(system.lever_arm_cm or none), *(system.lever_arm_sigma_cm or none)),
        "boresight": (*(system.boresight_deg or none), *(system.boresight_sigma_deg or none)),
    }
    rows = (
        (say(f"equipment.{key}"), *(say("word.none") if v is None else say.as_given(v) for v in values))
        for key, values in table.items()
    )
    return said_table(say, "equipment.offsets", heads, rows)


def technical_report(title: str, context: Context) -> Section:
    """Fill the ministry's form."""
    say = context.say
    rows = []
    for row in entries(read_layout(), context):
        # Only the letters of the form name an item; "table 1" or "planimetric" say where it stands.
        letter = row["item"].split()[0]
        item = f"{row['section']} {letter}" if len(letter) == 1 and letter.isalpha() else row["section"]
        label = row[say.language] + (f" [{row['unit']}]" if row["unit"] else "")
        rows.append((item, label, row["value"], say(f"ministry.origin_{row['origin']}")))
    heads, widths = ("item<", "field<", "value<", "origin<"), (0.11, 0.31, 0.44, 0.14)
    table = said_table(say, "ministry.table", heads, rows, widths=widths)
    heads_of_corners = ("corner<", "column [px]", "line [px]", "x [mm]", "y [mm]")
    note = say("ministry.corner_note")
    of_corners = said_table(say, "ministry.corner_table", heads_of_corners, corners(context), note)
    return Section(title, (Paragraph(say("ministry.text")), table, of_corners))


def signature(title: str, particulars: Metadata, say: Catalogue) -> Section:
    """Make the place to sign."""
    responsible, place = particulars.responsible, particulars.document.place
    day = say.date(particulars.date)
    lines = tuple(
        getattr(responsible, key) or say(f"signature.{key}") for key in ("name", "title", "registration")
    )
    where = f"{place}, {day}" if place else day
    pieces = (Paragraph(say("ministry.responsibility")), Paragraph(where), Signature(lines))
    if not responsible.key:
        return Section(title, pieces)
    return Section(title, (*pieces, Paragraph(say("signature.key", fingerprint=responsible.key))))
