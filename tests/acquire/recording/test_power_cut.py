"""A cut of the power costs no more than a second, and the logs open as they are."""

from __future__ import annotations

import pytest

from tests.acquire.forgetful_disk import forbidden
from tests.evidence.power_cut import cuts_of_recording


@pytest.fixture(scope="module", autouse=True)
def _disk() -> None:
    if reason := forbidden():
        pytest.skip(f"no disk of its own here: {reason}")


def test_a_power_cut_costs_a_second_at_most() -> None:
    """Any part, in any order, of what was not flushed may be missing; names of files are on the disk, too."""
    cuts = cuts_of_recording(7, "ext4", 6)
    assert max(cut.lost_s for cut in cuts) <= 1.0
    assert sum(cut.missing for cut in cuts) == 0
    assert sum(cut.wrong for cut in cuts) == 0
    assert cuts[-1].kept > 100
