"""Flights of a simulator that shares no code with the product: what is found in them, and what is not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import photocal
from photocal.adjustment.solver import ITERATIONS
from photocal.analysis.accuracy.standard import Question
from photocal.analysis.georeferencing.comparison import BlockCheck, check_block, differences
from photocal.analysis.georeferencing.findings import block_findings
from photocal.analysis.georeferencing.methods import Degradation, of_method
from photocal.analysis.georeferencing.output import to_text
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.block.model import Block
from photocal.findings.verdict import judge
from tests.evidence.judging import chance, fly, judged
from tests.independent.detectable import detectable, noncentrality, scaled
from tests.independent.faults import BASE, CLEAN, NO_CONTROL, TEN, Fault, table
from tests.independent.flights import Design, Errors, expected, world
from tests.independent.folder import Placement, write_folder
from tests.independent.rows import HARSH, Row, accused, named_first

FAULTS = {fault.name: fault for fault in table()}


def flown(folder: Path, design: Design, seed: int, errors: Errors | None = None) -> Block:
    return photocal.read_block(fly(folder / "block", design, errors or Errors(), seed).folder)


def found(check: BlockCheck) -> list[tuple[str, str]]:
    """What is said of a block beyond notes."""
    return [(one.code, one.subject) for one in block_findings(check) if not one.small]


@pytest.mark.parametrize(
    "name",
    [
        "time 20 ms",
        "c step 0.1%",
        "one of 6 control points, 10 cm Z",
        "rolling 3 ms",
        "shear 1e-4",
        "K3, 4 px at the corner",
    ],
)
def test_a_fault_raises_the_squares_as_normal_equations_of_another_hand_say(
    tmp_path: Path, name: str
) -> None:
    """Without noise v'Pv is what the unknowns cannot take up of the fault."""
    fault: Fault = FAULTS[name]
    truth = world(fault.design, chance(fault.design, 5))
    observed = expected(truth, fault.design, fault.errors)
    folder = write_folder(tmp_path / "block", fault.design, fault.errors, truth, observed, Placement())
    result = photocal.adjust(photocal.read_block(folder))
    assert result.chi_squared == pytest.approx(noncentrality(truth, fault.design, fault.errors), rel=3e-3)


@pytest.mark.parametrize("design", [BASE, NO_CONTROL, CLEAN[4], CLEAN[6]], ids=lambda design: design.name)
def test_nothing_is_said_of_a_clean_flight(tmp_path: Path, design: Design) -> None:
    """The boresight is free but in the last: the direct method is judged with the flight's calibration."""
    check = photocal.check(flown(tmp_path, design, 1))
    assert found(check) == []
    assert {judged.result.method for judged in check.judged} >= {"direct", "integrated"}
    assert "biased" not in to_text(check)


@pytest.mark.parametrize(
    ("name", "twice", "first", "rival"),
    [
        ("y scale 1e-4", True, "y-scale", "rolling-shutter"),
        ("rolling 3 ms", False, "rolling-shutter", "y-scale"),
    ],
)
def test_rows_that_no_shutter_reads_so_fast_have_another_scale(
    name: str, twice: bool, first: str, rival: str
) -> None:
    """One height and one speed: the rays cannot tell them apart, what shutters there are does."""
    fault = FAULTS[name]
    errors = fault.errors
    if twice:
        truth = world(fault.design, chance(fault.design, 0))
        errors = scaled(errors, 2.0 * detectable(truth, fault.design, errors))
    row = judged("fault", name, fault.design, errors, 0)
    for command in ("check", "analyse"):
        told = row.causes(command)[0]
        assert (told.code, told.rivals) == (first, rival)


def test_start_values_are_not_judged(tmp_path: Path) -> None:
    block = with_attitude_angles(flown(tmp_path, BASE, 1))
    check = photocal.check(block)
    direct = of_method(block, "direct")
    assert not direct.predicted
    # Start values of c and boresight make metres of what the sigmas call centimetres.
    assert differences(block, direct, "check").ratio > 3.0
    stated = check.of("direct")
    assert stated is not None
    open_values = replace(stated, result=direct, check=differences(block, direct, "check"))
    listed = block_findings(replace(check, judged=(open_values,)))
    said = [one for one in listed if one.subject == "direct"]
    causes = [one.cause for one in listed if one.severity == "untested"]
    assert said == []
    assert causes == ["start-values-used"]


def test_a_simulated_orientation_goes_with_the_adjusted_camera(tmp_path: Path) -> None:
    block = flown(tmp_path, replace(TEN, gnss=False), 3)
    noise = Degradation(0.05, np.radians(0.02)), np.random.default_rng(1)
    direct = check_block(block, (), Question(), noise).of("direct")
    assert direct is not None
    # c is started 0.4 % too long: 40 cm at 100 m.
    assert 0.5 < direct.check.ratio < 1.5


