"""The search for hidden errors on simulated networks with known truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.network import Exposures, Network, Points, Rays, Relations, point_weights
from photocal.analysis.estimates import Array
from photocal.analysis.finding import Finding
from photocal.analysis.hidden.candidates import candidates
from photocal.analysis.hidden.extra_parameter import estimated_amount
from photocal.analysis.hidden.findings import findings
from photocal.analysis.hidden.image_shift import joint_shift
from photocal.analysis.hidden.jackknife import jackknife
from photocal.analysis.hidden.refit import fit, with_sigmas, without_images
from photocal.analysis.hidden.residual_map import grid_shape, residual_map
from photocal.analysis.hidden.search import search
from photocal.analysis.hidden.variance_components import assumed_sigma, variance_components
from photocal.geometry.camera import Camera, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from tests.photocal.analysis.findings import said, sized

SIGMA = 0.3


@dataclass(frozen=True)
class Simulated:
    """A network with the image coordinates that its truth gives, without noise."""

    network: Network
    exact: Array


def a_camera(estimate: tuple[str, ...], **changed: float) -> Camera:
    values = {"c": 3500.0, "x0": 12.0, "y0": -8.0, "K1": -7e-9, "K2": 4e-16, "P1": 3e-8, **changed}
    return camera("sim", "brown-observed", "px", (4000, 3000), (1.0, 1.0), values, estimate=estimate)


def convergent(estimate: tuple[str, ...] = ("c", "x0", "y0", "K1", "K2", "P1", "P2")) -> Simulated:
    """Eight convergent photos, rolled by quarters, of 36 control points with relief."""
    own = a_camera(estimate)
    generator = np.random.default_rng(1)
    points = np.column_stack(
        [
            np.tile(np.linspace(-4, 4, 6), 6),
            np.repeat(np.linspace(-3, 3, 6), 6),
            generator.uniform(-0.8, 0.8, 36),
        ]
    )
    centres, rotations = [], []
    for k in range(8):
        azimuth = k * np.pi / 4
        centre = np.array([6.0 * np.cos(azimuth), 6.0 * np.sin(azimuth), 8.0])
        back = centre / np.linalg.norm(centre)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        level = np.array([right, np.cross(back, right), back])
        roll = (k % 4) * np.pi / 2
        turn = np.array([[np.cos(roll), np.sin(roll), 0], [-np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        centres.append(centre)
        rotations.append(turn @ level)
    return _imaged(own, np.array(centres), np.array(rotations), points, 0.002)


def flight(turned: bool = True, flat: bool = False) -> Simulated:
    """Two lines of seven nearly vertical photos flown there and back over 84 control points."""
    estimate = ("K1", "K2") if flat else ("c", "x0", "y0", "K1", "K2")
    own = a_camera(estimate)
    generator = np.random.default_rng(2)
    grid = np.meshgrid(np.linspace(-60, 220, 12), np.linspace(-50, 100, 7))
    points = np.column_stack(
        [grid[0].ravel(), grid[1].ravel(), (0.0 if flat else 25.0) * generator.random(84)]
    )
    centres, angles = [], []
    for line, heading in ((0, 0.0), (1, np.pi if turned else 0.0)):
        for k in range(7):
            along = 25.0 * k if line == 0 else 25.0 * (6 - k)
            centres.append([along, 50.0 * line, 100.0 + (0.0 if flat else 20.0) * line])
            angles.append([*generator.uniform(-0.03, 0.03, 2), heading])
    return _imaged(own, np.array(centres), matrix_from_angles(np.array(angles)), points, 0.02)


def _imaged(own: Camera, centres: Array, rotations: Array, points: Array, sigma_m: float) -> Simulated:
    rows = []
    for j, point in enumerate(points):
        for i, (centre, rotation) in enumerate(zip(centres, rotations, strict=True)):
            seen = projected(own, (rotation @ (point - centre))[None, :])[0]
            if np.all(np.abs(seen) < [1990.0, 1490.0]):
                rows.append((i, j, *seen))
    table = np.array(rows)
    image, point_of, exact = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:]
    pose = np.hstack([angles_from_matrix(rotations), centres])
    held, weight = point_weights(np.full(points.shape, sigma_m))
    network = Network(
        (own,),
        Exposures(np.zeros(len(centres), dtype=np.int64), pose, np.full(pose.shape, np.inf)),
        Points(points, held, weight),
        Rays(image, point_of, exact, np.full(exact.shape, SIGMA)),
        tuple(f"i{i}" for i in range(len(centres))),
        tuple(f"p{j}" for j in range(len(points))),
    )
    return Simulated(network, exact)


def noisy(simulated: Simulated, seed: int, plane: Array | None = None, control_m: float = 0.002) -> Network:
    """Draw image coordinates and surveyed coordinates."""
    generator = np.random.default_rng(seed)
    network = simulated.network
    measured = (simulated.exact if plane is None else plane) + SIGMA * generator.standard_normal(
        simulated.exact.shape
    )
    surveyed = network.points.values + control_m * generator.standard_normal(network.points.values.shape)
    return replace(
        network,
        rays=replace(network.rays, plane=measured),
        points=replace(network.points, values=surveyed),
    )


@pytest.fixture(scope="module")
def networks() -> dict[str, Simulated]:
    return {"convergent": convergent(), "flight": flight()}


CONTROL_M = {"convergent": 0.002, "flight": 0.02}


def found(simulated: Simulated, seed: int, plane: Array, control_m: float = 0.002) -> tuple[Finding, ...]:
    return findings(search(fit(noisy(simulated, seed, plane, control_m))))


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


def test_a_missing_radial_term_is_found(networks: dict[str, Simulated]) -> None:
    own = networks["convergent"].network.cameras[0]
    x = networks["convergent"].exact - own.values[1:3]
    r2 = np.sum(x**2, axis=1, keepdims=True)
    plane = networks["convergent"].exact - 1.5e-22 * x * r2**3
    first = found(networks["convergent"], 5, plane)[0]
    assert (first.code, "K3 is missing from the model" in said(first)) == ("radial", True)
    assert abs(sized(first).figure - 1.5e-22) < 4 * (sized(first).sigma or 0.0)


def read_in_flight(made: Simulated) -> Array:
    """Image coordinates when the rows are read during a twentieth of the exposure interval, in flight."""
    network = made.network
    own, image = network.cameras[0], network.rays.image
    centres = network.exposures.values[:, 3:]
    velocity = np.vstack([np.gradient(centres[:7], axis=0), np.gradient(centres[7:], axis=0)])
    late = 0.05 * -made.exact[:, 1] / own.size_px[1]
    rotation = matrix_from_angles(network.exposures.values[:, :3])[image]
    moved = centres[image] + late[:, None] * velocity[image]
    q = np.einsum("nij,nj->ni", rotation, network.points.values[network.rays.point] - moved)
    return projected(own, q)


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
    kinds = [one.kind for one in candidates(fitted.network, fitted.state)]
    assert kinds.count("rolling-shutter") <= 1
    still = replace(fitted.state, centre=np.zeros_like(fitted.state.centre))
    assert "rolling-shutter" not in [one.kind for one in candidates(fitted.network, still)]


@pytest.mark.parametrize(("factor", "words", "small"), [(3.0, "too good", False), (0.4, "too poor", True)])
def test_a_wrong_sigma_is_found(
    networks: dict[str, Simulated], factor: float, words: str, small: bool
) -> None:
    network = with_sigmas(noisy(networks["convergent"], 7), 1.0 / factor)
    (one,) = findings(search(fit(network)))
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


def test_an_extra_parameter_is_estimated_as_the_adjustment_would(networks: dict[str, Simulated]) -> None:
    """Amount, precision and fall of the sum of squares against the engine's own K3."""
    network = noisy(networks["convergent"], 10)
    fitted = fit(network)
    (radial,) = [one for one in candidates(network, fitted.state) if one.kind == "radial"]
    outcome = estimated_amount(fitted, radial)
    assert outcome is not None
    at = 5
    own = network.cameras[0]
    estimated = own.estimated.copy()
    estimated[at] = True
    solution = fit(replace(network, cameras=(replace(own, estimated=estimated),)), fitted.state).solution
    # Measured x less K3 x r^6 here, added to the projection there: the same sign, to first order.
    sigma = float(np.sqrt(solution.camera_covariance[0, at, at]))
    assert outcome.sigma == pytest.approx(sigma, rel=0.05)
    assert outcome.amount == pytest.approx(-solution.cameras[0, at], abs=0.1 * sigma)
    fall = fitted.solution.chi_squared - solution.chi_squared
    variance = (fitted.solution.chi_squared - fall) / (fitted.solution.degrees_of_freedom - 1)
    # 0.08 of a standard deviation between both forms of the term.
    assert np.sqrt(outcome.statistic) == pytest.approx(np.sqrt(fall / variance), abs=0.1)


