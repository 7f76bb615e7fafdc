"""A new format is one file and one entry, also from another package: read, written, adjusted and adopted."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.base.extensions import FORMATS, brought
from photocal.block.model import Block
from photocal.block.results.folder import read_result
from photocal.exchange import formats
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import read_foreign_project
from photocal.geometry.camera import camera
from tests.photocal.exchange import toy_format
from tests.photocal.exchange.conftest import reconstruction_of, shown, with_roles

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def given() -> Block:
    """What a toy holds: a camera without distortion; points of two rays and more, every third is control."""
    own = reconstruction_of((camera("1", "brown-ideal", "px", (4608, 3456), (1.0, 1.0), {"c": 3600.0}),))
    return with_roles(shown(own, 2), "control", "tie", "tie")


def package(folder: Path, entry: str = "toyformat:TOY", module: str | None = None) -> Path:
    """Install a package: a module and its entry point, as pip lays them down."""
    folder.mkdir()
    if module is None:
        shutil.copy(toy_format.__file__, folder / "toyformat.py")
    else:
        (folder / "toyformat.py").write_text(module)
    info = folder / "toyformat-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toyformat\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{FORMATS}]\ntoy = {entry}\n")
    return folder


@pytest.fixture
def forgotten(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Entry points are looked for anew, before and after."""
    brought.cache_clear()
    yield
    monkeypatch.undo()
    sys.modules.pop("toyformat", None)
    brought.cache_clear()


def photocal(installed: Path, *words: object) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(installed), str(ROOT), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    return subprocess.run(
        [sys.executable, "-c", "from photocal.commands.cli import main; main()", *map(str, words)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


def test_another_package_adds_a_format(tmp_path: Path, given: Block) -> None:
    """`photocal adjust` reads its file, `photocal export` writes it: nothing of ours knows of it."""
    toy_format.write(tmp_path / "field.toy", given, Choices())
    # Without the package nothing takes the file.
    alone = photocal(tmp_path / "none", "adjust", tmp_path / "field.toy", "-o", tmp_path / "run")
    assert alone.returncode != 0
    assert "has no block in a known format" in alone.stderr
    installed = package(tmp_path / "installed")
    made = photocal(installed, "adjust", tmp_path / "field.toy", "-o", tmp_path / "run", "--json")
    assert made.returncode == 0, made.stderr
    answer = json.loads((tmp_path / "run" / "result.json").read_text())
    assert answer["converged"]
    out = tmp_path / "out"
    written = photocal(installed, "export", tmp_path / "run", "--format", "toy", "-o", out, "--json")
    assert written.returncode == 0, written.stderr
    assert json.loads(written.stdout)["files"] == ["block.toy"]
    again = toy_format.read(out / "block.toy").block
    assert again.images.names == given.images.names
    assert set(again.points.names) == set(given.points.names)
    adjusted = read_result(tmp_path / "run").images
    np.testing.assert_array_equal(again.images.values, adjusted.values)
    # The noise is 0.4 px where the format states 1 px.
    assert np.abs((adjusted.values - given.images.values) / adjusted.sigma).max() < 3
    (tmp_path / "damaged.toy").write_text("{}")
    damaged = photocal(installed, "adjust", tmp_path / "damaged.toy", "-o", tmp_path / "none")
    assert damaged.returncode != 0
    assert "damaged.toy: could not be read as Toy (KeyError: 'size')" in damaged.stderr.replace("\n", " ")
    assert "Traceback" not in damaged.stderr
    refused = photocal(installed, "export", tmp_path / "run", "--format", "dwg", "-o", tmp_path / "dwg")
    assert refused.stderr.rstrip().endswith("toy")


@pytest.mark.usefixtures("forgotten")
def test_its_folder_is_a_project_to_adopt(
    tmp_path: Path, given: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "project" / "deep").mkdir(parents=True)
    toy_format.write(tmp_path / "project" / "deep" / "field.toy", given, Choices())
    with pytest.raises(InputNotFoundError, match="has no project in a known format"):
        read_foreign_project(tmp_path / "project")
    monkeypatch.syspath_prepend(package(tmp_path / "installed"))
    brought.cache_clear()
    foreign = read_foreign_project(tmp_path / "project")
    assert foreign.program == "Toy"
    assert foreign.block.images.names == given.images.names
    assert np.isnan(foreign.position).all()
    with pytest.raises(InputNotFoundError, match="Toy; Pix4D"):
        read_foreign_project(tmp_path / "installed")


@pytest.mark.usefixtures("forgotten")
@pytest.mark.parametrize(
    ("entry", "module", "message"),
    [
        ("toyformat:TOY", "import nothing_of_that_name", "cannot be loaded .ModuleNotFoundError"),
        ("toyformat:TOY", "TOY = 7", "is not a photocal.exchange.formats.Format"),
        ("toyformat:NONE", "", "cannot be loaded .AttributeError"),
    ],
)
def test_a_broken_package_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str, module: str, message: str
) -> None:
    monkeypatch.syspath_prepend(package(tmp_path / "installed", entry, module))
    brought.cache_clear()
    with pytest.raises(ConfigurationError, match=message) as refusal:
        formats.known()
    assert "correct the package that brings it" in str(refusal.value)
    # What is ours works without a look at it.
    assert formats.named("opf").module == "photocal.exchange.opf"


def test_the_table_loads_no_format() -> None:
    code = (
        "import sys, photocal.exchange.formats; "
        "print([m for m in sys.modules if m.startswith('photocal.exchange.') or m == 'numpy'])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "['photocal.exchange.formats']"


def test_every_function_of_the_table_exists() -> None:
    for form in formats.FORMATS:
        for name in filter(None, (form.writes, form.reads, form.detects)):
            assert hasattr(import_module(form.module), name.split(":")[0]), name
