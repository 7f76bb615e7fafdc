"""Relative orientation of a pair of images from their common points alone."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.base.arrays import Floats

# Five points make a matrix; more have to choose among several.
FEWEST = 8
FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class RelativeOrientation:
    """Pose of the second image in the camera axes of the first; the base has length 1.

    rotation (3, 3): from the first image's camera axes to the second's.
    base (3,): projection centre of the second image.
    points (n, 3): intersections of the rays, in the first image's camera axes.
    angle: median angle between the two rays of a point, radians.
    """

    rotation: Floats
    base: Floats
    points: Floats
    angle: float


def relative_orientations(first: Floats, second: Floats) -> list[RelativeOrientation]:
    """Possible relative orientations of two images.

    The essential matrix comes from five points at a time (Nister 2004), the one of least median residual
    is kept. Points near a plane allow a second pose; those of their homography (Malis and Vargas 2007) are
    returned too, and a third image or control has to choose.

    first, second (n, 2): undistorted image coordinates over the principal distance (x right, y up) of the
        common points.
    """
    if len(first) < FEWEST:
        return []
    import cv2

    a, b = (np.ascontiguousarray(rays * [1.0, -1.0]) for rays in (first, second))
    poses: list[tuple[Any, Any]] = []
    essential, _ = cv2.findEssentialMat(a, b, np.eye(3), method=cv2.LMEDS, prob=0.9999)
    if essential is not None:
        # Five points alone give several matrices, one below the other.
        for matrix in essential.reshape(-1, 3, 3):
            first_turn, second_turn, shift = cv2.decomposeEssentialMat(matrix)
            poses += [(turn, sign * shift) for turn in (first_turn, second_turn) for sign in (1, -1)]
    homography, _ = cv2.findHomography(a, b, cv2.LMEDS)
    if homography is not None:
        _, turns, shifts, _ = cv2.decomposeHomographyMat(homography, np.eye(3))
        poses += [(turn, sign * shift) for turn, shift in zip(turns, shifts, strict=True) for sign in (1, -1)]
    candidates = [_candidate(turn, np.ravel(shift), first, second) for turn, shift in poses]
    return [candidate for candidate in candidates if candidate is not None]


def _candidate(turn: Floats, shift: Floats, first: Floats, second: Floats) -> RelativeOrientation | None:
    """Relative orientation from OpenCV's rotation and translation; None when points lie behind an image."""
    length = float(np.linalg.norm(shift))
    if not length > 1e-9:
        return None
    rotation = FLIP @ turn @ FLIP
    base = -FLIP @ turn.T @ (shift / length)
    left = np.column_stack([first, -np.ones(len(first))])
    right = np.column_stack([second, -np.ones(len(second))]) @ rotation
    # Lengths s, t along both rays that bring s one and base + t other closest to each other.
    aa, bb, ab = (np.sum(x * y, axis=1) for x, y in ((left, left), (right, right), (left, right)))
    determinant = aa * bb - ab**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (bb * (left @ base) - ab * (right @ base)) / determinant
        t = (ab * (left @ base) - aa * (right @ base)) / determinant
    front = (s > 0) & (t > 0)
    # Share of the points that have to lie in front of both images.
    in_front = 0.8
    if front.mean() < in_front:
        return None
    points = (s[:, None] * left + base + t[:, None] * right) / 2
    points[~front] = np.nan
    angle = np.arccos(np.clip(ab[front] / np.sqrt(aa * bb)[front], -1.0, 1.0))
    return RelativeOrientation(rotation, base, points, float(np.median(angle)))
