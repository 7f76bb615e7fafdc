"""What the processing before the adjustment told: a fault may not pass silently into a certificate."""

from __future__ import annotations

from dataclasses import dataclass

from photocal.findings.catalogue import Catalogue
from photocal.report.document import Column, Section, Statement, Table


@dataclass(frozen=True)
class ProcessingWarnings:
    """What the processing told, each a sentence.

    Attributes
    ----------
    warnings : tuple of str
        Faults: what was measured is not as it should be.
    notes : tuple of str
        Limits: what this flight cannot tell, though nothing is wrong with it.
    """

    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


NO_WARNINGS = ProcessingWarnings()


def warned(told: ProcessingWarnings, say: Catalogue) -> list[Statement]:
    """Say at the head of a document that there are warnings.

    Parameters
    ----------
    say : Catalogue
        Language.

    Returns
    -------
    list of Statement
        One, or none.
    """
    if not told.warnings:
        return []
    text = say("warnings.verdict", count=len(told.warnings), first=told.warnings[0])
    return [Statement("bad", say("warnings.title"), text)]


def warning_sections(told: ProcessingWarnings, say: Catalogue) -> list[Section]:
    """List warnings and notes."""
    kinds = (("warning", told.warnings), ("note", told.notes))
    tables = []
    for kind, texts in kinds:
        columns = (Column("", align="right"), Column(say(f"warnings.{kind}"), align="left"))
        rows = tuple((str(n), text) for n, text in enumerate(texts, start=1))
        if rows:
            tables.append(Table(say(f"warnings.table_{kind}"), columns, rows, widths=(0.06, 0.94)))
    return [Section(say("warnings.section"), tuple(tables))] if tables else []
