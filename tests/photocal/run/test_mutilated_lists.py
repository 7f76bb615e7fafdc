"""Mutilated control lists and folders through `new` and `run --until control`: nothing is lost silently.

The study `tests/evidence/mutilated_lists.py` tries 2000; these are its first.
"""

from __future__ import annotations

from pathlib import Path

from tests.evidence.mutilated_lists import complaints, pictures, write_case

COUNT = 100
# What the study has found: UTF-16 with changed line ends (228, 507), and marks at -1e300.
FOUND = (228, 507, 679, 1852)


def test_no_row_is_lost_silently(tmp_path: Path) -> None:
    """Each list is read or named, each row used or named; what is asked or refused is one line."""
    pictures(tmp_path / "made")
    ended = []
    for seed in (*range(COUNT), *FOUND):
        case = write_case(tmp_path / str(seed), tmp_path / "made", seed)
        wrong, new, run = complaints(tmp_path / str(seed), case)
        assert wrong == [], (seed, case.folder)
        ended.append((new, run))
    # Most of them come as far as the pictures.
    assert sum(run.startswith("passed") for _, run in ended) > COUNT / 2
