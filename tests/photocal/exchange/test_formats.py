"""The table of formats: its page, and round trips of everything that a format says it holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from photocal.base.errors import ConfigurationError
from photocal.block.model import Block
from photocal.exchange import foreign_project
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import FORMATS, Format, named, page, read_any_block
from photocal.geometry.camera import MODELS, Camera, Model, camera
from photocal.geometry.conversion import in_pixels
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal import blocks
from tests.photocal.exchange.conftest import reconstruction_of, roles_of, shown

ROOT = Path(__file__).resolve().parents[3]
READ = [form for form in FORMATS if form.reads and form.writes]
# Formats whose points are the surveyed ones only.
SURVEYED = ("metashape", "dbat", "micmac")
# Formats that leave out the marks of the others.
FEW_MARKS = ("metashape",)
TO_RADIUS = -MODELS["brown-ideal"].powers()

unit = st.floats(-1, 1)
lens = st.tuples(st.floats(0.6, 1.0), *[unit] * 7)


def model_of(form: Format) -> Model:
    return "brown-observed" if form.distortion == "brown-observed" else "brown-ideal"


def made(form: Format, name: str, drawn: tuple[float, ...]) -> Camera:
    """A camera of the model that the format has, with up to some 100 px of distortion."""
    c, *shape = drawn
    c *= 20.0
    radius = 16.0
    scale = [0.3, 0.3, 0.02 / radius**2, 0.01 / radius**4, 0.005 / radius**6, 1e-3 / radius, 1e-3 / radius]
    names = ("x0", "y0", "K1", "K2", "K3", "P1", "P2")
    values = dict(zip(names, np.multiply(shape, scale).tolist(), strict=True)) | {"c": c}
    return camera(name, model_of(form), "mm", (3060, 2036), (0.009, 0.009), values)


def written(form: Format, folder: Path, given_: Block) -> Block:
    for conversion in form.write(folder, given_, Choices("gon")):
        # A format without distortion loses it, and says how much.
        assert conversion.largest_px == 0 or form.distortion == "none"
    if form.name == "jaicov":
        # What was written has no report, which tells the a priori standard deviation.
        (folder / "block.htm").write_text("S0 apriori: 0.001")
    return foreign_project.in_pixels(form.read(folder).block)


@pytest.mark.parametrize("form", READ, ids=lambda form: form.name)
@given(first=lens, second=lens)
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip_loses_nothing(
    tmp_path_factory: pytest.TempPathFactory,
    form: Format,
    first: tuple[float, ...],
    second: tuple[float, ...],
) -> None:
    # Cameras have no names in some formats: two that are alike would be one.
    cameras = [made(form, "1", first), made(form, "2", (second[0] + 0.5, *second[1:]))]
    own = shown(reconstruction_of(tuple(cameras[:1] if form.name == "dbat" else cameras)))
    again = written(form, tmp_path_factory.mktemp("format"), own)
    if "cameras" in form.holds:
        assert len(again.cameras) == len(own.cameras)
        for before, after in zip(own.cameras, again.cameras, strict=True):
            a, b = (in_pixels(which) for which in (before, after))
            assert a.size_px == b.size_px
            # Each parameter by what it moves at the edge of the image, as a share of the radius.
            assert np.abs((a.values - b.values) * 1800.0**TO_RADIUS).max() < 1e-9
    if "orientations" in form.holds:
        assert again.images.names == own.images.names or form.name == "jaicov"
        turn = matrix_from_angles(again.images.values[:, :3]) - matrix_from_angles(own.images.values[:, :3])
        assert np.abs(turn).max() < 1e-9
        np.testing.assert_allclose(again.images.values[:, 3:], own.images.values[:, 3:], rtol=1e-9)
        if "cameras" in form.holds:
            assert np.array_equal(again.images.camera, own.images.camera)
    if "points" in form.holds:
        places = dict(zip(again.points.names, again.points.values, strict=True))
        wanted = [
            name
            for name, role in zip(own.points.names, roles_of(own), strict=True)
            if form.name not in SURVEYED or role == "control"
        ]
        assert set(wanted) <= set(places)
        for name in wanted:
            np.testing.assert_allclose(
                places[name], own.points.values[own.points.names.index(name)], rtol=1e-9
            )
    if "marks" in form.holds:
        marks, found = rays(own), rays(again)
        if form.name == "jaicov":
            marks = {(str(own.images.names.index(i) + 1), j): xy for (i, j), xy in marks.items()}
        assert found.keys() == marks.keys() or (form.name in FEW_MARKS and found.keys() <= marks.keys())
        assert max(np.abs(np.subtract(found[key], marks[key])).max() for key in found) < 1e-9


def rays(given_: Block) -> dict[tuple[str, str], list[float]]:
    return {
        (given_.images.names[i], given_.points.names[j]): xy
        for i, j, xy in zip(
            given_.observations.image,
            given_.observations.point,
            given_.observations.values.tolist(),
            strict=True,
        )
    }


def test_the_page_is_made_of_the_table() -> None:
    assert (ROOT / "docs" / "exchange.md").read_text(encoding="utf-8") == page()


def test_names_are_unique_and_known() -> None:
    assert len({form.name for form in FORMATS}) == len(FORMATS)
    assert named("opf").title.startswith("Open Photogrammetry")
    with pytest.raises(ConfigurationError, match="use opf, "):
        named("dwg")


@pytest.mark.parametrize("form", [form for form in READ if "marks" in form.holds], ids=lambda form: form.name)
def test_origin_of_the_pixels_is_as_stated(tmp_path: Path, form: Format) -> None:
    """The first mark stands in the file shifted by the half pixel that the table states."""
    own = reconstruction_of((camera("1", model_of(form), "mm", (3060, 2036), (0.009, 0.009), {"c": 20.5}),))
    # A coordinate that is found again by its digits; point 100 is control and goes everywhere.
    ray = int(np.flatnonzero(own.observations.point == 0)[0])
    pixels = own.observations.values.copy()
    pixels[ray, 0] = 1234.0625
    moved = replace(own, observations=replace(own.observations, values=pixels))
    form.write(tmp_path, moved, Choices())
    content = b"".join(path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file())
    corner = {"corner of the first pixel": 1234.5625, "centre of the first pixel": 1234.0625}.get(form.origin)
    if form.name == "opensfm":
        assert repr((1234.0625 + 0.5 - 3060 / 2) / 3060).encode() in content
    elif form.name == "jaicov":
        assert repr(float((1234.0625 - 3059 / 2) * 0.009)).encode() in content
    else:
        assert corner is not None
        number = np.float64(corner)
        assert repr(float(number)).encode() in content or number.tobytes() in content


def test_a_block_folder_is_also_known_by_its_set_up_file(tmp_path: Path) -> None:
    folder = blocks.small(tmp_path / "block")
    by_folder, by_file = read_any_block(folder), read_any_block(folder / "block.toml")
    assert by_file.inputs == by_folder.inputs
    assert by_file.images.names == by_folder.images.names
