"""Warnings of the processing before the adjustment: a fault may not pass silently into a certificate."""

from __future__ import annotations

from photocal.report.catalogue import Catalogue
from photocal.report.document import Column, Section, Statement, Table


def warned(warnings: tuple[str, ...], say: Catalogue) -> list[Statement]:
    """Say at the head of a document that there are warnings.

    Parameters
    ----------
    warnings : tuple of str
        Each a sentence.
    say : Catalogue
        Language.

    Returns
    -------
    list of Statement
        One, or none.
    """
    if not warnings:
        return []
    text = say("warnings.verdict", count=len(warnings), first=warnings[0])
    return [Statement("bad", say("warnings.title"), text)]


def warning_sections(warnings: tuple[str, ...], say: Catalogue) -> list[Section]:
    """List the warnings.

    Parameters
    ----------
    warnings : tuple of str
        Each a sentence.
    say : Catalogue
        Language.

    Returns
    -------
    list of Section
        One, or none.
    """
    if not warnings:
        return []
    columns = (Column("", align="right"), Column(say("warnings.warning"), align="left"))
    rows = tuple((str(n), text) for n, text in enumerate(warnings, start=1))
    table = Table(say("warnings.table"), columns, rows, widths=(0.06, 0.94))
    return [Section(say("warnings.section"), (table,))]
