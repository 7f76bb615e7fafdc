"""The mistakes of a field day are called by their names."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import photocal
from photocal.adjustment.mounting import NO_ATTITUDES, NO_POSITIONS
from photocal.analysis.accuracy.standard import Question
from photocal.analysis.georeferencing.causes import Mistyped, causes_of, mistyped_of, slips_of
from photocal.analysis.georeferencing.comparison import check_block
from photocal.analysis.georeferencing.findings import block_findings
from photocal.analysis.georeferencing.prepared import with_attitude_angles, with_roles
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.geometry.rotation import matrix_from_angles
from photocal.hypotheses.control import contradicting, slips
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.search import SystematicErrors
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.findings.english import english

PLAN = Plan(tie=50)
Flown = Callable[[Errors, Plan], Block]


@pytest.fixture
def flown(tmp_path: Path) -> Flown:
    def make(errors: Errors, plan: Plan) -> Block:
        folder = fly(tmp_path / "flight", np.random.default_rng(31), errors, plan)
        return with_attitude_angles(read_block(folder))

    return make


def sought(block: Block) -> SystematicErrors:
    found, _ = causes_of(block)
    assert found is not None
    return found


def mistyped_control(block: Block) -> tuple[Mistyped, ...]:
    return mistyped_of(sought(block), slips_of(block, assemble(block)))


def findings(block: Block) -> dict[str, str]:
    check = check_block(block, (), Question(None, None, 0.9, None, None))
    return {finding.code: english(finding) for finding in block_findings(check)}


def test_an_antenna_height_is_named(flown: Flown) -> None:
    said = findings(flown(Errors(datum_m=(0.0, 0.0, 1.8)), PLAN))
    assert re.search(r"1\.(79|80|81)", said["antenna-height"])
    assert "above the control" in said["antenna-height"]
    assert {"base-position", "datum-shift", "lever-arm", "control-mistyped"}.isdisjoint(said)


def test_a_wrong_base_is_named(flown: Flown) -> None:
    said = findings(flown(Errors(datum_m=(0.8, -0.6, 0.0)), PLAN))
    assert "coordinates of the base" in said["base-position"]
    assert {"antenna-height", "datum-shift"}.isdisjoint(said)


def test_swapped_axes_of_the_lever_arm_are_named(flown: Flown) -> None:
    mounting = "lever_arm_m = [0.35, 0.10, -0.20]\nlever_arm_sigma_m = 0.01"
    said = findings(flown(Errors(lever_arm_m=(0.10, 0.35, -0.20)), replace(PLAN, mounting=mounting)))
    assert "forward and right are interchanged" in said["lever-arm-axes"]


def test_a_camera_that_changed_is_named_with_its_image(flown: Flown) -> None:
    """The principal distance is longer by 1 % from the first cross strip on."""
    found = sought(zoomed(flown(Errors(), PLAN), 1.01))
    assert found.errors[0].hypothesis.name == "camera-change"
    before, after = found.errors[0].hypothesis.estimates
    assert after.name == "c[cam@s4_0]"
    assert before.value == pytest.approx(12.0, abs=0.01)
    assert after.value == pytest.approx(12.12, abs=0.02)


def test_a_camera_that_changed_is_the_only_cause(flown: Flown) -> None:
    """Strip shifts, heights and lever arms could imitate it where the camera is calibrated on the job."""
    plan = replace(PLAN, heights_m=(80.0, 110.0), tie=100, estimate=("c", "x0", "y0", "K1", "K2"))
    found = sought(zoomed(flown(Errors(), plan), 1.004))
    assert [error.hypothesis.name for error in found.errors] == ["camera-change"]
    # One unknown more: what else a camera is stays the same.
    assert found.errors[0].hypothesis.unknowns == 1
    before, after = found.errors[0].hypothesis.estimates
    assert after.value / before.value == pytest.approx(1.004, abs=0.0005)


def zoomed(block: Block, factor: float) -> Block:
    """Enlarge the images from the first cross strip on."""
    later = block.observations.image >= block.images.names.index("s4_0")
    middle = (np.array(block.cameras[0].size_px) - 1) / 2
    values = block.observations.values.copy()
    values[later] = middle + factor * (values[later] - middle)
    return replace(block, observations=replace(block.observations, values=values))


@pytest.mark.parametrize(
    ("axis", "given", "slip"),
    [
        (0, lambda x: x + 5.0, "one-digit"),
        (1, lambda y: -y, "sign"),
    ],
)
def test_a_mistyped_control_point_is_named(
    flown: Flown, axis: int, given: Callable[[float], float], slip: str
) -> None:
    block = flown(Errors(), PLAN)
    point = 2
    values = block.points.values.copy()
    values[point, axis] = given(float(values[point, axis]))
    typed = replace(block, points=replace(block.points, values=values))
    (found,) = mistyped_control(typed)
    assert found.point == block.points.names[point]
    assert found.slips[0].startswith(slip)
    assert -found.d[axis] == pytest.approx(values[point, axis] - block.points.values[point, axis], abs=0.15)


def test_one_wrong_point_of_four_far_from_the_others(flown: Flown) -> None:
    """18 m, where every adjustment with it blames all points: the whole check names it, and no other."""
    plan = replace(PLAN, control=4, estimate=("c", "K1", "K2"))
    block = flown(Errors(), plan)
    (row, *_) = np.flatnonzero(block.points.of_role("control"))
    values = block.points.values.copy()
    values[row, 0] += 18.0
    typed = replace(block, points=replace(block.points, values=values))
    said = findings(typed)
    assert block.points.names[row] in said["control-mistyped"]
    (one,) = mistyped_control(typed)
    assert one.d == pytest.approx([-18.0, 0.0, 0.0], abs=0.3)


def test_coordinates_of_the_neighbouring_map_zone() -> None:
    """Against the place that pyproj gives to the same point in zone 23."""
    from pyproj import Transformer

    wanted = np.array([700_000.0, 7_200_000.0, 30.0])
    given = np.array([*Transformer.from_crs(31982, 31983, always_xy=True).transform(*wanted[:2]), 30.0])
    sigma = np.full(3, 0.02)
    assert slips(given, wanted, sigma, "EPSG:31982") == ("zone X 23",)
    assert slips(given, wanted, sigma, "local") == ()


def test_two_wrong_points_and_a_shift_of_all_of_them() -> None:
    """Differences alone: the shift is nobody's fault, a common error neither."""
    rng = np.random.default_rng(4)
    n = 7
    covariance = np.kron(np.full((n, n), 0.2**2), np.eye(3)) + 0.02**2 * np.eye(3 * n)
    d = 0.3 + 0.02 * rng.standard_normal((n, 3))
    common = np.tile(np.eye(3), (n, 1))
    assert contradicting(d, covariance, common)[0] == ()
    d[2, 0] += 0.4
    d[5, 2] -= 1.0
    assert set(contradicting(d, covariance, common)[0]) == {2, 5}
    # Of two points that disagree nobody knows which one is wrong.
    assert contradicting(d[1:3], covariance[:6, :6], common[:6])[0] == ()


