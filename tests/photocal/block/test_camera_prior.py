"""`prior_from`: another calibration with all its correlations as prior of a camera."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, InputNotFoundError, PhotocalError
from photocal.block.folder import read_block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import read_result
from photocal.geometry.camera import PARAMETERS

DEMO = Path(__file__).parents[3] / "photocal/demo/dcs460"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("first")
    adjust_block(DEMO, place / "run")
    return place / "run"


@pytest.fixture
def block(run: Path, tmp_path: Path) -> Path:
    """The same photos again, with the first calibration as prior."""
    shutil.copytree(DEMO, tmp_path / "block")
    (tmp_path / "block" / "may").mkdir()
    shutil.copy(run / "result.json", tmp_path / "block" / "may")
    setup = tmp_path / "block" / "block.toml"
    text = re.sub(r"parameters = .*\nestimate = .*\nprior_sigma = .*\n", "", setup.read_text("utf-8"))
    setup.write_text(text + 'prior_from = "may/result.json"\n', "utf-8")
    return tmp_path / "block"


def test_the_prior_is_the_calibration_with_its_covariance(block: Path, run: Path) -> None:
    (camera,), (given,) = read_block(block).cameras, read_result(run).cameras.values()
    names = [name for name in PARAMETERS if given.sigma_of(name) > 0]
    at = [PARAMETERS.index(name) for name in names]
    assert camera.free == tuple(names)
    assert camera.values == pytest.approx(given.values, rel=1e-12)
    assert camera.prior_correlation is not None
    covariance = camera.prior_correlation[np.ix_(at, at)] * np.outer(*(camera.prior_sigma[at],) * 2)
    assert covariance == pytest.approx(given.covariance_of(names), rel=1e-9)
    assert "may/result.json" in {file.path for file in read_block(block).inputs}


def test_a_prior_of_the_same_photos_halves_the_variances(block: Path, run: Path, tmp_path: Path) -> None:
    """As if each photo had been taken twice; a prior without correlations would claim more for K1 to K3."""
    adjust_block(block, tmp_path / "run")
    (now,), (first,) = (read_result(path).cameras.values() for path in (tmp_path / "run", run))
    for name in ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2"):
        assert now.value(name) == pytest.approx(first.value(name), abs=0.05 * first.sigma_of(name))
        assert now.sigma_of(name) == pytest.approx(first.sigma_of(name) / np.sqrt(2), rel=0.02), name


@pytest.mark.parametrize(
    ("old", "new", "kind", "message"),
    [
        ('"may/', '"june/', InputNotFoundError, "does not exist"),
        ('"may/', '"../elsewhere/', PhotocalError, "does not exist|outside"),
        ("size_px = [3060, 2036]", "size_px = [3060, 2000]", ConfigurationError, "size_px"),
        (
            'prior_from = "may/result.json"',
            'prior_from = "may/result.json"\nparameters = { c = 20.0 }',
            ConfigurationError,
            "both given",
        ),
        (
            'prior_from = "may/result.json"',
            'prior_from = "may/result.json"\nestimate = ["c"]',
            ConfigurationError,
            "lacks x0",
        ),
    ],
)
def test_what_cannot_be_a_prior(
    block: Path, old: str, new: str, kind: type[PhotocalError], message: str
) -> None:
    setup = block / "block.toml"
    setup.write_text(setup.read_text("utf-8").replace(old, new), "utf-8")
    with pytest.raises(kind, match=message):
        read_block(block)


def test_a_calibration_outside_of_the_folder_is_refused(block: Path, run: Path) -> None:
    setup = block / "block.toml"
    setup.write_text(
        setup.read_text("utf-8").replace('"may/result.json"', json.dumps(str(run / "result.json"))), "utf-8"
    )
    with pytest.raises(ConfigurationError, match="outside of the block folder"):
        read_block(block)
