"""Models of vision programs, adjusted directly: they come back to where they were made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.base.errors import InputMalformedError
from photocal.block.network import assemble
from photocal.exchange.formats import named, read_foreign_block
from photocal.exchange.reconstruction import Choices, Reconstruction
from photocal.geometry.camera import camera
from tests.photocal.exchange.conftest import reconstruction_of


@pytest.fixture(scope="module")
def exact() -> Reconstruction:
    """One camera, measurements without errors, every tenth point surveyed to 1 mm."""
    values = {"c": 20.0, "K1": -1e-5, "P1": 1e-6}
    made = reconstruction_of((camera("1", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), values),))
    seen = np.flatnonzero(np.bincount(made.point, minlength=len(made.xyz)) > 1)
    keep = np.isin(made.point, seen)
    return replace(
        made,
        point_names=tuple(made.point_names[j] for j in seen),
        xyz=made.xyz[seen],
        xyz_sigma=np.full((len(seen), 3), 1e-3),
        roles=tuple("control" if k % 10 == 0 else "tie" for k in range(len(seen))),
        image=made.image[keep],
        point=np.searchsorted(seen, made.point[keep]),
        pixels=(made.pixels + made.residuals_px)[keep],
        residuals_px=np.zeros((int(keep.sum()), 2)),
    )


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
def test_a_model_is_adjusted(
    tmp_path: Path, exact: Reconstruction, form: str, file: str, control: int
) -> None:
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


def test_metashape_markers_are_adjusted(tmp_path: Path, exact: Reconstruction) -> None:
    surveyed = replace(exact, roles=("control",) * len(exact.roles))
    named("metashape").write(tmp_path, surveyed, Choices())
    block = read_foreign_block(tmp_path / "cameras.xml")
    assert block.datum == "control"
    assert np.all(block.points.sigma == 1e-3)
    assert np.abs(adjust(assemble(block).network).residuals).max() < 1e-6


def test_what_cannot_be_adjusted(tmp_path: Path, exact: Reconstruction) -> None:
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
        empty = replace(
            exact,
            image=exact.image[:0],
            point=exact.point[:0],
            pixels=exact.pixels[:0],
            residuals_px=exact.pixels[:0],
        )
        named(form).write(tmp_path / form, empty, Choices())
        with pytest.raises(InputMalformedError, match="no measurements of points"):
            read_foreign_block(tmp_path / form / ("cameras.txt" if form == "colmap" else "project.opf"))


@pytest.mark.shared
def test_published_opensfm_example(shared: Path) -> None:
    block = read_foreign_block(shared / "data" / "opensfm-berlin-gcp" / "reconstruction_example.json")
    assert (len(block.images.names), block.datum) == (3, "free")
    assert len(block.observations.values) > 2000
