"""From images of a calibration board to a block that calibrates their camera."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, InputNotFoundError
from photocal.base.progress import Progress
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.network import assemble
from photocal.geometry.camera import pixel_to_plane
from photocal.geometry.resection import resection
from photocal.geometry.rotation import angles_from_matrix
from photocal.measurement.block_files import PIXEL_ORIGIN, SCHEMA, Measured
from photocal.measurement.boards import Board, BoardView, find_board
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import each_picture, read_grey
from photocal.measurement.maker_camera import group_cameras, principal_distance_px, start_camera

ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
FEWEST_VIEWS = 3


def measure_board(paths: Sequence[Path], board: Board, name: str, progress: Progress) -> Measured:
    """Measure a board in images and make the block that calibrates the camera.

    The board's points are held. The standard deviation of a corner has two parts: what the grey values
    give, and a common part for what they cannot know (the flatness of the board, motion, the camera
    model), taken from the residuals of a first adjustment.

    raises InputNotFoundError: when too few images show the board.
    raises PhotocalError: when the views do not determine the camera.
    """

    def measure(path: Path) -> tuple[ImageFacts, BoardView]:
        facts, view = read_facts(path), find_board(read_grey(path), board)
        if view is None:
            raise InputNotFoundError("the board was not found", where=path)
        return facts, view

    with progress("measuring the board", len(paths)) as done:
        measured, left_out = each_picture(paths, measure, done)
    facts, views = [facts for facts, _ in measured], [view for _, view in measured]
    if len(views) < FEWEST_VIEWS:
        across, down = board.inner
        raise InputNotFoundError(
            f"{len(views)} of {len(paths)} images show a board of {board.columns} x {board.rows} squares "
            f"({across} x {down} inner corners), {FEWEST_VIEWS} are needed",
            "count the squares, not the corners, and see that the whole board is visible",
            where=paths[0].parent,
        )
    block = _block(facts, views, board, name)
    block, figures = with_common_sigma(block)
    record = {
        "schema": SCHEMA,
        "kind": "board",
        "board": {"squares": [board.columns, board.rows], "square_m": board.square_m, "kind": board.kind},
        "images": [
            {"image": f.name, "corners": len(v.centres), "grey_value_sigma_px": float(v.sigmas.mean())}
            for f, v in zip(facts, views, strict=True)
        ],
        "left_out": left_out,
        **figures,
        "pixel_origin": PIXEL_ORIGIN,
    }
    return Measured(block, record)


def _block(facts: Sequence[ImageFacts], views: Sequence[BoardView], board: Board, name: str) -> Block:
    names, member = group_cameras(facts)
    xyz = board.points()
    cameras, poses = [], np.zeros((len(views), 6))
    for k, camera_name in enumerate(names):
        members = [j for j in range(len(views)) if member[j] == k]
        size = facts[members[0]].size_px
        planes = [pixel_to_plane(size, (1.0, 1.0), views[j].pixels) for j in members]
        flat = [xyz[views[j].corners, :2] for j in members]
        c = plane_principal_distance(flat, planes) or principal_distance_px(facts[members[0]])[0]
        cameras.append(start_camera(camera_name, facts[members[0]], c, ESTIMATE))
        for j, plane in zip(members, planes, strict=True):
            pose = resection(xyz[views[j].corners], plane / c)
            if pose is None:
                raise IllPosedError(
                    "its orientation to the board cannot be found",
                    "take it out",
                    where=f"image {facts[j].name}",
                )
            poses[j] = np.concatenate([angles_from_matrix(pose.rotation), pose.centre])
    image = np.repeat(np.arange(len(views)), [len(v.centres) for v in views])
    corner = np.concatenate([v.corners for v in views])
    used, point = np.unique(corner, return_inverse=True)
    across = board.inner[0]
    return Block(
        name,
        "local",
        "local",
        "control",
        tuple(cameras),
        Images(tuple(f.name for f in facts), member, poses),
        ObjectPoints(
            tuple(f"r{j // across + 1}c{j % across + 1}" for j in used),
            xyz[used],
            np.zeros((len(used), 3)),
            np.full(len(used), ROLES.index("control")),
        ),
        Observations(
            "px",
            "pixel",
            image,
            point.astype(np.int64),
            np.concatenate([v.pixels for v in views]),
            np.concatenate([v.sigmas for v in views]),
        ),
    )


def plane_principal_distance(flat: Sequence[Floats], planes: Sequence[Floats]) -> float | None:
    """Principal distance from views of a flat object, the principal point in the middle."""
    # Each homography H of the plane gives two linear equations in 1/c^2: its first two columns are images of
    # orthogonal unit vectors (Zhang 2000, eq. 3 and 4).
    import cv2

    rows, right = [], []
    for xy, plane in zip(flat, planes, strict=True):
        homography: Any = cv2.findHomography(xy, plane)
        matrix = homography[0]
        if matrix is None:
            continue
        h = matrix / np.linalg.norm(matrix[:, :2])
        a, b = h[:, 0], h[:, 1]
        rows += [a[:2] @ b[:2], a[:2] @ a[:2] - b[:2] @ b[:2]]
        right += [-a[2] * b[2], b[2] ** 2 - a[2] ** 2]
    left = np.array(rows)
    inverse_square = float(left @ np.array(right) / max(left @ left, 1e-300))
    return 1 / np.sqrt(inverse_square) if inverse_square > 0 else None


def with_common_sigma(block: Block) -> tuple[Block, dict[str, Any]]:
    """Add to the sigmas what makes the residuals as large as they claim (uniform over the images).

    Cameras and images start from its adjustment. Also tells how well each camera's principal distance is
    determined: its sigma over its value.
    """
    seen = block.observations
    fit_variance = seen.sigma**2
    level = np.sqrt(fit_variance.mean())
    equal = replace(block, observations=replace(seen, sigma=np.full_like(seen.sigma, level)))
    solution = adjust(assemble(equal).network)
    factor = max(solution.variance_factor, 0.0)
    common = float(np.sqrt(max(factor * level**2 - fit_variance.mean(), 0.0)))
    ratio = np.sqrt(factor * solution.camera_covariance[:, 0, 0]) / solution.cameras[:, 0]
    sigma = np.sqrt(fit_variance + common**2)
    cameras = tuple(camera.with_values(v) for camera, v in zip(block.cameras, solution.cameras, strict=True))
    images = replace(block.images, values=solution.exposures)
    block = replace(block, cameras=cameras, images=images, observations=replace(seen, sigma=sigma))
    return block, {"common_sigma_px": common, "principal_distance_sigma_ratio": ratio.tolist()}
