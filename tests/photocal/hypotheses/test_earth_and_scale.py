"""Curved earth, refraction, and scales of ground against grid, in flights of an independent simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import photocal
from photocal.analysis.georeferencing.findings import block_findings
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text
from tests.evidence.judging import AS_FLOWN, fly
from tests.independent.faults import BASE, HIGH, LARGE
from tests.independent.flights import Design, Errors
from tests.independent.folder import Placement

# On the central meridian of the zone, where UTM is 0.9996 of the ellipsoid.
UTM = Placement(frame="EPSG:31982", origin=(-51.0, -25.0))
UTM_SCALE = 0.9996
NEW = {"refraction", "earth-curvature", "positions-scale"}


def causes(
    folder: Path, design: Design, errors: Errors, seed: int, at: Placement = AS_FLOWN, more: str = ""
) -> list[Finding]:
    """Causes that a check names; more: what the block states beside."""
    flown = fly(folder / "block", design, errors, seed, at)
    setup = flown.folder / "block.toml"
    setup.write_text(
        setup.read_text(encoding="utf-8").replace("[block]", f"[block]\n{more}"), encoding="utf-8"
    )
    check = photocal.check(photocal.read_block(flown.folder))
    found = check.systematic
    assert found is not None
    named = {error.hypothesis.name for error in found.errors}
    return [one for one in block_findings(check) if one.code in named]


@pytest.mark.parametrize("seed", [0, 1])
def test_heights_that_were_taken_in_a_plane_are_named(tmp_path: Path, seed: int) -> None:
    (one,) = causes(tmp_path, HIGH, Errors(curved=True), seed)
    assert one.code == "earth-curvature"
    assert "heights-in-plane" in one.clauses
    assert one.figures["figure"] == pytest.approx(1.0, abs=4.0 * one.figures["sigma"])


def test_a_block_that_states_the_curvature_has_none_left(tmp_path: Path) -> None:
    assert causes(tmp_path, HIGH, Errors(curved=True), 0, more="curvature = true") == []


def test_a_curvature_that_was_stated_of_a_plane_is_named(tmp_path: Path) -> None:
    (one,) = causes(tmp_path, HIGH, Errors(), 0, more="curvature = true")
    assert (one.code, "curved-twice" in one.clauses) == ("earth-curvature", True)


@pytest.mark.parametrize("seed", [0, 1])
def test_refraction_is_told_with_its_coefficient(tmp_path: Path, seed: int) -> None:
    (one,) = causes(tmp_path, HIGH, Errors(refraction=0.17), seed)
    assert one.code == "refraction"
    assert one.figures["figure"] == pytest.approx(0.17, abs=4.0 * one.figures["sigma"])


def test_nothing_of_it_is_told_of_a_clean_flight_or_of_a_low_one(tmp_path: Path) -> None:
    for k, (design, errors) in enumerate(
        ((HIGH, Errors()), (BASE, Errors(curved=True, refraction=0.17)), (LARGE, Errors()))
    ):
        assert causes(tmp_path / str(k), design, errors, 0) == []


def test_a_missing_lens_term_is_no_refraction(tmp_path: Path) -> None:
    """Ten times what air can do to the rays, of the same shape at one height."""
    found = causes(tmp_path, HIGH, Errors(lens=(("K1", -9.0e-9),)), 0)
    assert {one.code for one in found} & NEW == set()
    assert found[0].code == "radial"


@pytest.mark.parametrize("seed", [0, 1])
def test_control_on_the_ground_is_named_by_the_combined_factor(tmp_path: Path, seed: int) -> None:
    (one,) = causes(tmp_path, LARGE, Errors(control_scale=1.0 / UTM_SCALE - 1.0), seed, UTM)
    assert (one.code, one.severity) == ("positions-scale", "grave")
    assert one.clauses == ("control-on-ground",)
    assert one.figures["ppm"] == pytest.approx(-400.0, abs=4.0 * one.figures["sigma_ppm"])
    # Height above the ellipsoid: R / (R + h) of the control beside the scale of UTM.
    assert one.figures["factor"] == pytest.approx(UTM_SCALE * 6.371e6 / (6.371e6 + 50.0), abs=2e-6)
    for language in ("en", "pt-BR"):
        assert "0.99959" in finding_text(one, catalogue(language)).replace(",", ".")


def test_a_scale_that_is_not_that_of_the_frame_is_told_as_another(tmp_path: Path) -> None:
    (one,) = causes(tmp_path, LARGE, Errors(control_scale=-1.5e-3), 0, UTM)
    assert (one.code, one.clauses[0]) == ("positions-scale", "other-scale")
    assert one.figures["ppm"] == pytest.approx(1500.0, abs=4.0 * one.figures["sigma_ppm"])


def test_a_shift_is_no_scale(tmp_path: Path) -> None:
    found = causes(tmp_path, LARGE, Errors(datum_m=(0.2, -0.22, 0.0)), 0)
    assert [one.code for one in found] == ["base-position"]


def test_the_sphere_drops_as_the_square_of_the_distance(tmp_path: Path) -> None:
    """The simulator itself: at 5 km the ground lies 1.96 m below the tangent plane (d^2 / 2 R)."""
    from tests.independent.flights import EARTH_M, ORIGIN, _seen
    from tests.independent.optics import LOOKS_DOWN, TO_NED, Lens

    axes = (LOOKS_DOWN @ TO_NED)[None]
    centre = ORIGIN[None] + [[0.0, 0.0, 5000.0]]
    ground = ORIGIN[None] + [[5000.0, 0.0, 0.0]]
    drop = np.array([[0.0, 0.0, 5000.0**2 / (2.0 * EARTH_M)]])
    lens, scale = Lens(K1=0.0, K2=0.0), np.ones(1)
    curved = _seen(lens, axes, centre, ground, scale, Errors(curved=True))
    assert curved == pytest.approx(_seen(lens, axes, centre, ground - drop, scale, Errors()), abs=2e-3)
    assert not np.allclose(curved, _seen(lens, axes, centre, ground, scale, Errors()), atol=0.1)