def test_no_control_point_is_blamed_for_a_shift_of_the_datum(flown: Flown) -> None:
    block = flown(Errors(datum_m=(0.8, -0.6, 0.0)), PLAN)
    assert mistyped_control(block) == ()


def test_navigation_fixes_are_no_evidence_of_a_mounting(flown: Flown) -> None:
    """A fix from half a second before the exposure looks like a lever arm of metres: nobody mounted one."""
    block = flown(Errors(), PLAN)
    values, sigma = block.images.values.copy(), np.full_like(block.images.sigma, np.inf)
    along = matrix_from_angles(values[:, :3])[:, 1]
    values[:, 3:] += np.random.default_rng(2).normal(0.0, 0.5, (len(values), 3)) - 5.0 * along
    sigma[:, 3:] = 1.5
    images = replace(block.images, values=values, sigma=sigma)
    late = replace(
        with_roles(block, np.zeros(0, dtype=np.int64)),
        images=images, positions=NO_POSITIONS, attitudes=NO_ATTITUDES,
    )  # fmt: skip
    assert not sought(late).errors
    said = findings(late)
    of_them = {"lever-arm", "camera-change", "strip-shifts", "time-offset", "positions-share-errors"}
    assert of_them.isdisjoint(said)
    # Only what rays alone tell is tested by the analysis, too.
    of_rays = {fault.code for fault in FAULTS if fault.each == "field"}
    analysed = photocal.analyse(late, photocal.adjust(late))
    assert {tested.name for tested in analysed.search.causes.tested} <= of_rays
    assert "navigation fixes" in said["coarse-positions"]
    sigma[:, 3:] = 0.02
    precise = replace(late, images=replace(images, sigma=sigma))
    analysed = photocal.analyse(precise, photocal.adjust(precise))
    assert not {tested.name for tested in analysed.search.causes.tested} <= of_rays
    assert "coarse-positions" not in findings(precise)
    assert "lever-arm" in [one.hypothesis.name for one in sought(precise).errors]
