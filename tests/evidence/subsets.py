"""Study of random subsets of flights: wrong c, wrong positions, pictures from elsewhere.

Each subset has 5 to 18 pictures of one flight in any order of gaps, one in ten from elsewhere; c starts up to
20 % wrong, positions are up to 30 m off. What is connected is judged by the matches alone: pictures that
share twenty points of three and more rays. Features and matches are kept for each picture and pair.
Writes `docs/evidence/subsets.md`.

Run: `make evidence`, or `python -m tests.evidence.subsets`, in portions as `tests.evidence.portions` says;
PHOTOCAL_STUDY_CACHE names a folder in which features and matches are kept.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from photocal.base.errors import PhotocalError
from photocal.measurement.image_pairs import stated_footprints
from photocal.measurement.match_images import ImageTracks, MatchingPlan, track_images
from photocal.measurement.oriented_ties import first_orientation
from photocal.measurement.position_files import local_places
from photocal.measurement.tie_adjustment import pixel_residuals
from photocal.measurement.tie_block import start_block
from tests.evidence.portions import outcomes
from tests.photocal.measurement.site import SIDE, flight, texture

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
OUTPUT = ROOT / "docs" / "evidence" / "subsets.md"
FLIGHTS = {
    "lewis": "flight-lewis-ten/*.jpg",
    "caliterra": "flight-caliterra-twelve/IMG*",
    "brighton": "uav-brighton-beach/images/*",
}
RENDERED = ("rendered 1", "rendered 2")
ELSEWHERE = (
    "opensfm-berlin-gcp/images/01.jpg",
    "micmac-saisies-gcp/IMGP4167.JPG",
    "sequoia-rig/IMG_161122_163239_0001_RGB.JPG",
    "mavlink-tlog-cuav-images/exifimg2018021100040450Z.jpg",
)
FEWEST, MOST, ONE_IN = 5, 18, 10
WRONG_C, WRONG_M = 0.2, 30.0
# Two pictures belong together by so many points of three and more rays; a block has so many pictures.
SHARED, BLOCK = 20, 4
SEED = 1
KEPT = "PHOTOCAL_STUDY_CACHE"


@dataclass(frozen=True)
class Outcome:
    """What became of a subset.

    Attributes
    ----------
    connected : int
        Pictures of the largest group that shares points.
    refused : str
        Why, or empty.
    named : bool
        Whether all pictures that are not oriented are named with a reason.
    strangers : int
        Pictures from elsewhere that were oriented.
    """

    flight: str
    pictures: int
    connected: int
    oriented: int
    refused: str
    named: bool
    strangers: int
    rms_px: float
    c_start: float
    c: float
    seconds: float


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    """Show no progress."""
    yield lambda _: None


def connected(tracked: ImageTracks) -> int:
    """Pictures of the largest group that shares points, whatever their orientation."""
    tracks = tracked.tracks.some((tracked.tracks.rays >= 3)[tracked.tracks.track])
    images = len(tracked.facts)
    seen = csr_array((np.ones(len(tracks.track)), (tracks.image, tracks.track)), (images, tracks.count))
    together = (seen @ seen.T).toarray() >= SHARED
    _, label = connected_components(together, directed=False)
    return int(np.bincount(label).max())


def oriented(
    name: str, paths: Sequence[Path], strangers: Sequence[Path], rng: np.random.Generator, cache: Path
) -> Outcome:
    """Orient a subset with a wrong start."""
    began = time.process_time()
    tracked = track_images(
        [*paths, *strangers], MatchingPlan(cache, 1), quiet, stated_footprints, lambda facts: facts
    )
    places, _ = local_places(tracked.facts)
    wrong = rng.normal(size=places.shape)
    wrong *= WRONG_M * rng.random((len(places), 1)) / np.linalg.norm(wrong, axis=1)[:, None]
    start = start_block(tracked.facts, places + wrong, name)
    share = 1 + rng.uniform(-WRONG_C, WRONG_C)
    cameras = []
    for own in start.cameras:
        values = own.values.copy()
        values[0] *= share
        cameras.append(own.with_values(values))
    group, names = connected(tracked), [f.name for f in tracked.facts]
    c_start = float(cameras[int(start.images.camera[names.index(paths[0].name)])].values[0])
    try:
        first = first_orientation(replace(start, cameras=tuple(cameras)), tracked.tracks)
    except PhotocalError as refusal:
        spent = time.process_time() - began
        nan = float("nan")
        return Outcome(name, len(names), group, 0, str(refusal), False, 0, nan, c_start, nan, spent)
    block = first.adjusted.block
    told = {entry["image"] for entry in first.left_out}
    residuals = pixel_residuals(first.adjusted.assembly, first.adjusted.solution)
    return Outcome(
        name,
        len(names),
        group,
        len(block.images.names),
        "",
        set(names) - set(block.images.names) == told,
        len({path.name for path in strangers} & set(block.images.names)),
        float(np.sqrt(np.mean(residuals**2))),
        c_start,
        float(block.cameras[0].value("c")),
        time.process_time() - began,
    )


def pictures(name: str, cache: Path) -> list[Path]:
    """Pictures of a flight; rendered ones are made once."""
    if name in FLIGHTS:
        return sorted(DATA.glob(FLIGHTS[name]))
    number = RENDERED.index(name)
    folder = cache / f"rendered-{number}"
    if not folder.exists():
        with tempfile.TemporaryDirectory(dir=cache) as scratch:
            flight(number).render(texture(number, SIDE), Path(scratch), number)
            # Of two workers that come at the same time one moves first.
            with suppress(OSError):
                Path(scratch).rename(folder)
            Path(scratch).mkdir(exist_ok=True)
    return sorted(folder.iterdir())


def subset(name: str, seed: int, number: int) -> dict[str, Any]:
    """Orient one random subset of a flight, pictures from elsewhere among it."""
    rng = np.random.default_rng([seed, number])
    cache = Path(os.environ[KEPT])
    paths = pictures(name, cache)
    elsewhere = [path for own in ELSEWHERE if (path := DATA / own).exists()]
    size = int(rng.integers(FEWEST, min(MOST, len(paths)) + 1))
    foreign = min(int(rng.binomial(size, 1 / ONE_IN)), len(elsewhere))
    chosen = sorted(rng.choice(len(paths), size, replace=False).tolist())
    strangers = [elsewhere[j] for j in rng.choice(len(elsewhere), foreign, replace=False)]
    return asdict(oriented(name, [paths[j] for j in chosen], strangers, rng, cache))


def page(found: Sequence[Outcome]) -> str:
    """Write the outcomes as a table."""
    due = [one for one in found if one.connected >= BLOCK]
    lines = [
        "# Random subsets of flights",
        "",
        "Made by `python -m tests.evidence.subsets`, in portions as `tests.evidence.portions` says.",
        "",
        f"{len(found)} subsets; {len(due)} of them have a connected block of at least {BLOCK} pictures.",
        f"Refused of these: {sum(bool(one.refused) for one in due)}. Subsets in which a picture was left",
        f"out without being named: {sum(not one.named and not one.refused for one in found)}. Pictures",
        f"from elsewhere that were oriented: {sum(one.strangers for one in found)}.",
        "",
        "| flight | subsets | with a block | refused | connected | oriented | rms (px) | c over its start |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(one.flight for one in found):
        mine = [one for one in due if one.flight == name]
        kept = [one for one in mine if not one.refused]
        if not kept:
            continue
        ratio = [one.c / one.c_start for one in kept]
        lines.append(
            f"| {name} | {sum(one.flight == name for one in found)} | {len(mine)} "
            f"| {sum(bool(one.refused) for one in mine)} | {sum(one.connected for one in mine)} "
            f"| {sum(one.oriented for one in kept)} | {np.median([one.rms_px for one in kept]):.2f} "
            f"| {min(ratio):.2f} to {max(ratio):.2f} |"
        )
    refused = [one for one in due if one.refused]
    lines += ["", *(f"- {one.flight}, {one.pictures} pictures: {one.refused}" for one in refused)]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    """Run the study."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(os.environ.setdefault(KEPT, folder))
        cache.mkdir(parents=True, exist_ok=True)
        names = [name for name in FLIGHTS if len(pictures(name, cache)) >= FEWEST] + list(RENDERED)
        cases = ((names[k % len(names)], SEED, k) for k in count())
        found = [Outcome(**one) for one in outcomes(cases, 500, subset).values()]
    OUTPUT.write_text(page(found), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
