"""What is written and read again is equal: every key and table that a block folder has."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import photocal
from photocal.adjustment.lasers import NO_LASERS, LaserDistances
from photocal.adjustment.mounting import (
    BORESIGHT,
    HEIGHT_SCALE,
    LEVER,
    NO_ATTITUDES,
    NO_MOUNTING,
    NO_POSITIONS,
    SHIFT,
    STRIPS,
    TIME,
    Attitudes,
    Mounting,
    Positions,
)
from photocal.adjustment.network import ANGLES, NO_RELATIONS, RELATIONS, Relations, covariance_matrices
from photocal.base.arrays import Floats
from photocal.base.codec import as_degrees, same
from photocal.base.errors import OutputError, PhotocalError
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block, FiducialFit, Images, ObjectPoints, Observations, Repetition
from photocal.block.mounting import BODY_AXES
from photocal.block.rig import Head
from photocal.block.writer import write_block
from photocal.geometry.camera import MODELS, PARAMETERS, SHAKE, Camera
from photocal.geometry.rotation import object_to_body
from tests.photocal import blocks

# Evidence asks for 1000: PHOTOCAL_EXAMPLES=1000 pytest tests/photocal/block/test_writing.py
EXAMPLES = int(os.environ.get("PHOTOCAL_EXAMPLES", "100"))
AWKWARD = ("IMG 001.jpg", "a,b", 'say "x"', "two\nlines", "cr\rlf\r\n.", "-x", "--", "é ü 日本", "007", "NaN",
           "null", "1e5", "=1+1", "a;b\tc", "'", "\\", "#", "[x]", "TRUE")  # fmt: skip
Draw = Callable[[st.SearchStrategy[Any]], Any]


def outer_blanks(name: str) -> bool:
    return name != name.strip() or not name.strip()


any_text = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
name = st.one_of(st.sampled_from(AWKWARD), any_text).filter(lambda text: not outer_blanks(text))


def names(draw: Draw, least: int, most: int) -> tuple[str, ...]:
    return tuple(draw(st.lists(name, min_size=least, max_size=most, unique=True)))


def sigma_vector(draw: Draw, rng: np.random.Generator, unit: float = 1.0) -> Floats:
    """Held, weighted or free, each axis by itself."""
    kinds = draw(st.lists(st.sampled_from([0.0, 1.0, np.inf]), min_size=3, max_size=3))
    return np.array([kind * unit * rng.exponential() if kind == 1.0 else kind for kind in kinds])


def degrees(rng: np.random.Generator, shape: Any, size: float = 60.0) -> Floats:
    """Angles that were given in degrees with all their digits, in radians."""
    return np.asarray(np.radians(rng.normal(0, size, shape)))


def a_camera(draw: Draw, rng: np.random.Generator, camera_id: str) -> Camera:
    model = draw(st.sampled_from(list(MODELS)))
    lens = MODELS[model]
    has = np.isin(PARAMETERS, lens.names)
    unit: Literal["mm", "px"] = draw(st.sampled_from(["mm", "px"]))
    values = np.where(has & (rng.random(len(PARAMETERS)) < 0.7), rng.normal(0, 1e-3, len(PARAMETERS)), 0.0)
    values[0] = rng.uniform(5, 5000)
    estimated = has & (rng.random(len(PARAMETERS)) < 0.5)
    prior = np.where(estimated & (rng.random(len(PARAMETERS)) < 0.5), rng.exponential(size=20), np.inf)
    deviation = np.where(has & (rng.random(len(PARAMETERS)) < 0.2), rng.exponential(size=20), 0.0)
    deviation[(deviation > 0) & ~estimated & (rng.random(20) < 0.5)] = np.inf
    deviation[-1] = 0.0
    rolling = bool(values[-1] or estimated[-1])

    def correlation(at: Any) -> Floats:
        whole = np.eye(len(PARAMETERS))
        mixed = rng.normal(size=(20, 20))
        matrix = mixed @ mixed.T
        matrix /= np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
        whole[np.ix_(at, at)] = matrix[np.ix_(at, at)]
        whole[range(20), range(20)] = 1.0
        return whole

    adjusted = draw(st.booleans())
    return Camera(
        camera_id,
        model,
        unit,
        draw(st.tuples(st.integers(1, 20000), st.integers(1, 20000))),
        (1.0, 1.0) if unit == "px" else tuple(rng.uniform(1e-3, 1e-2, 2).tolist()),
        values,
        estimated,
        prior,
        reference_radius=0.0 if lens.relative else draw(st.sampled_from([0.0, rng.exponential()])),
        affinity="after" if lens.relative else draw(st.sampled_from(["additive", "before", "after"])),
        affinity_form=draw(st.sampled_from(["fraser", "canon-elph", "tank"])),
        deviation_sigma=deviation,
        focus_m=0.0
        if lens.relative or unit == "px"
        else draw(st.sampled_from([0.0, 6.0 + rng.exponential()])),
        prior_correlation=correlation(np.flatnonzero(np.isfinite(prior))) if draw(st.booleans()) else None,
        guessed=draw(st.booleans()),
        given=np.where(has, rng.normal(size=20), 0.0) if adjusted else None,
        sigma=np.where(estimated, rng.exponential(size=20), 0.0) if adjusted else None,
        correlation=correlation(np.flatnonzero(estimated)) if adjusted else None,
        distortion_at=draw(st.sampled_from(["adjusted", "measured"])),
        readout_direction=draw(st.sampled_from(["top-to-bottom", "bottom-to-top", "left-to-right"])),
        shutter="rolling" if rolling else draw(st.sampled_from(["global", "unknown"])),
        gust=draw(st.sampled_from([(0.5, 0.1), (rng.exponential(), float(np.radians(rng.exponential())))])),
        shake=tuple(rng.exponential(size=6).tolist()) if draw(st.booleans()) else (),
    )


def with_gaps(rng: np.random.Generator, values: Floats, share: float, gap: float = np.nan) -> Floats:
    return np.where(rng.random(len(values)) < share, gap, values.T).T


def some_images(draw: Draw, rng: np.random.Generator, cameras: int) -> Images:
    called = names(draw, 1, 4)
    n = len(called)
    pose = np.hstack(
        [with_gaps(rng, degrees(rng, (n, 3)), 0.2), with_gaps(rng, rng.normal(0, 1e6, (n, 3)), 0.2)]
    )
    sigma = np.hstack([degrees(rng, (n, 3)) ** 2, rng.exponential(size=(n, 3))])
    sigma[:, :3] = np.radians(as_degrees(sigma[:, :3]))
    sigma[rng.random((n, 6)) < 0.2] = 0.0
    sigma[(rng.random((n, 6)) < 0.3) | np.isnan(pose)] = np.inf
    share = draw(st.sampled_from([0.0, 0.5, 1.0]))
    shaken = draw(st.booleans())
    motion = np.hstack([rng.normal(0, 9, (n, 3)), degrees(rng, (n, 3 + shaken * len(SHAKE)))])
    motion_sigma = np.hstack([rng.exponential(size=(n, 3)), np.abs(degrees(rng, (n, 3)))])
    exposure = tuple(draw(st.lists(st.one_of(st.just(""), name), min_size=n, max_size=n)))
    return Images(
        called,
        rng.integers(0, cameras, n),
        pose,
        sigma,
        with_gaps(rng, motion, share),
        with_gaps(rng, motion_sigma, share),
        with_gaps(rng, rng.uniform(0, 1e9, n), share),
        with_gaps(rng, rng.normal(20, 9, n), share),
        exposure,
    )


def some_points(draw: Draw, rng: np.random.Generator) -> ObjectPoints:
    called = names(draw, 3, 6)
    n = len(called)
    role = rng.integers(0, len(ROLES), n)
    tie = role == ROLES.index("tie")
    values = with_gaps(rng, rng.normal(0, 1e6, (n, 3)), 0.3)
    values = np.where((np.isnan(values) & ~tie[:, None]), 1.0, values)
    sigma = np.where(rng.random((n, 3)) < 0.3, 0.0, rng.exponential(size=(n, 3)))
    sigma[tie] = np.inf
    cross = None
    if draw(st.booleans()):
        whole = np.all(np.isfinite(sigma) & (sigma > 0), axis=1)
        a, b = [0, 0, 1], [1, 2, 2]
        safe = np.where(np.isfinite(sigma), sigma, 0.0)
        cross = rng.uniform(-0.4, 0.4, (n, 3)) * safe[:, a] * safe[:, b] * whole.reshape(-1, 1)
    return ObjectPoints(called, values, sigma, role, cross)


def some_relations(rng: np.random.Generator, points: int, kinds: list[str]) -> Relations:
    if not kinds:
        return NO_RELATIONS
    rows = []
    for kind in kinds:
        ends = [*rng.permutation(points)[: len(RELATIONS[kind])].tolist(), -1][:3]
        value, sigma = (0.0 if kind == "line" else rng.exponential()), rng.exponential()
        if kind in ANGLES:
            value, sigma = np.radians(60 * value), np.radians(sigma)
        rows.append((list(RELATIONS).index(kind), *ends[:2], value, sigma, ends[2]))
    return Relations(*map(np.array, zip(*rows, strict=True)))


def mounted(draw: Draw, rng: np.random.Generator, images: int) -> tuple[Positions, Attitudes, Mounting]:
    positions, attitudes, strips = NO_POSITIONS, NO_ATTITUDES, 0
    from_m = 0.0
    if draw(st.booleans()):
        image = rng.permutation(images)
        sigma = rng.exponential(size=(images, 3)) + 1e-3
        cross = rng.uniform(-0.4, 0.4, (images, 3)) * sigma[:, [0, 0, 1]] * sigma[:, [1, 2, 2]]
        strip = np.unique(rng.integers(0, 2, images), return_inverse=True)[1]
        strip = strip if strip[0] == 0 else 1 - strip
        values = rng.normal(0, 1e5, (images, 3))
        from_m = draw(st.sampled_from([0.0, 123.456, -0.1]))
        velocity, time = rng.normal(0, 9, (images, 3)), rng.normal(0, 60, images)
        if draw(st.booleans()):
            cross, velocity, time = 0 * cross, 0 * velocity, 0 * time
        covariance = covariance_matrices(sigma, cross)
        positions = Positions(image, values, covariance, velocity, strip, time, values[:, 2] - from_m)
        strips = int(strip.max()) + 1
    if draw(st.booleans()):
        # As tables have them: attitudes are kept as rotations, equal for angles of up to twelve decimals.
        angles = np.round(rng.uniform([-180, -80, 0], [180, 80, 360], (images, 3)), draw(st.integers(1, 9)))
        sigma = np.radians(np.round(rng.uniform(0.1, 2.0, (images, 3)), draw(st.integers(1, 9))))
        rotation, per_angle = object_to_body(np.radians(angles))
        covariance = per_angle @ (sigma[:, :, None] ** 2 * np.swapaxes(per_angle, 1, 2))
        rate = with_gaps(rng, degrees(rng, (images, 3)), 0.3)
        spread = with_gaps(rng, np.abs(degrees(rng, (images, 3))), 0.3)
        attitudes = Attitudes(rng.permutation(images), rotation, covariance, rate, spread)
    values = np.zeros(STRIPS + 6 * strips)
    sigma = np.zeros_like(values)
    values[LEVER], values[BORESIGHT], values[TIME] = rng.normal(size=3), degrees(rng, 3, 2.0), rng.normal()
    sigma[LEVER] = sigma_vector(draw, rng)
    boresight = sigma_vector(draw, rng)
    sigma[BORESIGHT], sigma[SHIFT] = np.radians(boresight), sigma_vector(draw, rng)
    sigma[TIME] = draw(st.sampled_from([0.0, 0.01, np.inf]))
    sigma[HEIGHT_SCALE] = draw(st.sampled_from([0.0, 1.23e-5]))
    shift, drift = sigma_vector(draw, rng), sigma_vector(draw, rng)
    for at in range(STRIPS, len(sigma), 6):
        sigma[at : at + 3], sigma[at + 3 : at + 6] = shift, drift
    axes = draw(st.sampled_from([("right", "forward", "up"), ("left", "backward", "up")]))
    rotation = np.array([BODY_AXES[axis] for axis in axes])
    return positions, attitudes, Mounting(rotation, values, sigma)


def some_lasers(draw: Draw, rng: np.random.Generator, images: int, points: int) -> LaserDistances:
    count = draw(st.integers(0, 4))
    if points < 3 or not count:
        return NO_LASERS
    corners = np.array([rng.permutation(points)[:3] for _ in range(count)])
    value, sigma = rng.exponential(size=(2, count)) + 1e-3
    image = np.asarray(rng.integers(0, images, count), dtype=np.int64)
    common = draw(st.sampled_from([0.0, 0.07, np.inf])), draw(st.sampled_from([0.0, 5e-4]))
    return LaserDistances(image, corners, value, sigma, common)


def some_heads(draw: Draw, rng: np.random.Generator, cameras: tuple[str, ...]) -> tuple[Head, ...]:
    if len(cameras) < 2 or not draw(st.booleans()):
        return ()
    nothing = np.zeros(7)
    heads = [Head(cameras[0], cameras[0], np.zeros(3), nothing, nothing)]
    for camera in cameras[1:]:
        known = draw(st.booleans())
        turns = np.radians(sigma_vector(draw, rng)) if known else np.full(3, np.inf)
        sigma = np.array([*turns, *sigma_vector(draw, rng), rng.exponential()])
        values = np.array([*degrees(rng, 3, 1.0), *rng.normal(size=4)])
        lag = (rng.normal(), rng.exponential()) if draw(st.booleans()) else None
        stiff = (rng.exponential(), float(np.radians(rng.exponential())))
        heads.append(Head(camera, cameras[0], degrees(rng, 3) if known else None, values, sigma, stiff, lag))
    return tuple(heads)


@st.composite
def whole_blocks(draw: Draw) -> Block:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    ids = names(draw, 1, 3)
    cameras = tuple(a_camera(draw, rng, camera_id) for camera_id in ids)
    images, points = some_images(draw, rng, len(cameras)), some_points(draw, rng)
    rays = np.argwhere(rng.random((len(images.names), len(points.names))) < 0.7)
    rays = rng.permutation(rays if len(rays) else np.zeros((1, 2), dtype=int))
    unit, axes = draw(st.sampled_from(["px", "mm"])), draw(st.sampled_from(["pixel", "photo"]))
    seen = Observations(
        unit,
        axes,
        rays[:, 0],
        rays[:, 1],
        values=rng.normal(0, 1e3, (len(rays), 2)),
        sigma=rng.exponential(size=(len(rays), 2)) + 1e-9,
    )
    kinds = sorted(draw(st.lists(st.sampled_from(list(RELATIONS)), max_size=5)), key=list(RELATIONS).index)
    positions, attitudes, mounting = mounted(draw, rng, len(images.names))
    frame = draw(st.sampled_from(["local", "EPSG:31982"]))
    fits = tuple(
        FiducialFit(image, names(draw, 1, 3), np.zeros((0, 2)), int(rng.integers(0, 5)), rng.exponential())
        for image in images.names[: draw(st.integers(0, 2))]
    )
    fits = tuple(replace(fit, residuals=rng.normal(size=(len(fit.fiducials), 2))) for fit in fits)
    fits = tuple(fit if fit.redundancy else replace(fit, sigma0=np.nan) for fit in fits)
    spread = draw(st.sampled_from([None, (0.1, rng.exponential())]))
    return Block(
        name=draw(name),
        frame=frame,
        height=draw(st.sampled_from(["", "local", "ellipsoidal", "orthometric"])),
        datum=draw(st.sampled_from(["control", "free"])),
        cameras=cameras,
        images=images,
        points=points,
        observations=seen,
        datum_points=points.names[: draw(st.integers(0, 2))],
        relations=some_relations(rng, len(points.names), kinds),
        positions=positions,
        attitudes=attitudes,
        mounting=mounting,
        fiducial_fits=fits,
        repetition=draw(st.sampled_from([None, Repetition(9, 2, 1.5, 1, 3, spread)])),
        global_test=(draw(st.floats(0.51, 0.99)), draw(st.sampled_from(["two-sided", "one-sided", "none"]))),
        check_distances=some_relations(rng, len(points.names), ["distance"] * draw(st.integers(0, 2))),
        heads=some_heads(draw, rng, ids),
        refraction=draw(st.sampled_from([None, 0.0, 0.13, rng.normal() % 1])),
        curvature=frame == "local" and draw(st.booleans()),
        lasers=some_lasers(draw, rng, len(images.names), len(points.names)),
    )


def differences(one: Block, other: Block) -> list[str]:
    return [
        field.name
        for field in fields(Block)
        if field.name != "inputs" and not same(getattr(one, field.name), getattr(other, field.name))
    ]


# To shrink a whole block takes minutes and helps little: `differences` names what is not equal.
@settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
)
@pytest.mark.timeout(3600)
@given(block=whole_blocks(), parquet=st.booleans())
def test_a_block_is_equal_when_it_is_read_again(block: Block, parquet: bool) -> None:
    with tempfile.TemporaryDirectory() as scratch, pytest.MonkeyPatch.context() as patch:
        if parquet:
            patch.setattr("photocal.block.writer.LONG_TABLE", 0)
        folder = Path(scratch)
        write_block(folder, block)
        assert (folder / "observations.parquet").exists() == parquet
        assert differences(read_block(folder), block) == []


def test_a_block_written_over_another_is_no_mixture_of_the_two(tmp_path: Path) -> None:
    block = read_block(blocks.small(tmp_path / "block"))
    given = [(*block.points.names[:2], 1.5, 0.001)]
    write_block(tmp_path / "out", photocal.with_relations(block, "distance", given))
    assert (tmp_path / "out" / "distances.csv").exists()
    write_block(tmp_path / "out", block)
    assert differences(read_block(tmp_path / "out"), block) == []


def test_readings_are_means_when_a_block_is_written_again(tmp_path: Path) -> None:
    folder = blocks.small(tmp_path / "block")
    table = (folder / "observations.csv").read_text(encoding="utf-8").splitlines()
    (folder / "observations.csv").write_text("\n".join([*table, table[1]]) + "\n", encoding="utf-8")
    setup = folder / "block.toml"
    text = setup.read_text(encoding="utf-8").replace(
        "[observations]", "[observations]\nrejection_limit = 1.0"
    )
    setup.write_text(text, encoding="utf-8")
    block = read_block(folder)
    assert block.repetition is not None
    photocal.write_block(tmp_path / "again", block)
    assert differences(read_block(tmp_path / "again"), block) == []


@pytest.mark.parametrize("wrong", [" a", "a\t", "", " "])
def test_names_that_a_table_does_not_keep_are_refused(tmp_path: Path, wrong: str) -> None:
    block = read_block(blocks.small(tmp_path / "block"))
    points = replace(block.points, names=(wrong, *block.points.names[1:]))
    with pytest.raises(OutputError, match=r"point .* is empty, or begins or ends with a blank"):
        write_block(tmp_path / "out", replace(block, points=points))
    assert not (tmp_path / "out").exists()


def test_what_no_block_folder_can_hold_is_refused(tmp_path: Path) -> None:
    block = read_block(blocks.small(tmp_path / "block"))
    shifted = NO_MOUNTING.values.copy()
    shifted[SHIFT] = 1.0
    turned = replace(NO_MOUNTING, rotation=np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]))
    related = photocal.with_relations(
        block, "mine", [(*block.points.names[:2], 1.0, 0.1)], lambda apart: (apart[:, 0], np.eye(3)[:1])
    )
    for bad, words in (
        (replace(block, mounting=replace(NO_MOUNTING, values=shifted)), "does not begin at zero"),
        (replace(block, mounting=turned), "not along those of the body"),
        (related, "a user-defined kind"),
        (replace(block, height="above the sea"), "height"),
    ):
        with pytest.raises(PhotocalError, match=words):
            write_block(tmp_path / "out", bad)
        assert not (tmp_path / "out").exists()


def test_any_radians_come_back_to_the_last_place() -> None:
    given_radians = np.random.default_rng(1).normal(0, 2, 100_000)
    again = np.radians(as_degrees(given_radians))
    assert np.abs(again / given_radians - 1).max() <= np.finfo(float).eps
    whole = np.radians(np.arange(-720.0, 720.0, 0.25))
    assert as_degrees(whole).tolist() == np.arange(-720.0, 720.0, 0.25).tolist()


def test_the_shipped_block(tmp_path: Path) -> None:
    block = read_block(Path("photocal/demo/dcs460"))
    write_block(tmp_path, block)
    assert differences(read_block(tmp_path), block) == []
