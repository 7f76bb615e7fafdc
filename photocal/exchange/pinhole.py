"""The pinhole camera of computer vision: fx, fy, cx, cy and coefficients of normalised coordinates.

Common to OpenCV, COLMAP, OpenSfM and Pix4D: camera axes x right, y down, z forward; the projection (X/Z, Y/Z)
is distorted (`brown-ideal`) with k1, k2, k3 and p1, p2 in normalised coordinates,
x = x' (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x' y' + p2 (r^2 + 2 x'^2), then scaled by fx, fy and moved to
cx, cy. OpenCV and COLMAP have the models `rational` and `equidistant`, too. Here the centre of the upper-left
pixel is (0, 0), as in OpenCV and in this project; each format adds its own half pixel. Source: Bradski and
Kaehler 2008, Learning OpenCV, ch. 11; Brown 1971.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.geometry.camera import MODELS, Camera, Model, camera
from photocal.geometry.conversion import Conversion, converted, in_pixels, require_no_skew
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles

# From our camera axes to those of computer vision, and back.
FLIP = np.diag([1.0, -1.0, -1.0])
# Beyond every focal length, coefficient and coordinate in use.
LARGEST = 1e9
# Our terms by theirs: sign (y is up here and down there: p1 and p2 change places), and power of c.
_SHARED = {f"K{n}": (f"k{n}", 1, 2 * n) for n in (1, 2, 3)} | {"P1": ("p2", 1, 1), "P2": ("p1", -1, 1)}
# Of the rational lens and its thin prism, and k4 of a fisheye; y is down there.
_MORE = ("k4", "k5", "k6", "s1", "s2", "s3", "s4")
_SIGN = {"s3": -1, "s4": -1}


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics as OpenCV has them.

    fx, fy, cx, cy: px; the centre of the upper-left pixel is (0, 0).
    k1, k2, k3, p1, p2, k4, k5, k6, s1, s2, s3, s4: of normalised coordinates; k1 to k4 of a fisheye's angle.
    """

    size_px: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    fisheye: bool = False


def from_pinhole(given: Pinhole, camera_id: str, place: object) -> Camera:
    """Turn pinhole intrinsics into a camera in px."""
    require_credible((given.fx, given.fy), (given.cx, given.cy), place)
    more = tuple(getattr(given, name) for name in _MORE)
    require_credible((), (given.k1, given.k2, given.k3, given.p1, given.p2, *more), place)
    c = given.fy
    model: Model = "equidistant" if given.fisheye else "rational" if any(more) else "brown-ideal"
    size = 1.0 if MODELS[model].relative else c
    values = {
        "c": c,
        "x0": given.cx - (given.size_px[0] - 1) / 2,
        "y0": (given.size_px[1] - 1) / 2 - given.cy,
        **{ours: s * getattr(given, theirs) / size**p for ours, (theirs, s, p) in _SHARED.items()},
        "B1": given.fx / given.fy - 1,
    }
    # Of Brown's lens these are zero.
    values |= {n.upper(): _SIGN.get(n, 1) * value for n, value in zip(_MORE, more, strict=True) if value}
    values = {name: value for name, value in values.items() if name in MODELS[model].names}
    return camera(camera_id, model, "px", given.size_px, (1.0, 1.0), values, affinity="after")


def require_credible(focal_px: Sequence[float], others: Sequence[float], place: object) -> None:
    """Complain about numbers that no camera has, before they overflow."""
    malformed = InputMalformedError.at(place)
    for value in focal_px:
        if not 1e-3 < value < LARGEST:
            raise malformed(f"the focal length {value:g} px is impossible", "correct it")
    for value in others:
        if not abs(value) < LARGEST:
            raise malformed(f"the camera parameter {value:g} is impossible")


def to_pinhole(
    camera: Camera, program: str, others: Mapping[Model, tuple[str, ...]] | None = None
) -> tuple[Pinhole, Conversion]:
    """Turn a camera into pinhole intrinsics."""
    require_no_skew(camera, program)
    flat, others = in_pixels(camera), others or {}
    model: Model = "equidistant" if flat.lens.angular else flat.model
    terms = others.get(model, tuple(_SHARED))
    # A camera without affinity keeps fx = fy.
    terms = (*terms, "B1") if flat.value("B1") else terms
    conversion = converted(flat, model if model in others else "brown-ideal", "after", terms)
    same = conversion.camera
    c, fisheye = same.value("c"), same.lens.angular
    size = 1.0 if same.lens.relative else c
    return Pinhole(
        same.size_px,
        c * (1 + same.value("B1")),
        c,
        same.value("x0") + (same.size_px[0] - 1) / 2,
        (same.size_px[1] - 1) / 2 - same.value("y0"),
        **{theirs: s * same.value(ours) * size**p for ours, (theirs, s, p) in _SHARED.items()},
        **{name: _SIGN.get(name, 1) * same.value(name.upper()) for name in _MORE},
        fisheye=fisheye,
    ), conversion


def require_one_focal_length(pinhole: Pinhole, camera_id: str, program: str) -> None:
    """Complain when fx and fy differ and a format has one focal length."""
    if abs(pinhole.fx / pinhole.fy - 1) > 1e-12:
        raise InputMalformedError(
            f"camera {camera_id} has an affinity (B1), which {program} cannot hold", "adjust without B1"
        )


def to_vision(pose: Floats) -> tuple[Floats, Floats]:
    """Turn exterior orientations into rotation and translation from object to vision camera axes."""
    rotation = FLIP @ matrix_from_angles(pose[..., :3])
    return rotation, -np.einsum("...ij,...j->...i", rotation, pose[..., 3:])


def from_vision(rotation: Floats, translation: Floats) -> Floats:
    """Turn rotation and translation from object to vision camera axes into exterior orientations."""
    place = -np.einsum("...ji,...j->...i", rotation, translation)
    return np.concatenate([angles_from_matrix(FLIP @ rotation), place], axis=-1)


def rotation_from_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrices of quaternions (w, x, y, z) of any length, shape (..., 4) to (..., 3, 3)."""
    return np.asarray(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), dtype=float)


def quaternion_from_rotation(rotation: Floats) -> Floats:
    """Unit quaternions (w, x, y, z), w not negative, of rotation matrices; inverse of the former."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True), dtype=float)
