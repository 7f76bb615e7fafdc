"""A laboratory's field of coded targets without coordinates, from rendered pictures to its camera."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.results.folder import read_result
from tests.photocal.conftest import Answer
from tests.photocal.measurement.laboratory import LENS, TAPE_SIGMA_M, laboratory, tapes, write_pictures

TARGETS, PICTURES = 30, 10


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("laboratory")
    lab = laboratory(TARGETS, PICTURES)
    write_pictures(lab, place / "pictures")
    rows = [f"{a},{b},{v:.5f},{TAPE_SIGMA_M}" for a, b, v in tapes(lab, np.random.default_rng(3))]
    (place / "tape.csv").write_text("\n".join(["from,to,value,sigma", *rows]) + "\n", encoding="utf-8")
    return place


@pytest.mark.slow
def test_one_command_from_pictures_to_the_camera(folder: Path, photocal: Callable[..., Answer]) -> None:
    given = ("--images", folder / "pictures", "--field", "4x4_100", "--distances", folder / "tape.csv")
    said = photocal("measure", *given, "-o", folder / "block", "--run", folder / "run")
    assert said.code == 0, said.err
    assert f"{TARGETS} targets in {PICTURES} pictures" in said.out
    record = json.loads((folder / "block" / "measurement.json").read_text(encoding="utf-8"))
    assert record["common_sigma_px"] < 0.3
    result = read_result(folder / "run")
    own = result.cameras["camera"]
    for name in own.free:
        assert abs(own.value(name) - LENS.get(name, 0.0)) < 3.5 * own.sigma_of(name), name
    assert own.sigma_of("c") < 1.0
    # The scale is the tapes': the sides of all targets, 160 mm, to a part in some hundred.
    at = dict(zip(result.points.names, result.points.values, strict=True))
    sides = [np.linalg.norm(at[f"{k}.1"] - at[f"{k}.2"]) for k in range(TARGETS) if f"{k}.1" in at]
    assert np.mean(sides) == pytest.approx(0.160, abs=0.0005)
    # Sigmas that come from residuals are not tested with them.
    assert result.global_test is None


def test_pictures_without_targets_are_refused_with_what_to_do(
    folder: Path, photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    said = photocal("measure", "--images", folder / "pictures", "--field", "6x6_50", "-o", tmp_path / "block")
    assert said.code == 3
    assert "6x6_50" in said.err
    assert "dictionary" in said.err
