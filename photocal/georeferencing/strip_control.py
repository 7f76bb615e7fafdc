"""Strips that show no control point: only their neighbours hold them, as often with outer strips."""

from collections.abc import Sequence

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.block.motion import lines_of_places
from photocal.findings.finding import Finding


def control_by_strip(block: Block, names: Sequence[str], strip: Integers) -> list[dict[str, int]]:
    """Count the images of each strip, and the control points that they show.

    names, strip (n,): images and their strips.
    """
    own = {name: int(number) for name, number in zip(names, strip.tolist(), strict=True)}
    of_image = np.array([own.get(name, -1) for name in block.images.names])
    control = block.points.of_role("control")[block.observations.point]
    rows = []
    for number in dict.fromkeys(strip.tolist()):
        seen = control & (of_image[block.observations.image] == number)
        points = len(np.unique(block.observations.point[seen]))
        rows.append({"strip": int(number), "images": int(np.sum(strip == number)), "control_points": points})
    return rows


def strip_findings(block: Block, exposures: Floats) -> tuple[Finding, ...]:
    """Name strips without control where nothing else holds them: no positions better than navigation fixes.

    exposures (images, 6): adjusted; NaN where there is none.
    """
    # Shorter ones are turns.
    fewest_images = 3
    stated = block.images.sigma[:, 3:5]
    held = len(block.positions.image) > 0 or (np.isfinite(stated) & (stated < policy.coarse_m)).any()
    known = np.flatnonzero(np.isfinite(exposures).all(axis=1))
    if held or len(block.cameras) > 1 or len(known) < 2 * fewest_images:
        return ()
    time = block.images.time[known]
    order = known[np.argsort(time, kind="stable")] if np.isfinite(time).all() else known
    strip = lines_of_places(exposures[order, 3:])
    names = [block.images.names[k] for k in order]
    rows = [row for row in control_by_strip(block, names, strip) if row["images"] >= fewest_images]
    bare = [row for row in rows if not row["control_points"]]
    if not bare or len(bare) == len(rows):
        return ()
    first = {number: names[int(np.argmax(strip == number))] for number in (row["strip"] for row in bare)}
    figures = {
        "strips": tuple(f"{row['strip']} (from {first[row['strip']]})" for row in bare),
        "images": float(sum(row["images"] for row in bare)),
        "of": float(len(names)),
    }
    return (Finding("strips-without-control", "note", figures=figures),)
