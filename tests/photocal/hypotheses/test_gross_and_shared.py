"""Gross rays, wrong control beside wrong sigmas, positions that share errors, single check points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import photocal
from photocal.adjustment.adjusted import fit
from photocal.block.network import assemble
from photocal.hypotheses.adequacy import Memory, memory_of
from photocal.hypotheses.gross import without_gross_rays
from photocal.hypotheses.search import systematic_errors
from tests.evidence.hypotheses import TWICE
from tests.evidence.judging import chance, fly, judged
from tests.evidence.single_points import blamed
from tests.independent.detectable import detectable, scaled
from tests.independent.faults import BASE, Fault, table
from tests.independent.flights import GROSS, Design, Errors, expected, world
from tests.independent.rows import accused, named_first, named_or_rival

FAULTS = {fault.name: fault for fault in table()}


@pytest.mark.parametrize(
    ("name", "seed"), [("5 % of rays 20 times worse", 2), ("2 % of rays 20 times worse", 2)]
)
def test_gross_rays_are_named_and_nothing_else(name: str, seed: int) -> None:
    """A point that one of its rays has pulled is no other matter than that ray."""
    fault = FAULTS[name]
    row = judged("fault", name, fault.design, fault.errors, seed)
    for command in ("check", "analyse"):
        assert named_first(fault, row, command)
        assert accused(fault, row, command) == []


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_rays_that_are_set_aside_are_those_that_were_spoilt(tmp_path: Path, share: float) -> None:
    """By the simulator's own pixels: beyond ten sigmas nearly all are found, within four nearly none."""
    flown = fly(tmp_path / "block", BASE, Errors(gross=share), 2)
    block = photocal.read_block(flown.folder)
    assembly = assemble(block)
    after, gross = without_gross_rays(fit(assembly.network))
    order = assembly.rays
    true = expected(flown.truth, BASE, Errors()).pixels
    wrong = np.abs(block.observations.values - true)[order].max(axis=1) / BASE.sigma_px
    # Rays of points that two images see miss across their base alone.
    seen = np.bincount(assembly.network.rays.point)[assembly.network.rays.point]
    assert gross[(wrong > 10.0) & (seen > 3)].mean() > 0.9
    assert gross[wrong < 4.0].mean() < 0.01
    assert after.solution.variance_factor < 1.1 < 5.0 < 1.0 + share * GROSS**2


def test_a_clean_flight_has_no_gross_rays(tmp_path: Path) -> None:
    first = fit(assemble(photocal.read_block(fly(tmp_path / "block", BASE, Errors(), 4).folder)).network)
    after, gross = without_gross_rays(first)
    assert after is first
    assert not gross.any()


@pytest.mark.parametrize("seed", [1, 3])
def test_two_points_in_height_are_named_or_stand_beside_the_sigmas(seed: int) -> None:
    """At twice the detectable size: six differences with two wrong ones fit a factor nearly as well."""
    fault: Fault = FAULTS["two control points, 30 cm Z"]
    truth = world(fault.design, chance(fault.design, seed))
    errors = scaled(fault.errors, TWICE * detectable(truth, fault.design, fault.errors))
    row = judged("power", fault.name, fault.design, errors, seed)
    for command in ("check", "analyse"):
        assert named_or_rival(fault, row, command)
        first = row.causes(command)[0]
        assert first.severity == "doubtful"
        assert {first.code, *first.rivals.split(",")} >= {"control-mistyped", "sigmas-too-small"}


def test_a_survey_that_is_worse_as_a_whole_is_no_single_points(tmp_path: Path) -> None:
    """Three times the stated sigma in all of ten points."""
    design = replace(BASE, name="worse survey", control=10, control_worse=3.0)
    told = []
    for seed in range(3):
        folder = fly(tmp_path / str(seed), design, Errors(), seed).folder
        found = systematic_errors(fit(assemble(photocal.read_block(folder)).network))
        told.append([error.hypothesis.name for error in found.errors])
        assert any(group.name.startswith("control") and group.factor > 1.5 for group in found.sigmas)
    assert told == [[], [], []]


@pytest.mark.parametrize(
    ("design", "significant", "exceeds"),
    [
        (replace(BASE, images=60), False, False),
        (replace(BASE, images=60, memory=0.95), True, True),
        # Three times the true sigma was stated: c is no less sure than that.
        (replace(BASE, images=60, memory=0.95, gnss_worse=1.0 / 3.0), None, False),
    ],
    ids=["independent", "shared", "shared, cautious"],
)
def test_shared_errors_are_weighed_against_what_was_stated(
    tmp_path: Path, design: Design, significant: bool | None, exceeds: bool
) -> None:
    flown = fly(tmp_path / "block", design, Errors(), 0)
    memory = memory_of(fit(assemble(photocal.read_block(flown.folder)).network))
    assert memory is not None
    if significant is not None:
        assert memory.significant == significant
    assert (memory.significant and memory.exceeds) == exceeds


def test_the_mean_of_correlated_errors_is_less_sure_by_the_series_of_bartlett() -> None:
    """Variance of a mean of AR(1) errors over that of independent ones, by drawing them."""
    rng, rho, n = np.random.default_rng(1), 0.6, 400
    series = np.zeros((2000, n))
    series[:, 0] = rng.normal(size=2000)
    for k in range(1, n):
        series[:, k] = rho * series[:, k - 1] + np.sqrt(1.0 - rho**2) * rng.normal(size=2000)
    assert Memory(rho, 0.0, n).inflation == pytest.approx(n * series.mean(axis=1).var(), rel=0.1)


@pytest.mark.parametrize(("wrong", "single"), [(2, 1.0), (6, 0.0)])
def test_single_check_points_make_a_misfit_up_to_a_third_of_them(wrong: int, single: float) -> None:
    assert blamed(12, "", 0, wrong, 0.4)[::2] == [1.0, single]


def test_an_error_of_the_block_is_no_single_points() -> None:
    """Datum off against control: points by the dozen are alike wrong."""
    assert blamed(12, "two control points, 30 cm in plane", 0, 0, 0.0)[::2] == [1.0, 0.0]
