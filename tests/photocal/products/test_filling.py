"""Partial volumes and the filling table: closed forms, the whole, and the sigma by simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.base.errors import ConfigurationError
from photocal.commands.cli import app
from photocal.products.sections import Tank, measure_tank, read_ring_points
from photocal.products.volume import filling_table, partial_volumes

SECTIONS = Path(__file__).parents[3] / "configs/studies/tank/sections.csv"


@pytest.fixture(scope="module")
def tank() -> Tank:
    return measure_tank(read_ring_points(SECTIONS, "Z", 0.0141421))


def test_parts_and_table_end_at_the_whole(tank: Tank) -> None:
    assert tank.between is not None
    parts, table = partial_volumes(tank), filling_table(tank, 2.0)
    assert sum(part["volume_m3"] for part in parts) == pytest.approx(tank.between["volume_m3"], rel=1e-12)
    assert [level["to_m"] for level in table] == pytest.approx([2.0, 4.0, 6.0, 8.0, 9.5])
    assert table[-1]["volume_m3"] == pytest.approx(tank.between["volume_m3"], rel=1e-9)
    # Held at its level, the top ring's own height is no part of what is filled: less than of the whole.
    assert 0.2 < table[-1]["sigma_m3"] / tank.between["sigma_m3"] < 1.01
    assert table[0]["volume_m3"] == pytest.approx(np.pi * 6.4776**2 * 2.0, rel=1e-4)


def test_sigma_of_a_level_by_simulation(tank: Tank) -> None:
    random = np.random.default_rng(4)
    (level,) = (one for one in filling_table(tank, 3.0) if one["to_m"] == 3.0)
    volumes = []
    for _ in range(400):
        rings = []
        for ring in tank.sections:
            by = random.multivariate_normal([0.0, 0.0], ring.covariance)
            circle = replace(ring.circle, radius=ring.circle.radius + by[0])
            rings.append(replace(ring, circle=circle, height=ring.height + by[1]))
        volumes.append(filling_table(replace(tank, sections=tuple(rings)), 3.0)[0]["volume_m3"])
    assert np.std(volumes, ddof=1) == pytest.approx(level["sigma_m3"], rel=0.15)


def test_the_command_prints_it() -> None:
    arguments = ["volume", str(SECTIONS), "--sigma", "0.0141421", "--filling", "2.5"]
    figures = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert len(figures["partial_volumes"]) == 4
    assert [level["to_m"] for level in figures["filling"]] == pytest.approx([2.5, 5.0, 7.5, 9.5])
    assert "filling table" in CliRunner().invoke(app, arguments).stdout


def test_levels_that_make_no_table(tank: Tank) -> None:
    for step in (0.0, 20.0):
        with pytest.raises(ConfigurationError, match="do not make a table"):
            filling_table(tank, step)
