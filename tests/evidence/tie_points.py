"""Study of tie points on recorded pictures: orientation and check points against other programs, refusals.

Writes `docs/evidence/tie-points.md`. The comparison with COLMAP is a measurement of speed too:
`tests/benchmarks/test_tie_points.py`.

Run: `make evidence`, or `python -m tests.evidence.tie_points [SHARED]`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.adjust import adjust
from photocal.base.errors import PhotocalError
from photocal.block.model import Block, ObjectPoints
from photocal.block.network import assemble
from photocal.block.results.adjusted import given_exposures, given_points
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.micmac import read_micmac
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.localisation import similarity
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.image_file import list_images
from photocal.measurement.image_pairs import footprints, select_pairs, stated_footprints
from photocal.measurement.match_images import MatchingPlan, track_images
from photocal.measurement.measurement_record import MeasuredBlock
from photocal.measurement.options import MeasureOptions
from photocal.measurement.oriented_ties import Oriented, orient_ties
from photocal.measurement.picture_block import measure_images
from photocal.measurement.tie_block import TIE

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "tie-points.md"
CONTROL_M = 0.01
# Adjusted less surveyed, m: report.txt of DBAT's own run with the published marks, printed to 1 mm.
DBAT = {"351": (0.167, 0.008, -0.459), "410": (0.096, -0.296, 0.136)}
PROCESSES = 2


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    """Show no progress."""
    yield lambda _: None


def micmac(shared: Path, plan: MatchingPlan) -> list[str]:
    """Orientation of four terrestrial images by the given marks, and by these and our tie points."""
    folder = shared / "data/micmac-saisies-gcp"
    block = read_micmac(folder / "Ground-Pts3D.xml", folder / "GroundMeasure.xml", folder / "Ori-Ground_mm3d")
    # MicMac's "uncertainty" of 1 is a weight: the points were measured to about a centimetre.
    sigma = np.where(np.isfinite(block.points.sigma), CONTROL_M, np.inf)
    marked = replace(block, points=replace(block.points, sigma=sigma))
    unknown = replace(block.images, values=np.full_like(block.images.values, np.nan))
    tied = _with_ties(replace(marked, images=unknown), folder, plan).adjusted.block
    lines = [
        "## Four terrestrial images against MicMac",
        "",
        "MicMac's interior orientation (c 2112.0 px) is held, or c is released (COLMAP's c: 2257 px).",
        "Differences from MicMac's exterior orientation, the largest in units of our a posteriori standard",
        "deviations. With the marks alone, an image with only three of them starts from MicMac's",
        "orientation.",
        "",
        "| from | c (px) | largest difference, position (m) | turn (deg) | in sd | sigma of c (px) |",
        "|---|---|---|---|---|---|",
    ]
    for source, own in (("the given marks", marked), ("these and our tie points", tied)):
        lines += [_beside_micmac(source, own, names, block) for names in ((), ("c",))]
    return lines


def _beside_micmac(source: str, own: Block, names: Sequence[str], block: Block) -> str:
    chosen = np.array([name in names for name in PARAMETERS])
    cameras = tuple(replace(one, estimated=chosen) for one in own.cameras)
    assembly = assemble(replace(own, cameras=cameras))
    try:
        solution = adjust(assembly.network)
    except PhotocalError as refusal:
        return f"| {source} | {'released' if names else 'held'} | refused: {refusal.what} | | | |"
    values, covariance = given_exposures(assembly, solution)
    order = [own.images.names.index(name) for name in block.images.names]
    apart = values[order] - block.images.values
    # Where the middle angle is nearly a right one the others are weak together: the turn is told.
    turned = Rotation.from_matrix(
        matrix_from_angles(values[order, :3])
        @ np.swapaxes(matrix_from_angles(block.images.values[:, :3]), 1, 2)
    ).magnitude()
    apart[:, :3] = (apart[:, :3] + np.pi) % (2 * np.pi) - np.pi
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * solution.variance_factor)[order]
    c = f"{solution.cameras[0, 0]:.1f}" + ("" if names else " held")
    sigma = np.sqrt(solution.camera_covariance[0, 0, 0] * solution.variance_factor)
    return (
        f"| {source} | {c} | {np.abs(apart[:, 3:]).max():.4f} | {np.degrees(turned.max()):.4f} "
        f"| {np.abs(apart / sd).max():.1f} | {sigma:.1f} |"
    )


def strasbourg(shared: Path, plan: MatchingPlan) -> list[str]:
    """Check points of an aerial block with the published marks of control, and our tie points."""
    folder = shared / "data/dbat-sxb"
    start = _marks_only(read_foreign_block(folder / "script" / "sxb.xml"))
    found = _with_ties(start, folder / "images", plan)
    adjusted = found.adjusted
    values, covariance = given_points(adjusted.assembly, adjusted.solution)
    row = {int(point): k for k, point in enumerate(adjusted.assembly.points)}
    ties = adjusted.block.observations.sigma[-len(adjusted.tracks.track) :]
    lines = [
        "## Check points of an aerial block",
        "",
        "Marks of control and check points are the published ones. Tie points are measured in the",
        f"pictures: {adjusted.tracks.count} with {len(ties)} rays, sigma {np.sqrt(np.mean(ties**2)):.2f}",
        f"px, variance factor {adjusted.solution.variance_factor:.2f}. Adjusted minus surveyed",
        "coordinates, and those of DBAT with its published tie points.",
        "",
        "| check point | X, Y, Z (m) | sigma (m) | DBAT's X, Y, Z (m) | largest over DBAT's |",
        "|---|---|---|---|---|",
    ]
    for name, published in DBAT.items():
        point = start.points.names.index(name)
        off = values[row[point]] - start.points.values[point]
        sigma = np.sqrt(np.diagonal(covariance[row[point]]))
        lines.append(
            f"| {name} | {_three(off)} | {_three(sigma)} | {_three(published)} "
            f"| {np.abs(off).max() / np.abs(published).max():.2f} |"
        )
    return lines


def _three(values: Sequence[float] | Floats) -> str:
    return ", ".join(f"{value:.3f}" for value in values)


def _marks_only(block: Block) -> Block:
    """Block without its tie points."""
    points, seen = block.points, block.observations
    keep = np.flatnonzero(points.role != TIE)
    number = np.full(len(points.names), -1)
    number[keep] = np.arange(len(keep))
    left = number[seen.point] >= 0
    return replace(
        block,
        points=ObjectPoints(
            tuple(points.names[k] for k in keep), points.values[keep], points.sigma[keep], points.role[keep]
        ),
        observations=replace(
            seen,
            image=seen.image[left],
            point=number[seen.point[left]],
            values=seen.values[left],
            sigma=seen.sigma[left],
        ),
    )


def _with_ties(start: Block, folder: Path, plan: MatchingPlan) -> Oriented:
    """Measure tie points in the pictures of a block, and orient it."""
    paths = [path for path in list_images(folder) if path.name in start.images.names]
    tracked = track_images(paths, plan, quiet, stated_footprints, lambda facts: facts)
    order = [start.images.names.index(own.name) for own in tracked.facts]
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
        observations=replace(seen, image=np.argsort(order)[seen.image]),
    )
    return orient_ties(turned, tracked.sources, tracked.tracks, tracked.pairs, plan.processes, quiet)


def brighton(shared: Path, plan: MatchingPlan) -> list[str]:
    """A flight without control: positions against the images' own, with c held and released."""
    images = list_images(shared / "data/uav-brighton-beach/images")
    made = measure_images(images, "brighton-beach", plan, quiet)
    record = made.record
    released = record["cameras"][0]["released"]
    names = (
        ("K1", "K2"),
        ("c", "K1"),
        ("c", "x0", "y0", "K1", "K2"),
        ("c", "x0", "y0", "K1", "K2", "P1", "P2"),
    )
    return [
        "## A flight without control",
        "",
        f"{len(record['images'])} images, {record['tracks']['three_and_more_rays']} tracks of three and",
        f"more rays; {record['points']} points adjusted, {100 * record['share_of_four_and_more']:.1f} % of",
        "them with four and more rays. Camera positions minus those stated in the images, root mean square",
        "after a similarity transformation; COLMAP's are 0.19, 0.35, 0.19 m, with c 2786 px.",
        "",
        "| estimated | c (px) | sigma (px) | rms (px) | sigma of a tie point (px) | positions X, Y, Z (m) |",
        "|---|---|---|---|---|---|",
        *(_released(made.block, some) for some in names),
        "",
        f"The relief of the ground is {100 * released['relief']:.0f} % of its distance: c is correlated",
        "with the heights, and errors of the model bias c. Its sigma does not contain this.",
    ]


