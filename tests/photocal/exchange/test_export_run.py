"""A run folder, exported; the command that does it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.adjustment.adjust import adjust
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.results.adjusted import result_of
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result, write_result
from photocal.commands.cli import app
from photocal.commands.export import FORMATS
from photocal.exchange.colmap import read_colmap
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import FORMATS as ALL
from photocal.exchange.formats import named
from photocal.exchange.metashape import read_metashape
from tests.photocal.exchange.conftest import residuals_of, roles_of, to_adjust


def run_of(given: Block, folder: Path) -> Path:
    """Adjust with control held, and write the run."""
    free = to_adjust(given, "small", 0.5)
    points = replace(
        free.points, sigma=np.full(free.points.sigma.shape, 0.01), role=np.zeros(40, dtype=np.int64)
    )
    block = replace(free, datum="control", points=points)
    assembly = assemble(block)
    solution = adjust(assembly.network)
    folder.mkdir()
    write_result(folder, result_of(block, assembly, solution))
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, vision: Block) -> Path:
    # Camera names must differ in a block.
    cameras = tuple(replace(own, id=f"camera {k}") for k, own in enumerate(vision.cameras))
    return run_of(replace(vision, cameras=cameras), tmp_path_factory.mktemp("run") / "run")


@pytest.fixture(scope="module")
def run_in_mm(tmp_path_factory: pytest.TempPathFactory, photogrammetric: Block) -> Path:
    return run_of(photogrammetric, tmp_path_factory.mktemp("run") / "mm")


def test_run_folder_gives_what_was_adjusted(run: Path, vision: Block) -> None:
    again, residuals_px = adjusted_block(read_result(run))
    assert again.images.names == vision.images.names
    assert set(roles_of(again)) == {"control"}
    np.testing.assert_allclose(again.observations.values, vision.observations.values, atol=1e-9)
    assert np.sqrt(np.mean((again.images.values - vision.images.values) ** 2)) < 0.05
    # Residuals are of the adjusted values; their sum of squares is below that of the true ones.
    assert np.sum(residuals_px**2) < np.sum(residuals_of(vision) ** 2)


@pytest.mark.parametrize("form", ["colmap", "colmap-binary", "metashape"])
def test_residuals_survive_the_export(run: Path, tmp_path: Path, form: str) -> None:
    given = adjusted_block(read_result(run))[0]
    assert all(made.largest_px == 0 for made in named(form).write(tmp_path, given, Choices()))
    if form == "metashape":
        again = read_metashape(tmp_path / "cameras.xml").block
    else:
        again = read_colmap(tmp_path)
        np.testing.assert_allclose(again.observations.values, given.observations.values, atol=1e-9)
        np.testing.assert_allclose(again.points.values, given.points.values, atol=1e-9)
    np.testing.assert_allclose(again.images.values, given.images.values, rtol=1e-9, atol=1e-9)
    for own, other in zip(given.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=1e-15)


def test_observations_in_mm_become_pixels(run_in_mm: Path, photogrammetric: Block) -> None:
    again, _ = adjusted_block(read_result(run_in_mm))
    wanted = photogrammetric.observations.values
    np.testing.assert_allclose(again.observations.values, wanted, atol=1e-9)


@pytest.mark.parametrize("form", [form.name for form in ALL if form.writes and form.name != "odm"])
def test_every_format_by_command(run: Path, run_in_mm: Path, tmp_path: Path, form: str) -> None:
    # Some formats hold no affinity, or want mm.
    wants_mm = ("pix4d", "opf", "inpho", "jaicov", "photomodeler", "dbat")
    folder = run_in_mm if form in wants_mm else run
    arguments = ["export", str(folder), "--format", form, "-o", str(tmp_path / "out"), "--json"]
    arguments += ["--angle-unit", "gon", "--origin", "47.5,8.25,500"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    answer = json.loads(result.stdout)
    assert answer["files"]
    written = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert written == set(answer["files"])


def test_help_names_every_format() -> None:
    assert FORMATS.split(", ") == [form.name for form in ALL if form.writes]


def test_text_says_what_the_conversion_costs(run_in_mm: Path, tmp_path: Path) -> None:
    arguments = ["export", str(run_in_mm), "--format", "colmap", "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "fitted, " in result.stdout
    arguments[3] = "inpho"
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "the distortion is left out, " in result.stdout


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--format", "dwg"], "format 'dwg' is not known"),
        (["--format", "patb"], "unit of the angles is not given"),
        (["--format", "patb", "--angle-unit", "mil"], "angle unit 'mil'"),
        (["--format", "kml"], "the origin of the local frame is not given"),
        (["--format", "kml", "--origin", "47.5,8"], "is not of the form LATITUDE,LONGITUDE,HEIGHT"),
        (["--format", "kml", "--origin", "147.5,8,0"], "not on the Earth"),
        (["--format", "inpho"], "is in px"),
        (["--format", "pix4d"], "affinity"),
        (["--format", "opf"], "affinity"),
        (["--format", "odm"], "name a coordinate reference system"),
    ],
)
def test_wrong_choices(run: Path, tmp_path: Path, extra: list[str], message: str) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["export", str(run), "-o", str(out), *extra])
    assert isinstance(result.exception, ConfigurationError | InputMalformedError)
    assert message in str(result.exception)
    assert not out.exists()


def test_no_run(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError):
        adjusted_block(read_result(tmp_path / "none"))[0]
    (tmp_path / "result.json").write_text('{"schema": "other/1"}')
    with pytest.raises(InputMalformedError, match="was expected"):
        adjusted_block(read_result(tmp_path))[0]
    (tmp_path / "result.json").write_text('{"schema": "photocal.adjustment/1", "x": NaN}')
    with pytest.raises(InputMalformedError, match="NaN where a number"):
        adjusted_block(read_result(tmp_path))[0]
    (tmp_path / "result.json").write_text("[" * 100_000)
    with pytest.raises(InputMalformedError, match="recursion"):
        adjusted_block(read_result(tmp_path))[0]
