"""Cameras fixed to each other, as `[[head]]` of a block names them, and as the network has them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat
from scipy.spatial.transform import Rotation

from acquire.checked_toml import Table
from drivers.arrays import Floats, Integers
from drivers.errors import ConfigurationError
from photocal.adjustment.rig import CENTRE, LATER, NO_RIG, OF_HEAD, TURN, Rig, pairs_of
from photocal.block.camera_setup import NonNegative, Sigma, sigmas

# How far heads on one frame move and turn against each other: a tenth of a millimetre, and a second of arc.
STIFFNESS_M, STIFFNESS_DEG = 1e-4, 1 / 3600


class HeadKeys(Table):
    """`[[head]]`: a camera and what it is fixed to.

    of: camera whose head the others of the frame refer to; the one of this entry itself for that head.
    rotation_deg: rotation vector from the camera axes of `of` to those of this camera; without it the start
        values of the images tell.
    centre_m: its projection centre in the camera axes of `of`.
    time_s: by how much later it exposes.
    stiffness_m, stiffness_deg: how far it moves and turns against the others from exposure to exposure.
    """

    camera: str
    of: str
    rotation_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    rotation_sigma_deg: Sigma = "free"
    centre_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    centre_sigma_m: Sigma = "free"
    time_s: FiniteFloat = 0.0
    time_sigma_s: NonNegative = 0.0
    stiffness_m: PositiveFloat = Field(default=STIFFNESS_M)
    stiffness_deg: PositiveFloat = Field(default=STIFFNESS_DEG)


@dataclass(frozen=True)
class Head:
    """A camera on a frame.

    rotation: vector from the axes of the camera `of` to its own, rad; None where nothing is known of it.
    values, sigma (7,): as `adjustment.rig.OF_HEAD`; the turns are about the axes of the head, from
        `rotation`.
    stiffness: m, rad.
    """

    camera: str
    of: str
    rotation: Floats | None
    values: Floats
    sigma: Floats
    stiffness: tuple[float, float] = (STIFFNESS_M, float(np.radians(STIFFNESS_DEG)))


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
    for one in keys:
        if len(given) < len(keys) or (one.of in given and given[one.of].of != one.of):
            raise wrong(
                f"camera {one.camera} has two places on its frame, or refers to one that refers to another",
                "give each camera one [[head]]; all of a frame have the same `of`",
            )
    others = [key for key in keys if key.camera != key.of]
    nothing = np.zeros(len(OF_HEAD))
    heads = [Head(name, name, np.zeros(3), nothing, nothing) for name in first]
    for one in others:
        values, sigma = nothing.copy(), nothing.copy()
        values[CENTRE], values[LATER] = one.centre_m, one.time_s
        sigma[TURN], sigma[CENTRE] = np.radians(sigmas(one.rotation_sigma_deg)), sigmas(one.centre_sigma_m)
        sigma[LATER] = one.time_sigma_s
        rotation = None if one.rotation_deg is None else np.radians(one.rotation_deg)
        if rotation is None and np.isfinite(sigma[TURN]).any():
            what = f"the head of camera {one.camera} has rotation_sigma_deg but no rotation_deg"
            raise wrong(what, 'give rotation_deg, or "free"')
        stiffness = one.stiffness_m, float(np.radians(one.stiffness_deg))
        heads.append(Head(one.camera, one.of, rotation, values, sigma, stiffness))
    return tuple(heads)


def head_lines(heads: Iterable[Head]) -> Iterable[str]:
    """Give the entries `[[head]]` of a `block.toml`."""

    def sigma(values: Floats) -> str:
        return '"free"' if np.isinf(values).any() else str([float(v) for v in values])

    for one in heads:
        if one.camera == one.of:
            continue
        yield from ("", "[[head]]", f'camera = "{one.camera}"', f'of = "{one.of}"')
        if one.rotation is not None:
            yield f"rotation_deg = {[float(v) for v in np.degrees(one.rotation)]}"
        yield f"rotation_sigma_deg = {sigma(np.degrees(one.sigma[TURN]))}"
        yield f"centre_m = {[float(v) for v in one.values[CENTRE]]}"
        yield f"centre_sigma_m = {sigma(one.sigma[CENTRE])}"
        yield f"time_s = {float(one.values[LATER])!r}"
        yield f"time_sigma_s = {float(one.sigma[LATER])!r}"
        yield f"stiffness_m = {one.stiffness[0]!r}"
        yield f"stiffness_deg = {float(np.degrees(one.stiffness[1]))!r}"


def rig_of(
    heads: Sequence[Head],
    cameras: Sequence[str],
    image_camera: Integers,
    exposure: Sequence[str],
    rotation: Floats,
    centre: Floats,
    gust: Floats | None,
) -> Rig:
    """Make the rig of a network from the heads whose cameras it has.

    exposure (images,): name of each image's exposure, empty for none.
    rotation (images, 3, 3), centre (images, 3): start values, which tell what is not known of a head.
    gust (images, 6): by how much velocity (m/s) and rate (rad/s) depart from those given; None at rest.
    """
    present = [one for one in heads if one.camera in cameras]
    if not present or not any(exposure):
        return NO_RIG
    camera = np.array([cameras.index(one.camera) for one in present], dtype=np.int64)
    frames = {name: k for k, name in enumerate(dict.fromkeys(one.of for one in present))}
    base = np.array([frames[one.of] for one in present], dtype=np.int64)
    _, number = np.unique(np.array(exposure, dtype=object).astype(str), return_inverse=True)
    number = np.where(np.array([bool(name) for name in exposure]), number, -1)
    values, sigma = (np.array([getattr(one, name) for one in present]) for name in ("values", "sigma"))
    own = Rotation.from_rotvec([np.zeros(3) if one.rotation is None else one.rotation for one in present])
    unknown = np.array([one.rotation is None for one in present])
    none = image_camera[:0]
    rig = Rig(own.as_matrix(), values, sigma, camera, base, none, none, np.zeros((0, 2)))
    head = rig.head_of(image_camera)
    first, second = pairs_of(number, head, base)
    stiffness = np.array([one.stiffness for one in present])[head[first]]
    if gust is not None and len(first):
        # Nobody knows how a gust moves the frame until the later head exposes.
        p, q = head[first], head[second]
        later = (values[q, LATER] - values[p, LATER]) ** 2 + sigma[p, LATER] ** 2 + sigma[q, LATER] ** 2
        departs = np.mean(gust[first].reshape(-1, 2, 3) ** 2, axis=2)
        stiffness = np.sqrt(stiffness**2 + departs * later[:, None])
    for frame in range(len(frames)):
        mine = np.flatnonzero(base == frame)
        # Without its first head a frame begins with another, where nothing else holds that one.
        lead = mine[0]
        if np.isinf(sigma[lead]).any():
            sigma[lead] = np.where(np.isinf(sigma[lead]), 0.0, sigma[lead])
            unknown[lead] = False
        for k in mine[1:]:
            pairs = (head[second] == k) & (head[first] == lead)
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
    return replace(rig, first=first, second=second, stiffness=stiffness)