def _released(block: Block, names: Sequence[str]) -> str:
    chosen = np.array([name in names for name in PARAMETERS])
    assembly = assemble(
        replace(block, cameras=tuple(replace(one, estimated=chosen) for one in block.cameras))
    )
    solution = adjust(assembly.network)
    c, sigma = solution.cameras[0, 0], np.sqrt(solution.camera_covariance[0, 0, 0])
    stated, found = block.images.values[:, 3:], assembly.frame.to_given(solution.exposures[:, 3:])
    fit = similarity(found, stated)
    assert fit is not None
    apart = np.sqrt(np.mean((fit.applied(found) - stated) ** 2, axis=0))
    level = np.sqrt(np.mean(block.observations.sigma**2) * solution.variance_factor)
    return (
        f"| {', '.join(names)} | {c:.1f} | {sigma:.1f} "
        f"| {np.sqrt(np.mean(solution.residuals**2)):.3f} | {level:.3f} | {_three(apart)} |"
    )


def few_images(shared: Path, plan: MatchingPlan) -> list[str]:
    """Blocks of few images: oriented, or refused with the reason."""
    cuav, berlin = shared / "data/mavlink-tlog-cuav-images", shared / "data/opensfm-berlin-gcp"
    pictures = list_images(cuav)
    raw = [path for path in pictures if path.name.startswith("raw")]
    given = MeasureOptions(gcp=berlin / "ground_control_points.json", height="ellipsoidal")
    street = list_images(berlin / "images")
    return [
        "## Few images",
        "",
        "| images | outcome |",
        "|---|---|",
        _outcome("three of a quadplane, without position", lambda: measure_images(raw, "cuav", plan, quiet)),
        _outcome("these and two of another flight", lambda: measure_images(pictures, "cuav", plan, quiet)),
        _outcome(
            "three of a street, two control points",
            lambda: measure_images(street, "berlin", plan, quiet, given),
        ),
        _outcome("the same without control", lambda: measure_images(street, "berlin", plan, quiet)),
    ]


def _outcome(what: str, measure: Callable[[], MeasuredBlock]) -> str:
    try:
        record: dict[str, Any] = measure().record
    except PhotocalError as refusal:
        return f"| {what} | refused: {refusal.what} |"
    left = "".join(f"; {entry['image']} left out: {entry['reason']}" for entry in record["left_out"])
    count = len(record["images"])
    return f"| {what} | {count} oriented by {record['points']} points, rms {record['rms_px']:.2f} px{left} |"


def pairs() -> list[str]:
    """Pairs chosen for flights of growing size."""
    lines = [
        "## Pairs of images",
        "",
        "| images | pairs | pairs an image | selection (s) |",
        "|---|---|---|---|",
    ]
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
    text = ["# Tie points in recorded pictures", "", "Made by `python -m tests.evidence.tie_points`.", ""]
    with tempfile.TemporaryDirectory() as cache:
        plan = MatchingPlan(Path(cache), PROCESSES)
        for part in (micmac, strasbourg, brighton, few_images):
            own = [*part(shared, plan), ""]
            print("\n".join(own), flush=True)
            text += own
    text += pairs()
    OUTPUT.write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared")
