"""Rigs of other programs: heads as the poses of their own images have them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.rig import CENTRE
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.colmap import read_colmap
from photocal.exchange.metashape import read_metashape
from photocal.exchange.opensfm import read_reconstruction
from photocal.exchange.pinhole import FLIP, from_vision
from photocal.exchange.rigs import of_poses
from photocal.geometry.camera import camera
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.exchange.conftest import to_adjust

Floats = NDArray[np.float64]
# From rig to sensor, and from world to rig in two exposures: x right, y down, z forward.
SENSORS = {
    "first": (Rotation.from_rotvec([0.0, 0.0, 0.0]), np.zeros(3)),
    "left": (Rotation.from_rotvec([0.1, -0.7, 0.05]), np.array([0.2, -0.1, 0.03])),
    "aft": (Rotation.from_rotvec([-0.75, 0.02, 3.0]), np.array([-0.02, 0.15, 0.01])),
}
FRAMES = [
    (Rotation.from_rotvec([2.9, 0.3, -0.2]), np.array([3.0, -2.0, 60.0])),
    (Rotation.from_rotvec([3.0, -0.4, 0.5]), np.array([-8.0, 5.0, 62.0])),
]


def pose(head: str, frame: int) -> tuple[Rotation, Floats]:
    (turn, shift), (own, at) = SENSORS[head], FRAMES[frame]
    return turn * own, turn.apply(at) + shift


def as_images_have_them(given: Block) -> None:
    """Relative orientations of the heads against those between the images, by the definition."""
    assert len(given.heads) == 3
    block = to_adjust(given, "rig", 1.0)
    assert [head.of for head in block.heads] == [block.heads[0].camera] * 3
    ids = [camera.id for camera in block.cameras]
    rotation = matrix_from_angles(block.images.values[:, :3])
    centre = block.images.values[:, 3:]
    pairs = 0
    for a, b in np.ndindex(len(ids) * 2, len(ids) * 2):
        of_a, of_b = (ids[block.images.camera[k]] for k in (a, b))
        if of_a != block.heads[0].camera or block.images.exposure[a] != block.images.exposure[b]:
            continue
        head = next(one for one in block.heads if one.camera == of_b)
        assert head.rotation is not None
        turn = Rotation.from_rotvec(head.rotation).as_matrix()
        assert np.allclose(turn, rotation[b] @ rotation[a].T, atol=1e-9)
        assert np.allclose(head.values[CENTRE], rotation[a] @ (centre[b] - centre[a]), atol=1e-9)
        pairs += 1
    assert pairs == 6


def test_opensfm(tmp_path: Path) -> None:
    lens = {"projection_type": "brown", "width": 1000, "height": 800, "focal_x": 0.9, "focal_y": 0.9}
    lens |= dict.fromkeys(("c_x", "c_y", "k1", "k2", "k3", "p1", "p2"), 0.0)
    shots = {}
    for head in SENSORS:
        for frame in range(2):
            turn, shift = pose(head, frame)
            shots[f"{head}_{frame}.jpg"] = {
                "rotation": turn.as_rotvec().tolist(), "translation": shift.tolist(), "camera": "one",
            }  # fmt: skip
    (tmp_path / "reconstruction.json").write_text(json.dumps([{"cameras": {"one": lens}, "shots": shots}]))
    poses = {
        n: {"rotation": r.as_rotvec().tolist(), "translation": t.tolist()} for n, (r, t) in SENSORS.items()
    }
    (tmp_path / "rig_cameras.json").write_text(json.dumps(poses))
    assigned = {f"e{k}": [[f"{head}_{k}.jpg", head] for head in SENSORS] for k in range(2)}
    (tmp_path / "rig_assignments.json").write_text(json.dumps(assigned))
    as_images_have_them(read_reconstruction(tmp_path / "reconstruction.json"))


def test_opensfm_with_rigs_in_the_reconstruction(tmp_path: Path) -> None:
    test_opensfm(tmp_path)
    file = tmp_path / "reconstruction.json"
    (content,) = json.loads(file.read_text())
    content["rig_cameras"] = json.loads((tmp_path / "rig_cameras.json").read_text())
    assigned = json.loads((tmp_path / "rig_assignments.json").read_text())
    content["rig_instances"] = {
        key: {"rotation": [0, 0, 0], "translation": [0, 0, 0], "rig_camera_ids": dict(rows)}
        for key, rows in assigned.items()
    }
    for name in ("rig_cameras.json", "rig_assignments.json"):
        (tmp_path / name).unlink()
    file.write_text(json.dumps([content]))
    as_images_have_them(read_reconstruction(file))
    # Images by themselves are instances, too.
    content["rig_instances"] = {
        name: {"rotation": [0, 0, 0], "translation": [0, 0, 0], "rig_camera_ids": {name: head}}
        for rows in assigned.values()
        for name, head in rows
    }
    file.write_text(json.dumps([content]))
    assert not read_reconstruction(file).heads


def test_binary_rigs_as_colmap_writes_them(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    test_colmap(tmp_path, "model")
    made = pycolmap.Reconstruction()
    made.read_text(str(tmp_path))
    (tmp_path / "binary").mkdir()
    made.write_binary(str(tmp_path / "binary"))
    as_images_have_them(read_colmap(tmp_path / "binary"))


def test_heads_are_known_by_their_poses() -> None:
    rng = np.random.default_rng(3)
    cameras = tuple(
        camera(n, "brown-ideal", "px", (1000, 800), (1.0, 1.0), {"c": 900.0}) for n in (*SENSORS, "other")
    )
    rotation, centre, member = [], [], []
    for frame in range(6):
        own, at = Rotation.from_rotvec([2.9, 0.1 * frame, -0.2]), np.array([20.0 * frame, 3.0, 60.0])
        for k, (turn, shift) in enumerate(SENSORS.values()):
            whole = turn * own
            rotation.append(whole.as_matrix())
            centre.append(at - whole.inv().apply(shift))
            member.append(k)
        # A camera of another flight comes near all of them.
        rotation.append((Rotation.from_rotvec(rng.normal(0, 0.01, 3)) * own).as_matrix())
        centre.append(at + rng.normal(0, 0.3, 3))
        member.append(3)
    vision = np.array(rotation)
    poses = from_vision(vision, -np.einsum("nij,nj->ni", vision, np.array(centre)))
    heads, exposure = of_poses(cameras, np.array(member), poses)
    assert [(head.camera, head.of) for head in heads] == [(name, "first") for name in SENSORS]
    assert [len({*exposure[k : k + 3]}) for k in range(0, 24, 4)] == [1] * 6
    assert set(exposure[3::4]) == {""}
    for head in heads[1:]:
        turn, shift = SENSORS[head.camera]
        assert head.rotation is not None
        assert np.allclose(Rotation.from_rotvec(head.rotation).as_matrix(), FLIP @ turn.as_matrix() @ FLIP)
        assert np.allclose(head.values[CENTRE], FLIP @ -turn.inv().apply(shift))


@pytest.mark.parametrize("form", ["model", "config"])
def test_colmap(tmp_path: Path, form: str) -> None:
    def wxyz(turn: Rotation) -> list[float]:
        x, y, z, w = turn.as_quat().tolist()
        return [w, x, y, z]

    lines = [f"{k} PINHOLE 1000 800 900 900 500 400" for k in (1, 2, 3)]
    (tmp_path / "cameras.txt").write_text("\n".join(lines) + "\n")
    images, frames = [], []
    for frame in range(2):
        for k, head in enumerate(SENSORS):
            turn, shift = pose(head, frame)
            numbers = " ".join(map(repr, [*wxyz(turn), *shift.tolist()]))
            images += [f"{3 * frame + k + 1} {numbers} {k + 1} {head}/{frame}.jpg", ""]
        own, at = FRAMES[frame]
        data = " ".join(f"CAMERA {k + 1} {3 * frame + k + 1}" for k in range(3))
        frames.append(f"{frame + 7} 4 {' '.join(map(repr, [*wxyz(own), *at.tolist()]))} 3 {data}")
    (tmp_path / "images.txt").write_text("\n".join(images) + "\n")
    (tmp_path / "points3D.txt").write_text("# none\n")
    if form == "model":
        rig = " ".join(
            f"CAMERA {k + 1} 1 " + " ".join(map(repr, [*wxyz(r), *t.tolist()]))
            for k, (r, t) in enumerate(SENSORS.values())
            if k
        )
        (tmp_path / "rigs.txt").write_text(f"# rigs\n4 3 CAMERA 1 {rig}\n")
        (tmp_path / "frames.txt").write_text("\n".join(frames) + "\n")
    else:
        entries = [
            {
                "image_prefix": f"{n}/",
                "cam_from_rig_rotation": wxyz(r),
                "cam_from_rig_translation": t.tolist(),
            }
            for n, (r, t) in SENSORS.items()
        ]
        entries[0] = {"image_prefix": "first/", "ref_sensor": True}
        (tmp_path / "rig_config.json").write_text(json.dumps([{"cameras": entries[::-1]}]))
    as_images_have_them(read_colmap(tmp_path))


def test_metashape(tmp_path: Path) -> None:
    sensors, cameras = [], []
    for k, (turn, shift) in enumerate(SENSORS.values()):
        inverse = turn.inv()
        place = -inverse.apply(shift)
        of_master = (
            f"<rotation>{' '.join(map(repr, inverse.as_matrix().ravel().tolist()))}</rotation>"
            f"<location>{' '.join(map(repr, place.tolist()))}</location>"
        )
        sensors.append(
            f'<sensor id="{k}" label="s{k}" {"" if k == 0 else "master_id=" + chr(34) + "0" + chr(34)}>'
            f'<calibration type="frame" class="adjusted"><resolution width="1000" height="800"/><f>900</f>'
            f"</calibration>{'' if k == 0 else of_master}</sensor>"
        )
    for frame, (own, at) in enumerate(FRAMES):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = own.inv().as_matrix(), -own.inv().apply(at)
        text = " ".join(map(repr, matrix.ravel().tolist()))
        cameras.append(
            f'<camera id="{3 * frame}" sensor_id="0" label="a{frame}"><transform>{text}</transform></camera>'
        )
        cameras += [
            f'<camera id="{3 * frame + k}" sensor_id="{k}" master_id="{3 * frame}" label="b{k}{frame}"/>'
            for k in (1, 2)
        ]
    (tmp_path / "cameras.xml").write_text(
        f'<document version="1.5.0"><chunk label="c"><sensors>{"".join(sensors)}</sensors>'
        f"<cameras>{''.join(cameras)}</cameras></chunk></document>"
    )
    as_images_have_them(read_metashape(tmp_path / "cameras.xml").block)


def test_rig_assignments_that_are_none_are_refused(tmp_path: Path) -> None:
    test_opensfm(tmp_path)
    (tmp_path / "rig_assignments.json").write_text("0")
    with pytest.raises(InputMalformedError):
        read_reconstruction(tmp_path / "reconstruction.json")


def test_a_sensor_that_is_turned_by_no_rotation_is_refused(tmp_path: Path) -> None:
    test_metashape(tmp_path)
    path = tmp_path / "cameras.xml"
    mirrored = re.sub(r"<rotation>", "<rotation>-", path.read_text(), count=1).replace("--", "")
    path.write_text(mirrored)
    with pytest.raises(InputMalformedError, match="not a rotation"):
        read_metashape(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("image_prefix", []),
        ("cam_from_rig_rotation", [0.0] * 4),
        ("cam_from_rig_rotation", [1.0]),
        ("cam_from_rig_translation", [1.0]),
    ],
)
def test_a_damaged_rig_is_refused(tmp_path: Path, key: str, value: list[float]) -> None:
    test_colmap(tmp_path, "config")
    path = tmp_path / "rig_config.json"
    rigs = json.loads(path.read_text())
    rigs[0]["cameras"][0][key] = value
    path.write_text(json.dumps(rigs))
    with pytest.raises(InputMalformedError):
        read_colmap(tmp_path)
