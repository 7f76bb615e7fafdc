"""How images move while they are read: known readouts, velocities and rates of a block folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment.mounting import NO_POSITIONS, Attitudes, Mounting
from photocal.analysis.georeferencing.prepared import with_shutters
from photocal.base.errors import ConfigurationError
from photocal.block.camera_setup import CameraKeys, make_camera
from photocal.block.folder import read_block
from photocal.block.motion import expected_rates, motion_of, velocity_of_neighbours
from photocal.block.network import assemble
from photocal.block.results.adjusted import adjust_block
from photocal.geometry.rotation import NADIR, object_to_body
from photocal.geometry.strips import lines_of_places
from tests.photocal import blocks

PHANTOM = {
    "id": "p",
    "model": "brown-ideal",
    "unit": "px",
    "size_px": (4000, 3000),
    "parameters": {"c": 2300.0},
}


def made(**more: Any) -> Any:
    return make_camera(CameraKeys(**(PHANTOM | more)), "block.toml")


def test_readout_of_a_known_camera() -> None:
    own = made(readout_from="DJI FC330", estimate=("c", "readout"))
    assert own.rolling
    assert own.shutter == "rolling"
    assert own.value("readout") == pytest.approx(0.033)
    assert own.prior_sigma[-1] == pytest.approx(0.002)
    assert np.isinf(made(estimate=("readout",)).prior_sigma[-1])
    pro = {"readout_from": "hasselblad l1d-20c"}
    assert made(size_px=(5472, 3648), **pro).value("readout") == pytest.approx(0.056)


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        ({"readout_from": "hasselblad l1d-20c"}, "this size"),
        ({"readout_from": "dji fc330", "parameters": {"c": 2300.0, "readout": 0.03}}, "both given"),
        ({"shutter": "rolling"}, "neither"),
        ({"shutter": "global", "estimate": ("readout",)}, "global"),
        ({"photo_variant": {"readout": 0.01}, "estimate": ("readout",)}, "image to image"),
    ],
)
def test_readouts_that_make_no_sense(keys: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigurationError, match=word):
        made(**keys)


def test_velocity_between_neighbours() -> None:
    """Two strips at 8 m/s east and back; a third image far off in time has no neighbour."""
    x = np.array([0.0, 16, 32, 32, 16, 0, 7])
    centre = np.column_stack([x, [0, 0, 0, 20, 20, 20, 5], np.full(7, 80.0)])
    time = np.array([0.0, 2, 4, 20, 22, 24, 500])
    order = np.array([3, 0, 6, 5, 1, 4, 2])
    velocity, change = velocity_of_neighbours(np.zeros(7, dtype=np.int64), time[order], centre[order])
    expected = np.array([8.0, 8, 8, -8, -8, -8, np.nan])[order]
    assert velocity[:, 0] == pytest.approx(expected, nan_ok=True)
    assert change == pytest.approx(np.zeros(7))


def test_rates_of_the_vehicle_turn_what_the_camera_sees(tmp_path: Path) -> None:
    """The camera axes a moment later, by the attitude then, are those now turned by the rate."""
    block = read_block(blocks.dcs460(tmp_path / "block"))
    angles, rate, moment = np.radians([[3.0, -5.0, 70.0]]), np.radians([[4.0, -7.0, 20.0]]), 1e-4
    body = object_to_body(angles)[0][0]
    later = Rotation.from_rotvec(-rate[0] * moment).as_matrix() @ body
    boresight = np.array([0.02, -0.01, 0.03])
    values = np.zeros(17)
    values[3:6] = boresight
    to_camera = Rotation.from_rotvec(boresight).as_matrix() @ NADIR
    attitudes = Attitudes(np.array([1]), body[None], np.eye(3)[None], rate, np.full((1, 3), 1e-6))
    block = replace(block, attitudes=attitudes, mounting=Mounting(NADIR, values, np.zeros(17)))
    count = len(block.images.names)
    motion, sigma, _ = motion_of(block, np.zeros((count, 3)), NO_POSITIONS, np.tile(np.eye(3), (count, 1, 1)))
    seen = Rotation.from_matrix(to_camera @ later @ (to_camera @ body).T).as_rotvec() / moment
    assert motion[1, 3:] == pytest.approx(seen, rel=1e-6)
    assert sigma[1, 3:] == pytest.approx(1e-6)
    assert motion[0, 3:] == pytest.approx(0.0)


def test_rates_of_images_csv_are_those_of_the_camera(tmp_path: Path) -> None:
    folder = blocks.dcs460(tmp_path / "block")
    table = folder / "images.csv"
    lines = table.read_text().splitlines()
    table.write_text(
        "\n".join([lines[0] + ",vX,vY,vZ,wx,wy,wz", *(f"{one},1,2,3,4,5,6" for one in lines[1:])])
    )
    setup = folder / "block.toml"
    setup.write_text(setup.read_text().replace("distortion_at", 'shutter = "unknown"\ndistortion_at'))
    exposures = assemble(read_block(folder)).network.exposures
    assert exposures.motion is not None
    # What the camera sees turns against it.
    assert exposures.motion[0] == pytest.approx([1, 2, 3, *np.radians([-4, -5, -6])])


def test_readout_without_velocities_is_refused(tmp_path: Path) -> None:
    folder = blocks.dcs460(tmp_path / "block")
    setup = folder / "block.toml"
    setup.write_text(setup.read_text().replace('"P2"]', '"P2", "readout"]'))
    with pytest.raises(ConfigurationError, match="the speed of its images is unknown"):
        adjust_block(folder, tmp_path / "run")


def test_observed_rates_are_drawn_towards_zero_by_their_reliability() -> None:
    """A product with a third value goes along expected rates without bias, and not along observed ones."""
    rng = np.random.default_rng(4)
    true, sigma = rng.normal(0, 0.03, (4000, 3)), np.full((4000, 3), 0.03)
    observed = true + rng.normal(0, 0.03, true.shape)
    rates, left = expected_rates(observed, sigma, np.full(4000, 0.1))
    assert np.sum(true * observed) / np.sum(observed**2) == pytest.approx(0.5, abs=0.03)
    assert np.sum(true * rates) / np.sum(rates**2) == pytest.approx(1.0, abs=0.05)
    assert np.std(true - rates) == pytest.approx(left.mean(), rel=0.05)


def test_rates_that_nobody_observed_stay_as_they_are() -> None:
    none = np.full((3, 3), np.nan)
    rates, sigma = expected_rates(none, none, np.full(3, 0.1))
    assert np.isnan(rates).all()
    assert np.isnan(sigma).all()


@pytest.mark.parametrize("observed", [False, True])
def test_rates_and_gusts_are_the_same_in_georeferencing(tmp_path: Path, observed: bool) -> None:
    folder = blocks.dcs460(tmp_path / "block")
    table, setup = folder / "images.csv", folder / "block.toml"
    head, *lines = table.read_text().splitlines()
    rng = np.random.default_rng(3)
    rates = [",".join(f"{value:.3f}" for value in (*rng.normal(0.0, 3.0, 3), 2.0, 2.0, 2.0)) for _ in lines]
    more = (",wx,wy,wz,swx,swy,swz", [f",{rate}" for rate in rates]) if observed else ("", [""] * len(lines))
    rows = [f"{line},1,2,3{rate}" for line, rate in zip(lines, more[1], strict=True)]
    table.write_text("\n".join([f"{head},vX,vY,vZ{more[0]}", *rows]))
    text = setup.read_text()
    for before, after in (
        ('"P2"]', '"P2", "readout"]'),
        ("prior_sigma = {", "prior_sigma = { readout = 0.001,"),
        ("parameters = {", "parameters = { readout = 0.02,"),
    ):
        text = text.replace(before, after)
    setup.write_text(text)
    block = read_block(folder)
    decided = with_shutters(block)
    assert np.isfinite(decided.images.motion_sigma).all()
    given, kept = (assemble(one).network.exposures for one in (block, decided))
    assert given.motion is not None
    assert given.motion_sigma is not None
    assert kept.motion is not None
    assert kept.motion_sigma is not None
    assert np.allclose(kept.motion, given.motion)
    assert np.allclose(kept.motion_sigma, given.motion_sigma)


def test_strips_are_told_by_their_places() -> None:
    """To and fro with a step across, two photos longer each time, then a corner without a step across."""
    random, places, truth = np.random.default_rng(1), [], []
    for k, count in enumerate((5, 7, 9)):
        x = np.arange(count) * 20.0
        places += [(v, 60.0 * k, 100.0) for v in (x if k % 2 == 0 else x[::-1])]
        truth += [k] * count
    places += [(places[-1][0], 120.0 + 20.0 * n, 100.0) for n in range(1, 5)]
    truth += [3] * 4
    noisy = np.array(places) + random.normal(0.0, 1.5, (len(places), 3))
    assert lines_of_places(noisy).tolist() == truth
    assert [lines_of_places(noisy[:n]).tolist() for n in (0, 1, 2)] == [[], [0], [0, 0]]
