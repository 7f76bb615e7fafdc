"""Lens models compared: the one that made the pictures is found, and none where the given one did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjusted import fit
from photocal.adjustment.network import Network
from photocal.analysis import lens_models
from photocal.analysis.left_out import Checks
from photocal.analysis.lens_models import better_lens, lens_fits, of_lenses
from photocal.findings.texts import catalogue, finding_text
from photocal.geometry.camera import PARAMETERS, Camera, Model, camera
from tests.photocal import networks

NO_CHECKS = Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def lens(model: Model, **values: float) -> Camera:
    terms = tuple(values)
    estimate = ("c", "x0", "y0", *terms)
    return camera("a", model, "mm", (3000, 2000), (0.009, 0.009), {"c": 12.0, **values}, estimate=estimate)


def measured(true: Camera) -> Network:
    """Pictures from near by, so that rays lie up to 60 degrees off the axis."""
    scene = networks.convergent((true,), images=8, points=60)
    near = scene.exposures * [1, 1, 1, 0.45, 0.45, 0.45]
    return networks.observe(replace(scene, exposures=near), np.random.default_rng(8), disturb=0.002)


def given_lens(network: Network, model: Model, terms: tuple[str, ...]) -> Network:
    (own,) = network.cameras
    made = camera("a", model, "mm", own.size_px, own.pitch, {"c": 12.0}, estimate=("c", "x0", "y0", *terms))
    return replace(network, cameras=(made,))


def test_a_fisheye_that_brown_cannot_hold_is_named() -> None:
    network = measured(lens("equidistant", K1=-0.03, K2=0.01))
    fitted = fit(given_lens(network, "brown-ideal", ("K1", "K2", "K3", "P1", "P2")))
    fits = lens_fits(fitted, 0, NO_CHECKS, lambda: None)
    better = better_lens(fits)
    assert better is not None
    assert better.model == "equidistant"
    assert better.left_out < 0.7 * fits[0].left_out
    # Without Brown's lack of fit v'Pv is what its redundancy lets expect.
    assert better.chi_squared == pytest.approx(fitted.solution.degrees_of_freedom, rel=0.15)
    (finding,) = of_lenses(fitted, (fits,))
    for language, words in (("en", "fits better"), ("pt-BR", "ajusta-se melhor")):
        text = finding_text(finding, catalogue(language))
        assert words in text
        assert "equidistant" in text


@pytest.mark.parametrize("true", [("equidistant", -0.03), ("pix4d-fisheye", -0.1), ("rational", 2e-4)])
def test_a_lens_that_is_not_tried_is_none_that_would_be_named(
    true: tuple[Model, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against fitting every one, whatever one step foretells."""
    model, k1 = true
    network = measured(lens(model, K1=k1, K2=0.01 if model == "equidistant" else 1e-6))
    fitted = fit(given_lens(network, "brown-ideal", ("K1", "K2", "K3", "P1", "P2")))
    some = better_lens(lens_fits(fitted, 0, NO_CHECKS, lambda: None))
    monkeypatch.setattr(lens_models, "_PROMISING", -np.inf)
    every = lens_fits(fitted, 0, NO_CHECKS, lambda: None)
    best = better_lens(every)
    assert (some and some.model) == (best and best.model)


def test_no_other_lens_where_the_given_one_took_the_pictures() -> None:
    network = measured(lens("brown-ideal", K1=-2.5e-4, K2=3e-7))
    fitted = fit(network)
    fits = lens_fits(fitted, 0, NO_CHECKS, lambda: None)
    assert {one.model for one in fits} >= {"brown-ideal", "equidistant"}
    assert better_lens(fits) is None
    assert fits[0].terms == ("K1", "K2")
    assert fits[0].change_of_c == 0.0


def test_lenses_behind_a_rolling_shutter_are_compared() -> None:
    network = measured(lens("brown-ideal", K1=-2.5e-4, K2=3e-7))
    moving = np.zeros((8, 6)), np.full((8, 6), 1e-3)
    rolls = replace(network, cameras=(network.cameras[0].changed(readout=0.02),))
    rolls = replace(rolls, exposures=replace(network.exposures, motion=moving[0], motion_sigma=moving[1]))
    fits = lens_fits(fit(rolls), 0, NO_CHECKS, lambda: None)
    assert {one.model for one in fits} >= {"brown-ideal", "equidistant"}
    assert better_lens(fits) is None


def test_a_lens_that_is_held_is_not_compared() -> None:
    network = measured(lens("brown-ideal", K1=-2.5e-4))
    held = replace(network.cameras[0], estimated=np.array([name == "c" for name in PARAMETERS]))
    fitted = fit(replace(network, cameras=(held.changed(K1=-2.5e-4),)))
    assert lens_fits(fitted, 0, NO_CHECKS, lambda: None) == ()
