"""SXB against DBAT's check points; saisies against MicMac's orientation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.accuracy.standard import Question
from photocal.analysis.georeferencing.comparison import check_block, differences
from photocal.analysis.georeferencing.methods import Degradation, of_method
from photocal.analysis.georeferencing.prepared import with_roles
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.micmac import read_micmac
from photocal.exchange.photomodeler import block_from_export, read_control, read_export
from tests.photocal.blocks import with_positions

pytestmark = pytest.mark.shared

# Adjusted less surveyed, m: report.txt of DBAT's own run, printed to 1 mm.
DBAT = {"351": (0.167, 0.008, -0.459), "410": (0.096, -0.296, 0.136)}


@pytest.fixture
def sxb(shared: Path) -> Path:
    return shared / "data" / "dbat-sxb"


def test_sxb_indirect_as_in_dbat(sxb: Path) -> None:
    block = read_foreign_block(sxb / "script" / "sxb.xml")
    noise = Degradation(0.08, np.radians(0.02))
    result = check_block(block, (), Question(), (noise, np.random.default_rng(1)))
    indirect = result.of("indirect")
    assert indirect is not None
    assert set(indirect.check.names) == set(DBAT)
    for name, d in zip(indirect.check.names, indirect.check.d, strict=True):
        np.testing.assert_allclose(d, DBAT[name], atol=0.0006)
    # Their errors are several times what the sigmas promise, and that is said.
    assert indirect.check.suspected == ("410",)
    assert indirect.check.ratio > 3
    direct = result.of("direct")
    assert direct is not None
    assert "SIMULATED" in direct.result.label
    assert 0.2 < direct.check.ratio < 2
    assert result.exposures is not None
    np.testing.assert_allclose(result.exposures[2][3:], 0.08, rtol=0.7)
    assert [method for method, _ in result.refused] == ["integrated"]


def test_sxb_integrated_with_camera_positions(sxb: Path) -> None:
    export = read_export(sxb / "pmexports" / "wsmart-with-orient-pmexport.txt")
    control = read_control(sxb / "ref" / "ctrlpts-weighted.txt")
    block = with_positions(block_from_export(export, control), sxb / "ref" / "fake-camera-positions.txt")
    index = {name: k for k, name in enumerate(block.points.names)}
    held = np.array([k for k in np.flatnonzero(block.points.of_role("control")) if k not in _of(index)])
    block = with_roles(block, held)
    result = check_block(block, (), Question())
    methods = [one.result.method for one in result.judged]
    assert methods == ["integrated", "indirect"]
    integrated, indirect = result.judged
    assert set(integrated.check.names) == set(indirect.check.names) == set(DBAT)
    # Positions known to 5 cm stiffen the block: no predicted sigma grows.
    assert np.all(integrated.check.product_sigma <= indirect.check.product_sigma * (1 + 1e-9))
    assert np.all(np.abs(integrated.check.d) < 0.6)
    assert "direct georeferencing needs position and attitude" in result.refused[0][1]
    assert result.systematic is not None


def _of(index: dict[str, int]) -> set[int]:
    return {index[name] for name in DBAT}


def test_saisies_indirect_against_micmac(shared: Path) -> None:
    """MicMac's orientation, made with more tie points, lies within the sigmas of control alone."""
    folder = shared / "data" / "micmac-saisies-gcp"
    block = read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / "Ori-Ground_mm3d")
    # The file's uncertainty of 1 is a placeholder.
    sigma = np.where(np.isfinite(block.points.sigma), 0.01, np.inf)
    block = replace(block, points=replace(block.points, sigma=sigma))
    found = of_method(block, "indirect")
    assert found.solution is not None
    # One image of four has three marks only: it is set aside, and that is said.
    assert "images with fewer than four rays, left out: 1" in found.label
    seen = np.asarray(np.isfinite(found.exposures).all(axis=1))
    assert [block.images.names[k] for k in np.flatnonzero(~seen)] == ["IMGP4167.JPG"]
    deviation = np.sqrt(np.diagonal(found.solution.exposure_covariance, axis1=1, axis2=2))
    d = (found.exposures - block.images.values)[seen]
    assert np.abs(d[:, 3:]).max() < 0.04
    assert np.abs(d / deviation[seen]).max() < 1.5
    control = differences(block, found, "control")
    assert len(control.names) == 6
    assert control.suspected == ()
