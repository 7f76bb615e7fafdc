"""Stated standard deviations of positions and control that are wrong by a factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit, without_member
from photocal.adjustment.groups import group_tests, member_tests
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.search import causes_in, search
from photocal.geometry.camera import PARAMETERS
from tests.evidence.drift import flown
from tests.photocal.analysis.aerial import Flight, fly
from tests.photocal.analysis.findings import said

SMALL = Flight(25, 3000, sigma_px=0.3, control_points=16)


def test_groups_share_chi_squared_and_redundancy_among_them() -> None:
    network = fly(SMALL, 1).network
    solution = adjust(network)
    tests = group_tests(network, solution)
    assert {one.name for one in tests} == {
        "image-tie",
        "image-control",
        "control-X",
        "control-Y",
        "control-Z",
        "position",
    }
    assert sum(one.chi_squared for one in tests) == pytest.approx(solution.chi_squared, rel=1e-9)
    assert sum(one.redundancy for one in tests) == pytest.approx(solution.degrees_of_freedom, rel=1e-9)
    assert all(one.lower < 1.0 < one.upper for one in tests)


def test_the_probabilities_of_clean_groups_are_even() -> None:
    """Over 60 flights the position's p-values are no smaller than even ones (one-sided Kolmogorov)."""
    own = replace(SMALL, images=16, rays=1200)
    p_values = []
    for seed in range(60):
        network = fly(own, 100 + seed).network
        tests = {one.name: one for one in group_tests(network, adjust(network))}
        p_values.append(tests["position"].p_value)
    assert stats.kstest(p_values, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.parametrize(("factor", "code"), [(1.0 / 3.0, "sigmas-too-small"), (3.0, "sigmas-too-large")])
def test_positions_with_wrong_sigmas_are_named_as_that(factor: float, code: str) -> None:
    network = fly(SMALL, 2).network
    stated = replace(network.positions, covariance=network.positions.covariance * factor**2)
    (one,) = findings(search(causes_in(fit(replace(network, positions=stated)))))
    assert (one.code, one.subject) == (code, "position")
    assert "standard deviations of GNSS antenna positions are too" in said(one)
    assert one.size is not None
    assert one.size.figure == pytest.approx(1.0 / factor, rel=0.25)


@pytest.mark.parametrize("seed", range(6))
def test_heights_of_control_that_are_worse_than_stated_are_named(seed: int) -> None:
    """By four times what the images tell of them: sixteen such draws are no single wrong points."""
    network = fly(SMALL, seed).network
    noise = 0.15 * np.random.default_rng(seed).standard_normal(len(network.points.values))
    known = np.diagonal(network.points.weight, axis1=1, axis2=2)[:, 2] > 0
    values = network.points.values.copy()
    values[known, 2] += noise[known]
    listed = findings(search(causes_in(fit(replace(network, points=replace(network.points, values=values))))))
    assert ("sigmas-too-small", "control-Z") in {(finding.code, finding.subject) for finding in listed}
    assert "control-mistyped" not in {finding.code for finding in listed}
    assert "grave" not in {finding.severity for finding in listed}


def test_the_factor_of_a_group_is_that_of_its_errors() -> None:
    """In 12 flights with positions 2.5 times worse than stated the intervals hold it; no cause is told."""
    held = 0
    for seed in range(12):
        network = fly(replace(SMALL, sigma_px=0.7), 40 + seed).network
        stated = replace(network.positions, covariance=network.positions.covariance / 2.5**2)
        (one,) = findings(search(causes_in(fit(replace(network, positions=stated)))))
        assert (one.code, one.subject) == ("sigmas-too-small", "position")
        held += one.figures["lower"] < 2.5 < one.figures["upper"]
    assert held >= 10


def test_an_error_of_the_camera_is_found_beside_positions_that_are_worse_than_stated() -> None:
    network = fly(SMALL, 5, K3=2e-22).network
    known = tuple(
        replace(one, estimated=one.estimated & (np.array(PARAMETERS) != "K3")) for one in network.cameras
    )
    stated = replace(network.positions, covariance=network.positions.covariance / 2.5**2)
    listed = findings(search(causes_in(fit(replace(network, cameras=known, positions=stated)))))
    assert listed[0].code == "radial"
    assert any((one.code, one.subject) == ("sigmas-too-small", "position") for one in listed)


def test_a_member_is_what_an_adjustment_without_it_says() -> None:
    """Fall of v'Pv, and observed minus adjusted without it; with a lever arm to estimate, and correlated."""
    network = fly(SMALL, 3).network
    own, count = network.positions, len(network.positions.image)
    correlated = own.covariance + 1e-4 * np.array([[0, 0.6, 0.3], [0.6, 0, -0.5], [0.3, -0.5, 0]])
    sigma = network.mounting.sigma.copy()
    sigma[:3] = 0.5
    network = replace(
        network,
        positions=replace(own, covariance=correlated),
        mounting=replace(network.mounting, sigma=sigma),
    )
    whole = fit(network)
    members = member_tests(whole.factored, whole.solution)
    assert [one.kind for one in members] == ["position"] * count + ["control"] * 16
    for one in (members[0], members[7], members[count], members[count + 5]):
        alone = adjust(without_member(network, one))
        assert one.dimensions == 3
        assert one.statistic == pytest.approx(whole.solution.chi_squared - alone.chi_squared, abs=0.02)
        if one.kind == "control":
            error = network.points.values[one.index] - alone.points[one.index]
            spread = np.linalg.inv(network.points.weight[one.index]) + alone.point_covariance[one.index]
            np.testing.assert_allclose(one.error, error, atol=0.02 * np.sqrt(spread.max()))
            np.testing.assert_allclose(one.covariance, spread, atol=0.01 * spread.max())


def test_members_of_clean_flights_are_rejected_as_often_as_the_level_says() -> None:
    """Positions and control of 40 flights: even probabilities, and 5 % of them below 5 %."""
    own = replace(SMALL, images=16, rays=1200, control_points=9)
    p_values = []
    for seed in range(40):
        whole = fit(fly(own, 300 + seed).network)
        members = member_tests(whole.factored, whole.solution)
        p_values += [stats.chi2.sf(one.statistic, one.dimensions) for one in members]
    # Binomial of a thousand members: 1.4 % and 3 % are two standard errors.
    assert np.mean(np.array(p_values) < 0.05) == pytest.approx(0.05, abs=0.014)
    assert np.mean(np.array(p_values) < 0.5) == pytest.approx(0.5, abs=0.032)


@pytest.mark.parametrize(("kind", "index"), [("position", 11), ("control", 4)])
def test_one_gross_error_is_named_with_its_size_and_nothing_else(kind: str, index: int) -> None:
    """A position 6 sigma off in plane and height, a control point 15 cm off."""
    network = fly(SMALL, 4).network
    if kind == "position":
        error = np.array([0.12, 0.0, -0.24])
        values = network.positions.values.copy()
        values[index] += error
        wrong = replace(network, positions=replace(network.positions, values=values))
        name = network.image_names[network.positions.image[index]]
    else:
        error = np.array([0.0, 0.15, 0.0])
        values = network.points.values.copy()
        values[index] += error
        wrong = replace(network, points=replace(network.points, values=values))
        name = network.point_names[index]
    found = search(causes_in(fit(wrong)))
    (one,) = [told for told in findings(found) if not told.small]
    assert (one.code, one.subject) == (
        "position-contradicts" if kind == "position" else "control-mistyped", name,
    )  # fmt: skip
    (cause,) = found.causes.errors
    for axis, estimate in enumerate(cause.hypothesis.estimates):
        assert abs(estimate.correction - error[axis]) < 4.0 * estimate.sigma
    assert name in said(one)


def test_a_shifted_strip_is_not_blamed_on_its_positions() -> None:
    network = fly(SMALL, 5).network
    own = network.positions
    moved = own.values + (own.strip == 1)[:, None] * np.array([0.15, 0.0, 0.0])
    found = search(causes_in(fit(replace(network, positions=replace(own, values=moved)))))
    assert [error.hypothesis.name for error in found.causes.errors] == ["strip-position"]
    assert "strip-position" in {one.code for one in findings(found)}


@pytest.mark.parametrize(("shape", "code"), [("drift", "c-drift"), ("step", "camera-change")])
def test_a_c_that_changes_is_not_taken_for_positions_worse_than_stated(shape: str, code: str) -> None:
    """Heights that follow 0.2 % of c look like positions with wrong sigmas, until c is corrected."""
    codes, *_ = flown(shape, "GNSS", 5)
    assert codes[0] == code
    assert "sigmas-too-small" not in codes
