"""A disk that fails, hangs or is full under a running recorder: what can be written somewhere is not lost."""

from __future__ import annotations

import pytest

from tests.acquire.forgetful_disk import forbidden
from tests.evidence.failing_media import CASES, outcome_of


@pytest.fixture(scope="module", autouse=True)
def _disk() -> None:
    if reason := forbidden():
        pytest.skip(f"no disk of its own here: {reason}")


@pytest.mark.parametrize(
    "name", ["EIO for each write and flush, with a fallback", "full, room again after 12 s"]
)
def test_a_disk_with_a_fault_costs_no_frame(name: str) -> None:
    outcome = outcome_of(CASES[name], fault_s=3.0, after_s=6.0)
    assert outcome.lost == 0
    assert outcome.wrong == 0
    assert outcome.code == 0
    assert 0 <= outcome.told_s < 3.0
