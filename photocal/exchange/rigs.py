"""Rigs of other programs: which images are of one exposure, and how their cameras lie on a frame.

COLMAP: rigs and frames of a model (3.12 and later), or the `rig_config.json` that its rig_configurator takes
(prefixes of image names; what follows them names the exposure). OpenSfM: the reconstruction itself, or
`rig_cameras.json` and `rig_assignments.json`. Both state sensor from rig, x = R X + t, in camera axes x
right, y down, z forward. Metashape: sensors with a master have place and rotation to its axes, images a
`master_id`. What a program found has no standard deviations: turns and places start there and are free.
Pix4D's `params` do not say which images are of one exposure: their poses do. Sources: COLMAP documentation,
"Rig Support" and "Output Format"; OpenSfM documentation, "Rig"; Metashape Python reference, "Sensor".
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from photocal.adjustment.rig import CENTRE, OF_HEAD, TURN
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.block.rig import Head
from photocal.exchange.pinhole import FLIP, rotation_from_quaternion, to_vision
from photocal.exchange.source import numbers, read_json, structured
from photocal.geometry.camera import Camera
from photocal.geometry.rotation import matrix_from_angles

# By how much a quaternion that was printed may fail the length 1.
LARGEST_MISFIT = 1e-3
# Heads are on a frame where nearly all their exposures, and so many, agree to what is printed.
SAME_M, SAME_RAD, MOST, FEWEST_EXPOSURES = 1e-3, 1e-5, 0.9, 3
# Rotation and translation from rig to sensor, in vision axes; none where it is not known.
Sensor = tuple[Floats, Floats] | None
# Of COLMAP: number of a rig, and its sensors by name, the reference first; number of a frame, that of its
# rig, and the images of its sensors.
Rig = tuple[int, dict[str, Sensor]]
Frame = tuple[int, int, list[tuple[str, int]]]


def with_rig(
    given: Block, head: Sequence[str], exposure: Sequence[str], sensors: Mapping[str, Sensor]
) -> Block:
    """Give a block its rigs.

    head, exposure (images,): of each image; empty for one by itself.
    sensors: of each head, the one that the others refer to first. A camera of several heads becomes one each.
    """
    used = [name for name in sensors if name in head]
    if len(used) < 2:
        return given
    cameras, camera_of = list(given.cameras), given.images.camera.copy()
    names = {camera.id for camera in cameras}
    ids, taken = dict[str, str](), set[int]()
    for name in used:
        in_head = np.array([of_image == name for of_image in head])
        first = int(camera_of[in_head][0])
        if first in taken or (camera_of[~in_head] == first).any():
            camera_id = next(n for n in (f"{given.cameras[first].id}-{name}", name) if n not in names)
            names.add(camera_id)
            cameras.append(replace(given.cameras[first], id=camera_id))
            first = len(cameras) - 1
        camera_of[in_head] = first
        taken.add(first)
        ids[name] = cameras[first].id
    left = np.unique(camera_of[camera_of >= 0])
    place = np.full(len(cameras), -1)
    place[left] = np.arange(len(left))
    images = replace(
        given.images,
        camera=np.where(camera_of >= 0, place[camera_of], -1),
        exposure=tuple(
            key if name in used else before
            for key, name, before in zip(exposure, head, given.images.exposure, strict=True)
        ),
    )
    return replace(
        given,
        cameras=tuple(cameras[k] for k in left),
        images=images,
        heads=(*given.heads, *(_head(name, used[0], ids, sensors) for name in used)),
    )


def _head(name: str, base: str, ids: Mapping[str, str], sensors: Mapping[str, Sensor]) -> Head:
    values, sigma = np.zeros(len(OF_HEAD)), np.zeros(len(OF_HEAD))
    first, sensor = sensors[base], sensors[name]
    if name == base:
        return Head(ids[name], ids[base], np.zeros(3), values, sigma)
    sigma[TURN], sigma[CENTRE] = np.inf, np.inf
    if first is None or sensor is None:
        return Head(ids[name], ids[base], None, values, sigma)
    between = FLIP @ sensor[0] @ first[0].T @ FLIP
    centres = [-rotation.T @ translation for rotation, translation in (first, sensor)]
    values[CENTRE] = FLIP @ first[0] @ (centres[1] - centres[0])
    return Head(ids[name], ids[base], Rotation.from_matrix(between).as_rotvec(), values, sigma)


def of_opensfm(given: Block, path: Path, first: Mapping[str, Any]) -> Block:
    """Give an OpenSfM reconstruction its own rigs, else those of the files beside it, if there are any.

    first: as it stands in the file.
    """
    poses, assigned = path.with_name("rig_cameras.json"), path.with_name("rig_assignments.json")

    def sensors(content: Mapping[str, Any]) -> dict[str, Sensor]:
        """Read rotation and translation of each sensor on its rig."""
        return {
            name: (
                Rotation.from_rotvec(np.array(keys["rotation"], dtype=float).reshape(3)).as_matrix(),
                np.array(keys["translation"], dtype=float).reshape(3),
            )
            for name, keys in content.items()
        }

    def beside() -> dict[str, tuple[str, str]]:
        """Read which head and instance an image belongs to from the file beside."""
        content = read_json(assigned)
        instances = content if isinstance(content, dict) else dict(enumerate(content))
        return {str(image): (str(head), str(key)) for key, rows in instances.items() for image, head in rows}

    def inside() -> dict[str, tuple[str, str]]:
        """Read the same from the reconstruction itself."""
        # Images by themselves are instances of one, too.
        return {
            str(image): (str(head), key)
            for key, instance in first.get("rig_instances", {}).items()
            for image, head in instance["rig_camera_ids"].items()
            if len(instance["rig_camera_ids"]) > 1
        }

    of = structured(path, "an OpenSfM file", inside)
    known = structured(path, "an OpenSfM file", lambda: sensors(first.get("rig_cameras", {}))) if of else {}
    if not of and poses.is_file() and assigned.is_file():
        of = structured(assigned, "a file of OpenSfM's rigs", beside)
        known = structured(poses, "a file of OpenSfM's rigs", lambda: sensors(read_json(poses)))
    pairs = [of.get(name, ("", "")) for name in given.images.names]
    return with_rig(given, [head for head, _ in pairs], [key for _, key in pairs], known)


def of_colmap(
    given: Block, folder: Path, keys: Mapping[int, str], rigs: Iterable[Rig], frames: Iterable[Frame]
) -> Block:
    """Give a COLMAP model its rigs, else those of a rig_config.json in its folder or above.

    keys: names of the images by their numbers.
    """
    several = {rig: sensors for rig, sensors in rigs if len(sensors) > 1}
    if several:
        member = {
            keys.get(image, ""): (of, sensor, frame) for frame, of, data in frames for sensor, image in data
        }
        for rig, sensors in several.items():
            members = [member.get(name, (-1, "", 0)) for name in given.images.names]
            head = [sensor if of == rig else "" for of, sensor, _ in members]
            given = with_rig(given, head, [str(frame) for *_, frame in members], sensors)
        return given
    paths = (parent / "rig_config.json" for parent in (folder, *folder.parents[:2]))
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        return given

    def configured() -> list[list[tuple[str, bool, Sensor]]]:
        """Read the rigs as they were configured."""
        return [[_prefixed(camera, path) for camera in rig["cameras"]] for rig in read_json(path)]

    for k, listed in enumerate(structured(path, "a rig_config.json of COLMAP", configured)):
        sensors = {prefix: sensor for prefix, _, sensor in sorted(listed, key=lambda entry: not entry[1])}
        head = [
            next((sensor for sensor in sensors if name.startswith(sensor)), "") for name in given.images.names
        ]
        exposure = [f"{k}/{n[len(prefix) :]}" for n, prefix in zip(given.images.names, head, strict=True)]
        given = with_rig(given, head, exposure, sensors)
    return given


def _prefixed(camera: dict[str, Any], path: Path) -> tuple[str, bool, Sensor]:
    first, prefix = bool(camera.get("ref_sensor")), camera["image_prefix"]
    if not isinstance(prefix, str):
        raise TypeError("an image_prefix is not text")
    if first:
        return prefix, first, (np.eye(3), np.zeros(3))
    if "cam_from_rig_rotation" not in camera:
        return prefix, first, None
    shift = camera.get("cam_from_rig_translation", [0.0] * 3)
    return prefix, first, sensor_of(camera["cam_from_rig_rotation"], shift, path)


def sensor_of(wxyz: Sequence[float], shift: Sequence[float], place: object) -> Sensor:
    """Rotation and translation from rig to sensor, of a quaternion w, x, y, z."""
    quaternion = np.array(wxyz, dtype=float).reshape(4)
    if not abs(np.linalg.norm(quaternion) - 1) < LARGEST_MISFIT:
        raise InputMalformedError("the quaternion of a sensor of a rig does not have length 1", where=place)
    return rotation_from_quaternion(quaternion), np.array(shift, dtype=float).reshape(3)


def of_poses(
    cameras: Sequence[Camera], image_camera: Integers, poses: Floats
) -> tuple[tuple[Head, ...], tuple[str, ...]]:
    """Heads that a program held on a frame, and the exposure of each image (empty for one by itself).

    They lie the same to each other at all exposures, as no free images do.
    """
    rotation, centre = matrix_from_angles(poses[:, :3]), poses[:, 3:]
    ids, exposure, heads = [camera.id for camera in cameras], np.full(len(poses), -1), list[Head]()
    for lead, other in combinations(range(len(ids)), 2):
        on_frame = {head.camera: head.of for head in heads}
        first, second = (np.flatnonzero(image_camera == k) for k in (lead, other))
        alone = on_frame.get(ids[lead], ids[lead]) == ids[lead] and ids[other] not in on_frame
        if not alone or min(len(first), len(second)) < FEWEST_EXPOSURES:
            continue
        first = first[cKDTree(centre[first]).query(centre[second])[1]]
        between = rotation[second] @ np.swapaxes(rotation[first], 1, 2)
        apart = np.einsum("nab,nb->na", rotation[first], centre[second] - centre[first])
        place = np.median(apart, axis=0)
        usual = np.argmin(np.linalg.norm(apart - place, axis=1))
        turned = np.linalg.norm(between - between[usual], axis=(1, 2))
        same = (turned < SAME_RAD) & (np.linalg.norm(apart - place, axis=1) < SAME_M)
        if np.mean(same) < MOST or len(np.unique(first[same])) < same.sum():
            continue
        exposure[first[same]] = exposure[second[same]] = first[same]
        if ids[lead] not in on_frame:
            none = np.zeros(len(OF_HEAD))
            heads.append(Head(ids[lead], ids[lead], np.zeros(3), none, none))
        values, sigma = np.zeros(len(OF_HEAD)), np.zeros(len(OF_HEAD))
        values[CENTRE], sigma[TURN], sigma[CENTRE] = place, np.inf, np.inf
        turn = Rotation.from_matrix(between[usual]).as_rotvec()
        heads.append(Head(ids[other], ids[lead], turn, values, sigma))
    return tuple(heads), tuple("" if key < 0 else f"e{key}" for key in exposure)


def of_metashape(given: Block, shots: Sequence[Element]) -> Block:
    """Give a Metashape chunk its multi-camera system: images with a `master_id`."""
    place = {shot.get("id", ""): k for k, shot in enumerate(shots)}
    rotation, translation = to_vision(given.images.values)
    sensors = dict[str, Sensor]()
    # As images lie to those of their masters: a chunk has a scale of its own.
    for k, shot in enumerate(shots):
        a = place.get(shot.get("master_id", ""), k)
        if a != k:
            sensors.setdefault(shots[a].get("sensor_id", ""), (np.eye(3), np.zeros(3)))
            turn = rotation[k] @ rotation[a].T
            sensors.setdefault(shot.get("sensor_id", ""), (turn, translation[k] - turn @ translation[a]))
    head = [shot.get("sensor_id", "") for shot in shots]
    exposure = [shot.get("master_id", shot.get("id", "")) for shot in shots]
    return with_rig(given, head, exposure, sensors) if sensors else given


def slave_in_master(sensor: Element, path: Path) -> Floats:
    """From the axes of a slave to those of its master, (4, 4): `rotation`, and its centre, `location`."""
    matrix = np.eye(4)
    if turn := sensor.findtext("rotation"):
        matrix[:3, :3] = np.array(numbers(turn, path, "rotation", 9)).reshape(3, 3)
        misfit = np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max()
        if not misfit < LARGEST_MISFIT or np.linalg.det(matrix[:3, :3]) < 0:
            raise InputMalformedError("the rotation of a sensor of a rig is not a rotation", where=path)
    if place := sensor.findtext("location"):
        matrix[:3, 3] = numbers(place, path, "location", 3)
    return matrix
