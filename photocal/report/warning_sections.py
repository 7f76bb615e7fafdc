"""What the processing before the adjustment found: a fault may not pass silently into a certificate."""

from __future__ import annotations

from photocal.findings.catalogue import Catalogue
from photocal.findings.finding import Finding
from photocal.findings.texts import finding_text
from photocal.report.document import Column, Section, Statement, Table


def warned(findings: tuple[Finding, ...], say: Catalogue) -> list[Statement]:
    """Say at the head of a document that there are warnings; nothing where there are none."""
    warnings = [one for one in findings if one.severity != "note"]
    if not warnings:
        return []
    text = say("warnings.verdict", count=len(warnings), first=finding_text(warnings[0], say))
    return [Statement("bad", say("warnings.title"), text)]


def warning_sections(findings: tuple[Finding, ...], say: Catalogue) -> list[Section]:
    """List warnings and notes."""
    tables = []
    for kind in ("warning", "note"):
        texts = [finding_text(one, say) for one in findings if (one.severity == "note") == (kind == "note")]
        columns = (Column("", align="right"), Column(say(f"warnings.{kind}"), align="left"))
        rows = tuple((str(n), text) for n, text in enumerate(texts, start=1))
        if rows:
            tables.append(Table(say(f"warnings.table_{kind}"), columns, rows, widths=(0.06, 0.94)))
    return [Section(say("warnings.section"), tuple(tables))] if tables else []
