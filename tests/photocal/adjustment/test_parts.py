"""Blocks in parts against the same blocks as a whole: values, covariances, statistics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network, Relations
from photocal.adjustment.parts import work
from photocal.adjustment.parts.adjusting import adjust_parts, solution_of_parts
from photocal.adjustment.parts.dissection import dissect
from photocal.adjustment.parts.forecast import forecast
from photocal.adjustment.parts.part import SubNetwork, divided, images_together
from photocal.adjustment.parts.portions import Portion, together_in, write_parts, write_portions
from photocal.adjustment.solution import Solution
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.workers import Workers
from tests.photocal.strips import Floats, Strips


def in_parts(network: Network, folder: Path, most: int, workers: Workers = 1) -> Solution:
    """Adjust a network in parts of at most so many inner images."""
    dissection = write_parts(network, most, folder)
    assert len(dissection.parts) > 2
    adjusted = adjust_parts(folder, dissection, workers, free=network.datum_points is not None)
    return solution_of_parts(folder, adjusted, len(dissection.parts))


def sigmas(covariance: Floats) -> Floats:
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def assert_same(found: Solution, whole: Solution, sigma: Floats) -> None:
    """The same minimum and the same statistics, far within what anybody could use."""
    assert found.chi_squared == pytest.approx(whole.chi_squared, rel=1e-9)
    for name in ("observations", "unknowns", "datum_defect"):
        assert getattr(found, name) == getattr(whole, name), name
    pairs = [
        ("cameras", "camera_covariance"),
        ("exposures", "exposure_covariance"),
        ("points", "point_covariance"),
    ]
    for values, covariance in pairs:
        expected = sigmas(getattr(whole, covariance))
        known = expected > 0
        off = getattr(found, values) - getattr(whole, values)
        if values == "exposures":
            off[:, :3] = np.remainder(off[:, :3] + np.pi, 2 * np.pi) - np.pi
        assert np.abs(off[known] / expected[known]).max() < 1e-4, values
        assert np.abs(sigmas(getattr(found, covariance))[known] / expected[known] - 1).max() < 1e-6, values
        assert np.abs(off[~known]).max(initial=0.0) == 0.0
    scale = np.maximum(np.abs(whole.common_covariance).max(initial=0.0), 1e-30)
    assert np.abs(found.common_covariance - whole.common_covariance).max(initial=0.0) < 1e-6 * scale
    assert np.abs((found.residuals - whole.residuals) / sigma).max() < 1e-4
    assert np.abs(found.redundancy - whole.redundancy).max() < 1e-7
    for one, other in zip(found.groups, whole.groups, strict=True):
        assert (one.name, one.observations) == (other.name, other.observations)
        assert one.redundancy == pytest.approx(other.redundancy, rel=1e-7)
    for name in ("image", "parameter"):
        assert np.array_equal(getattr(found.photo_variant, name), getattr(whole.photo_variant, name))
    assert found.photo_variant.sigma == pytest.approx(whole.photo_variant.sigma, rel=1e-6)
    assert found.photo_variant.values == pytest.approx(whole.photo_variant.values, rel=1e-9)


BLOCKS = {
    "positions": Strips(5, 12, rays=60),
    "control alone, two cameras": Strips(5, 12, rays=60, positions=False, control=40, cameras=2),
    "free": Strips(5, 12, rays=60, positions=False),
    "antenna with lever arm, three cameras": Strips(5, 12, rays=60, antenna=True, cameras=3, control=60),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_sixty_images_in_parts_are_the_whole(name: str, tmp_path: Path) -> None:
    network = BLOCKS[name].network()
    whole = adjust(network)
    if name == "free":
        assert whole.datum_defect == 7
    assert_same(in_parts(network, tmp_path, 16), whole, network.rays.sigma)


def test_parameters_of_single_images_held_values_and_priors(tmp_path: Path) -> None:
    network = BLOCKS["positions"].network()
    sigma = network.exposures.sigma.copy()
    sigma[::5, :3], sigma[7::11, 5] = 0.01, 0.0
    first = np.arange(len(network.cameras[0].values))
    cameras = tuple(
        replace(
            one,
            deviation_sigma=np.where(first == 0, 0.01, 0.0),
            prior_sigma=np.where(first < 3, 0.02, np.inf),
        )
        for one in network.cameras
    )
    network = replace(network, cameras=cameras, exposures=replace(network.exposures, sigma=sigma))
    whole = adjust(network)
    assert len(whole.photo_variant.image) == 60
    assert_same(in_parts(network, tmp_path, 16), whole, network.rays.sigma)


def test_a_free_block_has_inner_constraints_over_the_points_given(tmp_path: Path) -> None:
    network = BLOCKS["free"].network()
    network = replace(network, datum_points=np.arange(3, len(network.point_names), 7))
    assert_same(in_parts(network, tmp_path, 16), adjust(network), network.rays.sigma)


def test_nothing_changes_where_no_memory_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts that fall out are computed again from their file and their state."""
    network = BLOCKS["positions"].network()
    kept = in_parts(network, tmp_path, 16)
    reads = list[int]()
    original = work.read_part

    def read(folder: str, part: int) -> SubNetwork:
        reads.append(part)
        return original(folder, part)

    monkeypatch.setattr(work, "read_part", read)
    monkeypatch.setattr(work, "available_memory", lambda: 0)
    again = in_parts(network, tmp_path, 16)
    assert len(reads) > 3 * len(set(reads))
    assert again.chi_squared == kept.chi_squared
    assert np.array_equal(again.point_covariance, kept.point_covariance)


