"""Resection and intersection: the pose of one image from known points, points from known poses.

Relative orientation of a pair of images from their common points alone.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers

# Three points leave up to four poses.
FEWEST = 4
# A fit may hold gross errors when a residual is larger than this many times the median, or than this many
# principal distances.
UNEVEN, LARGE = 6.0, 5e-3
# Camera axes here are x right, y up, z backwards; in OpenCV x right, y down, z forward.
FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Resection:
    """Pose of an image.

    rotation (3, 3): object to camera axes.
    centre (3,): projection centre, m.
    residual (n,): length of each point's residual, in units of the principal distance; infinite behind the
        camera.
    """

    rotation: Floats
    centre: Floats
    residual: Floats


def resection(xyz: Floats, rays: Floats) -> Resection | None:
    """Pose of one image from known points, some of which may be wrong.

    All points together give a pose by SQPnP (Terzakis and Lourakis 2020), improved after Levenberg and
    Marquardt. Where single points fit much worse than the others, the pose of least median residual among
    those of samples of four points (P3P: Ke and Roumeliotis 2017) decides which to leave out.

    xyz (n, 3): points, m.
    rays (n, 2): undistorted image coordinates over the principal distance, x right, y up.
    returns: none when the points do not give a pose: fewer than four, in a line, or behind the camera.
    """
    if len(xyz) < FEWEST:
        return None
    middle = xyz.mean(axis=0)
    extent = np.linalg.svd(xyz - middle, compute_uv=False)
    # Points whose second extent is a smaller share of their first lie in a line that the image can turn
    # about.
    line = 0.01
    if not extent[1] > line * extent[0]:
        return None
    size = float(np.abs(xyz - middle).max())
    world = (xyz - middle) / size
    best = _direct(world, rays)
    if best is None or best.residual.max() > min(UNEVEN * np.median(best.residual), LARGE):
        robust = _least_median(world, rays)
        if robust is not None and (best is None or _misfit(robust.residual) < 0.5 * _misfit(best.residual)):
            best = robust
    if best is None or not np.isfinite(_misfit(best.residual)):
        return None
    return Resection(best.rotation, best.centre * size + middle, best.residual)


def ray_residuals(rotation: Floats, centre: Floats, xyz: Floats, rays: Floats) -> Floats:
    """Length of the residual of each ray, in units of the principal distance; infinite behind the camera.

    rotation (..., 3, 3).
    centre (..., 3).
    xyz (..., 3).
    rays (..., 2): leading shapes are broadcast.
    returns (...).
    """
    q = np.einsum("...ij,...j->...i", rotation, xyz - centre)
    with np.errstate(divide="ignore", invalid="ignore"):
        miss = np.linalg.norm(-q[..., :2] / q[..., 2:] - rays, axis=-1)
    return np.where(q[..., 2] < 0, miss, np.inf)


def _misfit(residual: Floats) -> Floats:
    """Median residual over the last axis; the mean of few, of which three fit any pose made from them."""
    few = residual.shape[-1] < 2 * FEWEST
    return np.asarray(residual.mean(axis=-1) if few else np.median(residual, axis=-1))


def _direct(world: Floats, rays: Floats) -> Resection | None:
    import cv2

    poses = _with_residuals(_poses(world, rays, cv2.SOLVEPNP_SQPNP, refine=True), world, rays)
    return min(poses, key=lambda pose: float(np.mean(pose.residual)), default=None)


def _least_median(world: Floats, rays: Floats) -> Resection | None:
    """Pose of least median residual, improved with the points that fit it."""
    sample_count = 100
    import cv2

    # The samples are the same every time: no result may depend on chance.
    rng = np.random.default_rng(len(world))
    samples = [rng.choice(len(world), FEWEST, replace=False) for _ in range(sample_count)]
    poses = [pose for some in samples for pose in _poses(world[some], rays[some], cv2.SOLVEPNP_AP3P)]
    if not poses:
        return None
    rotation, centre = np.array([p[0] for p in poses]), np.array([p[1] for p in poses])
    # A median of so many points tells a pose of good ones from others.
    some = rng.choice(len(world), min(len(world), 200), replace=False)
    misfit = _misfit(ray_residuals(rotation[:, None], centre[:, None], world[some], rays[some]))
    (best,) = _with_residuals([poses[int(np.argmin(misfit))]], world, rays)
    if not np.isfinite(_misfit(best.residual)):
        return None
    good = best.residual <= UNEVEN / 2 * _misfit(best.residual)
    if good.sum() < FEWEST:
        return best
    improved = _poses(world[good], rays[good], cv2.SOLVEPNP_SQPNP, refine=True)
    return min(
        [best, *_with_residuals(improved, world, rays)], key=lambda pose: float(_misfit(pose.residual))
    )


def _with_residuals(poses: Iterable[tuple[Floats, Floats]], xyz: Floats, rays: Floats) -> list[Resection]:
    return [Resection(m, centre, ray_residuals(m, centre, xyz, rays)) for m, centre in poses]


def _poses(
    xyz: Floats, rays: Floats, method: int, *, refine: bool = False
) -> Iterator[tuple[Floats, Floats]]:
    """Rotations and projection centres that one solver finds."""
    import cv2

    flipped = np.ascontiguousarray(rays * [1.0, -1.0])
    xyz = np.ascontiguousarray(xyz)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(xyz, flipped, np.eye(3), None, flags=method)
    except cv2.error:
        return
    for turn, shift in zip(turns, shifts, strict=True):
        if refine:
            turn, shift = cv2.solvePnPRefineLM(xyz, flipped, np.eye(3), None, turn, shift)
        matrix = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)
        if np.isfinite(matrix).all() and np.isfinite(shift).all():
            yield FLIP @ matrix, -matrix.T @ np.ravel(shift)


def intersect(
    point: Integers,
    count: int,
    centre: Floats,
    rotation: Floats,
    ideal: Floats,
    principal_distance: Floats,
    least: float = 1e-9,
) -> Floats:
    """Intersect rays linearly: least squares of the distances from the rays.

    point (n,): point of each ray.
    centre (n, 3): projection centre of each ray.
    rotation (n, 3, 3): object to camera axes of each ray.
    ideal (n, 2): undistorted image coordinates from the principal point.
    principal_distance (n,).
    least: mean squared sine between the rays of a point that has a place.

    returns (count, 3): NaN for points whose rays are parallel or fewer than two.
    """
    direction = np.column_stack([ideal, -principal_distance])
    direction = np.einsum("nji,nj->ni", rotation, direction)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    right = np.einsum("nij,nj->ni", across, centre)
    matrix = np.empty((count, 3, 3))
    vector = np.empty((count, 3))
    for a in range(3):
        vector[:, a] = np.bincount(point, right[:, a], count)
        for b in range(3):
            matrix[:, a, b] = np.bincount(point, across[:, a, b], count)
    determinant = np.linalg.det(matrix)
    rays = np.bincount(point, minlength=count)
    # The determinant of the mean of I - d d' falls with the square of the angle between the rays.
    good = determinant > least * np.maximum(rays, 1) ** 3
    result = np.full((count, 3), np.nan)
    result[good] = np.linalg.solve(matrix[good], vector[good][..., None])[..., 0]
    return result


# Five points make a matrix; more have to choose among several.
FEWEST_PAIRS = 8


@dataclass(frozen=True)
class RelativeOrientation:
    """Pose of the second image in the camera axes of the first; the base has length 1.

    rotation (3, 3): from the first image's camera axes to the second's.
    base (3,): projection centre of the second image.
    angle: median angle between the two rays of a point, radians.
    """

    rotation: Floats
    base: Floats
    angle: float


def relative_orientations(first: Floats, second: Floats) -> list[RelativeOrientation]:
    """Possible relative orientations of two images.

    The essential matrix comes from five points at a time (Nister 2004), the one of least median residual
    is kept. Points near a plane allow a second pose; those of their homography (Malis and Vargas 2007) are
    returned too, and a third image or control has to choose.

    first, second (n, 2): undistorted image coordinates over the principal distance (x right, y up) of the
        common points.
    """
    if len(first) < FEWEST_PAIRS:
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
    angle = np.arccos(np.clip(ab[front] / np.sqrt(aa * bb)[front], -1.0, 1.0))
    return RelativeOrientation(rotation, base, float(np.median(angle)))
