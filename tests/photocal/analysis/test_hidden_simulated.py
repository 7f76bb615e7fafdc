"""The search for hidden errors on simulated networks with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.adjusted import fit, with_measurements, with_sigmas, without_images
from photocal.adjustment.network import Relations
from photocal.analysis.left_out import within_flight
from photocal.analysis.robust import jackknife
from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.search import causes_in, search
from photocal.analysis.systematic_errors.shifts import joint_shift
from photocal.base.arrays import Floats
from photocal.findings.finding import Finding
from photocal.hypotheses.causes import Candidates, Cause, candidates
from photocal.hypotheses.fields import ray_fields
from photocal.hypotheses.findings import cause_findings
from tests.photocal.analysis import aerial
from tests.photocal.analysis.findings import said, sized
from tests.photocal.analysis.simulated import (
    CONTROL_M,
    SIGMA,
    Simulated,
    convergent,
    flight,
    noisy,
    read_in_flight,
)


@pytest.fixture(scope="module")
def networks() -> dict[str, Simulated]:
    return {"convergent": convergent(), "flight": flight()}


def found(simulated: Simulated, seed: int, plane: Floats, control_m: float = 0.002) -> tuple[Finding, ...]:
    return findings(search(causes_in(fit(noisy(simulated, seed, plane, control_m)))))


@pytest.mark.parametrize("which", ["convergent", "flight"])
def test_clean_networks_raise_no_alarm(networks: dict[str, Simulated], which: str) -> None:
    """The list stays empty in at least 95 of 100: of 4 seeds, 3 alarms would be very unlikely."""
    alarms = [found(networks[which], seed, networks[which].exact, CONTROL_M[which]) for seed in range(4)]
    assert sum(bool(alarm) for alarm in alarms) <= 2


def test_a_scale_of_y_is_found(networks: dict[str, Simulated]) -> None:
    plane = networks["convergent"].exact * np.array([1.0, 1.0 / 0.9990])
    first = found(networks["convergent"], 3, plane)[0]
    assert first.code == "y-scale"
    assert abs(sized(first).figure - 0.9990) < 4 * (sized(first).sigma or 0.0)
    # Pitches that are equal explain nothing.
    assert "x and y were scaled differently" in said(first)


def test_a_shear_is_found(networks: dict[str, Simulated]) -> None:
    exact = networks["convergent"].exact
    plane = exact - 0.0008 * np.column_stack([exact[:, 1], np.zeros(len(exact))])
    first = found(networks["convergent"], 4, plane)[0]
    assert first.code == "shear"
    assert abs(sized(first).figure - 0.0008) < 4 * (sized(first).sigma or 0.0)


@pytest.mark.parametrize(("share", "severity"), [(0.5e-4, "note"), (2e-4, "doubtful")])
def test_what_changes_c_by_less_than_any_use_of_it_is_small(
    networks: dict[str, Simulated], share: float, severity: str
) -> None:
    """However precise c is, 1 cm in 100 m of height is no reservation."""
    exact = networks["convergent"].exact
    plane = exact - 0.0008 * np.column_stack([exact[:, 1], np.zeros(len(exact))])
    causes = search(causes_in(fit(noisy(networks["convergent"], 4, plane, 0.002)))).causes
    solution, error = causes.first.solution, causes.errors[0]
    change = (-share * float(solution.cameras[0, 0]),)
    precise = replace(solution, camera_covariance=1e-8 * solution.camera_covariance)
    first = replace(causes.first, solution=precise)
    error = replace(error, hypothesis=replace(error.hypothesis, change_of_c=change))
    # What the field leaves in the residuals, and what moves on the ground, is another matter.
    told = cause_findings(replace(causes, first=first, last=first, errors=(error,)))
    assert told[0].severity == severity


def test_a_missing_radial_term_is_found(networks: dict[str, Simulated]) -> None:
    own = networks["convergent"].network.cameras[0]
    x = networks["convergent"].exact - own.values[1:3]
    r2 = np.sum(x**2, axis=1, keepdims=True)
    plane = networks["convergent"].exact - 1.5e-22 * x * r2**3
    first = found(networks["convergent"], 5, plane)[0]
    assert (first.code, "K3 is missing from the model" in said(first)) == ("radial", True)
    assert abs(sized(first).figure - 1.5e-22) < 4 * (sized(first).sigma or 0.0)


@pytest.mark.parametrize("turned", [True, False])
def test_a_rolling_shutter_is_found(turned: bool) -> None:
    made = flight(turned)
    first = found(made, 6, read_in_flight(made), 0.02)[0]
    assert first.code == "rolling-shutter"
    assert sized(first).figure == pytest.approx(0.05, rel=0.1)


def test_over_flat_ground_shutter_and_shear_are_alike() -> None:
    made = flight(turned=True, flat=True)
    first = found(made, 6, read_in_flight(made), 0.02)[0]
    assert first.code in ("shear", "rolling-shutter")
    assert "would explain it as well" in said(first)


def test_no_rolling_shutter_is_suspected_where_nothing_flies_on(networks: dict[str, Simulated]) -> None:
    fitted = fit(noisy(networks["convergent"], 1))
    kinds = [one.code for one in ray_fields(fitted)]
    assert kinds.count("rolling-shutter") <= 1
    still = replace(fitted.state, centre=np.zeros_like(fitted.state.centre))
    assert "rolling-shutter" not in [one.code for one in ray_fields(replace(fitted, state=still))]


@pytest.mark.parametrize(("factor", "words", "small"), [(3.0, "too good", False), (0.4, "too poor", True)])
def test_a_wrong_sigma_is_found(
    networks: dict[str, Simulated], factor: float, words: str, small: bool
) -> None:
    network = with_sigmas(noisy(networks["convergent"], 7), 1.0 / factor)
    (one,) = findings(search(causes_in(fit(network))))
    assert (one.code, one.small) == ("observation-sigma", small)
    assert f"the precisions are {words}" in said(one)
    # Too much assumed: the figure is the rms of the residuals, of which the unknowns took a part.
    assert sized(one).figure == pytest.approx(SIGMA, rel=0.2)


def test_an_image_with_a_principal_point_of_its_own_is_found(networks: dict[str, Simulated]) -> None:
    made = networks["convergent"]
    mine = (made.network.rays.image == 5)[:, None]
    listed = found(made, 8, made.exact + mine * np.array([20.0, 12.0]))
    (image,) = [one for one in listed if one.code == "image"]
    assert said(image).startswith("Image i5 scatters")
    assert "with a scale or principal point of its own" in said(image)


def test_an_image_that_scatters_more_is_found(networks: dict[str, Simulated]) -> None:
    made = networks["convergent"]
    more = (
        np.random.default_rng(9).standard_normal(made.exact.shape) * (made.network.rays.image == 2)[:, None]
    )
    listed = found(made, 9, made.exact + more)
    assert any(said(one).startswith("Image i2 scatters") for one in listed)


def test_an_extra_parameter_is_estimated_as_the_adjustment_would() -> None:
    """Amount, precision and fall of the sum of squares against the engine's own K3."""
    network = noisy(convergent(model="brown-ideal"), 10)
    fitted = fit(network)
    these, radial = radial_of(candidates(fitted))
    chi_squared, freedom = these.fall(these.beyond(()), (), radial)
    ((amount,), ((variance,),)) = these.solved((radial,))[1][radial.key]
    at = 5
    own = network.cameras[0]
    estimated = own.estimated.copy()
    estimated[at] = True
    solution = fit(replace(network, cameras=(replace(own, estimated=estimated),)), fitted.state).solution
    # Added to the measurement here, to the projection there.
    sigma = float(np.sqrt(solution.camera_covariance[0, at, at]))
    assert np.sqrt(variance) == pytest.approx(sigma, rel=1e-3)
    assert amount == pytest.approx(-solution.cameras[0, at], abs=0.01 * sigma)
    assert chi_squared == pytest.approx(solution.chi_squared, abs=0.01)
    assert freedom == solution.degrees_of_freedom


