"""MicMac: its own projections, both generations of its files, and a block that adjusts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import parse

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.base.errors import InputMalformedError
from photocal.block.model import ROLES, Block
from photocal.block.network import assemble
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import named, read_foreign_project
from photocal.exchange.micmac import (
    read_calibration,
    read_ground_points,
    read_measures,
    read_micmac,
    read_orientation,
)
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.exchange.conftest import roles_of

pytestmark = pytest.mark.shared


@pytest.fixture
def folder(shared: Path) -> Path:
    return shared / "data" / "micmac-saisies-gcp"


@pytest.mark.parametrize("number", range(4167, 4171))
def test_its_own_projections(folder: Path, number: int) -> None:
    """<Verif>: image and ground coordinates that MicMac itself computed with this orientation."""
    own = read_calibration(folder / "Ori-Ground_mm3d" / "AutoCal_Foc-28000_Cam-PENTAX_K5.xml")
    path = folder / "Ori-Ground_mm3d" / f"Orientation-IMGP{number}.JPG.xml"
    pose, _ = read_orientation(path)
    checks = parse(path).getroot().findall("OrientationConique/Verif/Appuis")  # noqa: S314
    image, ground = (np.array([c.findtext(key, "").split() for c in checks], float) for key in ("Im", "Ter"))
    assert len(ground) == 10
    q = (ground - pose[3:]) @ matrix_from_angles(pose[:3]).T
    found = plane_to_pixel(own.size_px, own.pitch, projected(own, q))
    assert np.abs(found - image).max() < 1e-9


def test_both_generations_say_the_same(folder: Path) -> None:
    new = folder / "MMVII-PhgrProj" / "PointsMeasure" / "Saisies_MMVII"
    old = {point.name: point for point in read_ground_points(folder / "Ground-Pts3D.xml")}
    for point in read_ground_points(new / "MesGCP-FromV1-Ground-Pts3D.xml"):
        np.testing.assert_allclose(point.xyz, old[point.name].xyz, atol=1e-14)
        assert point.sigma == old[point.name].sigma
    marks = {(mark.image, mark.point): mark for mark in read_measures(folder / "GroundMeasure.xml")}
    again = [mark for path in sorted(new.glob("MesIm-*.xml")) for mark in read_measures(path)]
    assert len(again) == len(marks)
    for mark in again:
        other = marks[mark.image, mark.point]
        assert (mark.x, mark.y) == pytest.approx((other.x, other.y), abs=1e-9)


def test_block_adjusts(folder: Path) -> None:
    block = read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / "Ori-Ground_mm3d")
    # The file's uncertainty of 1 is a placeholder: with 1 m the network would hang in the air.
    assert np.all(block.points.sigma[block.points.of_role("control")] == 1)
    points = replace(block.points, sigma=np.where(block.points.sigma == 1, 0.01, block.points.sigma))
    solution = adjust(assemble(replace(block, points=points)).network)
    # Clicked marks.
    assert np.sqrt(np.mean(solution.residuals**2)) < 2


def test_wrong_convention(folder: Path, tmp_path: Path) -> None:
    text = (folder / "Ori-Ground_mm3d" / "AutoCal_Foc-28000_Cam-PENTAX_K5.xml").read_text()
    path = tmp_path / "c.xml"
    for old, new, message in (
        ("eConvApero_DistM2C", "eConvApero_DistC2M", "convention eConvApero_DistC2M"),
        ("ModRad", "ModUnif", "no equivalent"),
        ("<CDist>856", "<CDist>857", "centre of its own"),
        ("<SzIm>1728", "<SzIm>172800000", "impossible"),
        ("<F>2112.", "<F>2112,", "decimal comma"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(InputMalformedError, match=message):
            read_calibration(path)


def test_check_points_of_an_export_stay_check_points(tmp_path: Path, vision: Block) -> None:
    plain = replace(vision, cameras=tuple(replace(own, id=f"c{k}") for k, own in enumerate(vision.cameras)))
    named("micmac").write(tmp_path, plain, Choices())
    points = read_foreign_project(tmp_path).block.points
    role = dict(zip(points.names, (ROLES[k] for k in points.role), strict=True))
    for name, own in zip(vision.points.names, roles_of(vision), strict=True):
        if name in role:
            assert role[name] == own
    assert {"control", "check"} <= set(role.values())