def test_what_the_unknowns_take_up_cannot_be_tested(networks: dict[str, Simulated]) -> None:
    fitted = fit(noisy(networks["convergent"], 10))
    (radial,) = [one for one in candidates(fitted.network, fitted.state) if one.kind == "radial"]
    shift = replace(radial, displacement=np.ones_like(radial.displacement))
    assert estimated_amount(fitted, shift) is None


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


def test_the_residual_map_finds_a_patch_and_nothing_else() -> None:
    generator = np.random.default_rng(12)
    pixel = generator.uniform(0, [4000, 3000], (4000, 2))
    w = generator.standard_normal((4000, 2))
    patch = (pixel[:, 0] > 3000) & (pixel[:, 1] < 750)
    clean = residual_map((4000, 3000), pixel, 0.3 * w, w, 1.0)
    dirty = residual_map((4000, 3000), pixel, 0.3 * (w + 1.2 * patch[:, None]), w + 1.2 * patch[:, None], 1.0)
    assert not clean.significant.any()
    assert clean.global_p_value > 0.01
    assert dirty.significant.any()
    assert dirty.global_p_value < 1e-10
    rows, columns = np.nonzero(dirty.significant)
    assert np.all(dirty.columns_px[columns + 1] > 3000)
    assert np.all(dirty.rows_px[rows] < 750)
    inside = dirty.mean_px[0, -1]
    np.testing.assert_allclose(inside, 0.36, atol=0.15)


