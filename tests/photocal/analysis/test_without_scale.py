"""A block that nothing gives a scale: no page of its analysis has metres."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.network import Network
from photocal.analysis.left_out import Checks
from photocal.analysis.outcome import Outcome, analyse_network
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.findings.verdict import judge, verdict_text
from tests.photocal.analysis.simulated import convergent

METRES = re.compile(r"\d (m|cm|mm|µm)\b")


def analysed(network: Network) -> Outcome:
    return analyse_network(network, Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3))), 0.1, 0.8)


@pytest.fixture(scope="module")
def stretched() -> Network:
    """Photos whose y scale is wrong, which shifts c."""
    made, rng = convergent(), np.random.default_rng(3)
    plane = made.exact * [1.0, 0.998] + rng.normal(0.0, 0.3, made.exact.shape)
    return replace(made.network, rays=replace(made.network.rays, plane=plane))


def free(network: Network) -> Network:
    points = network.points
    none = replace(points, held=np.zeros_like(points.held), weight=np.zeros_like(points.weight))
    return replace(network, points=none, datum_points=np.arange(len(points.values)))


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_effects_are_shares_of_the_distance(stretched: Network, language: str) -> None:
    say = catalogue(language)
    with_control, without = analysed(stretched), analysed(free(stretched))
    pages = [
        [
            *(finding_text(one, say, plain) for one in found.findings),
            *verdict_text(judge(found.findings), say),
        ]
        for found in (with_control, without)
    ]
    assert any(METRES.search(line) for line in pages[0])
    assert not any(METRES.search(line) for line in pages[1])
    assert any("%" in line for line in pages[1])
    sizes = [one.size for one in without.findings if one.size is not None]
    assert all(size.ground_m is None for size in sizes)
    assert any(size.of_distance for size in sizes)