def radial_of(these: Candidates) -> tuple[Candidates, Cause]:
    (radial,) = [cause for cause in these.causes if cause.fault.code == "radial"]
    return these, radial


def test_what_the_unknowns_take_up_cannot_be_tested() -> None:
    """Over flat ground a line flown to and fro: the principal point and the positions are one."""
    made = flight(flat=True)
    fitted = fit(noisy(made, 10))
    these, radial = radial_of(candidates(fitted))
    assert these.determined([radial])
    # A field of nothing has no length that anything could leave of it.
    nothing = replace(these, whole=replace(these.whole, lengths=1e12 * these.whole.lengths))
    assert not nothing.determined([radial])


def test_leaving_out_an_image_is_adjusting_without_it(networks: dict[str, Simulated]) -> None:
    network = noisy(networks["convergent"], 11)
    fitted = fit(network)
    smaller, _ = without_images(network, fitted.state, np.arange(8) == 3)
    assert smaller.image_names == ("i0", "i1", "i2", "i4", "i5", "i6", "i7")
    assert not np.any(network.rays.image == 8)
    anew = fit(smaller).solution
    found_without = jackknife(fitted)
    at = found_without.left_out.index(("i3",))
    sigma = np.sqrt(np.diagonal(anew.camera_covariance[0]))
    assert (np.abs(found_without.cameras[at] - anew.cameras)[0] <= 1e-4 * sigma).all()


def test_leaving_out_images_keeps_relations_and_datum_of_the_points_that_stay(
    networks: dict[str, Simulated],
) -> None:
    network = noisy(networks["flight"], 1)
    fitted = fit(network)
    lonely = int(np.flatnonzero(np.bincount(network.rays.point) == 1)[0])
    (image,) = network.rays.image[network.rays.point == lonely]
    others = np.argsort(np.bincount(network.rays.point))[-2:].tolist()
    pairs = np.array([[lonely, others[0]], others])
    tied = replace(
        network,
        relations=Relations(np.zeros(2, dtype=np.int64), pairs[:, 0], pairs[:, 1], np.ones(2), np.ones(2)),
        datum_points=np.array([lonely, *others]),
    )
    smaller, state = without_images(tied, fitted.state, np.arange(len(network.image_names)) == image)
    assert smaller.datum_points is not None
    names = [smaller.point_names[j] for j in smaller.datum_points]
    assert names == [network.point_names[j] for j in others]
    assert [smaller.point_names[j] for j in smaller.relations.first] == [network.point_names[others[0]]]
    assert [smaller.point_names[j] for j in smaller.relations.second] == [network.point_names[others[1]]]
    assert len(state.points) == len(smaller.point_names)


