"""What a calibration laboratory states (ISO/IEC 17025:2017, 7.8; GUM); what nobody gave is said to be so."""

from __future__ import annotations

import math

from photocal.findings.catalogue import Catalogue
from photocal.findings.digits import decimals_of, fixed, measured, significant
from photocal.report.camera_sections import critical_t
from photocal.report.certificate_metadata import Metadata, Source
from photocal.report.document import Column, KeyValues, Paragraph, Section, Table, columns
from photocal.report.stored_analysis import Run

# Contributions that a person may enter, in the order of the budget; type B.
ENTERED: tuple[Source, ...] = ("control", "datum", "temperature", "refocus", "model")


def laboratory(title: str, particulars: Metadata, number: str, say: Catalogue) -> Section:
    """List what clause 7.8 asks of a certificate, item by item."""
    missing = say("laboratory.not_stated")
    lab, conditions, given = particulars.laboratory, particulars.conditions, particulars.camera
    camera = " ".join(part for part in (given.manufacturer, given.model, given.serial) if part)
    lens = " ".join(part for part in (given.lens_type, given.lens_serial) if part)
    values = {
        "laboratory": ", ".join(part for part in (lab.name, lab.address) if part),
        "place": lab.place_of_work or particulars.document.place,
        "number": number,
        "customer": ", ".join(part for part in (particulars.document.client, lab.client_contact) if part),
        "item": camera,
        "lens": lens,
        "state": conditions.state,
        "received": say.date(lab.received) if lab.received else "",
        "measured": say.date(lab.measured) if lab.measured else "",
        "issued": say.date(particulars.date),
        "temperature": _with_unit(conditions.temperature_c, "°C", say),
        "focus": conditions.focus,
        "aperture": conditions.aperture,
        "stabilisation": conditions.stabilisation,
        "firmware": conditions.firmware,
        "correction": conditions.in_camera_correction,
        "traceability": lab.traceability,
        "deviations": lab.deviations,
        "external": lab.external,
        "decision_rule": lab.decision_rule or say("laboratory.rule"),
        "authorised": particulars.responsible.name,
    }
    rows = tuple((say(f"laboratory.{key}"), value or missing) for key, value in values.items())
    notes = Paragraph(f"{say('laboratory.relates_only')} {say('laboratory.reproduction')}")
    return Section(title, (KeyValues(rows), notes))


def _with_unit(value: float | None, unit: str, say: Catalogue) -> str:
    return "" if value is None else f"{significant(value, 3, say.mark)} {unit}"


def uncertainty(title: str, run: Run, particulars: Metadata, say: Catalogue) -> Section:
    """Give the budget of each principal distance and its expanded uncertainty.

    Notes
    -----
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


def _budget(camera_id: str, run: Run, particulars: Metadata, say: Catalogue) -> Table:
    result, camera = run.result, run.result.cameras[camera_id]
    stated, whose = run.stated(camera_id)
    own = max(math.sqrt(max(result.sigma0_squared or 1.0, 1.0)) * camera.sigma_of("c"), stated)
    factor = own / camera.sigma_of("c") if camera.sigma_of("c") > 0.0 else 1.0
    entered = particulars.uncertainty.of_c
    # What images say together hangs on their number, not on that of the rays.
    images = max(
        int((result.images.camera == list(result.cameras).index(camera_id)).sum()) - len(camera.free), 1
    )
    parts = [(own, float(result.degrees_of_freedom if whose == "formal" else images))]
    parts += [(entered[key], math.inf) for key in ENTERED if key in entered]
    total, freedom, k = combined(parts)
    source, kind_of, share_of = columns(say, "uncertainty", "source<", "type=", "share [%]")

    def row(key: str, kind: str, u: float | None) -> tuple[str, ...]:
        if u is None:
            return say(f"uncertainty.{key}"), kind, say("laboratory.not_stated"), ""
        share = 100.0 * u**2 / total**2 if total > 0.0 else 0.0
        return say(f"uncertainty.{key}"), kind, significant(u, 2, say.mark), fixed(share, 1, say.mark)

    rows = [row("adjustment", "A", own), *(row(key, "B", entered.get(key)) for key in ENTERED)]
    rows.append(row("combined", "", total))
    c = measured(camera.value("c"), k * total, say.mark)
    note = say(
        "uncertainty.note",
        c=c.value,
        u=c.sigma,
        unit=camera.unit,
        k=fixed(k, 2, say.mark),
        nu=f"{math.floor(freedom)}" if math.isfinite(freedom) else "∞",
        factor=fixed(factor, max(decimals_of(factor), 2), say.mark),
    )
    heads = (source, kind_of, Column("u", camera.unit), share_of)
    return Table(say("uncertainty.table", camera=camera_id), heads, tuple(rows), note)
