"""Models of vision programs, adjusted directly: they come back to where they were made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import named, read_foreign_block
from photocal.geometry.camera import camera
from tests.photocal.exchange.conftest import reconstruction_of, residuals_of, shown, with_roles


@pytest.fixture(scope="module")
def exact() -> Block:
    """One camera, measurements without errors, every tenth point surveyed to 1 mm."""
    values = {"c": 20.0, "K1": -1e-5, "P1": 1e-6}
    made = reconstruction_of((camera("1", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), values),))
    made = with_roles(shown(made, 2), "control", *("tie",) * 9)
    seen, points = made.observations, made.points
    points = replace(points, sigma=np.full(points.sigma.shape, 1e-3))
    return replace(made, points=points, observations=replace(seen, values=seen.values + residuals_of(made)))


@pytest.mark.parametrize(
    ("form", "file", "control"),
    [
        ("colmap", "images.txt", 0),
        ("colmap-binary", "cameras.bin", 0),
        ("opensfm", "reconstruction.json", 0),
        ("opf", "project.opf", 4),
        ("jaicov", "block.ior", 0),
        ("photomodeler", "block.txt", 4),
    ],
)
def test_a_model_is_adjusted(tmp_path: Path, exact: Block, form: str, file: str, control: int) -> None:
    named(form).write(tmp_path, exact, Choices())
    if form == "jaicov":
        (tmp_path / "block.htm").write_text("S0 apriori: 0.005")
    block = read_foreign_block(tmp_path / file)
    assert block.points.of_role("control").sum() == control
    assert block.datum == ("control" if control else "free") or form == "photomodeler"
    assert file in {Path(one.path).name for one in block.inputs}
    held = replace(
        block, cameras=tuple(replace(own, estimated=own.estimated & False) for own in block.cameras)
    )
    solution = adjust(assemble(held).network)
    assert np.abs(solution.residuals).max() < 1e-6
    # PhotoModeler has the other direction of the distortion: what the fit leaves is some 1e-5 px.
    assert solution.variance_factor < 1e-6


def test_metashape_markers_are_adjusted(tmp_path: Path, exact: Block) -> None:
    surveyed = with_roles(exact, "control")
    named("metashape").write(tmp_path, surveyed, Choices())
    block = read_foreign_block(tmp_path / "cameras.xml")
    assert block.datum == "control"
    assert np.all(block.points.sigma == 1e-3)
    assert np.abs(adjust(assemble(block).network).residuals).max() < 1e-6


def test_what_cannot_be_adjusted(tmp_path: Path, exact: Block) -> None:
    named("metashape").write(tmp_path, exact, Choices())
    path = tmp_path / "cameras.xml"
    path.write_text(path.read_text().replace("LOCAL_CS[", "PROJCS[", 1))
    with pytest.raises(InputMalformedError, match="coordinate system"):
        read_foreign_block(path)
    named("opensfm").write(tmp_path, exact, Choices())
    (tmp_path / "tracks.csv").unlink()
    with pytest.raises(InputMalformedError, match=r"put the tracks beside it as tracks\.csv"):
        read_foreign_block(tmp_path / "reconstruction.json")
    for form in ("colmap", "opf"):
        (tmp_path / form).mkdir()
        empty = replace(exact, observations=exact.observations.rows(slice(0)))
        named(form).write(tmp_path / form, empty, Choices())
        with pytest.raises(InputMalformedError, match="no measurements of points"):
            read_foreign_block(tmp_path / form / ("cameras.txt" if form == "colmap" else "project.opf"))


@pytest.mark.shared
def test_published_opensfm_example(shared: Path) -> None:
    block = read_foreign_block(shared / "data" / "opensfm-berlin-gcp" / "reconstruction_example.json")
    assert (len(block.images.names), block.datum) == (3, "free")
    assert len(block.observations.values) > 2000
