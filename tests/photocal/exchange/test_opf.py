"""OPF: its own library as the judge, round trips, and damaged projects."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyopf.io import load  # type: ignore[import-untyped]
from pyopf.resolve import resolve  # type: ignore[import-untyped]

from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.block.model import Block
from photocal.exchange.opf import read as read_opf
from photocal.exchange.opf import write as write_opf
from tests.photocal.exchange.conftest import reconstruction_of, residuals_of, roles_of, vision_camera


@pytest.fixture(scope="module")
def plain() -> Block:
    """Two cameras, without the affinity that OPF has no place for."""
    return reconstruction_of((vision_camera(), replace(vision_camera(K1=-1e-9), id="second")))


def turned(omega: float, phi: float, kappa: float) -> np.ndarray:
    """Rx(omega) Ry(phi) Rz(kappa), from image axes (right, top, back) to object space, as OPF defines it."""
    (so, co), (sp, cp), (sk, ck) = ((math.sin(a), math.cos(a)) for a in (omega, phi, kappa))
    rx = np.array([[1, 0, 0], [0, co, -so], [0, so, co]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(rx @ ry @ np.array([[ck, -sk, 0], [sk, ck, 0], [0, 0, 1]]))


def test_its_own_library_reads_the_project(tmp_path: Path, plain: Block) -> None:
    """All that pyopf resolves, projected by the specification, gives our residuals."""
    assert [made.largest_px for made in write_opf(tmp_path, plain)] == [0, 0]
    project = resolve(load(tmp_path / "project.opf"))
    calibration = project.calibration
    internals = {sensor.id.int: sensor.internals for sensor in calibration.calibrated_cameras.sensors}
    shots = {shot.id.int: shot for shot in calibration.calibrated_cameras.cameras}
    xyz = {point.id: point.coordinates for point in calibration.calibrated_control_points.points}
    names = {row.id.int: row.uri for row in project.camera_list.cameras}
    assert list(names.values()) == list(plain.images.names)
    points = [*project.input_control_points.gcps, *project.input_control_points.mtps]
    assert sum(point.is_checkpoint for point in points) == 1
    assert len(project.projected_control_points.projected_gcps) == 2
    residual = {
        (plain.images.names[i], plain.points.names[j]): v
        for i, j, v in zip(
            plain.observations.image, plain.observations.point, residuals_of(plain), strict=True
        )
    }
    found = {}
    for point in points:
        for mark in point.marks:
            shot = shots[mark.camera_id.int]
            own = internals[shot.sensor_id.int]
            matrix = turned(*np.radians(shot.orientation_deg))
            q = matrix.T @ (xyz[point.id] - shot.position)
            x, y = q[0] / -q[2], -q[1] / -q[2]
            r2 = x * x + y * y
            r1, r_2, r3 = own.radial_distortion
            t1, t2 = own.tangential_distortion
            radial = 1 + r1 * r2 + r_2 * r2**2 + r3 * r2**3
            u = own.focal_length_px * (x * radial + 2 * t1 * x * y + t2 * (r2 + 2 * x * x))
            v = own.focal_length_px * (y * radial + 2 * t2 * x * y + t1 * (r2 + 2 * y * y))
            found[names[shot.id.int], point.id] = np.array([u, v]) + own.principal_point_px - mark.position_px
    assert found.keys() == residual.keys()
    assert max(np.abs(found[key] - residual[key]).max() for key in found) < 1e-6


def test_round_trip(tmp_path: Path, plain: Block) -> None:
    write_opf(tmp_path, plain)
    again = read_opf(tmp_path / "project.opf").block
    assert (again.images.names, again.points.names, roles_of(again)) == (
        plain.images.names,
        plain.points.names,
        roles_of(plain),
    )
    np.testing.assert_allclose(again.images.values, plain.images.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.points.values, plain.points.values, rtol=1e-15)
    np.testing.assert_allclose(again.points.sigma[:2], plain.points.sigma[:2])
    order = np.lexsort((plain.observations.image, plain.observations.point))
    np.testing.assert_allclose(again.observations.values, plain.observations.values[order], atol=1e-9)
    assert np.array_equal(again.images.camera, plain.images.camera)
    for own, other in zip(plain.cameras, again.cameras, strict=True):
        assert own.id == other.id
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=1e-15)


def test_affinity_has_no_place(tmp_path: Path, vision: Block) -> None:
    with pytest.raises(InputMalformedError, match="affinity"):
        write_opf(tmp_path, vision)
    assert not list(tmp_path.iterdir())


def _shutter(content: dict) -> None:  # type: ignore[type-arg]
    content["cameras"][0]["rolling_shutter"] = [0.1, 0, 0]


def _fisheye(content: dict) -> None:  # type: ignore[type-arg]
    content["sensors"][0]["internals"]["type"] = "fisheye"


def _unknown_sensor(content: dict) -> None:  # type: ignore[type-arg]
    content["cameras"][0]["sensor_id"] = 10**18


def _short(content: dict) -> None:  # type: ignore[type-arg]
    content["cameras"][0]["position"] = [1, 2]


def _outside(content: dict) -> None:  # type: ignore[type-arg]
    content["items"][1]["resources"][0]["uri"] = "..%2Fcamera_list.json"


def _web(content: dict) -> None:  # type: ignore[type-arg]
    content["items"][1]["resources"][0]["uri"] = "http://127.0.0.1/x.json"


def _future(content: dict) -> None:  # type: ignore[type-arg]
    content["version"] = "2.0"


def _uncalibrated(content: dict) -> None:  # type: ignore[type-arg]
    content["items"] = content["items"][:-1]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("calibrated_cameras.json", _shutter, "rolling shutter"),
        ("calibrated_cameras.json", _fisheye, "no equivalent"),
        ("calibrated_cameras.json", _unknown_sensor, "unknown sensor"),
        ("calibrated_cameras.json", _short, "lacks the structure"),
        ("calibrated_cameras.json", _future, "version 2.0"),
        ("project.opf", _outside, "not inside its folder"),
        ("project.opf", _web, "neither there nor beside"),
        ("project.opf", _future, "version 2.0"),
        ("project.opf", _uncalibrated, "names no calibrated cameras"),
    ],
)
def test_bad_project(
    tmp_path: Path,
    plain: Block,
    name: str,
    change: Callable[[dict], None],  # type: ignore[type-arg]
    message: str,
) -> None:
    write_opf(tmp_path, plain)
    content = json.loads((tmp_path / name).read_text())
    change(content)
    (tmp_path / name).write_text(json.dumps(content))
    with pytest.raises((InputMalformedError, InputNotFoundError), match=message):
        read_opf(tmp_path / "project.opf")
