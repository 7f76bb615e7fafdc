"""Images taken out of a network take their positions and attitudes with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import without_images
from photocal.adjustment.state import start_state
from photocal.block.folder import read_block
from photocal.block.network import assemble
from tests.photocal.analysis.georeferencing.flights import Plan, fly


def test_positions_and_attitudes_go_with_their_images(tmp_path: Path) -> None:
    network = assemble(
        read_block(fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(tie=50)))
    ).network
    out = np.zeros(len(network.image_names), dtype=np.bool_)
    out[[0, 5]] = True
    smaller, _ = without_images(network, start_state(network), out)
    for before, after in ((network.positions, smaller.positions), (network.attitudes, smaller.attitudes)):
        assert len(after.image) == len(before.image) - 2
        names = [smaller.image_names[i] for i in after.image]
        assert names == [network.image_names[i] for i in before.image if not out[i]]
        np.testing.assert_array_equal(after.covariance, before.covariance[~out[before.image]])
    assert adjust(smaller).degrees_of_freedom < adjust(network).degrees_of_freedom
