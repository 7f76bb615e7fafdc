"""A laboratory's field of coded targets without coordinates, from rendered pictures to its camera."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.network import NO_RELATIONS
from photocal.adjustment.snooping import snoop
from photocal.block.results.folder import read_result
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.distortion import projected
from tests.photocal.conftest import Answer
from tests.photocal.measurement.laboratory import (
    LENS,
    TAPE_SIGMA_M,
    laboratory,
    observed,
    tapes,
    write_pictures,
)

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


@pytest.mark.parametrize("free", [True, False])
def test_exact_coordinates_of_a_field_have_no_gross_errors(*, free: bool) -> None:
    """Without noise residuals are rounding: Pope's test would go on rejecting the largest of it."""
    lab = laboratory(TARGETS, PICTURES)
    network = observed(lab, 1)
    points, image = lab.corners.reshape(-1, 3), network.rays.image
    away = points[network.rays.point] - lab.centre[image]
    seen = np.einsum("nab,nb->na", lab.rotation[image], away)
    rays = replace(network.rays, plane=projected(lab.lens, seen))
    network = replace(network, rays=rays, relations=NO_RELATIONS)
    if not free:
        held = np.ones(points.shape, np.bool_)
        known = replace(network.points, values=points, held=held)
        network = replace(network, points=known, datum_points=None)
    found = snoop(network, "tau")
    assert found.accepted.all()
    assert found.solution.cameras[0, PARAMETERS.index("c")] == pytest.approx(LENS["c"], abs=1e-6)
