"""A rig of five heads of ours, in the layouts of other programs, adopted: our own figures come back."""

from __future__ import annotations

import datetime as dt
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.block.model import Block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.block.results.result import Result
from photocal.block.writer import write_block
from photocal.geometry.camera import PARAMETERS
from photocal.run import adopt as module
from tests.photocal.exchange.conftest import to_adjust
from tests.photocal.exchange.rig_projects import LAYOUTS, NOISE_PX, SURVEY_M, on_a_frame, project
from tests.photocal.run.adopting import without_analysis

ESTIMATED = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Block, Result]:
    """Twelve exposures of five heads: adjusted, with its control as it was surveyed."""
    folder = tmp_path_factory.mktemp("rig")
    made, _ = project(12, 5, 80, np.zeros(3))
    control = made.points.of_role("control")[:, None]
    made = replace(made, points=replace(made.points, sigma=np.where(control, SURVEY_M, np.inf)))
    block = on_a_frame(to_adjust(made, "rig", NOISE_PX))
    estimated = np.array([name in ESTIMATED for name in PARAMETERS])
    block = replace(block, cameras=tuple(replace(own, estimated=estimated) for own in block.cameras))
    (folder / "block").mkdir()
    write_block(folder / "block", block)
    adjust_block(folder / "block", folder / "run")
    result = read_result(folder / "run")
    run = adjusted_block(result)[0]
    place = {name: k for k, name in enumerate(made.points.names)}
    rows = [place[name] for name in run.points.names]
    surveyed = np.where(control[rows], made.points.values[rows], run.points.values)
    points = replace(run.points, values=surveyed, sigma=np.where(control[rows], SURVEY_M, np.inf))
    return replace(run, points=points), result


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_our_own_rig_comes_back(
    tmp_path: Path, rig: tuple[Block, Result], layout: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, result = rig
    LAYOUTS[layout](tmp_path, given)
    without_analysis(monkeypatch)
    path = tmp_path / "cameras.xml" if layout == "metashape" else tmp_path
    figures = module.adopt(
        path, tmp_path / "out", dt.date(2026, 1, 1), lambda *_: nullcontext(lambda _: None)
    )
    assert len(figures["cameras"]) == 5
    # The one that the others refer to has no relation.
    assert len(figures["heads"]) == len(result.heads) == 4
    for theirs, ours in zip(figures["cameras"].values(), result.cameras.values(), strict=True):
        for name in ESTIMATED:
            assert abs(theirs["parameters"][name]["difference_in_sigmas"]) < 0.1
            assert theirs["parameters"][name]["sigma"] == pytest.approx(ours.sigma_of(name), rel=0.1)
    for head, own in zip(figures["heads"], result.heads, strict=True):
        assert head["exposures"] == own.exposures == 12
        for key, value in head["values"].items():
            if key in "xyz":
                assert abs(value["ours"] - own.values[key].value) < 0.1 * own.values[key].sigma
        one, other = (
            Rotation.from_rotvec(vector, degrees=True) for vector in (head["rotation_deg"], own.rotation_deg)
        )
        away = np.degrees((one * other.inv()).as_rotvec())
        turn_sigma = [own.values[f"turn_{axis}"].sigma for axis in "xyz"]
        assert (np.abs(away) < 0.1 * np.array(turn_sigma)).all()