def test_the_residual_map_keeps_its_level() -> None:
    generator = np.random.default_rng(13)
    alarms = 0.0
    for _ in range(400):
        pixel, w = generator.uniform(0, [400, 300], (300, 2)), generator.standard_normal((300, 2))
        alarms += float(residual_map((400, 300), pixel, w, w, 1.0, level=0.05).significant.any())
    # 20 expected, with a standard deviation of 4.4.
    assert abs(alarms - 20) < 4 * 4.4


@pytest.mark.parametrize(("rays", "shape"), [(1, (1, 1)), (240, (4, 3)), (10**6, (12, 9))])
def test_cells_are_as_many_as_the_rays_can_fill(rays: int, shape: tuple[int, int]) -> None:
    assert grid_shape((4000, 3000), rays) == shape


def test_variance_components_of_known_scatter() -> None:
    generator = np.random.default_rng(14)
    group = np.repeat(np.arange(5), 200)
    truth = np.array([1.0, 1.0, 1.0, 1.6, 1.0])
    v = generator.standard_normal(1000) * truth[group]
    parts = variance_components(tuple("abcde"), group, v**2, np.full(1000, 1.0))
    for part, sigma in zip(parts, truth, strict=True):
        assert part.ratio == pytest.approx(sigma, abs=4 * sigma / np.sqrt(400))
    assert min(parts, key=lambda part: part.p_value).name == "d"
    equal = variance_components(tuple("abcde"), group, (v / truth[group]) ** 2, np.full(1000, 1.0))
    assert all(part.p_value > 0.005 for part in equal)


def test_the_sigma_that_is_found_has_an_honest_interval() -> None:
    generator = np.random.default_rng(15)
    inside = 0
    for _ in range(300):
        v = 2.0 * np.sqrt(0.8) * generator.standard_normal((40, 2))
        one = assumed_sigma(np.full((40, 2), 1.0), v, np.full((40, 2), 0.8))
        # 80 residuals with redundancy 0.8 carry 64 degrees of freedom: the interval is a little wide.
        inside += one.lower < 2.0 < one.upper
    assert 285 - 4 * 3.8 <= inside <= 300


def test_an_image_gets_its_own_geometry_as_the_adjustment_would_give_it() -> None:
    """Scale, principal point and significance against a camera of its own for that image."""
    made = convergent(("c", "x0", "y0"))
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