def test_check_points_are_biased_where_their_mean_is_beyond_what_they_share(tmp_path: Path) -> None:
    block = flown(tmp_path, BASE, 1)
    values = block.points.values.copy()
    values[block.points.of_role("check"), 2] += 0.10
    check = photocal.check(replace(block, points=replace(block.points, values=values)))
    assert ("check-mean", "integrated") in found(check)
    assert "biased" in to_text(check)
    joint = check.of("integrated").check.joint  # type: ignore[union-attr]
    assert joint is not None
    assert joint.mean[2] == pytest.approx(-0.10, abs=4 * joint.mean_sigma[2])


def test_sigmas_that_are_a_little_wrong_are_no_finding(tmp_path: Path) -> None:
    """Of 3 % the test of a large block is sure, but it is below the limit of equivalence; 10 % is not."""
    large = replace(TEN, images=100)
    codes = {}
    for worse in (1.03, 1.10):
        check = photocal.check(flown(tmp_path / str(worse), replace(large, rays_worse=worse), 2))
        judged = check.of("integrated")
        assert judged is not None
        assert judged.result.test is not None
        assert not judged.result.test.accepted
        codes[worse] = ("global-test", "integrated") in found(check)
    assert codes == {1.03: False, 1.10: True}


def test_points_are_suspected_by_holm(tmp_path: Path) -> None:
    """Holm (1979) by hand: of four points at 0.5 % the limits are 0.125, 0.167, 0.25 and 0.5 %."""
    block = flown(tmp_path, replace(BASE, check=4), 1)
    check = photocal.check(block).of("integrated").check  # type: ignore[union-attr]
    for shares, expected_number in (
        ((0.0012, 0.0016, 0.3, 0.0024), 3),
        ((0.0012, 0.0018, 0.3, 0.0024), 1),
        ((0.0013, 0.0013, 0.0013, 0.0013), 0),
        ((0.0012, 0.0016, 0.0049, 0.0024), 4),
    ):
        distance = stats.chi2(3).isf(np.array(shares))
        assert len(replace(check, distance=distance).suspected) == expected_number


@pytest.mark.parametrize("name", [None, "one of 6 control points, 30 cm in plane"], ids=str)
def test_the_same_flight_otherwise_has_the_same_verdict(name: str | None) -> None:
    """Turned, moved to map coordinates, renamed, and taken by two cameras in turn."""
    errors = Errors() if name is None else FAULTS[name].errors
    said = {}
    for place, at in {
        "as flown": Placement(),
        "turned": Placement(turn_deg=37.0),
        "moved": Placement(shift_m=(512_000.0, 7_100_000.0, 310.0)),
        "renamed": Placement(prefix="a-"),
        "by two cameras": Placement(cameras=2),
    }.items():
        row = judged("placed", place, BASE, errors, 0, at)
        causes = [
            (one.code, one.severity, one.subject.removeprefix("a-"))
            for command in ("check", "analyse")
            for one in row.causes(command)
            if one.severity in HARSH
        ]
        said[place] = row.check_verdict, row.analyse_verdict, causes
    assert [place for place in said if said[place] != said["as flown"]] == []


@pytest.mark.parametrize(
    "name",
    [
        "time 50 ms",
        "c held 0.10% wrong, six control points",
        "one of 6 control points, 10 cm in plane",
        "two control points, 30 cm Z",
        "rolling 15 ms",
    ],
)
def test_both_commands_name_the_fault_and_nothing_else(name: str) -> None:
    fault = FAULTS[name]
    row = judged("fault", name, fault.design, fault.errors, 0)
    assert [named_first(fault, row, command) for command in ("check", "analyse")] == [True, True]
    assert [accused(fault, row, command) for command in ("check", "analyse")] == [[], []]
    first = [row.causes(command)[0] for command in ("check", "analyse")]
    assert (first[0].code, first[0].subject) == (first[1].code, first[1].subject)


def at_twice_its_size(name: str, seed: int) -> tuple[Fault, Row]:
    """A fault at twice what a test of it alone finds in 80 % of cases, and what is said of its flight."""
    fault = FAULTS[name]
    truth = world(fault.design, chance(fault.design, seed))
    errors = scaled(fault.errors, 2.0 * detectable(truth, fault.design, fault.errors))
    return fault, judged("power", name, fault.design, errors, seed)


