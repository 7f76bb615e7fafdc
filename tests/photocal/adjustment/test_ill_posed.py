"""Networks that do not determine their unknowns are answered with what is missing, never with numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.base.errors import IllPosedError, NotConvergedError
from tests.photocal import networks
from tests.photocal.networks import Scene

INF = np.inf


def complaint(*args: object, **kwargs: object) -> str:
    with pytest.raises(IllPosedError) as failure:
        adjust(networks.observe(*args, **kwargs))  # type: ignore[arg-type]
    assert "\n" not in str(failure.value)
    return str(failure.value)


def test_no_datum_at_all() -> None:
    said = complaint(networks.convergent(), np.random.default_rng(1), point_sigma=INF)
    for element in ("position in X", "position in Z", "rotation about Y", "scale"):
        assert element in said
    assert "rank defect 7" in said


def test_no_scale() -> None:
    sigma = np.full((6, 6), INF)
    sigma[0] = 0.0
    said = complaint(networks.convergent(), np.random.default_rng(2), point_sigma=INF, exposure_sigma=sigma)
    assert "rank defect 1" in said


def test_no_heights() -> None:
    """Positions known in X and Y only: the height of everything is free, and so is nothing else."""
    sigma = np.full((20, 3), INF)
    sigma[:, :2] = 0.003
    said = complaint(networks.convergent(), np.random.default_rng(3), point_sigma=sigma)
    assert "position in Z" in said
    assert "position in X" not in said
    assert "scale" not in said


def nadir(relief: float) -> Scene:
    """Vertical images over a field without relief."""
    own = networks.lens(estimate=("c", "x0", "y0"), K1=0.0, K2=0.0, K3=0.0, P1=0.0, P2=0.0, B1=0.0, B2=0.0)
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-60, 60, (40, 2)), rng.uniform(-relief, relief, 40)])
    places = np.array([[x, y, 100.0] for x in (-20.0, 0.0, 20.0) for y in (-15.0, 15.0)])
    return Scene((own,), np.zeros(6, np.int64), np.hstack([np.zeros((6, 3)), places]), points)


def test_flat_vertical_block_does_not_give_the_principal_distance() -> None:
    # Exactly vertical images over a plane with its scale held: c goes with the flying height (Merchant).
    sigma = np.full((6, 6), INF)
    sigma[:, :3] = 0.0
    said = complaint(nadir(0.0), None, point_sigma=0.0, exposure_sigma=sigma, disturb=0.0)
    assert "c" in said.partition("separate")[2]
    assert "Z" in said.partition("separate")[2]


def test_null_vectors_are_given_in_units() -> None:
    """A camera over a plane: 1 mm of c goes with the flying height over c, of the height of every image."""
    sigma = np.full((6, 6), INF)
    sigma[:, :3] = 0.0
    network = networks.observe(nadir(0.0), None, point_sigma=0.0, exposure_sigma=sigma, disturb=0.0)
    with pytest.raises(IllPosedError) as failure:
        adjust(network)
    # x0 goes with X and y0 with Y, each alone.
    assert len(failure.value.details) == 3
    (vector,) = (line for line in failure.value.details if "c of camera" in line)
    parts = {part.split(" ", 2)[2]: float(part.split()[0]) for part in vector.split(": ")[1].split(", ")}
    c = parts["c of camera main"]
    heights = np.array([parts[f"Z of image i{i}"] for i in range(6)])
    # 100 m above the plane with 20 mm: what the images fix is the ratio of the two.
    assert heights / c == pytest.approx(np.full(6, 100.0 / 20.0), rel=1e-3)


def test_all_images_from_one_place() -> None:
    scene = networks.convergent()
    exposures = scene.exposures.copy()
    exposures[:, 3:] = [0.0, 0.0, 9.0]
    for image in range(6):
        exposures[image, :3] = networks.looking(
            exposures[image, 3:], np.array([0.1 * image, 0.0, 0.0]), image
        )
    sigma = np.full((20, 3), INF)
    sigma[:6] = 0.003
    said = complaint(
        replace(scene, exposures=exposures), np.random.default_rng(4), point_sigma=sigma, disturb=0.0
    )
    assert "intersect" in said or "separate" in said


def test_mirrored_start_values_end_at_the_truth_or_in_words() -> None:
    scene = networks.convergent()
    given = networks.observe(scene, np.random.default_rng(5))
    values = given.exposures.values.copy()
    values[:, 3:] *= -1.0
    mirrored = replace(given, exposures=replace(given.exposures, values=values))
    try:
        solution = adjust(mirrored)
    except (IllPosedError, NotConvergedError) as failure:
        assert "\n" not in str(failure)  # noqa: PT017
    else:
        assert solution.exposures[:, 3:] == pytest.approx(scene.exposures[:, 3:], abs=0.05)


def test_collinear_control_leaves_a_rotation_open() -> None:
    scene = networks.convergent()
    points = scene.points.copy()
    points[:4] = [[-2.0, 0.5, 0.0], [-1.0, 0.5, 0.0], [1.0, 0.5, 0.0], [2.0, 0.5, 0.0]]
    sigma = np.full((len(points), 3), np.inf)
    sigma[:4] = 0.003
    network = networks.observe(replace(scene, points=points), np.random.default_rng(1), point_sigma=sigma)
    with pytest.raises(IllPosedError, match="rotation about X"):
        adjust(network)


def test_a_point_that_is_held_behind_the_cameras_is_named() -> None:
    """A control point with its height far above the flight: no image can see it."""
    scene = networks.convergent()
    sigma = np.full((len(scene.points), 3), np.inf)
    sigma[:4] = 0.0
    network = networks.observe(scene, np.random.default_rng(1), point_sigma=sigma)
    points = network.points.values.copy()
    points[2] += 10.0 * (network.exposures.values[:, 3:].mean(axis=0) - points[2])
    wrong = replace(network, points=replace(network.points, values=points))
    with pytest.raises(NotConvergedError, match=rf"behind the camera \({network.point_names[2]} of "):
        adjust(wrong)
