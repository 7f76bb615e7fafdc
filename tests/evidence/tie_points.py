"""Study of image measurement on recorded pictures: orientation against MicMac, pair selection.

Writes `docs/evidence/tie-points.md`.

Run: `make evidence`, or `python -m tests.evidence.tie_points [SHARED]`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import PhotocalError
from photocal.adjustment.adjust import adjust
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.exchange.micmac import read_micmac
from photocal.geometry.camera import PARAMETERS
from photocal.measurement.image_file import list_images
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import sight, stated_footprints
from photocal.measurement.oriented_ties import orient_ties
from photocal.measurement.pair_selection import footprints, select_pairs

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "tie-points.md"
CONTROL_M = 0.01


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    """Show no progress."""
    yield lambda _: None


def micmac(shared: Path, cache: Path) -> list[str]:
    """Orientation of the four recorded images by the given marks and our tie points.

    The marks alone leave an image with three of them: tests/photocal/accuracy has that case.
    """
    folder = shared / "data/micmac-saisies-gcp"
    block = read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / "Ori-Ground_mm3d")
    peer = block.images.values
    # MicMac's "uncertainty" of 1 is a weight: the points were measured to about a centimetre.
    points = replace(block.points, sigma=np.full_like(block.points.sigma, CONTROL_M))
    images = replace(block.images, values=np.full_like(peer, np.nan))
    start = replace(block, images=images, points=points)
    lines = [
        "| from | c | largest difference, position (m) | angle (deg) | in sd | sigma of c (px) |",
        "|---|---|---|---|---|---|",
    ]
    ties = _with_ties(start, folder, cache)
    for source, own in (("marks and our tie points", ties),):
        for names in ((), ("c",)):
            chosen = np.array([name in names for name in PARAMETERS])
            cameras = tuple(replace(one, estimated=chosen) for one in own.cameras)
            assembly = assemble(replace(own, cameras=cameras))
            try:
                solution = adjust(assembly.network)
            except PhotocalError as refusal:
                lines.append(f"| {source} | released | refused: {refusal.what} | | | |")
                continue
            found = np.hstack([solution.exposures[:, :3], assembly.frame.to_given(solution.exposures[:, 3:])])
            order = [own.images.names.index(name) for name in block.images.names]
            apart = found[order] - peer
            apart[:, :3] = (apart[:, :3] + np.pi) % (2 * np.pi) - np.pi
            sd = np.sqrt(
                np.diagonal(solution.exposure_covariance, axis1=1, axis2=2) * solution.variance_factor
            )[order]
            c = f"{solution.cameras[0, 0]:.1f}" + ("" if names else " held")
            sigma = np.sqrt(solution.camera_covariance[0, 0, 0] * solution.variance_factor)
            lines.append(
                f"| {source} | {c} | {np.abs(apart[:, 3:]).max():.4f} "
                f"| {np.degrees(np.abs(apart[:, :3]).max()):.4f} | {np.abs(apart / sd).max():.1f} "
                f"| {sigma:.1f} |"
            )
    return lines


def _with_ties(start: Block, folder: Path, cache: Path) -> Block:
    paths = [path for path in list_images(folder) if path.name in start.images.names]
    sighted = sight(paths, MatchingPlan(cache, 1), quiet, stated_footprints)
    order = [start.images.names.index(own.name) for own in sighted.facts]
    place = np.argsort(order)
    images, seen = start.images, start.observations
    turned = replace(
        start,
        images=replace(
            images,
            names=tuple(images.names[k] for k in order),
            camera=images.camera[order],
            values=images.values[order],
            sigma=images.sigma[order],
        ),
        observations=replace(seen, image=place[seen.image]),
    )
    found = orient_ties(turned, sighted.sources, sighted.tracks, sighted.pairs, 1, quiet)
    return found.adjusted.block


def pairs() -> list[str]:
    """Pairs chosen for flights of growing size."""
    lines = ["| images | pairs | pairs an image | selection (s) |", "|---|---|---|---|"]
    for count in (250, 500, 1000, 2000):
        side = int(np.sqrt(count))
        east, north = np.meshgrid(np.arange(side) * 30.0, np.arange(count // side) * 20.0)
        places = np.column_stack([east.ravel(), north.ravel()])
        n = len(places)
        began = time.perf_counter()
        seen = footprints(
            places,
            np.full(n, 60.0),
            np.full((n, 2), np.nan),
            np.tile([4000.0, 3000.0], (n, 1)),
            np.full(n, 3000.0),
        )
        chosen, _ = select_pairs(seen, n)
        spent = time.perf_counter() - began
        lines.append(f"| {n} | {len(chosen)} | {len(chosen) / n:.1f} | {spent:.2f} |")
    return lines


def main(shared: Path) -> None:
    """Run the study and write its tables."""
    with tempfile.TemporaryDirectory() as cache:
        oriented = micmac(shared, Path(cache))
    text = [
        "# Image measurement on recorded pictures",
        "",
        "Made by `python -m tests.evidence.tie_points`.",
        "",
        "## Four terrestrial images against MicMac",
        "",
        "MicMac's interior orientation (c 2112.0 px) is held, or c is released. Differences from its",
        "exterior orientation, the largest in units of our a posteriori standard deviations.",
        "",
        *oriented,
        "",
        "## Pairs of images",
        "",
        *pairs(),
    ]
    OUTPUT.write_text("\n".join(text) + "\n", encoding="utf-8")
    print("\n".join(text))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared")