def test_an_image_gets_its_own_geometry_as_the_adjustment_would_give_it() -> None:
    """Scale, principal point and significance against a camera of its own for that image."""
    made = convergent(("c", "x0", "y0"), model="brown-ideal")
    mine = (made.network.rays.image == 5)[:, None]
    network = noisy(made, 16, made.exact + mine * np.array([1.5, -1.0]))
    fitted = fit(network)
    found = joint_shift(fitted, "i5")
    assert found is not None
    assert found.sigma is not None
    own = network.cameras[0]
    camera_of = network.exposures.camera.copy()
    camera_of[5] = 1
    split = replace(
        network,
        cameras=(own, replace(own, id="other")),
        exposures=replace(network.exposures, camera=camera_of),
    )
    anew = fit(split).solution
    # What must be added to the measurements is minus what the other camera has more.
    more = anew.cameras[1, :3] - anew.cameras[0, :3]
    # The measured coordinates are scaled with their distortion, c without it: nearly the same.
    assert found.scale == pytest.approx(-more[0] / 3500.0, abs=0.15 * float(found.sigma[0]))
    np.testing.assert_allclose(found.shift_px, -more[1:], atol=0.15 * float(found.sigma[1]))
    freedom = fitted.solution.degrees_of_freedom - 3
    fall = fitted.solution.chi_squared - anew.chi_squared
    p_value = stats.f.sf(fall / 3 / (anew.chi_squared / freedom), 3, freedom)
    assert np.log(found.p_value / 8) == pytest.approx(np.log(p_value), rel=0.1)
    # 0.3 px of noise: what nothing else takes up is less than what was moved.
    assert 0.0 < found.effect_px < 2.0


@pytest.mark.parametrize(
    ("shape", "code"), [("drift", "c-drift"), ("step", "camera-change"), ("late", "c-drift")]
)
def test_a_principal_distance_that_changes_within_the_flight_is_named(shape: str, code: str) -> None:
    """c grows by 0.3 % through a flight, in its middle, or with a time that is not the order of the names."""
    flown = aerial.fly(aerial.Flight(24, 4000, sigma_px=0.6), 5).network
    images = len(flown.image_names)
    at = np.linspace(-0.5, 0.5, images)
    time: Floats | None = None
    if shape == "late":
        time = np.asarray(np.random.default_rng(2).permutation(images) * 2.0)
        at = time / time.max() - 0.5
    change = 0.003 * (np.sign(at) / 2 if shape == "step" else at)
    network = with_measurements(flown, flown.rays.plane * (1.0 + change[flown.rays.image, None]))
    network = replace(network, exposures=replace(network.exposures, time=time))
    fitted = fit(network)
    first = findings(search(causes_in(fitted)))[0]
    assert first.code == code
    # 0.3 % are told apart; a fortieth of it are not.
    assert not first.figures.get("alike")
    assert not first.figures["same"]
    if shape != "step":
        assert abs(sized(first).figure - 0.003 * aerial.LENS["c"]) < 4 * (sized(first).sigma or 0.0)
    c = within_flight(fitted, 0)[0]
    assert c.p_value < 1e-4
    amount, sigma = c.parts[2]
    expected = 0.003 * aerial.LENS["c"] * (1.0 if shape == "step" else 2.0 / 3.0)
    assert abs(amount - expected) < 4 * sigma
    if time is not None:
        assert c.drifts["time"][0] == pytest.approx(c.drifts["order"][0], rel=1e-6)


def test_what_each_image_has_otherwise_is_no_missing_term(networks: dict[str, Simulated]) -> None:
    """A radial field of each image's own: rays by the hundred agree with K3, the images do not."""
    made = networks["flight"]
    x = made.exact - made.network.cameras[0].values[1:3]
    image = made.network.rays.image
    amount = 5e-24 * np.random.default_rng(17).standard_normal(len(made.network.image_names))
    network = noisy(made, 17, made.exact - amount[image, None] * x * np.sum(x**2, axis=1, keepdims=True) ** 3)
    fitted = fit(network)
    these, radial = radial_of(candidates(fitted))
    chi_squared, freedom = these.fall(these.beyond(()), (), radial)
    f = (fitted.solution.chi_squared - chi_squared) / (chi_squared / freedom)
    assert stats.f.sf(f, 1, freedom) < 1e-6
    codes = {one.code for one in findings(search(causes_in(fitted)))}
    assert not codes & {"radial", "decentring", "c-bias"}
