"""Second opinions on standard deviations, against the true errors of simulated flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.removed import least_standard_error
from photocal.analysis.left_out import Checks
from photocal.analysis.outcome import analyse_network
from photocal.analysis.robust import apart, bootstrap, jackknife, sandwich
from tests.photocal.analysis.aerial import Flight, correlated, fly

FLIGHT = Flight(24, 1500, sigma_px=0.5)


def flown(seed: int, size_px: float) -> tuple[AdjustedNetwork, np.ndarray]:
    """A flight whose images have smooth errors of their own, adjusted, and the errors of its camera."""
    truth = fly(FLIGHT, seed)
    found = fit(correlated(truth.network, size_px, np.random.default_rng(seed)))
    return found, (found.state.cameras - truth.lens.values)[0]


def test_sandwich_covers_where_rays_of_an_image_are_not_independent() -> None:
    formal, robust = [], []
    for seed in range(8):
        found, error = flown(seed, 0.5)
        estimated = found.network.cameras[0].estimated
        sigma = np.sqrt(np.diag(found.solution.camera_covariance[0]) * found.solution.variance_factor)
        formal.append((error / np.where(estimated, sigma, 1.0))[estimated])
        robust.append(error[estimated] / sandwich(found)[0][estimated])
    assert np.sqrt(np.mean(np.square(formal))) > 1.6
    assert 0.7 < np.sqrt(np.mean(np.square(robust))) < 1.3


def test_sandwich_and_bootstrap_agree_with_the_adjustment_on_a_clean_flight() -> None:
    found, _ = flown(1, 0.0)
    estimated = found.network.cameras[0].estimated
    formal = np.sqrt(np.diag(found.solution.camera_covariance[0]))[estimated]
    assert np.median(sandwich(found)[0][estimated] / formal) == pytest.approx(1.0, abs=0.25)
    drawn = bootstrap(found, 30, np.random.default_rng(1))[0][estimated]
    assert np.median(drawn / formal) == pytest.approx(1.0, abs=0.35)


def test_apart_from_a_third_on() -> None:
    assert apart(1.0, 1.34)
    assert apart(1.34, 1.0)
    assert not apart(1.0, 1.33)
    assert not apart(0.0, 1.0)
    assert not apart(1.0, None)
    assert not apart(1.0, float("nan"))


def test_of_images_that_cannot_be_left_out_the_others_tell_a_lower_bound() -> None:
    """Image 7 shares points with image 6 only: without that one nothing says how it was turned."""
    network = fly(Flight(8, 900, control=False, estimate=("c", "K1")), 4).network
    in_last = np.isin(network.rays.point, network.rays.point[network.rays.image == 7])
    kept = ~in_last | (network.rays.image >= 6)
    seen = np.bincount(network.rays.point[kept], minlength=len(network.points.values)) >= 2
    rays = replace(network.rays, point=(np.cumsum(seen) - 1)[network.rays.point])
    chain = replace(
        network,
        points=network.points.rows(seen),
        rays=rays.rows(kept & seen[network.rays.point]),
        point_names=tuple(np.array(network.point_names)[seen].tolist()),
    )
    found = fit(chain)
    left = jackknife(found)
    assert left.not_possible == ("i6",)
    # Written out: of three terms that would be squared and added, two are known.
    known = np.array([values - found.state.cameras for values in left.cameras])
    assert left.standard_error == pytest.approx(np.sqrt(7.0 / 8.0 * (known**2).sum(axis=0)))
    checks = Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    outcome = analyse_network(found.network, checks, 0.1, 0.8, start=found.state)
    (needed,) = [one for one in outcome.findings if one.code == "image-needed"]
    assert needed.severity == "note"
    assert needed.figures["names"] == ("i6",)
    formal = float(np.sqrt(found.solution.camera_covariance[0][0, 0]))
    sigma, whose = outcome.jackknife["sim"].largest("c", formal)
    assert whose == "at_least"
    assert sigma >= formal


def test_without_two_known_removals_there_is_no_standard_error() -> None:
    whole = np.array([[5.0, 1.0]])
    assert np.isnan(least_standard_error(np.empty((0, 1, 2)), whole, 3)).all()
    assert np.isnan(least_standard_error(whole[None], whole, 2)).all()
    # One of three moves the first parameter by 3: at least sqrt(2 / 3 * 9).
    assert least_standard_error(whole[None] + [3.0, 0.0], whole, 3)[0] == pytest.approx([6.0**0.5, 0.0])
