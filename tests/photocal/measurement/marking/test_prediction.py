"""Predictions: places, ellipses that hold what they promise, and what cannot be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.block.folder import read_points
from photocal.block.project import read_project
from photocal.exchange.parts import Mark
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.marking.adjustment import adjust_marks
from photocal.measurement.orientation import WITHIN_95, Orientation, ellipse, of_project, of_run, predict
from tests.photocal.measurement.marking.conftest import IMAGES, POINTS, Survey


def known(survey: Survey) -> Orientation:
    found = of_project(read_project(survey.file), survey.site.names)
    assert found is not None
    return found


def true_marks(survey: Survey, noise: float = 0.0) -> list[Mark]:
    rng = np.random.default_rng(2)
    marks = []
    for image in survey.site.names:
        for k in range(POINTS):
            x, y = np.array(survey.truth(image, f"P{k + 1}")) + rng.normal(0, noise, 2)
            marks.append(Mark(image, f"P{k + 1}", float(x), float(y), (0.1, 0.1), ""))
    return marks


def test_ellipses_hold_the_spread_of_simulated_errors(flown: Survey) -> None:
    """The covariance against 4000 draws of all that has a sigma."""
    own = known(flown)
    xyz, sigma = flown.points[3], np.array([0.02, 0.03, 0.05])
    found = predict(own, xyz, sigma)
    rng = np.random.default_rng(1)
    draws = 4000
    values, spread = own.images.values[2], own.images.sigma[2]
    poses = values + rng.normal(0, 1, (draws, 6)) * spread
    (camera,) = own.images.cameras
    c = camera.value("c") + rng.normal(0, 1.0, draws)
    views = OrientedImages(("i",) * draws, (camera,), np.zeros(draws, np.int64), poses)
    places = xyz + rng.normal(0, 1, (draws, 3)) * sigma
    pixels = np.array(
        [
            replace(views.only([k]), cameras=(camera.with_values(np.r_[value, camera.values[1:]]),)).project(
                np.zeros(1, np.int64), places[k : k + 1]
            )[0]
            for k, value in enumerate(c)
        ]
    )
    drawn = np.cov(pixels.T)
    assert np.allclose(found.covariance[2], drawn, rtol=0.08, atol=0.03 * np.trace(drawn))
    assert np.allclose(found.pixels[2], pixels.mean(axis=0), atol=0.3)
    outline = ellipse(found.covariance[2])
    assert outline is not None
    turn = np.array([np.cos(outline["direction"]), np.sin(outline["direction"])])
    along = (pixels - found.pixels[2]) @ turn
    across = (pixels - found.pixels[2]) @ [-turn[1], turn[0]]
    inside = np.mean((along / outline["major"]) ** 2 + (across / outline["minor"]) ** 2 < 1)
    assert inside == pytest.approx(0.95, abs=0.012)
    assert pytest.approx(2.4477, abs=1e-4) == WITHIN_95


def test_images_know_what_they_cannot_see(flown: Survey) -> None:
    own = known(flown)
    count = len(own.images.names)
    far = predict(own, np.array([500.0, 0, 0]), np.zeros(3))
    assert (far.probability == 0).all()
    above = predict(own, np.array([0.0, 0, 60]), np.zeros(3))
    assert (above.probability == 0).all()
    assert np.isnan(above.pixels).all()
    values = own.images.values.copy()
    values[1] = np.nan
    lost = predict(replace(own, images=replace(own.images, values=values)), flown.points[0], np.zeros(3))
    assert np.isnan(lost.probability).tolist() == [k == 1 for k in range(count)]
    silent = replace(own, images=replace(own.images, covariance=None))
    unsure = predict(silent, flown.points[0], np.zeros(3))
    assert np.isfinite(unsure.pixels).all()
    assert ellipse(unsure.covariance[0]) is None


def test_a_point_at_the_edge_is_in_the_image_half_of_the_time(flown: Survey) -> None:
    own = known(flown)
    at = own.images.values[2, 3:]
    low, high = at[0], at[0] + 40
    for _ in range(60):
        middle = (low + high) / 2
        found = predict(own, np.array([middle, at[1], 0.0]), np.zeros(3))
        inside = found.pixels[2, 0] < 479.5
        low, high = (middle, high) if inside else (low, middle)
    assert found.probability[2] == pytest.approx(0.5, abs=0.01)


def test_adjusted_marks_orient_the_images_and_find_the_wrong_one(flown: Survey) -> None:
    own, points = known(flown), read_points(flown.folder / "control.csv")
    marks = true_marks(flown, 0.1)
    found = adjust_marks(own, points, marks)
    assert len(found.residuals) == POINTS * IMAGES
    assert found.sigma0 == pytest.approx(1, abs=0.35)
    assert found.left_out == ()
    for k in range(POINTS):
        better = predict(found.orientation, flown.points[k], np.zeros(3))
        truth = np.array([flown.truth(image, f"P{k + 1}") for image in flown.site.names])
        sigma = np.sqrt(np.trace(better.covariance, axis1=1, axis2=2))
        assert (np.hypot(*(better.pixels - truth).T) < 4 * sigma + 0.05).all()
        assert sigma.max() < 0.6
    bad = replace(marks[7], x=marks[7].x + 1.5)
    wrong = adjust_marks(own, points, [*marks[:7], bad, *marks[8:]])
    worst = max(wrong.residuals, key=lambda r: r["in_sigmas"] or 0)
    assert (worst["image"], worst["point"]) == (bad.image, bad.point)
    assert worst["in_sigmas"] is not None
    assert worst["in_sigmas"] > 6


def test_images_without_exposures_need_marks_enough(flown: Survey) -> None:
    own, points = known(flown), read_points(flown.folder / "control.csv")
    unknown = replace(own.images, values=np.full((IMAGES, 6), np.nan), covariance=None)
    nothing = replace(own, images=unknown)
    marks = [m for m in true_marks(flown) if m.image != "p2.png" or m.point in ("P1", "P2")]
    found = adjust_marks(nothing, points, marks)
    assert found.left_out == ({"image": "p2.png", "marks": 2, "needed": 4},)
    assert {r["image"] for r in found.residuals} == {"p1.png", "p3.png", "p4.png", "p5.png"}
    # The pictures' own rendering is not involved: only numbers are.
    assert max(np.hypot(r["vx"], r["vy"]) for r in found.residuals) < 0.05


def test_a_run_folder_says_how_images_are_oriented(survey: Survey) -> None:
    from photocal.block.results.adjusted import adjust_block
    from photocal.block.writer import write_block
    from photocal.measurement.marking.adjustment import block_of_marks

    own, points = known(survey), read_points(survey.folder / "control.csv")
    block, _ = block_of_marks(own, points, true_marks(survey))
    folder = survey.folder / "block"
    folder.mkdir()
    write_block(folder, block)
    adjust_block(folder, survey.folder / "run")
    read, direct = of_run(survey.folder / "run"), adjust_marks(own, points, true_marks(survey)).orientation
    assert np.allclose(read.images.values, direct.images.values, atol=2e-5)
    assert np.allclose(read.images.sigma, direct.images.sigma, rtol=1e-4)
    scale = direct.images.sigma[:, :, None] * direct.images.sigma[:, None, :]
    assert np.allclose(read.images.covariances / scale, direct.images.covariances / scale, atol=1e-4)
    assert np.allclose(read.images.cameras[0].values, direct.images.cameras[0].values)