def portions_of(network: Network, many: int) -> list[Portion]:
    """A network in so many portions."""
    result, rays = [], network.rays
    for numbers in np.array_split(np.arange(len(network.point_names)), many):
        kept = (rays.point >= numbers[0]) & (rays.point <= numbers[-1])
        chosen = rays.rows(kept)
        names = tuple(network.point_names[j] for j in numbers)
        seen = replace(chosen, point=chosen.point - numbers[0])
        result.append(Portion(network.points.rows(numbers), seen, names, numbers, np.flatnonzero(kept)))
    return result


def test_a_block_divided_by_portions_has_the_parts_of_the_whole(tmp_path: Path) -> None:
    network = BLOCKS["antenna with lever arm, three cameras"].network()
    empty = replace(
        network, points=network.points.rows([]), rays=network.rays.rows([]), point_names=(), datum_points=None
    )
    whole, portions = tmp_path / "whole", tmp_path / "portions"
    whole.mkdir()
    portions.mkdir()
    dissection = write_parts(network, 16, whole)
    in_four = portions_of(network, 4)
    again = dissect(together_in(in_four, 60), network.exposures.started[:, 3:], 16)
    write_portions(empty, in_four, again, portions)
    assert np.array_equal(again.node, dissection.node)
    for number in range(len(dissection.parts)):
        one, other = work.read_part(whole, number), work.read_part(portions, number)
        for name in ("images", "points", "rays", "inside", "home", "first"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        assert one.network.point_names == other.network.point_names
        assert np.array_equal(one.network.rays.point, other.network.rays.point)
    assert not list(portions.glob("piece*"))


@st.composite
def seen(draw: st.DrawFn) -> tuple[Network, int]:
    """Places of images, and points that are seen by those around them, some of them by no one else."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 60))
    centre = rng.uniform(0.0, 10.0, (count, 3)) * [1.0, draw(st.sampled_from([0.0, 0.3, 1.0])), 0.1]
    points = draw(st.integers(1, 150))
    of_point = [
        np.argsort(np.linalg.norm(centre - rng.uniform(0.0, 10.0, 3) * [1.0, 0.3, 0.1], axis=1))[
            : rng.integers(1, 6)
        ]
        for _ in range(points)
    ]
    image = np.concatenate(of_point)
    point = np.repeat(np.arange(points), [len(one) for one in of_point])
    frame = replace(Strips(1, count, rays=1, antenna=True).frame(), datum_points=None)
    start = frame.exposures.values.copy()
    start[:, 3:] = centre
    xyz = np.zeros((points, 3))
    network = replace(
        frame,
        exposures=replace(frame.exposures, values=start),
        points=replace(frame.points, values=xyz, held=xyz != 0, weight=np.zeros((points, 3, 3))),
        rays=replace(
            frame.rays,
            image=image,
            point=point,
            plane=np.zeros((len(image), 2)),
            sigma=np.ones((len(image), 2)),
        ),
        point_names=tuple(map(str, range(points))),
    )
    return network, draw(st.integers(1, 20))


@given(seen())
@settings(deadline=None)
def test_parts_share_all_and_are_joined_by_separators_alone(made: tuple[Network, int]) -> None:
    network, most = made
    rays, count = network.rays, len(network.image_names)
    together = images_together(rays.image, rays.point, count)
    dissection = dissect(together, network.exposures.started[:, 3:], most)
    assert (dissection.node >= 0).all()
    assert (dissection.parent[:-1] > np.arange(len(dissection.parent) - 1)).all()
    parts = list(divided(network, dissection))
    # Each image is inside one part or in a separator; points, rays and observations count once.
    inside = np.concatenate([part.images[part.inside] for part in parts])
    separators = np.flatnonzero(~np.isin(dissection.node, dissection.parts))
    assert sorted([*inside, *separators]) == list(range(count))
    assert sorted(np.concatenate([part.points for part in parts])) == list(range(len(network.point_names)))
    assert sorted(np.concatenate([part.rays for part in parts])) == list(range(len(rays.image)))
    assert sorted(np.concatenate([part.images[part.home] for part in parts])) == list(range(count))
    assert sum(len(part.network.positions.image) for part in parts) == count
    assert sum(part.first for part in parts) == 1
    # No point of a part is seen by an inner image of another, nor by one that is not above it.
    for number, part in enumerate(parts):
        assert np.array_equal(part.images[part.network.rays.image], rays.image[part.rays])
        assert np.array_equal(part.points[part.network.rays.point], rays.point[part.rays])
        above, node = set[int](), int(dissection.parts[number])
        while node >= 0:
            above.add(node)
            node = int(dissection.parent[node])
        assert set(dissection.node[rays.image[part.rays]].tolist()) <= above
    # The forecast counts no less than the fronts that there are.
    counted = forecast(together, network.exposures.started[:, 3:], dissection)
    assert counted.inner.tolist() == [int(part.inside.sum()) for part in parts]
    assert counted.own.sum() == len(separators)


def test_what_no_part_could_hold_is_refused(tmp_path: Path) -> None:
    network = BLOCKS["positions"].network()
    one = np.zeros(1, dtype=np.int64)
    related = replace(network, relations=Relations(one, one, one + 1, np.ones(1), np.ones(1)))
    with pytest.raises(ConfigurationError, match="cannot be adjusted in parts"):
        write_parts(related, 16, tmp_path)


def test_a_block_without_a_datum_is_refused(tmp_path: Path) -> None:
    network = replace(BLOCKS["free"].network(), datum_points=None)
    with pytest.raises(IllPosedError, match="are not determined"):
        in_parts(network, tmp_path, 16)


def test_an_image_that_no_ray_determines_is_named(tmp_path: Path) -> None:
    network = BLOCKS["positions"].network()
    part = next(
        divided(
            network,
            dissect(
                images_together(network.rays.image, network.rays.point, 60),
                network.exposures.started[:, 3:],
                16,
            ),
        )
    )
    image = int(part.images[part.inside][0])
    kept = network.rays.image != image
    with pytest.raises(IllPosedError, match=f"of image i{image} is not determined"):
        in_parts(replace(network, rays=network.rays.rows(kept)), tmp_path, 16)
