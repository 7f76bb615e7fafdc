"""Checks of exposures by images: their own tie points, or a block that was adjusted before."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats, Integers, picked
from photocal.base.errors import PhotocalError
from photocal.base.policy import policy
from photocal.base.progress import Progress
from photocal.base.text_tables import read_wider_table
from photocal.block.results.folder import RESULT, read_result
from photocal.findings.finding import Finding, untested
from photocal.geometry.localisation import similarity
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.image_metadata import ImageMetadata
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.picture_block import measure_images
from photocal.navigation.exposures import Exposures, orientations
from photocal.navigation.position_comparison import judge_positions
from photocal.navigation.rig import CameraOnBody

CODE = "image-rotations"
# Attitudes of small vehicles are good to a few degrees.
ROUGH_DEG = 5.0


@dataclass(frozen=True)
class PairRotation:
    """Two neighbouring images.

    first, second: rows of the exposures.
    points: matched points; 0 where an adjustment gave the rotations.
    quarter_turns: turns by 90 degrees in the image plane by which the second image is stored otherwise than
        recorded, relative to the first.
    angle_deg: angle between both relative rotations beside those turns.
    along: cosine between the direction to the second image by the points and by the recorded orientation and
        positions, both in the axes of the first; NaN without positions.
    """

    first: int
    second: int
    points: int
    quarter_turns: int
    angle_deg: float
    along: float


def least_turn(measured: Floats, recorded: Floats) -> tuple[int, float]:
    """Return the quarter turns in the image plane that bring two relative rotations closest, and the rest."""
    quarters = Rotation.from_rotvec([[0, 0, np.pi / 2 * turns] for turns in range(4)])
    angles = np.degrees((quarters * Rotation.from_matrix(measured @ recorded.T)).magnitude())
    turns = int(np.argmin(angles))
    return turns, float(angles[turns])


def places_of(exposures: Exposures) -> Floats:
    """Return positions east, north, up about their middle, m (n, 3); NaN where unknown."""
    p = exposures.placed
    known = p.placed
    if not known.any():
        return np.full((len(exposures), 3), np.nan)
    return p.offsets(np.mean(p.place[known], axis=0))


def stored_turns(pairs: list[PairRotation]) -> dict[int, int]:
    """Tell which exposures' images are stored turned against their attitude, in quarter turns.

    Turns between neighbours leave one turn common to all open: the images whose direction to the next one
    agrees with the recorded positions decide it; without positions most images are taken to be right.
    """
    turns: dict[int, int] = {}
    group: dict[int, int] = {}
    for number, pair in enumerate(pairs):
        if pair.first not in turns:
            turns[pair.first], group[pair.first] = 0, number
        turns[pair.second] = (turns[pair.first] + pair.quarter_turns) % 4
        group[pair.second] = group[pair.first]
    for number in set(group.values()):
        members = [row for row in turns if group[row] == number]
        votes = np.zeros(4)
        for pair in pairs:
            if group[pair.first] == number and np.isfinite(pair.along):
                # Pictures stored upside down see their follower behind them.
                votes[(turns[pair.first] + (0 if pair.along > 0 else 2)) % 4] += abs(pair.along)
        if not votes.any():
            votes = np.bincount([turns[row] for row in members], minlength=4).astype(float)
        upright = int(np.argmax(votes))
        for row in members:
            turns[row] = (turns[row] - upright) % 4
    return {row: turn for row, turn in turns.items() if turn}


def rotation_check(exposures: Exposures, pairs: list[PairRotation], source: str) -> Finding:
    """Return what the comparison shows as a check."""
    if not pairs:
        return untested(CODE, "no-neighbours", {"source": source})
    angles, names = np.array([pair.angle_deg for pair in pairs]), exposures.first_images
    turned = stored_turns(pairs)
    # Over a turn of the vehicle attitudes lag behind: pairs within a strip are separated from those across.
    within = np.array([pair.quarter_turns == 0 for pair in pairs])
    figures: dict[str, Any] = {
        "source": source,
        "n": len(pairs),
        "pairs": [
            {
                "first": names[pair.first],
                "second": names[pair.second],
                **picked(pair, "points", "angle_deg", "quarter_turns"),
            }
            for pair in pairs
        ],
        "median_deg": float(np.median(angles)),
        "median_same_way_deg": float(np.median(angles[within])) if within.any() else None,
        "stored_turned": [
            {"image": names[row], "degrees": 90 * turn} for row, turn in sorted(turned.items())
        ],
    }
    clauses = ("within",) if within.any() and not within.all() else ()
    figures["within"] = int(within.sum())
    if turned:
        rows = sorted(turned)
        figures["images"] = tuple(names[row] for row in rows)
        figures["first"], figures["last"] = figures["images"][0], figures["images"][-1]
        strip = len(rows) > 2 and rows[-1] - rows[0] == len(rows) - 1
        stored = "strip-turned" if strip else "stored-turned"
        figures["turns_deg"] = tuple(sorted({str(90 * turn) for turn in turned.values()}))
        return Finding(CODE, "grave", figures=figures, clauses=(stored, "pairs-differ", *clauses))
    if figures["median_deg"] > ROUGH_DEG:
        return Finding(CODE, "grave", figures=figures, clauses=("other-images", "pairs-differ", *clauses))
    return Finding(CODE, "passed", figures=figures, clauses=clauses)


def compare_with_oriented(
    exposures: Exposures, oriented: OrientedImages, rig: CameraOnBody
) -> list[PairRotation]:
    """Compare relative rotations of every image and its follower; the frame of the block does not matter."""
    # An adjustment of many images knows rotations better than two images over flat ground do, whose tilt and
    # shift can hardly be separated.
    recorded, _ = orientations(exposures, rig)
    place = places_of(exposures)
    rows = _common(exposures, oriented)
    pairs = []
    for a, b in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        measured = oriented.rotation[b] @ oriented.rotation[a].T
        turns, angle = least_turn(measured, recorded[b] @ recorded[a].T)
        ways = (
            rotation[a] @ ((where[b] - where[a]) / np.linalg.norm(where[b] - where[a]))
            for rotation, where in ((oriented.rotation, oriented.station), (recorded, place))
        )
        pairs.append(PairRotation(a, b, 0, turns, angle, float(next(ways) @ next(ways))))
    return pairs


def boresight_check(exposures: Exposures, oriented: OrientedImages, rig: CameraOnBody) -> Finding:
    """Return the constant turn between recorded attitudes and the camera as a check."""
    # Of fewer rotations the spread about their median is not known.
    least = 6
    # A boresight's difference is judged as a blunder is: beyond three sigmas.
    sigmas = 3.0
    # The block is turned into east, north, up by its positions (a similarity); the median of what is left is
    # taken about each camera axis, images that are stored turned taken upright.
    rows = _common(exposures, oriented)
    place = places_of(exposures)
    if len(rows) < least or not np.isfinite(place[rows]).all():
        return untested("boresight", "few-rotations", {"n": float(len(rows)), "needed": float(least)})
    aligned = similarity(oriented.station[rows], place[rows])
    if aligned is None:
        return untested("boresight", "on-one-line")
    quarter = stored_turns(compare_with_oriented(exposures, oriented, rig))
    turned = Rotation.from_rotvec([[0, 0, np.pi / 2 * quarter.get(row, 0)] for row in rows.tolist()])
    upright = turned.as_matrix() @ aligned.applied_to_rotations(oriented.rotation[rows])
    recorded = orientations(exposures, rig)[0][rows]
    turn = Rotation.from_matrix(upright @ np.swapaxes(recorded, 1, 2)).as_rotvec()
    value = np.median(turn, axis=0)
    spread = policy.mad_to_sigma * np.median(np.abs(turn - value), axis=0)
    # The median of n normal values has pi / 2 times the variance of their mean; neighbours err alike.
    sigma = spread * np.sqrt(np.pi / 2 / len(rows) * _inflation(turn - value))
    stated = np.radians(ROUGH_DEG) if rig.angle_sigma is None else float(np.max(rig.angle_sigma))
    limit = sigmas * np.sqrt(sigma**2 + rig.boresight_sigma**2 + stated**2)
    figures: dict[str, Any] = {
        "images": len(rows),
        "turn_deg": np.degrees(value).tolist(),
        "sigma_deg": np.degrees(sigma).tolist(),
        "scatter_deg": np.degrees(spread).tolist(),
    }
    turns = zip(np.degrees(value), np.degrees(sigma), "xyz", strict=True)
    figures["numbers"] = tuple(f"{axis} {v:+.2f} +- {s:.2f}" for v, s, axis in turns)
    if (np.abs(value) > limit).any():
        return Finding("boresight", "grave", figures=figures, clauses=("turned-by",))
    return Finding("boresight", "passed", figures=figures)


def _common(exposures: Exposures, oriented: OrientedImages) -> Integers:
    known = exposures.attitude.known & np.isfinite(oriented.rotation).all(axis=(1, 2))
    return np.flatnonzero(known)


def _inflation(error: Floats) -> Floats:
    """Return (1 + r) / (1 - r) with the correlation r of neighbours, for each column."""
    squares = np.maximum(np.sum(error**2, axis=0), 1e-300)
    r = np.clip(np.sum(error[1:] * error[:-1], axis=0) / squares, 0.0, 0.9)
    return np.asarray((1 + r) / (1 - r))


# How tie points of the images are found, and where the progress is reported.
TieMatching = tuple[MatchingPlan, Progress]


def check_oriented(
    oriented: OrientedImages, exposures: Exposures, rig: CameraOnBody, source: str
) -> list[Finding]:
    """Compare exposures with images that an adjustment oriented."""
    findings = [judge_positions("adjusted-images", exposures, oriented.station, rig, "similarity")]
    pairs = compare_with_oriented(exposures, oriented, rig)
    if pairs:
        findings.append(rotation_check(exposures, pairs, source))
        findings.append(boresight_check(exposures, oriented, rig))
    return findings


def check_images(
    exposures: Exposures, images: list[ImageMetadata], rig: CameraOnBody, how: TieMatching
) -> list[Finding]:
    """Compare exposures with their images, oriented together by tie points.

    Two images alone would not do: over flat ground a tilt and a shift look alike.
    """
    names = exposures.first_images
    paths = [image.path for image in images if image.path is not None and image.name in names]
    try:
        block = measure_images(paths, "images", *how).block
    except PhotocalError as refusal:
        return [untested(CODE, "images-not-oriented", {"source": "tie-points", "reason": refusal.what})]
    made = block.images
    oriented = OrientedImages(made.names, block.cameras, made.camera, made.values)
    return check_oriented(oriented.named(names), exposures, rig, "tie-points")


def oriented_images(folder: Path, images: list[str]) -> OrientedImages:
    """Read images of a run folder, a block folder, or a table of images with X, Y, Z, omega, phi, kappa."""
    if (folder / RESULT).is_file():
        return read_result(folder).images.named(images)
    path = folder / "images.csv" if folder.is_dir() else folder
    table = read_wider_table(path, ("image", "X", "Y", "Z"))
    # Without angles the positions serve all the same.
    angles = np.radians(table.matrix(("omega", "phi", "kappa"), empty=np.nan))
    values = np.hstack([angles, table.matrix("XYZ")])
    names = table.unique_names("image")
    return OrientedImages(names, (), np.full(len(names), -1), values).named(images)
