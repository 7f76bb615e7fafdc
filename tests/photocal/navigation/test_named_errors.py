"""What two lists of positions show bears the names of the one table of what may be wrong."""

from __future__ import annotations

from photocal.hypotheses.faults import fault
from photocal.navigation.position_comparison import AXES, LEVER, TIME


def test_names_are_those_of_the_table() -> None:
    entries = [fault(name) for name in (TIME, LEVER, AXES)]
    assert all(entry is not None and "positions" in entry.where for entry in entries)
