"""Cameras fixed to each other, as `[[head]]` of a block names them, and as the network has them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat
from scipy.spatial.transform import Rotation

from photocal.adjustment.rig import CENTRE, LATER, NO_RIG, OF_HEAD, TURN, RigHeads, pairs_of
from photocal.base.arrays import Floats, Integers
from photocal.base.checked_toml import Table
from photocal.base.codec import as_degrees
from photocal.base.errors import ConfigurationError
from photocal.block.camera_setup import NonNegative, Sigma, sigma_keys, sigmas

# How far heads on one frame move and turn against each other: a tenth of a millimetre, and a second of arc.
STIFFNESS_M, STIFFNESS_DEG = 1e-4, 1 / 3600


class HeadKeys(Table):
    """`[[head]]`: a camera and what it is fixed to.

    of: camera whose head the others of the frame refer to; the one of this entry itself for that head.
    rotation_deg: rotation vector from the camera axes of `of` to those of this camera; without it the start
        values of the images tell.
    turn_deg: where its small turn from `rotation_deg` about its own axes begins.
    centre_m: its projection centre in the camera axes of `of`.
    lag_s: time and its sigma while which gusts move the frame, where an adjustment has found them.
    time_s: by how much later it exposes.
    stiffness_m, stiffness_deg: how far it moves and turns against the others from exposure to exposure.
    """

    camera: str
    of: str
    rotation_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    rotation_sigma_deg: Sigma = "free"
    turn_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    centre_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    centre_sigma_m: Sigma = "free"
    time_s: FiniteFloat = 0.0
    time_sigma_s: NonNegative = 0.0
    stiffness_m: PositiveFloat = Field(default=STIFFNESS_M)
    stiffness_deg: PositiveFloat = Field(default=STIFFNESS_DEG)
    lag_s: tuple[FiniteFloat, NonNegative] | None = None


@dataclass(frozen=True)
class Head:
    """A camera on a frame.

    rotation: vector from the axes of the camera `of` to its own, rad; None where nothing is known of it.
    values, sigma (7,): as `adjustment.rig.OF_HEAD`; the turns are about the axes of the head, from
        `rotation`.
    stiffness: m, rad.
    lag: time and its sigma (s) while which gusts move the frame, where an adjustment has found them; None for
        those that are given.
    """

    camera: str
    of: str
    rotation: Floats | None
    values: Floats
    sigma: Floats
    stiffness: tuple[float, float] = (STIFFNESS_M, float(np.radians(STIFFNESS_DEG)))
    lag: tuple[float, float] | None = None


def make_heads(keys: Sequence[HeadKeys], cameras: Sequence[str], where: object) -> tuple[Head, ...]:
    """Make the heads of `[[head]]`, those that the others refer to first among them.

    raises ConfigurationError: for an unknown camera, one that is on two frames, or a chain of frames.
    """
    wrong = ConfigurationError.at(str(where))
    given = {key.camera: key for key in keys}
    first = dict.fromkeys(key.of for key in keys)
    for name in (*given, *first):
        if name not in cameras:
            what = f"[[head]] names camera {name}, which is not in the block"
            raise wrong(what, f"name one of {', '.join(cameras)}")
    for key in keys:
        if len(given) < len(keys) or (key.of in given and given[key.of].of != key.of):
            raise wrong(
                f"camera {key.camera} has two places on its frame, or refers to one that refers to another",
                "give each camera one [[head]]; all of a frame have the same `of`",
            )
    nothing = np.zeros(len(OF_HEAD))
    heads = [Head(name, name, np.zeros(3), nothing, nothing) for name in first]
    for key in keys:
        if key.camera == key.of:
            continue
        values = np.array([*np.radians(key.turn_deg), *key.centre_m, key.time_s])
        turn = np.radians(sigmas(key.rotation_sigma_deg))
        sigma = np.array([*turn, *sigmas(key.centre_sigma_m), key.time_sigma_s])
        rotation = None if key.rotation_deg is None else np.radians(key.rotation_deg)
        if rotation is None and np.isfinite(turn).any():
            what = f"the head of camera {key.camera} has rotation_sigma_deg but no rotation_deg"
            raise wrong(what, 'give rotation_deg, or "free"')
        stiffness = key.stiffness_m, float(np.radians(key.stiffness_deg))
        heads.append(Head(key.camera, key.of, rotation, values, sigma, stiffness, key.lag_s))
    return tuple(heads)


def head_keys(head: Head) -> HeadKeys:
    """Say a head in the keys of `[[head]]`, the inverse of `make_heads`."""
    x, y, z = head.values[CENTRE].tolist()
    return HeadKeys(
        camera=head.camera,
        of=head.of,
        rotation_deg=None if head.rotation is None else _degrees(head.rotation),
        rotation_sigma_deg=sigma_keys(as_degrees(head.sigma[TURN])),
        turn_deg=_degrees(head.values[TURN]),
        centre_m=(x, y, z),
        centre_sigma_m=sigma_keys(head.sigma[CENTRE]),
        time_s=float(head.values[LATER]),
        time_sigma_s=float(head.sigma[LATER]),
        stiffness_m=head.stiffness[0],
        stiffness_deg=float(as_degrees(head.stiffness[1])),
        lag_s=head.lag,
    )


def _degrees(radians: Floats) -> tuple[float, float, float]:
    x, y, z = as_degrees(radians).tolist()
    return x, y, z


def rig_of(
    heads: Sequence[Head],
    cameras: Sequence[str],
    image_camera: Integers,
    exposure: Sequence[str],
    rotation: Floats,
    centre: Floats,
    gust: Floats | None,
) -> RigHeads:
    """Make the rig of a network from the heads whose cameras it has.

    exposure (images,): name of each image's exposure, empty for none.
    rotation (images, 3, 3), centre (images, 3): start values, which tell what is not known of a head.
    gust (images, 6): by how much velocity (m/s) and rate (rad/s) depart from those given; None at rest.
    """
    present = [head for head in heads if head.camera in cameras]
    if not present or not any(exposure):
        return NO_RIG
    camera = np.array([cameras.index(head.camera) for head in present], dtype=np.int64)
    base = np.unique([head.of for head in present], return_inverse=True)[1]
    names = np.array(exposure, dtype=object).astype(str)
    number = np.where(names != "", np.unique(names, return_inverse=True)[1], -1)
    values, sigma = (np.array([getattr(head, name) for head in present]) for name in ("values", "sigma"))
    unknown = np.array([head.rotation is None for head in present])
    turn = Rotation.from_rotvec([np.zeros(3) if head.rotation is None else head.rotation for head in present])
    lag = np.array([head.lag or (head.values[LATER], head.sigma[LATER]) for head in present])
    rig = replace(
        NO_RIG, rotation=turn.as_matrix(), values=values, sigma=sigma, camera=camera, base=base, lag=lag
    )
    of_image = rig.head_of(image_camera)
    first, second = pairs_of(number, of_image, base)
    stiffness = np.array([head.stiffness for head in present])[of_image[first]]
    departs = np.zeros((len(first), 6)) if gust is None else gust[first]
    for k, lead in enumerate(np.argmax(base[:, None] == base, axis=1)):
        # Without its first head a frame begins with another, where nothing else holds that one.
        if k == lead and np.isinf(sigma[k]).any():
            sigma[k] = np.where(np.isinf(sigma[k]), 0.0, sigma[k])
            unknown[k] = False
        pairs = (of_image[second] == k) & (of_image[first] == lead)
        if not pairs.any():
            continue
        a, b = first[pairs], second[pairs]
        if unknown[k]:
            between = rotation[b] @ np.swapaxes(rotation[a], 1, 2) @ rig.rotation[lead]
            rig.rotation[k] = Rotation.from_matrix(between).mean().as_matrix()
        loose = np.isinf(sigma[k, CENTRE])
        apart = np.einsum("ji,nj->ni", rig.rotation[lead], np.einsum("nab,nb->na", rotation[a], centre[b] - centre[a]))  # fmt: skip  # noqa: E501
        place = np.median(apart, axis=0) + values[lead, CENTRE]
        values[k, CENTRE] = np.where(loose, place, values[k, CENTRE])
    gusts = np.sqrt(np.mean(departs.reshape(-1, 2, 3) ** 2, axis=2))
    return replace(rig, first=first, second=second, stiffness=stiffness, gust=gusts)
