"""How much control a flight needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.georeferencing.experiment import CHOICES, control_numbers, numbers_text
from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.findings.texts import catalogue
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

PLAN = Plan(tie=20, control=4, check=3)


def test_more_control_is_predicted_and_seen_to_be_better(tmp_path: Path) -> None:
    fly(tmp_path / "block", np.random.default_rng(3), Errors(), PLAN)
    outcome, figures = control_numbers(read_block(tmp_path / "block"), (0, 3, 99))
    rows = figures["numbers"]
    assert [(row["control"], row["choices"]) for row in rows] == [(0, 1), (3, CHOICES), (6, 7)]
    predicted = [np.linalg.norm(list(row["predicted_m"].values())) for row in rows]
    assert predicted[2] < min(predicted[:2])
    assert rows[0]["errors"] == 7
    # All but one: each point is judged once.
    judged = [run.check.names for run in outcome.runs if run.control == 6 and run.check is not None]
    assert len({name for names in judged for name in names}) == 7
    assert "6 control, 7 choices" in numbers_text(figures, catalogue("en"))


def test_one_surveyed_point_is_refused(tmp_path: Path) -> None:
    fly(tmp_path / "block", np.random.default_rng(3), Errors(), Plan(tie=10, control=1, check=0))
    with pytest.raises(ConfigurationError, match="1 surveyed points with sigmas cannot judge"):
        control_numbers(read_block(tmp_path / "block"))
