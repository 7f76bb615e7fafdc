"""Projects of cameras on one frame, simulated, in the layouts of the programs that know rigs.

What the layouts look like is that of the programs' descriptions (COLMAP "Rig Support" and "Output Format",
OpenSfM "Rig", camera XML of Metashape); rigs are written here, nothing of them is taken from the readers.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.rig import OF_HEAD, TURN
from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.block.rig import Head
from photocal.exchange import colmap, metashape, opensfm
from photocal.exchange.exporting import Choices
from photocal.exchange.parts import pixels as in_px
from photocal.exchange.pinhole import to_vision
from photocal.exchange.source import read_xml
from photocal.geometry.camera import Camera, camera, plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.frames import ReferenceFrame
from photocal.geometry.oriented_images import given_places
from photocal.geometry.rotation import angles_from_matrix

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SIZE, HEIGHT_M, OUT = (6000, 4000), 150.0, np.radians(40.0)
# As rotation vectors about the axes of the head that looks down.
NOMINAL = np.array([[0, 0, 0], [0, -OUT, 0], [0, OUT, 0], [OUT, 0, 0], [-OUT, 0, 0]])
ORIGIN = np.array([677000.0, 7184000.0, 0.0])
CONTROL, NOISE_PX, POSITION_M, SURVEY_M = 15, 0.5, 0.02, (0.02, 0.02, 0.03)
# The system of control lists, and where in it the middle of a project is.
SYSTEM, MIDDLE = "EPSG:32722", np.array([677000.0, 7184000.0, 900.0])


def lens(k: int, rng: np.random.Generator) -> Camera:
    """A camera of a frame of 6000 x 4000 px: the oblique ones are longer."""
    c = (5000 if k == 0 else 7500) + rng.normal(0, 10)
    values = {"c": c, "x0": rng.normal(0, 10), "y0": rng.normal(0, 10)}
    values |= {"K1": -0.05 / c**2, "K2": 0.02 / c**4, "K3": -0.01 / c**6, "P1": 1e-4 / c, "P2": -2e-4 / c}
    return camera(f"h{k}", "brown-ideal", "px", SIZE, (1.0, 1.0), values)


def project(exposures: int, heads: int, rays: int, origin: Floats = ORIGIN) -> tuple[Block, Floats]:
    """Crossing strips over a plain: the truth, measured with noise, and positions by GNSS (images, 3)."""
    rng = np.random.default_rng(3)
    cameras = tuple(lens(k, rng) for k in range(heads))
    real = NOMINAL[:heads] + rng.normal(0, np.radians(0.5), (heads, 3)) * (np.arange(heads) > 0)[:, None]
    turn = Rotation.from_rotvec(real).as_matrix()
    arm = rng.normal(0, 0.1, (heads, 3)) * (np.arange(heads) > 0)[:, None]
    strip, along = np.divmod(np.arange(exposures), int(np.ceil(np.sqrt(exposures))))
    place = np.column_stack([strip * 45.0, along * 30.0, np.full(exposures, HEIGHT_M)])
    place += rng.normal(0, 2, place.shape)
    angles = rng.normal(0, np.radians(3), (exposures, 3))
    angles[:, 2] = np.where(strip % 2, np.pi / 2, -np.pi / 2)
    first = Rotation.from_euler("zyx", -angles[:, ::-1]).as_matrix()
    rotation = np.einsum("hab,ebc->heac", turn, first).reshape(-1, 3, 3)
    centre = (place + np.einsum("eba,hb->hea", first, arm)).reshape(-1, 3)
    member = np.repeat(np.arange(heads), exposures)
    low, high = place.min(axis=0) - HEIGHT_M, place.max(axis=0) + HEIGHT_M
    count = int(rays * len(centre) / 3)
    ground = rng.uniform([*low[:2], 0], [*high[:2], 15], (count, 3))
    seen = [_seen(cameras[member[i]], rotation[i], centre[i], ground) for i in range(len(centre))]
    image = np.repeat(np.arange(len(centre)), [len(points) for points, _ in seen])
    point, pixels = np.concatenate([p for p, _ in seen]), np.vstack([xy for _, xy in seen])
    # Tracks are short: two images and a few more; those of control are longer.
    order = np.lexsort((rng.random(len(point)), point))
    rank = np.empty(len(point), dtype=np.int64)
    rank[order] = np.arange(len(point)) - np.searchsorted(point[order], point[order])
    wanted = 2 + rng.poisson(2, count)
    wanted[: 4 * CONTROL] = 12
    kept = rank < wanted[point]
    kept &= (np.bincount(point[kept], minlength=count) > 1)[point]
    used, point = np.unique(point[kept], return_inverse=True)
    roles = tuple("control" if k < 3 * CONTROL and k % 3 == 0 else "tie" for k in range(len(used)))
    surveyed = np.array([role == "control" for role in roles])[:, None]
    xyz = ground[used] + origin + surveyed * rng.normal(0, SURVEY_M, (len(used), 3))
    measured = pixels[kept] + rng.normal(0, NOISE_PX, (int(kept.sum()), 2))
    names = tuple(f"H{head}_{k:04d}.JPG" for head in range(heads) for k in range(exposures))
    poses = np.column_stack([angles_from_matrix(rotation), centre + origin])
    role = np.array([ROLES.index("control" if word == "control" else "tie") for word in roles])
    points = ObjectPoints(tuple(str(1000 + k) for k in range(len(used))), xyz, role=role)
    rays_of = in_px(image[kept], point, measured)
    made = Block("block", "local", "", "control", cameras, Images(names, member, poses), points, rays_of)
    return made, np.tile(place + origin + rng.normal(0, POSITION_M, place.shape), (heads, 1))


def _seen(own: Camera, rotation: Floats, centre: Floats, ground: Floats) -> tuple[Integers, Floats]:
    inside = (ground - centre) @ rotation.T
    ahead = np.flatnonzero((np.abs(inside[:, :2]) < -0.9 * inside[:, 2:]).all(axis=1))
    pixels = plane_to_pixel(own.size_px, own.pitch, projected(own, inside[ahead]))
    kept = np.isfinite(pixels).all(axis=1) & (pixels > 0).all(axis=1) & (pixels < own.size_px).all(axis=1)
    return ahead[kept], pixels[kept]


def on_a_frame(made: Block) -> Block:
    """The same with its cameras as heads of one frame, whose images of one number are of one exposure."""
    first = made.cameras[0].id
    heads = []
    for k, own in enumerate(made.cameras):
        sigma = np.zeros(len(OF_HEAD))
        if k:
            sigma[: TURN.stop + 3] = np.inf
        turn = Rotation.from_rotvec(NOMINAL[k]).as_rotvec()
        heads.append(Head(own.id, first, turn, np.zeros(len(OF_HEAD)), sigma))
    exposure = tuple(name.split("_")[1].split(".")[0] for name in made.images.names)
    return replace(made, heads=tuple(heads), images=replace(made.images, exposure=exposure))


def _in_rig(given: Block) -> tuple[Floats, Floats, Integers]:
    """From the first head to each (rotation, translation), in vision axes, and exposures by head."""
    count = len(given.cameras)
    image = np.array([np.flatnonzero(given.images.camera == k) for k in range(count)])
    rotation, translation = to_vision(given.images.values)
    first = image[:, 0]
    turn = rotation[first] @ rotation[first[0]].T
    return turn, translation[first] - np.einsum("nab,b->na", turn, translation[first[0]]), image


def _wxyz(turn: Floats) -> list[float]:
    x, y, z, w = Rotation.from_matrix(turn).as_quat().tolist()
    return [w, x, y, z]


def _control_list(folder: Path, given: Block) -> None:
    """gcp_list.txt in a map system, whose scale is not that of the ground."""
    mapped, seen = given_places(ReferenceFrame(SYSTEM, MIDDLE), given.points.values), given.observations
    rows = [SYSTEM]
    for ray in np.flatnonzero(~given.points.of_role("tie")[seen.point]):
        i, j = seen.image[ray], seen.point[ray]
        numbers = [*mapped[j].tolist(), *seen.values[ray].tolist()]
        rows.append(" ".join([*map(repr, numbers), given.images.names[i], f"P{given.points.names[j]}"]))
    (folder / "gcp_list.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")


def _ties(given: Block) -> Block:
    tie = given.points.of_role("tie")
    seen = given.observations.rows(tie[given.observations.point])
    seen = replace(seen, point=(np.cumsum(tie) - 1)[seen.point])
    return replace(given, points=given.points.only(tie), observations=seen)


def write_colmap_text(folder: Path, given: Block) -> None:
    """A text model with rigs.txt and frames.txt, and a list of control."""
    colmap.write_colmap(folder, _ties(given), Choices())
    _control_list(folder, given)
    turn, shift, image = _in_rig(given)
    rotation, translation = to_vision(given.images.values)
    sensors = [f"CAMERA {k + 1} 1 {_digits(_wxyz(turn[k]))} {_digits(shift[k])}" for k in range(1, len(turn))]
    rig = " ".join([f"1 {len(turn)} CAMERA 1", *sensors])
    (folder / "rigs.txt").write_text(f"# RIG_ID, ...\n{rig}\n", encoding="utf-8")
    rows = ["# FRAME_ID, ..."]
    for key, of_exposure in enumerate(image.T, start=1):
        pose = f"{_digits(_wxyz(rotation[of_exposure[0]]))} {_digits(translation[of_exposure[0]])}"
        data = " ".join(f"CAMERA {k + 1} {row + 1}" for k, row in enumerate(of_exposure))
        rows.append(f"{key} 1 {pose} {len(turn)} {data}")
    (folder / "frames.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_colmap_binary(folder: Path, given: Block) -> None:
    """The same in binary."""
    colmap.write_binary(folder, _ties(given), Choices())
    _control_list(folder, given)
    turn, shift, image = _in_rig(given)
    rotation, translation = to_vision(given.images.values)
    camera_kind = 0
    rigs = struct.pack("<QII", 1, 1, len(turn)) + struct.pack("<iI", camera_kind, 1)
    for k in range(1, len(turn)):
        rigs += struct.pack("<iIB7d", camera_kind, k + 1, 1, *_wxyz(turn[k]), *shift[k])
    frames = struct.pack("<Q", image.shape[1])
    for key, of_exposure in enumerate(image.T, start=1):
        lead = of_exposure[0]
        frames += struct.pack("<II7dI", key, 1, *_wxyz(rotation[lead]), *translation[lead], len(turn))
        for k, row in enumerate(of_exposure):
            frames += struct.pack("<iIQ", camera_kind, k + 1, row + 1)
    (folder / "rigs.bin").write_bytes(rigs)
    (folder / "frames.bin").write_bytes(frames)


def write_opensfm(folder: Path, given: Block) -> None:
    """A reconstruction with rig cameras and instances, tracks, and a list of control."""
    opensfm.write(folder, _ties(given))
    _control_list(folder, given)
    turn, shift, image = _in_rig(given)
    rotation, translation = to_vision(given.images.values)
    file = folder / "reconstruction.json"
    (content,) = json.loads(file.read_text(encoding="utf-8"))

    def pose(of: Floats, by: Floats) -> dict[str, list[float]]:
        return {"rotation": Rotation.from_matrix(of).as_rotvec().tolist(), "translation": by.tolist()}

    ids = [own.id for own in given.cameras]
    content["rig_cameras"] = {name: pose(turn[k], shift[k]) for k, name in enumerate(ids)}
    content["rig_instances"] = {
        str(key): pose(rotation[rows[0]], translation[rows[0]])
        | {"rig_camera_ids": {given.images.names[row]: ids[k] for k, row in enumerate(rows)}}
        for key, rows in enumerate(image.T)
    }
    file.write_text(json.dumps([content]), encoding="utf-8")


def write_metashape(folder: Path, given: Block) -> None:
    """A camera XML of a multi-camera system: images of its other sensors have their master only.

    Such a file has no tie points but markers: those without a reference.
    """
    path = folder / "cameras.xml"
    everything = np.full(len(given.points.names), ROLES.index("control"))
    metashape.write(path, replace(given, points=replace(given.points, role=everything)))
    turn, shift, image = _in_rig(given)
    tree = ElementTree.ElementTree(read_xml(path))
    for k, sensor in enumerate(tree.iterfind("chunk/sensors/sensor")):
        if k:
            sensor.set("master_id", "0")
            ElementTree.SubElement(sensor, "rotation").text = _digits(turn[k].T.ravel())
            ElementTree.SubElement(sensor, "location").text = _digits(-turn[k].T @ shift[k])
    lead = {str(row): str(rows[0]) for rows in image.T for row in rows[1:]}
    for shot in tree.iterfind("chunk/cameras/camera"):
        if (of := lead.get(shot.get("id", ""))) is not None:
            shot.set("master_id", of)
            shot.remove(shot.find("transform"))  # type: ignore[arg-type]
    ties = {given.points.names[k] for k in np.flatnonzero(given.points.of_role("tie"))}
    for marker in tree.iterfind("chunk/markers/marker"):
        if marker.get("label") in ties:
            marker.remove(marker.find("reference"))  # type: ignore[arg-type]
    tree.write(path)


def _digits(values: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


LAYOUTS: dict[str, Callable[[Path, Block], None]] = {
    "colmap-text": write_colmap_text,
    "colmap-binary": write_colmap_binary,
    "opensfm": write_opensfm,
    "metashape": write_metashape,
}
