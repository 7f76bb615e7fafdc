"""The lens that the rays of a flight prefer, against the one that its rays were made with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.block.model import Block, Images
from photocal.geometry.camera import PARAMETERS, Camera, Model, camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.release import with_chosen_lenses, with_shutters_closed
from photocal.measurement.tie_adjustment import AdjustedTies, adjust_ties
from photocal.measurement.tracks import Tracks

SIZE, C = (2000, 1500), 1500.0
ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")
CORNER = np.hypot(*SIZE) / 2


def lens(model: Model, k: tuple[float, ...], estimate: tuple[str, ...] = ()) -> Camera:
    """Coefficients as displacements of the corner, as shares of its radius."""
    values = {f"K{n}": share / CORNER ** (2 * n) for n, share in enumerate(k, 1)}
    return camera("c", model, "px", SIZE, (1.0, 1.0), {"c": C, **values}, estimate=estimate)


def flown(
    true: Camera,
    seed: int,
    unknown: bool = False,
    readout: float = 0.0,
    noise_px: float = 0.5,
    forwards: bool = False,
) -> tuple[AdjustedTies, Block, Tracks]:
    """Two heights of strips over hills, positions to 3 cm; adjusted without K4.

    With a readout (s) at 8 m/s there and back in gusts of 2 deg/s. Or 45 images, flown to where their top is,
    slower below: there rows move nearly alike.
    """
    rng = np.random.default_rng(seed)
    places = np.array(
        [
            [x, y, 60.0 + 15 * (k % 2)]
            for k, y in enumerate((-12.0, 0, 12))
            for x in range(-30, 31, 5 if forwards else 15)
        ]
    )
    count, ground = len(places), rng.uniform([-55, -40, -4], [55, 40, 4], (900, 3))
    angles = np.column_stack(
        [rng.normal(0, 0.03, (count, 2)), np.where(np.arange(count) < 8, 0.0, np.pi / 2)]
    )
    views = OrientedImages(("i",) * count, (true,), np.zeros(count, np.int64), np.hstack([angles, places]))
    speed = np.where(np.arange(count) % 2, -8.0, 8.0)[:, None] * [1.0, 0, 0]
    if forwards:
        ahead = np.column_stack([-np.sin(angles[:, 2]), np.cos(angles[:, 2]), np.zeros(count)])
        speed = np.where(places[:, 2:] > 70, 9.5, 5.7) * ahead
    if readout:
        gusts = np.hstack([rng.normal(0, 0.3, (count, 3)), rng.normal(0, np.radians(2.0), (count, 3))])
        movement = readout * (np.hstack([speed, np.zeros((count, 3))]) + gusts)
        rolls = replace(true.changed(readout=readout), shutter="rolling", readout_direction="top-to-bottom")
        views = replace(views, cameras=(rolls,), movement=movement)
    track, image = np.repeat(np.arange(900), count), np.tile(np.arange(count), 900)
    pixels = views.project(image, ground[track]) + rng.normal(0, noise_px, (len(track), 2))
    inside = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=1)
    tracks = Tracks(track, image, pixels, np.ones(len(track))).some(np.asarray(inside))
    own = lens("brown-ideal", (), ESTIMATE)
    own = replace(own, shutter="unknown") if unknown else own
    sigma = np.full((count, 6), np.inf)
    sigma[:, 3:] = 0.03
    values = np.hstack([angles, places + rng.normal(0, 0.03, places.shape)])
    images = Images(tuple(f"{k}.jpg" for k in range(count)), np.zeros(count, np.int64), values, sigma)
    if unknown:
        images.motion[:, :3], images.motion_sigma[:, :3] = speed, 0.3
        images.motion_sigma[:, 3:] = np.radians(6.0)
    block = Block("b", "local", "", "control", (own,), images)
    return adjust_ties(block, values, tracks), block, tracks


@pytest.mark.parametrize(
    ("true", "terms"),
    [
        (lens("brown-observed", (-0.25, 0.12)), ("brown-observed", False)),
        (lens("brown-ideal", (-0.20, 0.10, -0.04, 0.05)), ("brown-ideal", True)),
    ],
    ids=["observed", "ideal K4"],
)
def test_the_lens_that_made_the_rays_is_chosen(true: Camera, terms: tuple[Model, bool]) -> None:
    adjusted, block, tracks = flown(true, 1)
    better, chosen, findings = with_chosen_lenses(adjusted, block, tracks)
    own = chosen.cameras[0]
    assert (own.model, "K4" in own.free) == terms
    assert [(one.code, one.figures["model"]) for one in findings] == [("lens-chosen", terms[0])]
    assert better.start.cameras[0].model == terms[0]
    sigma = np.sqrt(better.solution.camera_covariance[0, 0, 0])
    assert better.solution.cameras[0, 0] == pytest.approx(C, abs=3.5 * sigma)
    # Values that were given, and what nobody asked for, stay.
    same = np.array([name != "K4" for name in PARAMETERS])
    assert (own.estimated[same] == block.cameras[0].estimated[same]).all()
    assert (own.values == block.cameras[0].values).all()


@pytest.mark.parametrize("seed", range(2, 5))
def test_a_lens_that_is_right_stays(seed: int) -> None:
    adjusted, block, tracks = flown(lens("brown-ideal", (-0.10, 0.05, -0.02)), seed)
    _, chosen, findings = with_chosen_lenses(adjusted, block, tracks)
    assert findings == []
    assert chosen.cameras[0].model == "brown-ideal"
    assert chosen.cameras[0].free == ESTIMATE


def test_a_wrong_lens_is_no_readout() -> None:
    """Shutters are tested only with the lens that was chosen."""
    adjusted, block, tracks = flown(lens("brown-observed", (-0.25, 0.12)), 8, unknown=True)
    closed = with_shutters_closed(adjusted)
    assert [own.shutter for own in closed.start.cameras] == ["global"]
    better, chosen, _ = with_chosen_lenses(closed, block, tracks)
    assert chosen.cameras[0].model == "brown-observed"
    assert not better.start.cameras[0].rolling
    assert better.start.cameras[0].shutter == "unknown"


@pytest.mark.parametrize(("seed", "readout"), [(3, 0.06), (4, 0.025), (5, 0.025)])
def test_a_readout_is_no_other_lens(seed: int, readout: float) -> None:
    """Where the shutter rolls and its readout is left out, any lens with more terms fits better."""
    adjusted, block, tracks = flown(lens("brown-ideal", (-0.10, 0.05, -0.02)), seed, True, readout)
    better, chosen, findings = with_chosen_lenses(with_shutters_closed(adjusted), block, tracks)
    assert findings == []
    assert (chosen.cameras[0].model, chosen.cameras[0].free) == ("brown-ideal", ESTIMATE)
    assert better.start.cameras[0].rolling


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_pixels_that_are_not_square_are_no_readout(seed: int) -> None:
    """Sides that differ by 0.04 %, there and back over hills and with a crossing height."""
    true = lens("brown-ideal", (-0.10, 0.05, -0.02)).changed(B1=4e-4)
    adjusted, block, tracks = flown(true, seed, unknown=True)
    better, chosen, findings = with_chosen_lenses(with_shutters_closed(adjusted), block, tracks)
    assert chosen.cameras[0].free == (*ESTIMATE, "B1")
    assert [one.figures["names"][-1] for one in findings] == ["B1"]
    assert not better.start.cameras[0].rolling
    scale = PARAMETERS.index("B1")
    assert np.isinf(chosen.cameras[0].prior_sigma[scale])
    free = adjust_ties(chosen, better.values, better.tracks).solution
    assert free.cameras[0, scale] == pytest.approx(
        4e-4, abs=3.3 * np.sqrt(free.camera_covariance[0, scale, scale])
    )


@pytest.mark.parametrize(("seed", "noise_px"), [(1, 0.05), (4, 0.1)])
def test_a_scale_is_no_readout_of_images_that_move_on_their_own(seed: int, noise_px: float) -> None:
    """Flown forwards a readout is found first: what each image may move by fits any rays a little better."""
    true = lens("brown-ideal", (-0.10, 0.05, -0.02)).changed(B1=4e-4)
    adjusted, block, tracks = flown(true, seed, unknown=True, noise_px=noise_px, forwards=True)
    assert adjusted.start.cameras[0].rolling
    better, chosen, _ = with_chosen_lenses(with_shutters_closed(adjusted), block, tracks)
    assert chosen.cameras[0].free == (*ESTIMATE, "B1")
    assert not better.start.cameras[0].rolling


def test_coefficients_that_are_known_or_held_leave_no_choice() -> None:
    true = lens("brown-observed", (-0.25, 0.12))
    adjusted, block, tracks = flown(true, 1)
    prior = np.where(np.array([name == "K1" for name in PARAMETERS]), 1e-9, np.inf)
    for own in (
        replace(block.cameras[0], estimated=np.array([name == "c" for name in PARAMETERS])),
        replace(
            block.cameras[0],
            estimated=np.array([name in ("c", "K1") for name in PARAMETERS]),
            prior_sigma=prior,
        ),
    ):
        _, chosen, findings = with_chosen_lenses(adjusted, replace(block, cameras=(own,)), tracks)
        assert findings == []
        assert chosen.cameras == (own,)