@pytest.mark.parametrize("seed", [2, 10])
def test_a_lever_arm_that_any_order_of_axes_would_fit_has_no_exchanged_axes(seed: int) -> None:
    """Wrong to the right by some centimetres, below a height that control determines to centimetres."""
    fault, row = at_twice_its_size("lever arm 20 cm right", seed)
    for command in ("check", "analyse"):
        assert named_first(fault, row, command)
        assert accused(fault, row, command) == []
    fault = FAULTS["lever arm, axes exchanged"]
    exchanged = judged("fault", fault.name, fault.design, fault.errors, seed)
    assert [exchanged.causes(command)[0].code for command in ("check", "analyse")] == ["lever-arm-axes"] * 2


@pytest.mark.parametrize("seed", [9, 13, 30])
def test_two_control_points_that_hide_each_other_are_both_named(seed: int) -> None:
    """Both too high: control fits as a group, and each of the two with the other."""
    fault, row = at_twice_its_size("two control points, 30 cm Z", seed)
    for command in ("check", "analyse"):
        assert named_first(fault, row, command)
        assert accused(fault, row, command) == []


def test_a_control_point_that_another_may_replace_says_so() -> None:
    fault, row = at_twice_its_size("two control points, 30 cm Z", 3)
    for command in ("check", "analyse"):
        rivals = {one.subject: one.rivals for one in row.causes(command) if one.code in fault.names}
        assert set(rivals) == set(fault.subjects)
        assert "co4" in rivals["co1"].split(",")
        assert "co4" not in rivals["co3"].split(",")
        assert all(one.severity == "doubtful" for one in row.causes(command))


@pytest.mark.parametrize("name", ["rolling 15 ms, shutter unknown", "rolling 3 ms, shutter unknown"])
def test_both_commands_tell_once_of_a_readout_that_was_estimated(tmp_path: Path, name: str) -> None:
    fault = FAULTS[name]
    block = flown(tmp_path, fault.design, 0, fault.errors)
    for listed in (
        photocal.analyse(block, photocal.adjust(block)).findings,
        photocal.analyse(block).findings,
        block_findings(photocal.check(block)),
    ):
        (told,) = [one for one in listed if one.code in fault.names]
        assert (told.severity, told.subject) == ("note", "cam0")
        readout_ms = pytest.approx(1e3 * fault.errors.readout_s, abs=4.0 * float(told.figures["sigma_ms"]))
        assert told.figures["value_ms"] == readout_ms
        assert judge(listed).outcome.code == "usable"
    still = flown(tmp_path / "still", fault.design, 0)
    assert [one for one in photocal.analyse(still).findings if one.code in fault.names] == []
    assert [one for one in block_findings(photocal.check(still)) if one.code in fault.names] == []


def test_exchanged_control_far_apart_that_is_adjusted_is_named(tmp_path: Path) -> None:
    """Two points 143 m apart with each other's names: v'Pv has a minimum, if an absurd one."""
    fault = FAULTS["two control points swapped"]
    block = flown(tmp_path, fault.design, 0, fault.errors)
    result = photocal.adjust(block)
    assert result.iterations > ITERATIONS
    first = photocal.analyse(block, result).findings[0]
    assert (first.code, first.subject, first.severity) == ("control-exchanged", "co0 co1", "grave")


@pytest.mark.parametrize(
    ("name", "code", "points"),
    [
        ("two control points swapped", "control-exchanged", ["co 0 co 1"]),
        ("two control points, 30 cm Z", "control-mistyped", ["co 1", "co 3"]),
    ],
)
def test_names_of_control_points_have_blanks(tmp_path: Path, name: str, code: str, points: list[str]) -> None:
    fault = FAULTS[name]
    block = flown(tmp_path, fault.design, 0, fault.errors)
    spaced = tuple(re.sub(r"^co(\d+)$", r"co \1", point) for point in block.points.names)
    block = replace(block, points=replace(block.points, names=spaced))
    named = [(one.code, one.subject) for one in photocal.analyse(block).findings if one.code == code]
    assert sorted(named) == [(code, point) for point in points]
    assert [one for one in found(photocal.check(block)) if one[0] == code] == named


def test_exchanged_control_that_leaves_no_minimum_is_named_by_all(tmp_path: Path) -> None:
    """The same 152 m apart, where v'Pv falls while the principal distance shrinks to nothing."""
    fault = FAULTS["two control points swapped"]
    block = flown(tmp_path, fault.design, 3, fault.errors)
    with pytest.raises(photocal.PhotocalError, match=r"first exchange the coordinates of co0, co1"):
        photocal.adjust(block)
    analysed = photocal.analyse(block).findings[0]
    (first, subject), *_ = found(photocal.check(block))
    assert (analysed.code, analysed.subject) == (first, subject) == ("control-exchanged", "co0 co1")
