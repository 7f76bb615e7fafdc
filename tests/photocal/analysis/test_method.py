"""The shape of a network against what the methods of calibration ask for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, Relations, point_weights
from photocal.adjustment.state import start_state
from photocal.analysis.method import METHODS, Shape, check_method, shape
from photocal.base.arrays import Floats
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.findings.texts import catalogue, need_words
from photocal.geometry.camera import camera


def network_of(
    angles_deg: list[list[float]], centres: list[list[float]], points: Floats, sigma: Floats
) -> Network:
    own = camera("a", "brown-observed", "px", (4000, 3000), (1.0, 1.0), {"c": 3000.0}, estimate=("c",))
    images = len(angles_deg)
    pose = np.hstack([np.radians(angles_deg), np.array(centres, dtype=np.float64)])
    held, weight = point_weights(sigma)
    n = len(points)
    rays = Rays(
        np.tile(np.arange(images), n),
        np.repeat(np.arange(n), images),
        np.zeros((n * images, 2)),
        np.ones((n * images, 2)),
    )
    return Network(
        (own,),
        ExteriorOrientations(np.zeros(images, dtype=np.int64), pose, np.full((images, 6), np.inf)),
        Points(points, held, weight),
        rays,
        tuple(str(i) for i in range(images)),
        tuple(str(j) for j in range(n)),
    )


GROUND = np.column_stack([np.tile([0.0, 50.0, 100.0], 3), np.repeat([0.0, 50.0, 100.0], 3), np.zeros(9)])
KNOWN, FREE = np.full((9, 3), 0.02), np.full((9, 3), np.inf)


def shape_of(
    angles: list[list[float]],
    centres: list[list[float]],
    points: Floats,
    sigma: Floats,
    centre_sigma: float = np.inf,
) -> Shape:
    network = network_of(angles, centres, points, sigma)
    observed = np.tile([np.inf] * 3 + [centre_sigma] * 3, (len(centres), 1))
    network = replace(network, exposures=replace(network.exposures, sigma=observed))
    return shape(network, start_state(network))


def test_a_single_strip_over_flat_ground_satisfies_nothing() -> None:
    strip = shape_of([[0, 0, 0]] * 5, [[25.0 * i, 50.0, 100.0] for i in range(5)], GROUND, FREE)
    assert strip.convergence_deg == pytest.approx(0.0, abs=1e-6)
    assert strip.roll_deg == pytest.approx(90.0, abs=1e-6)
    assert strip.range_spread == pytest.approx(0.0, abs=1e-9)
    assert strip.constraints == 0
    checks = [check_method(method, strip) for method in METHODS]
    assert not any(check.met for check in checks)
    say = catalogue("en")
    missing = [need for check in checks for need in check.requirements if need.severity != "passed"]
    advice = {need.code: need_words(need.code, need.figures, say)["advice"] for need in missing}
    assert "tilt the camera" in advice["convergence"]
    assert "cross line" in advice["roll"]
    assert "higher" in advice["mixed-ranges"]
    assert "corners and edges" in advice["around"]


def test_convergent_and_rolled_photographs() -> None:
    found = shape_of(
        [[0, 45, 0], [0, -45, 0], [0, 0, 90]], [[150, 50, 100], [-50, 50, 100], [50, 50, 140]], GROUND, KNOWN
    )
    assert found.convergence_deg == pytest.approx(90.0)
    assert found.roll_deg == pytest.approx(0.0, abs=1e-6)
    assert check_method("convergent", found).met
    assert check_method("self-calibration", found).met


@pytest.mark.parametrize("kappa", [90.0, 270.0, -90.0])
def test_roll_is_about_the_optical_axis(kappa: float) -> None:
    found = shape_of([[0, 30, 0], [0, 30, kappa]], [[0, 0, 100], [10, 0, 100]], GROUND, FREE)
    assert found.roll_deg == pytest.approx(0.0, abs=1e-6)


def test_a_photograph_upside_down_is_no_roll_by_a_right_angle() -> None:
    found = shape_of([[0, 0, 0], [0, 0, 180]], [[0, 0, 100], [10, 0, 100]], GROUND, FREE)
    assert found.roll_deg == pytest.approx(90.0)


def test_two_heights_or_relief_make_mixed_ranges() -> None:
    heights = shape_of(
        [[0, 0, 0], [0, 0, 90], [0, 0, 0]], [[0, 0, 100], [50, 0, 100], [50, 50, 130]], GROUND, FREE, 0.05
    )
    assert heights.height_ratio == pytest.approx(1.3)
    assert check_method("mixed-ranges", heights).met
    hills = GROUND + np.outer(np.arange(9), [0, 0, 3.0])
    relief = shape_of(
        [[0, 0, 0], [0, 0, 90], [0, 0, 0]], [[0, 0, 100], [50, 0, 100], [50, 50, 100]], hills, FREE
    )
    assert relief.range_spread > 0.10
    assert check_method("mixed-ranges", relief).met


def test_two_heights_that_are_unknown_separate_nothing() -> None:
    """The design of c and the heights is singular over flat ground, and regular with one height observed."""
    centres = np.array([[0.0, 0, 100], [50, 0, 100], [50, 50, 130]])
    # x = -c u / w: by c, and by the height of each centre.
    design = [
        [-along / w, *(-3000.0 * along / w**2 * (k == i) for i in range(3))]
        for k, centre in enumerate(centres)
        for u, v, w in GROUND - centre
        for along in (u, v)
    ]
    # The column of c is made of the others: only what is known of the heights tells them apart.
    assert np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-9) == 3
    free = shape_of([[0, 0, 0], [0, 0, 90], [0, 0, 0]], centres.tolist(), GROUND, KNOWN)
    assert free.height_ratio == pytest.approx(1.0)
    assert not check_method("mixed-ranges", free).met
    assert not check_method("on-the-job", free).met


def test_a_flat_wall_has_no_mixed_ranges() -> None:
    """Seen from both sides its distances vary by a third; that is convergence."""
    wall = shape_of(
        [[0, 45, 0], [0, -45, 0], [0, 0, 90]], [[150, 50, 100], [-50, 50, 100], [50, 50, 140]], GROUND, KNOWN
    )
    assert wall.range_spread == pytest.approx(0.0, abs=1e-9)
    assert not check_method("mixed-ranges", wall).met
    assert check_method("self-calibration", wall).met


def test_a_point_astray_makes_no_relief_of_a_wall() -> None:
    points = np.vstack([np.tile(GROUND, (4, 1)), [[5000.0, 50, -4000]]])
    found = shape_of(
        [[0, 45, 0], [0, -45, 0], [0, 0, 90]],
        [[150, 50, 100], [-50, 50, 100], [50, 50, 140]],
        points,
        np.full(points.shape, 0.02),
    )
    assert found.range_spread == pytest.approx(0.0, abs=1e-9)


def test_control_on_one_side_is_not_around_the_object() -> None:
    one_side = np.where(GROUND[:, :1] < 60.0, 0.02, np.inf) * np.ones(3)
    all_over = shape_of([[0, 0, 0]] * 3, [[0, 0, 100], [50, 0, 100], [50, 50, 130]], GROUND, KNOWN, 0.05)
    half = shape_of([[0, 0, 0]] * 3, [[0, 0, 100], [50, 0, 100], [50, 50, 130]], GROUND, one_side, 0.05)
    assert (all_over.quadrants, half.quadrants) == (4, 2)
    assert all_over.control_share == pytest.approx(1.0)
    assert half.control_share == pytest.approx(0.5)
    assert check_method("on-the-job", all_over).met
    assert not check_method("on-the-job", half).met


@pytest.mark.parametrize(("count", "enough"), [(2, False), (3, True)])
def test_seven_datum_constraints(count: int, enough: bool) -> None:
    sigma = FREE.copy()
    sigma[:count] = 0.02
    found = shape_of(
        [[0, 45, 0], [0, -45, 0], [0, 0, 90]], [[150, 50, 100], [-50, 50, 100], [50, 50, 140]], GROUND, sigma
    )
    assert found.constraints == 3 * count
    datum = next(n for n in check_method("self-calibration", found).requirements if n.code == "datum")
    assert (datum.severity == "passed") == enough


def test_observed_exposures_carry_the_datum_too() -> None:
    network = network_of([[0, 0, 0]] * 3, [[0, 0, 100], [50, 0, 100], [50, 50, 130]], GROUND, FREE)
    sigma = np.full((3, 6), np.inf)
    sigma[:, 3:] = 0.05
    observed = replace(network, exposures=replace(network.exposures, sigma=sigma))
    assert shape(observed, start_state(observed)).constraints == 9


def test_a_free_network_and_distances_carry_the_datum_too() -> None:
    network = network_of([[0, 0, 0]] * 3, [[0, 0, 100], [50, 0, 100], [50, 50, 130]], GROUND, FREE)
    one = Relations(np.array([0]), np.array([0]), np.array([1]), np.array([50.0]), np.array([0.01]))
    assert shape(replace(network, relations=one), start_state(network)).constraints == 1
    free = replace(network, relations=one, datum_points=np.arange(9))
    assert shape(free, start_state(network)).constraints == 8


def test_the_convergent_camera_study_satisfies_its_method(dcs460_block: Path) -> None:
    network = assemble(read_block(dcs460_block)).network
    found = shape(network, start_state(network))
    assert check_method("convergent", found).met
    assert found.images == 12
    assert found.control_points == 40
    # More than 60 targets on a wall, Z from -0.007 to 0.007 m.
    assert found.range_spread < 0.005
    assert not check_method("mixed-ranges", found).met
