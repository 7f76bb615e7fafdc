"""Variance components: known factors are found again, and the real precision of the DCS460 readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjusted import fit
from photocal.adjustment.network import Network, Relations
from photocal.adjustment.variance_components import (
    VarianceComponents,
    estimate_components,
    rays_by_camera,
    rays_together,
    settled_factor,
    with_factors,
)
from photocal.base.errors import IllPosedError
from photocal.block.folder import read_block
from photocal.block.network import assemble
from tests.photocal import blocks, networks, oracle
from tests.photocal.analysis.georeferencing import flights

RUNS = 60
# What the standard deviations that enter have to be multiplied by.
TRUE = {"image one": 0.5, "image two": 2.0, "control": 1.5, "exposure": 0.7}


def scene() -> networks.Scene:
    own = {"model": "brown-ideal", "estimate": ("c", "x0", "y0", "K1")}
    cameras = tuple(networks.lens(name, **own) for name in ("one", "two"))  # type: ignore[arg-type]
    return networks.convergent(cameras, images=8, points=25)


def wrongly_weighted(truth: networks.Scene, seed: int) -> Network:
    """A network whose observations have errors of TRUE times the standard deviations it believes in."""
    rng = np.random.default_rng(seed)
    points, exposures = np.full((25, 3), np.inf), np.full((8, 6), np.inf)
    points[:15] = 0.003
    exposures[:, 3:] = 0.01
    exact = networks.observe(truth, None, point_sigma=points, exposure_sigma=exposures)
    camera = truth.camera_of[exact.rays.image]
    factor = np.array([TRUE["image one"], TRUE["image two"]])[camera][:, None]
    plane = exact.rays.plane + rng.normal(0, 1, exact.rays.plane.shape) * exact.rays.sigma * factor
    noise = rng.normal(0, 1, points.shape) * np.where(np.isfinite(points), points, 0.0) * TRUE["control"]
    values = truth.points + noise
    pose = truth.exposures.copy()
    pose[:, 3:] += rng.normal(0, 0.01 * TRUE["exposure"], (8, 3))
    return replace(
        exact,
        rays=replace(exact.rays, plane=plane),
        points=replace(exact.points, values=values),
        exposures=replace(exact.exposures, values=pose),
    )


@pytest.fixture(scope="module")
def trials() -> list[VarianceComponents]:
    truth = scene()
    made = (wrongly_weighted(truth, 500 + k) for k in range(RUNS))
    return [estimate_components(network, rays_by_camera(network)) for network in made]


@pytest.mark.parametrize("name", TRUE)
def test_known_factors_are_found(trials: list[VarianceComponents], name: str) -> None:
    """Over many networks the mean is the truth, and the scatter what each estimate says of itself."""
    found = [next(c for c in trial.components if c.name == name) for trial in trials]
    assert all(c.estimated for c in found)
    values = np.array([c.factor for c in found])
    stated = np.mean([c.sigma for c in found])
    assert values.mean() == pytest.approx(
        TRUE[name], abs=3.5 * values.std() / np.sqrt(RUNS) + 0.01 * TRUE[name]
    )
    assert values.std() == pytest.approx(stated, rel=0.35)


def test_every_group_fits_at_the_end(trials: list[VarianceComponents]) -> None:
    for trial in trials[:5]:
        assert trial.solution.variance_factor == pytest.approx(1.0, abs=2e-3)
        for group in trial.solution.groups:
            if group.name != "image":
                assert group.chi_squared == pytest.approx(group.redundancy, rel=2e-3)


def test_relations_and_held_groups() -> None:
    """A free network with distances; what is held stays as it is given."""
    truth = scene()
    rng = np.random.default_rng(12)
    network = networks.observe(truth, rng, point_sigma=np.inf)
    first, second = np.triu_indices(12, 1)
    length = np.linalg.norm(truth.points[first] - truth.points[second], axis=1)
    given = np.full(len(first), 0.002)
    relations = Relations(
        np.zeros(len(first), np.int64), first, second, length + rng.normal(0, 0.006, len(first)), given
    )
    network = replace(network, relations=relations, datum_points=np.zeros(0, np.int64))
    found = {c.name: c for c in estimate_components(network, hold=("image",)).components}
    assert not found["image"].estimated
    assert found["image"].factor == 1.0
    sigma = found["distance"].sigma
    assert sigma is not None
    assert found["distance"].factor == pytest.approx(3.0, abs=4 * sigma)
    assert sigma == pytest.approx(3.0 / np.sqrt(2 * found["distance"].redundancy), rel=0.4)


def test_begins_with_an_adjustment_that_is_at_hand() -> None:
    """The network as it is given is adjusted by whoever asks, and not again."""
    network, reported = wrongly_weighted(scene(), 5), list[float]()
    first = fit(network)
    made = estimate_components(network, report=lambda step: reported.append(step.chi_squared), start=first)
    assert 0.0 < max(reported) < 0.9 * first.solution.chi_squared
    for ours, alone in zip(made.components, estimate_components(network).components, strict=True):
        assert ours.factor == pytest.approx(alone.factor, rel=1e-6)


def test_nothing_to_see() -> None:
    """Observations without any error: the variance runs to zero and is named."""
    network = networks.observe(scene(), None, point_sigma=0.003)
    truth = scene()
    exact = replace(
        network,
        points=replace(network.points, values=truth.points),
        cameras=truth.cameras,
    )
    with pytest.raises(IllPosedError, match=r"group (image|control)"):
        estimate_components(exact)


def test_scaling_keeps_what_is_held_and_free() -> None:
    network = wrongly_weighted(scene(), 3)
    sigma = network.exposures.sigma.copy()
    sigma[0, 0] = 0.0
    network = replace(network, exposures=replace(network.exposures, sigma=sigma))
    scaled = with_factors(network, rays_together(network), {"image": 2.0, "exposure": 3.0, "control": 0.5})
    assert (np.isinf(scaled.exposures.sigma) == np.isinf(sigma)).all()
    assert scaled.exposures.sigma[0, 0] == 0.0
    assert scaled.rays.sigma == pytest.approx(2 * network.rays.sigma)
    assert scaled.points.weight == pytest.approx(4 * network.points.weight)


def precision_um(made: VarianceComponents) -> tuple[float, float]:
    """Standard deviation of the image coordinates, um, and of the control, mm."""
    by_name = {c.name: c for c in made.components}
    return 3.0 * by_name["image"].factor, 3.0 * by_name["control"].factor


def test_dcs460_with_square_pixels(tmp_path: Path) -> None:
    """The residuals of the readings are 1.20 um, not the 3 um that the study assumed.

    Their standard deviation is that times sqrt(n / r). A second, dense adjustment with the sigmas that were
    found gives every group a v'Pv equal to its redundancy.
    """
    folder = blocks.dcs460(tmp_path / "square", photo2=True, y_scale=blocks.SQUARE)
    made = estimate_components(assemble(read_block(folder)).network, hold=("camera",))
    image, control = precision_um(made)
    by_name = {c.name: c for c in made.components}
    rms = np.sqrt(np.mean(made.solution.residuals**2)) * 1000
    assert rms == pytest.approx(1.20, abs=0.03)
    assert image == pytest.approx(1.20 * np.sqrt(914 / by_name["image"].redundancy), rel=0.03)
    assert 1.5 <= control <= 3.0
    assert not by_name["camera"].estimated
    dense = oracle.adjust_densely(made.network)
    chi_squared = np.sum((dense.residuals / made.network.rays.sigma) ** 2)
    assert chi_squared == pytest.approx(dense.redundancy.sum(), rel=2e-3)
    # The eight priors of the camera, far wider than needed, are met almost exactly.
    assert dense.chi_squared == pytest.approx(dense.total_redundancy - 8, rel=2e-3)


def test_dcs460_as_published_hides_it(tmp_path: Path) -> None:
    """With the pixel scale of the study the systematic error looks like 3 um of noise."""
    folder = blocks.dcs460(tmp_path / "published", photo2=True)
    image, _ = precision_um(estimate_components(assemble(read_block(folder)).network))
    assert 2.7 <= image <= 3.2


def test_reports_every_iteration() -> None:
    seen: list[float] = []
    note: Callable[[object], None] = lambda iteration: seen.append(iteration.chi_squared)  # type: ignore[attr-defined]  # noqa: E731
    estimate_components(wrongly_weighted(scene(), 5), report=note)
    assert len(seen) > 3


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Network:
    """A flight with positions and attitudes."""
    plan = flights.Plan(tie=40, estimate=("c", "x0", "y0", "K1"), mounting="lever_arm_sigma_m = 0.02")
    folder = flights.fly(tmp_path_factory.mktemp("flown") / "block", np.random.default_rng(8), plan=plan)
    return assemble(read_block(folder)).network


@pytest.mark.parametrize("stated", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("group", ["position", "attitude"])
def test_a_factor_settles_without_adjustments_as_with_them(flown: Network, group: str, stated: float) -> None:
    """Rounds of adjustments (Foerstner 1979) against rounds with the derivatives of one minimum."""
    network = with_factors(flown, rays_together(flown), {group: stated})
    others = {"image", "position", "attitude", "mounting", "control"} - {group}
    components = estimate_components(network, hold=others, settled=1e-6).components
    (known,) = (part for part in components if part.name == group)
    first = fit(network)
    factor, near = settled_factor(first.factored, group)
    # What is left is the curvature of the equations over the way from one minimum to the other.
    assert factor == pytest.approx(known.factor, rel=0.01)
    last = fit(with_factors(network, rays_together(network), {group: factor}))
    left, way = (np.abs(state.centre - last.state.centre).max() for state in (near, first.state))
    assert left < 0.01 * way
