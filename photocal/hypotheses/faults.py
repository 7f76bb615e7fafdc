"""All faults that are looked for: those of the table, and those that installed packages bring.

They stand apart from the table: a package that brings a fault imports the table before its own is known.
"""

from photocal.base.extensions import HYPOTHESES, brought
from photocal.hypotheses.table import OWN, AddedFault, Fault

FAULTS = (*OWN, *(added.fault for added in brought(HYPOTHESES, AddedFault).values()))


def searched(code: str, table: tuple[Fault, ...] = FAULTS) -> bool:
    """Whether the search judges a fault itself, rather than another stage."""
    entry = fault(code, table)
    return entry is not None and (bool(entry.frees) or entry.each != "block" or bool(entry.kind_of))


def fault(code: str, table: tuple[Fault, ...] = FAULTS) -> Fault | None:
    """Give the entry of a code; None for a finding that is no fault of the table."""
    return next((entry for entry in table if entry.code == code), None)
