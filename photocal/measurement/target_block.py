"""From pictures of a calibration board or a field of coded targets to a block that calibrates the camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.snooping import snoop
from photocal.adjustment.solution import Solution
from photocal.base.arrays import Columns, Floats, Integers
from photocal.base.errors import IllPosedError, InputNotFoundError
from photocal.base.files import digest
from photocal.base.progress import Progress
from photocal.block.folder import read_relations
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.network import assemble
from photocal.geometry.camera import pixel_to_plane
from photocal.geometry.resection import resection
from photocal.geometry.rotation import angles_from_matrix
from photocal.measurement.features import Arrays, cached, combined_key
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import each_picture, read_grey
from photocal.measurement.maker_camera import group_cameras, principal_distance_px, start_camera
from photocal.measurement.markers import (
    COMMON_PX,
    VERSION,
    Board,
    dictionary,
    find_board,
    find_markers,
    on_bent_edges,
)
from photocal.measurement.measurement_record import PIXEL_ORIGIN, SCHEMA, MeasuredBlock
from photocal.measurement.position_files import Given

ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
# Of fewer pictures or targets of a field no camera is calibrated.
FEWEST_PICTURES, FEWEST_TARGETS = 4, 8


@dataclass(frozen=True)
class TargetView(Columns):
    """Points that a picture shows.

    point (n,): numbers of the points.
    pixels (n, 2).
    sigma (n, 2): what the grey values give, px.
    """

    facts: ImageFacts
    point: Integers
    pixels: Floats
    sigma: Floats


def measure_board(paths: Sequence[Path], board: Board, name: str, progress: Progress) -> MeasuredBlock:
    """Measure a board in pictures and make the block that calibrates the camera; the board's points are held.

    raises InputNotFoundError: when too few pictures show the board.
    raises PhotocalError: when the views do not determine the camera.
    """

    def measure(path: Path) -> TargetView:
        """Measure the corners of the board in one picture."""
        facts, view = read_facts(path), find_board(read_grey(path), board)
        if view is None:
            raise InputNotFoundError("the board was not found", where=path)
        return TargetView(facts, *view)

    with progress("measuring the board", len(paths)) as done:
        views, left_out = each_picture(paths, measure, done)
    across, down = board.inner
    # Of fewer pictures of a board no camera is calibrated.
    fewest_views = 3
    if len(views) < fewest_views:
        raise InputNotFoundError(
            f"{len(views)} of {len(paths)} images show a board of {board.columns} x {board.rows} squares "
            f"({across} x {down} inner corners), {fewest_views} are needed",
            "count the squares, not the corners, and see that the whole board is visible",
            where=paths[0].parent,
        )
    xyz = board.points()
    used = np.unique(np.concatenate([view.point for view in views]))
    points = ObjectPoints(
        tuple(f"r{k // across + 1}c{k % across + 1}" for k in used),
        xyz[used],
        np.zeros((len(used), 3)),
        np.full(len(used), ROLES.index("control")),
    )
    block, record = _measured(_block(views, used, points, name), views, left_out)
    given = {"squares": [board.columns, board.rows], "square_m": board.square_m, "kind": board.kind}
    return MeasuredBlock(block, {"schema": SCHEMA, "kind": "board", "board": given, **record})


def measure_field(
    paths: Sequence[Path],
    dictionary_name: str,
    distances: Path | None,
    name: str,
    lens: Given,
    cache: Path,
    progress: Progress,
) -> MeasuredBlock:
    """Measure the corners of coded targets without coordinates and make the block that calibrates the camera.

    Corners count as independent. Those beside each other share an edge, and their errors across it are
    correlated by -0.5: by that alone the camera's sigmas are 1.4 times as large as its errors.

    lens: what an image states, with what is said of the lens.
    cache: folder where what was measured is kept by the content of the picture.
    distances: CSV with the columns from, to, value, sigma (m) between corners; without, the unit is free.
    raises InputNotFoundError: when too few pictures show too few targets.
    raises PhotocalError: when the pictures do not determine the camera.
    """
    # What is wrong with the inputs is said before the pictures cost minutes.
    codes = dictionary(dictionary_name)
    if distances is not None:
        possible = tuple(f"{code}.{k + 1}" for code in range(len(codes.bytesList)) for k in range(4))
        read_relations(distances, "distance", possible, f"targets of {dictionary_name}")

    def measure(path: Path) -> TargetView:
        """Measure the corners of the coded targets in one picture, or take them from the cache."""

        def make() -> Arrays:
            """Find and measure them."""
            markers = find_markers(read_grey(path), dictionary_name)
            corner = np.array([[4 * m.identity + k for k in range(4)] for m in markers], dtype=np.int64)
            pixels, sigma = (
                np.array(own).reshape(-1, 2)
                for own in ([m.corners for m in markers], [m.sigma for m in markers])
            )
            return {"corner": corner.ravel(), "pixels": pixels, "sigma": sigma}

        facts = lens(read_facts(path))
        key = combined_key(VERSION, "corners of coded targets", digest(path), dictionary_name)
        found = cached(cache, key, ("corner", "pixels", "sigma"), make)
        return TargetView(facts, found["corner"], found["pixels"], found["sigma"])

    with progress("measuring the targets", len(paths)) as done:
        views, left_out = each_picture(paths, measure, done)
    seen = [corner for view in views for corner in view.point.tolist()]
    corners, shown = np.unique(np.array(seen, dtype=np.int64), return_counts=True)
    corners = corners[shown > 1]
    least = 4 * (FEWEST_TARGETS // 2)
    used = [view for view in views if np.isin(corners, view.point).sum() >= least]
    left_out += [
        {"image": view.facts.name, "reason": f"{len(view.point) // 4} targets only"}
        for view in views
        if not np.isin(corners, view.point).sum() >= least
    ]
    targets = len(corners) // 4
    if len(used) < FEWEST_PICTURES or targets < FEWEST_TARGETS:
        raise InputNotFoundError(
            f"{len(used)} of {len(paths)} pictures show {targets} targets of {dictionary_name} twice or "
            f"more; {FEWEST_PICTURES} pictures and {FEWEST_TARGETS} targets are needed",
            "check the dictionary and the size of the targets in the pictures",
            where=paths[0].parent,
        )
    # 17.1 is the target's own first corner, then clockwise as it is printed.
    names = tuple(f"{corner // 4}.{corner % 4 + 1}" for corner in corners)
    points = ObjectPoints(names, np.full((len(names), 3), np.nan))
    block = _block([view.rows(np.isin(view.point, corners)) for view in used], corners, points, name)
    if distances is not None:
        block = replace(block, relations=read_relations(distances, "distance", names, "the pictures"))
    block, rejected = without_gross_corners(block)
    block, record = _measured(block, used, left_out)
    record["rejected"] = rejected
    # Sigmas from the residuals are not tested with them.
    block = replace(block, global_test=(0.95, "none"))
    given = {"dictionary": dictionary_name, "targets": targets, "distances": len(block.relations.values)}
    return MeasuredBlock(block, {"schema": SCHEMA, "kind": "field of coded targets", **given, **record})


def _block(views: Sequence[TargetView], numbers: Integers, points: ObjectPoints, name: str) -> Block:
    """Block of the views of points with these numbers; of a flat board with coordinates, oriented to it."""
    facts = [view.facts for view in views]
    names, member = group_cameras(facts)
    rows = [np.searchsorted(numbers, view.point) for view in views]
    held = bool(points.of_role("control").any())
    cameras, poses = [], np.full((len(views), 6), np.nan)
    for k, camera_name in enumerate(names):
        members = np.flatnonzero(member == k).tolist()
        first = facts[members[0]]
        c: float | None = None
        if held:
            planes = [pixel_to_plane(first.size_px, (1.0, 1.0), views[j].pixels) for j in members]
            c = plane_principal_distance([points.values[rows[j], :2] for j in members], planes)
        c = c or principal_distance_px(first)[0]
        cameras.append(start_camera(camera_name, first, c, ESTIMATE))
        for j, plane in zip(members, planes if held else (), strict=held):
            pose = resection(points.values[rows[j]], plane / c)
            if pose is None:
                raise IllPosedError(
                    "its orientation to the board cannot be found",
                    "take it out",
                    where=f"image {facts[j].name}",
                )
            poses[j] = np.concatenate([angles_from_matrix(pose.rotation), pose.centre])
    return Block(
        name,
        "local",
        "local",
        "control" if held else "free",
        tuple(cameras),
        Images(tuple(f.name for f in facts), member, poses),
        points,
        Observations(
            "px",
            "pixel",
            np.repeat(np.arange(len(views)), [len(seen) for seen in rows]),
            np.concatenate(rows).astype(np.int64),
            np.concatenate([view.pixels for view in views]),
            np.concatenate([view.sigma for view in views]),
        ),
    )


def _measured(
    block: Block, views: Sequence[TargetView], left_out: list[dict[str, str]]
) -> tuple[Block, dict[str, Any]]:
    """The block with the sigmas that its residuals tell, and what the record of both kinds says."""
    block, figures = with_common_sigma(block)
    corners = np.bincount(block.observations.image, minlength=len(views))
    images = [
        {"image": view.facts.name, "corners": int(n), "grey_value_sigma_px": float(view.sigma.mean())}
        for view, n in zip(views, corners, strict=True)
    ]
    return block, {"images": images, "left_out": left_out, **figures, "pixel_origin": PIXEL_ORIGIN}


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


def without_gross_corners(block: Block) -> tuple[Block, list[dict[str, str]]]:
    """Leave out corners that a neighbour covers or a plate's edge shifts, by data snooping.

    The grey values tell how much surer the corner of a large target is; what they cannot know is not known
    yet: Pope's tau goes by what the residuals tell. Cameras and images start from its adjustment; corners,
    measured with straight edges, four of a target in a row, come to where the lens bends the edges.
    """
    seen = block.observations
    assembly = assemble(replace(block, observations=replace(seen, sigma=np.hypot(seen.sigma, COMMON_PX))))
    snooping = snoop(assembly.network, "tau")
    accepted = assembly.rays[snooping.accepted]
    out = np.setdiff1d(np.arange(len(seen.image)), accepted)
    images, points = block.images.names, block.points.names
    names = [{"image": images[seen.image[row]], "point": points[seen.point[row]]} for row in out]
    block = _started(block, snooping.solution)
    values, member = seen.values.reshape(-1, 4, 2).copy(), block.images.camera[seen.image[::4]]
    for k, lens in enumerate(block.cameras):
        values[member == k] = on_bent_edges(lens, values[member == k])
    seen = replace(seen, values=values.reshape(-1, 2))
    return replace(block, observations=seen.rows(np.sort(accepted))), names


def _started(block: Block, solution: Solution) -> Block:
    """The block, its cameras and images where an adjustment has them."""
    cameras = tuple(camera.with_values(v) for camera, v in zip(block.cameras, solution.cameras, strict=True))
    return replace(block, cameras=cameras, images=replace(block.images, values=solution.exposures))


def with_common_sigma(block: Block) -> tuple[Block, dict[str, Any]]:
    """Add to the sigmas what makes the residuals as large as they claim (uniform over the images).

    Each corner counts by its own sigma: a few that grey values tell badly do not hide the common part.
    Cameras and images start from its adjustment. Also tells how well each camera's principal distance is
    determined: its sigma over its value.
    """
    from scipy.optimize import brentq

    seen, assembly = block.observations, assemble(block)
    network, told = assembly.network, seen.sigma[assembly.rays]
    solution, common = adjust(network), 0.0

    def adjusted(common: float) -> Solution:
        """Adjust with that common part, from where all of them end nearly."""
        wider = network.rays.sigma * np.hypot(told, common) / told
        return adjust(replace(network, rays=replace(network.rays, sigma=wider)), state=solution.state)

    if solution.variance_factor > 1.0:
        # With twice the root mean square of all, no residuals are that large.
        most = 2.0 * float(np.sqrt(solution.variance_factor * (told**2).max()))
        common = float(
            brentq(lambda one: adjusted(one).variance_factor - 1.0, 0.0, most, xtol=1e-5, rtol=1e-3)
        )
        solution = adjusted(common)
    factor = max(solution.variance_factor, 0.0)
    ratio = np.sqrt(factor * solution.camera_covariance[:, 0, 0]) / solution.cameras[:, 0]
    sigma = np.hypot(seen.sigma, common)
    block = _started(replace(block, observations=replace(seen, sigma=sigma)), solution)
    return block, {"common_sigma_px": common, "principal_distance_sigma_ratio": ratio.tolist()}
