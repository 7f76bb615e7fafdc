"""A laboratory's field of coded targets without coordinates: four corners each, and tape distances."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.adjustment.network import NO_RELATIONS
from photocal.base.arrays import Floats
from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Progress
from photocal.block.folder import read_relations
from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.measurement.block_files import PIXEL_ORIGIN, SCHEMA, Measured
from photocal.measurement.board_block import ESTIMATE, with_common_sigma
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import each_picture, read_grey
from photocal.measurement.maker_camera import GivenLens, group_cameras, principal_distance_px, start_camera
from photocal.measurement.markers import dictionary, find_markers

# Of fewer pictures or targets no camera is calibrated.
FEWEST_PICTURES, FEWEST_TARGETS = 4, 8


@dataclass(frozen=True)
class _View:
    """Corners (n, 4, 2) of the targets in a picture, and the sigmas (n,) that their grey values give."""

    facts: ImageFacts
    codes: tuple[int, ...]
    corners: Floats
    sigma: Floats


def measure_field(
    paths: Sequence[Path],
    dictionary_name: str,
    distances: Path | None,
    name: str,
    lens: GivenLens,
    progress: Progress,
) -> Measured:
    """Measure the corners of all coded targets and make the block that calibrates the camera.

    distances: CSV with the columns from, to, value, sigma (m) between corners; without, the unit is free.
    raises InputNotFoundError: when too few pictures show too few targets.
    raises PhotocalError: when the pictures do not determine the camera.
    """
    dictionary(dictionary_name)

    def measure(path: Path) -> _View:
        markers = find_markers(read_grey(path), dictionary_name)
        # Two edges make a corner, each about as good as the centre that four of them make.
        sigma = np.array([2.0 * np.hypot(*m.centre.sigma) / np.sqrt(2.0) for m in markers])
        corners = np.array([m.corners for m in markers]).reshape(-1, 4, 2)
        return _View(lens.of(read_facts(path)), tuple(m.identity for m in markers), corners, sigma)

    with progress("measuring the targets", len(paths)) as done:
        views, left_out = each_picture(paths, measure, done)
    seen = [code for view in views for code in view.codes]
    codes = sorted(code for code in set(seen) if seen.count(code) > 1)
    used = [view for view in views if len(set(view.codes) & set(codes)) >= FEWEST_TARGETS // 2]
    left_out += [
        {"image": view.facts.name, "reason": f"{len(view.codes)} targets only"}
        for view in views
        if view not in used
    ]
    if len(used) < FEWEST_PICTURES or len(codes) < FEWEST_TARGETS:
        raise InputNotFoundError(
            f"{len(used)} of {len(paths)} pictures show {len(codes)} targets of {dictionary_name} twice or "
            f"more; {FEWEST_PICTURES} pictures and {FEWEST_TARGETS} targets are needed",
            "look at the dictionary and at the size of the targets in the pictures",
            where=paths[0].parent,
        )
    block, figures = with_common_sigma(_block(used, codes, distances, name))
    # Sigmas from the residuals are not tested with them.
    block = replace(block, global_test=(0.95, "none"))
    record = {
        "schema": SCHEMA,
        "kind": "field of coded targets",
        "dictionary": dictionary_name,
        "targets": len(codes),
        "images": [
            {
                "image": view.facts.name,
                "corners": 4 * len(set(view.codes) & set(codes)),
                "grey_value_sigma_px": float(view.sigma.mean()),
            }
            for view in used
        ],
        "left_out": left_out,
        "distances": len(block.relations.values),
        **figures,
        "pixel_origin": PIXEL_ORIGIN,
    }
    return Measured(block, record)


def _block(views: Sequence[_View], codes: list[int], distances: Path | None, name: str) -> Block:
    facts = [view.facts for view in views]
    camera_names, member = group_cameras(facts)
    cameras = tuple(
        start_camera(camera_name, first, principal_distance_px(first)[0], ESTIMATE)
        for k, camera_name in enumerate(camera_names)
        for first in [facts[int(np.flatnonzero(member == k)[0])]]
    )
    row = {code: k for k, code in enumerate(codes)}
    image, point, pixels, sigmas = [], [], [], []
    for k, view in enumerate(views):
        for code, corners, sigma in zip(view.codes, view.corners, view.sigma, strict=True):
            if code in row:
                image += [k] * 4
                point += [4 * row[code] + corner for corner in range(4)]
                pixels += corners.tolist()
                sigmas += [[sigma, sigma]] * 4
    # 17.1 is the target's own first corner, then clockwise as it is printed.
    names = tuple(f"{code}.{corner}" for code in codes for corner in (1, 2, 3, 4))
    return Block(
        name,
        "local",
        "local",
        "free",
        cameras,
        Images(tuple(f.name for f in facts), member),
        ObjectPoints(names, np.full((len(names), 3), np.nan)),
        Observations("px", "pixel", np.array(image), np.array(point), np.array(pixels), np.array(sigmas)),
        relations=NO_RELATIONS
        if distances is None
        else read_relations(distances, "distance", names, "the pictures"),
    )
