"""Attacks on the pages, links that come and go, bad casters and clocks that are set cost the log nothing."""

from __future__ import annotations

import pytest

from tests.evidence.long_day import SETTINGS, day
from tests.evidence.neighbours import heard_under


@pytest.mark.parametrize("attack", ["half_open", "websocket_flood"])
def test_an_attack_on_the_pages_costs_the_recording_nothing(attack: str) -> None:
    assert heard_under(attack, 4.0).lost == 0


def test_links_that_come_and_go_bad_casters_and_clocks_that_are_set_cost_nothing() -> None:
    """A long day in seconds; of the clock each setting is told."""
    seen = day(12.0)
    assert (seen.lost, seen.flapped_lost, seen.code) == (0, 0, 0)
    assert (seen.jumps, seen.flapped > 20) == (len(SETTINGS), True)
    assert max(seen.descriptors[4:]) <= max(seen.descriptors[:4]) + 3
