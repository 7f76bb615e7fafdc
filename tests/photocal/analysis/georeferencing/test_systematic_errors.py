"""Injected errors of mounting, time and datum are found, estimated and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.georeferencing.causes import Separation, causes_of
from photocal.analysis.georeferencing.findings import separation_findings
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.findings import fall_of, named
from photocal.hypotheses.judged import Estimate, Hypothesis, Stated, moved_surely
from photocal.hypotheses.search import SystematicErrors
from photocal.hypotheses.table import Fault
from photocal.run.summary import causes_first
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.findings.english import english

SMALL = Plan(tie=50)
Flown = Callable[[Errors, int], Block]


@pytest.fixture
def flown(tmp_path: Path) -> Flown:
    def make(errors: Errors, seed: int) -> Block:
        folder = fly(tmp_path / f"flight{seed}", np.random.default_rng(seed), errors, SMALL)
        return with_attitude_angles(read_block(folder))

    return make


def sought(block: Block, table: tuple[Fault, ...] = FAULTS) -> SystematicErrors:
    found, _ = causes_of(block, table=table)
    assert found is not None
    return found


def within_three_sigma(found: SystematicErrors, truth: dict[str, float]) -> None:
    values = {e.name: e for e in found.estimates}
    for name, true in truth.items():
        assert abs(values[name].value - true) < 3 * values[name].sigma, name


@pytest.mark.parametrize(
    ("errors", "name", "truth"),
    [
        (
            Errors(lever_arm_m=(0.16, 0.12, 0.0)),
            "lever-arm",
            {"lever_arm_x": 0.16, "lever_arm_y": 0.12, "lever_arm_z": 0.0},
        ),
        (
            Errors(boresight_deg=(0.3, -0.4, 0.0)),
            "boresight",
            {"boresight_x": 0.3, "boresight_y": -0.4, "boresight_z": 0.0},
        ),
        (Errors(time_offset_s=0.017), "time-offset", {"time_offset": 0.017}),
        (
            Errors(datum_m=(0.2, 0.1, 0.2)),
            "datum-shift",
            {"shift_x": 0.2, "shift_y": 0.1, "shift_z": 0.2},
        ),
        (Errors(focal_mm=0.03), "principal-distance", {"c[cam]": 12.03}),
    ],
)
def test_injected_error_is_found_estimated_and_named(
    flown: Flown, errors: Errors, name: str, truth: dict[str, float]
) -> None:
    found = sought(flown(errors, 21))
    assert [error.hypothesis.name for error in found.errors] == [name]
    assert found.errors[0].same == ()
    within_three_sigma(found, truth)


def test_two_errors_at_once(flown: Flown) -> None:
    found = sought(flown(Errors(boresight_deg=(0.0, 0.5, 0.0), datum_m=(0.3, 0.0, 0.0)), 23))
    # In plane alone it is the base.
    assert {error.hypothesis.name for error in found.errors} == {"boresight", "base-position"}
    within_three_sigma(found, {"boresight_y": 0.5, "shift_x": 0.3})


def test_nothing_is_found_where_nothing_is(flown: Flown) -> None:
    found = sought(flown(Errors(), 25))
    assert found.errors == ()
    assert {one.name for one in found.tested} == {
        "lever-arm",
        "boresight",
        "time-offset",
        "datum-shift",
        "strip-shifts",
        "principal-distance",
        "principal-point",
        "camera-change",
        "antenna-height",
        "base-position",
        "strip-position",
        "position-contradicts",
        "positions-scale",
        "control-mistyped",
        "rolling-shutter",
        "c-drift",
        "y-scale",
        "shear",
        "radial",
        "decentring",
    }


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
def test_wrong_sigmas_of_positions_are_named_as_that(flown: Flown, factor: float) -> None:
    """Positions that are stated three times too good or too poor: no shift of strips or datum."""
    block = flown(Errors(), 31)
    stated = replace(block.positions, covariance=block.positions.covariance * factor**2)
    found = sought(replace(block, positions=stated))
    (sigma,) = found.sigmas
    assert sigma.name == "position"
    assert sigma.lower < 1.0 / factor < sigma.upper
    assert found.errors == ()


def test_an_error_is_not_taken_for_wrong_sigmas(flown: Flown) -> None:
    found = sought(flown(Errors(datum_m=(0.0, 0.0, 0.085)), 33))
    assert found.sigmas == ()
    assert "antenna-height" in {found.errors[0].hypothesis.name, *found.errors[0].same}


@pytest.mark.parametrize(
    ("white", "jump", "named"),
    [
        # As stated, and one strip 90 mm beside the others.
        (0.03, 0.09, ["strip-position"]),
        # Errors that stay alike for minutes: the rays tell 9 mm of positions that are stated to 30 mm.
        (0.0015, 0.009, []),
    ],
)
def test_strips_that_jump_are_an_error_beyond_what_is_stated_of_each_position(
    tmp_path: Path, white: float, jump: float, named: list[str]
) -> None:
    plan = replace(SMALL, tie=200, pixel_sigma=0.05, position_sigma_m=white)
    block = with_attitude_angles(read_block(fly(tmp_path / "f", np.random.default_rng(41), plan=plan)))
    own = block.positions
    values = own.values + (own.strip == 1)[:, None] * np.array([0.0, jump, 0.0])
    stated = replace(own, values=values, covariance=own.covariance * (0.03 / white) ** 2)
    found = sought(replace(block, positions=stated))
    assert [error.hypothesis.name for error in found.errors] == named


def test_c_is_judged_as_it_was_stated_where_smaller_sigmas_of_positions_agree() -> None:
    """A rendered flight: heights 11 mm stated, 6.8 mm wrong, 2.5 mm of it within strips; c 8.8235."""

    def on_c(stated_c: float, sigma_c: float) -> float:
        stated = Stated(np.array([stated_c]), np.array([sigma_c]), np.full(3, 0.011))
        before, had, after, has = (np.array([v]) for v in (8.827258, 0.000637, 8.822734, 0.000975))
        return moved_surely(before, had, after, has, stated)

    alone = on_c(8.827258, 0.000637)
    assert alone == pytest.approx(7.1, abs=0.05)
    assert on_c(8.824190, 0.000929) == pytest.approx(1.57, abs=0.01)
    # Larger sigmas than stated make it no surer.
    assert on_c(8.824190, 0.000300) == alone


def test_a_height_alone_pays_for_one_unknown() -> None:
    """An antenna 0.1 m low explains 32.7 as a shift, 0.4 of it in plane; a drift of c, one unknown, 18."""
    shift = (("x", -0.0029, 0.006), ("y", -0.0003, 0.003), ("z", -0.099, 0.0167))
    estimates = tuple(
        Estimate(f"shift_{axis}", "m", value, value, sigma, value / sigma, axis == "z")
        for axis, value, sigma in shift
    )
    found = Hypothesis("datum-shift", 32.7, 1.0, 3, 10.9, 6.7, True, estimates, 8.7, 5.3)
    # What is no more than chance in plane gains one for each unknown.
    assert fall_of(found) == pytest.approx(30.7)


def test_vertical_lever_arm_is_said_to_be_like_a_height_datum(flown: Flown) -> None:
    found = sought(flown(Errors(lever_arm_m=(0.0, 0.0, 0.3)), 27))
    error = found.errors[0]
    # Over two heights two principal distances look the same, too.
    assert {error.hypothesis.name, *error.same} == {
        "lever-arm", "datum-shift", "antenna-height", "camera-change",
    }  # fmt: skip
    assert error.hypothesis.name != "camera-change"


def test_one_height_does_not_separate_c_height_and_lever_arm(tmp_path: Path) -> None:
    """One height over flat ground: c, height datum and vertical lever arm have the same effect."""
    groups = {}
    for name, heights, relief in (("one", (90.0, 90.0), 0.0), ("two", (90.0, 130.0), 0.0)):
        plan = replace(SMALL, heights_m=heights, relief_m=relief, estimate=("c",), camera_sigma={"c": 0.05})
        block = with_attitude_angles(read_block(fly(tmp_path / name, np.random.default_rng(3), plan=plan)))
        _, found = causes_of(block)
        assert found is not None
        groups[name] = found
    assert any({"c", "shift_z", "lever_arm_z"} <= set(group) for group in groups["one"].groups)
    assert not any("c" in group for group in groups["two"].groups)
    assert any({"shift_z", "lever_arm_z"} == set(group) for group in groups["two"].groups)
    text = english(separation_findings(groups["one"])[0])
    assert "cannot separate" in text
    assert "principal distance c" in text
    assert "second height" in text


def test_all_that_a_flight_leaves_open_stands_in_one_finding() -> None:
    groups = (("shift_x",), ("c[a]", "shift_z"), ("shift_y",), ("x0[a]", "lever_arm_x"))
    found = separation_findings(Separation((), np.zeros(0), np.zeros((0, 0)), groups))
    assert [finding.figures["terms"] for finding in found] == [
        ("c", "shift_z"),
        ("x0", "lever_arm_x"),
        ("shift_x", "shift_y"),
    ]
    assert "datum shift in X and datum shift in Y" in english(found[-1])
    # Whoever collects findings keeps one of each code and subject.
    assert len({(finding.code, finding.subject) for finding in found}) == len(found)


def test_one_speed_does_not_separate_time_and_forward_lever_arm(tmp_path: Path) -> None:
    plan = replace(SMALL, speeds_m_s=(10.0, 10.0))
    block = with_attitude_angles(read_block(fly(tmp_path / "flight", np.random.default_rng(3), plan=plan)))
    _, found = causes_of(block)
    assert found is not None
    assert any({"lever_arm_x", "time_offset"} == set(group) for group in found.groups)


def test_values_left_free_in_the_block_are_estimated(tmp_path: Path) -> None:
    plan = replace(SMALL, mounting='lever_arm_sigma_m = "free"\nboresight_sigma_deg = "free"')
    errors = Errors(lever_arm_m=(0.16, 0.12, 0.0), boresight_deg=(0.3, -0.4, 0.0))
    block = with_attitude_angles(
        read_block(fly(tmp_path / "flight", np.random.default_rng(29), errors, plan))
    )
    found = sought(block)
    assert found.errors == ()
    values = {e.name: e for e in found.free_in_block}
    truth = {"lever_arm_x": 0.16, "lever_arm_y": 0.12, "boresight_x": 0.3, "boresight_y": -0.4}
    for name, true in truth.items():
        assert abs(values[name].value - true) < 3 * values[name].sigma, name
        assert values[name].significant
    assert not values["boresight_z"].significant
    assert {"lever-arm", "boresight"}.isdisjoint(one.name for one in found.tested)


def test_a_new_fault_is_one_entry_and_its_texts(flown: Flown) -> None:
    """Search, naming, words and root causes take it from there."""
    new = Fault("worn-zoom", ("camera",), ("c",), prior=0.1)
    found = sought(flown(Errors(focal_mm=0.03), 21), table=(new,))
    (error,) = found.errors
    assert error.hypothesis.name == "worn-zoom"
    within_three_sigma(found, {"c[cam]": 12.03})
    (finding,) = named(found)
    assert (finding.code, finding.severity) == ("worn-zoom", "grave")
    say = catalogue("en")
    texts = {"finding.worn-zoom": "The zoom is worn", "remedy.worn-zoom": "Fix it with glue."}
    text = finding_text(finding, replace(say, messages={**say.messages, **texts}))
    assert text.startswith("The zoom is worn; correction c[cam] +0.03")
    assert text.endswith("Fix it with glue.")
    told = (replace(finding, stage="georeferencing"), Finding("global-test", "doubtful"))
    assert [one.severity for one in causes_first(told, 100.0, (new,))] == ["grave", "consequence"]


def test_what_a_block_cannot_estimate_nobody_is_told_to_estimate() -> None:
    held = Finding("camera-held", "doubtful", "cam", {"names": ("c",)}, stage="measurements")
    wrong = Finding("principal-distance", "grave", figures={"numbers": ("c[cam] +434 +- 20 px",)})
    other = replace(wrong, figures={"numbers": ("c[cam2] +434 +- 20 px",)})
    told = causes_first((held, wrong), 100.0)
    assert [(one.code, one.severity, one.remedy) for one in told] == [
        ("principal-distance", "grave", "camera-held"),
        ("camera-held", "consequence", ""),
    ]
    assert causes_first((held, other), 100.0) == (held, other)


def test_a_readout_beside_a_refocused_camera_is_told_as_what_follows() -> None:
    readout, shake = (Finding(code, "note") for code in ("shutter-rolls", "images-shake"))
    change = Finding("camera-change", "grave", stage="georeferencing")
    told = causes_first((readout, shake, change), 100.0)
    assert [one.severity for one in told] == ["grave", "consequence", "consequence"]
    assert [one.severity for one in causes_first((readout, shake), 100.0)] == ["note", "note"]
