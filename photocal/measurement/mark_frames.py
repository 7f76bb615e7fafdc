"""Marks made in pictures of another size, or turned as viewers turn them: which of these they are.

People mark in what their program shows: a reduced copy, or the picture turned by its EXIF orientation. Marks
of one point in two pictures tell which, for features of both pictures say where the one lies in the other.

Marks of control as they will be used: brought to the stored pictures, the others named.
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, groupby, islice, zip_longest
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.exchange.parts import Mark
from photocal.exchange.source import MAX_SIDE_PX
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue
from photocal.measurement.features import Features, FeatureSettings
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.match_images import MatchingPlan, features_of, matches_of

# Sizes that people reduce pictures to, of the stored ones, beside what EXIF says was the full one.
FACTORS = (1.0, 0.5, 0.25, 2.0, 4.0)
FRACTION = "fraction"
TURNS = ("stored", "exif", "90", "180", "270")
# Rows counted from the lower edge, and row before column: turns by 180 and 270 degrees, mirrored. Along a
# strip both may fit what a turn explains, too: they are tried where nothing else fits.
_AXES = {"bottom": (180, True), "swapped": (270, True)}
# Pairs of pictures that are compared, on reduced copies; the nearest matches carry a mark over.
MOST_PAIRS, LONGEST_PX, NEAREST, FEWEST = 6, 1200, 12, 20
# Marks carried over miss by such a share of the picture's diagonal where they show one place, and by so many
# times as much where they do not.
FITS, CLEARLY = 0.02, 3.0
# EXIF orientations by how far viewers turn the picture clockwise, once those that mirror it have mirrored it.
_TURNED = {3: 180, 4: 180, 5: 270, 6: 90, 7: 90, 8: 270}
_MIRRORED = (2, 4, 5, 7)
Facts = Mapping[str, ImageFacts]


@dataclass(frozen=True)
class MarkFrame:
    """How marks were made.

    factor: size of the pictures that they were made in, over the stored ones.
    turn: "stored", "exif" for as viewers show them, degrees clockwise, "bottom" for rows counted from below,
        or "swapped" for row before column.
    fraction: whether they are fractions of the width and the height, from the upper left corner.
    """

    factor: float = 1.0
    turn: str = "stored"
    fraction: bool = False

    def __str__(self) -> str:
        """Write it as an option takes it."""
        if self.fraction:
            return FRACTION
        share = Fraction(self.factor).limit_denominator(1000)
        parts = [] if self.factor == 1.0 else [str(share)]
        parts += [] if self.turn == "stored" else [self.turn]
        return " ".join(parts) or "1"

    def said(self, say: Catalogue) -> str:
        """Say it in words."""
        if self.fraction:
            return say("new.frame_fraction")
        share = Fraction(self.factor).limit_denominator(1000)
        size = "" if self.factor == 1.0 else say("new.frame_size", share=share)
        turned = {"stored": ""} | {name: say(f"new.frame_{name}") for name in ("exif", *_AXES)}
        turn = turned.get(self.turn, say("new.frame_turn", turn=self.turn))
        both = say("new.frame_both", size=size, turn=turn) if size and turn else size or turn
        return both or say("new.frame_stored")

    def stored(self, marks: Sequence[Mark], facts: Facts) -> tuple[Mark, ...]:
        """Give marks in the stored grid of pictures that are there."""
        return tuple(self._stored(mark, facts[mark.image]) for mark in marks if mark.image in facts)

    def _stored(self, mark: Mark, picture: ImageFacts) -> Mark:
        width, height = picture.size_px
        if self.fraction:
            return replace(mark, x=mark.x * width - 0.5, y=mark.y * height - 0.5)
        # From the edge, in stored pixels; the centre of the first one is half a pixel from it.
        x, y = (mark.x + 0.5) / self.factor, (mark.y + 0.5) / self.factor
        turn, mirrored = self._turn_of(picture)
        x, y = {0: (x, y), 90: (y, height - x), 180: (width - x, height - y), 270: (width - y, x)}[turn]
        x = width - x if mirrored else x
        return replace(mark, x=x - 0.5, y=y - 0.5)

    def _turn_of(self, picture: ImageFacts) -> tuple[int, bool]:
        if self.turn == "exif":
            return _TURNED.get(picture.orientation, 0), picture.orientation in _MIRRORED
        return _AXES.get(self.turn) or (0 if self.turn == "stored" else int(self.turn), False)


AS_STORED, OF_SIZE = MarkFrame(), MarkFrame(fraction=True)


@dataclass(frozen=True)
class FrameFit:
    """How marks fit a frame.

    outside: marks that lie outside of their pictures.
    miss: median of what marks miss by that were carried over to another picture, share of the diagonal; NaN
        where none could be.
    """

    frame: MarkFrame
    outside: int
    miss: float = math.nan


@dataclass(frozen=True)
class FrameChoice:
    """Which frame marks were made in.

    chosen: what they are taken for.
    sure: whether that leaves no doubt.
    fits: of the frames that were tried, the best first, that of the stored grid among them.
    pairs: marks that were carried over.
    fractions: whether all marks lie between 0 and 1, so that they are none of the stored grid.
    """

    chosen: MarkFrame
    sure: bool
    fits: tuple[FrameFit, ...]
    pairs: int
    fractions: bool = False

    def fit_of(self, frame: MarkFrame) -> FrameFit:
        """Give how marks fit one of the frames."""
        return next(fit for fit in self.fits if fit.frame == frame)

    def offers(self, marks: Sequence[Mark], facts: Facts) -> tuple[dict[str, Any], ...]:
        """Give the likeliest frames, and that of the stored grid, as JSON values.

        Each has the places of some marks of one point in the stored pictures, if inside. Frames that are the
        same for these pictures are one.
        """
        most_frames, most_marks = 5, 3
        most = Counter(mark.point for mark in marks).most_common(1)
        shown = [mark for mark in marks if most and mark.point == most[0][0]][:most_marks]
        fits = list[FrameFit]()
        for fit in self.fits:
            if not any(_alike(fit.frame, other.frame, marks, facts) for other in fits):
                fits.append(fit)
        listed = [fit for k, fit in enumerate(fits) if k < most_frames or fit.frame == AS_STORED]
        return tuple(
            {
                "frame": str(fit.frame),
                "chosen": fit.frame == self.chosen,
                "outside": fit.outside,
                "miss": None if math.isnan(fit.miss) else fit.miss,
                "marks": [
                    {"image": mark.image, "point": mark.point, "x": mark.x, "y": mark.y}
                    for mark in fit.frame.stored(shown, facts)
                    if inside(mark, facts[mark.image].size_px)
                ],
            }
            for fit in listed
        )


def parse_frame(text: str) -> MarkFrame:
    """Read an option: a factor ("1/2", "0.25"), a turn ("exif", "90", "bottom"), or both; "1" is as stored.

    "fraction" is for marks between 0 and 1.
    """
    if text.strip().lower() == FRACTION:
        return OF_SIZE
    factor, turn = 1.0, "stored"
    for word in text.lower().replace(",", " ").split():
        if word in TURNS or word in _AXES:
            turn = word
        elif re.fullmatch(r"\d+(\.\d+)?(/\d+)?|\.\d+", word) and 0.01 <= (value := _share(word)) <= 100:
            factor = value
        else:
            raise ConfigurationError(
                f"marks made in {text!r} are not understood",
                "give the size of the pictures that they were made in over that of the stored ones (1/2), a "
                f"turn (exif, 90, 180, 270, bottom, swapped), or both; or {FRACTION}",
                where="--marks",
            )
    return MarkFrame(factor, turn)


def _share(word: str) -> float:
    above, _, below = word.partition("/")
    return float(above) / float(below) if below and float(below) else float(above)


def choose_frame(marks: Sequence[Mark], facts: Facts, folder: Mapping[str, Path]) -> FrameChoice:
    """Find the frame of marks: where they fall inside, and where those of one point show one place.

    folder: where the pictures lie, by name.
    """
    # What lies farther out than any picture reaches is a slip of its own.
    marks = [m for m in marks if m.image in facts and max(abs(m.x), abs(m.y)) <= MAX_SIDE_PX]
    if not marks:
        return FrameChoice(AS_STORED, True, (FrameFit(AS_STORED, 0),), 0)
    if are_fractions(np.array([(mark.x, mark.y) for mark in marks])):
        return _as_fractions(marks, facts, folder)
    frames = _frames(marks, facts)
    inside = [FrameFit(frame, _outside(frame.stored(marks, facts), facts)) for frame in frames]
    as_stored = inside[0]
    # A smaller share of marks outside of their pictures are slips of their own.
    slips = 0.2
    if as_stored.outside <= slips * len(marks):
        inside = [replace(fit, outside=max(0, fit.outside - as_stored.outside)) for fit in inside]
        as_stored = inside[0]
    possible = [fit for fit in inside if not fit.outside or fit is as_stored]
    carried = _carried(marks, folder)
    if not carried:
        others = tuple(fit for fit in possible if not fit.outside and fit is not as_stored)
        told = [fit for fit in others if fit.frame in _told(marks, facts)]
        if as_stored.outside and len(told) == 1:
            return FrameChoice(told[0].frame, True, (*told, as_stored), 0)
        return FrameChoice(AS_STORED, not as_stored.outside, (as_stored, *others), 0)
    judged = [replace(fit, miss=_miss(fit.frame, carried, facts)) for fit in possible]
    if min(fit.miss for fit in judged) > FITS:
        axes = [MarkFrame(frame.factor, turn) for turn in _AXES for frame in frames if frame.turn == "stored"]
        judged += [
            FrameFit(frame, 0, _miss(frame, carried, facts))
            for frame in axes
            if not _outside(frame.stored(marks, facts), facts)
        ]
    judged.sort(key=lambda fit: fit.miss)
    best = judged[0]
    own = next(fit for fit in judged if fit.frame == AS_STORED)
    if own.miss <= FITS and not own.outside:
        return FrameChoice(AS_STORED, True, tuple(judged), len(carried))
    rivals = [fit for fit in judged[1:] if not _alike(best.frame, fit.frame, marks, facts)]
    sure = best.miss <= FITS and all(fit.miss > CLEARLY * best.miss for fit in rivals) and not best.outside
    return FrameChoice(best.frame if sure else AS_STORED, sure, tuple(judged), len(carried))


def _as_fractions(marks: Sequence[Mark], facts: Facts, folder: Mapping[str, Path]) -> FrameChoice:
    """Take marks between 0 and 1 for fractions, unless marks of one point then show different places."""
    carried = _carried(OF_SIZE.stored(marks, facts), folder)
    miss = _miss(AS_STORED, carried, facts) if carried else math.nan
    own = FrameFit(AS_STORED, len(marks))
    if miss > FITS:
        return FrameChoice(AS_STORED, False, (own,), len(carried), fractions=True)
    return FrameChoice(OF_SIZE, True, (FrameFit(OF_SIZE, 0, miss), own), len(carried), fractions=True)


def are_fractions(places: Floats) -> bool:
    """Whether places in pictures, (n, 2), lie between 0 and 1: nobody marks nothing but the first pixel."""
    inside = (places >= 0.0).all() and (places <= 1.0).all()
    return bool(len(places) and inside and (places % 1.0 != 0.0).any())


def _frames(marks: Sequence[Mark], facts: Facts) -> list[MarkFrame]:
    """What may be tried: that of the stored grid first."""
    factors = dict.fromkeys([1.0, *_full(marks, facts), *FACTORS])
    turned = any(facts[mark.image].orientation != 1 for mark in marks)
    turns = [turn for turn in TURNS if turn != "exif" or turned]
    return [MarkFrame(factor, turn) for turn in turns for factor in factors]


def _full(marks: Sequence[Mark], facts: Facts) -> dict[float, None]:
    """Sizes that EXIF says the pictures had, over those that they have."""
    pictures = [facts[mark.image] for mark in marks]
    return dict.fromkeys(
        round(max(picture.full_size_px) / max(picture.size_px), 4)
        for picture in pictures
        if max(picture.full_size_px) > max(picture.size_px)
    )


def _told(marks: Sequence[Mark], facts: Facts) -> list[MarkFrame]:
    """The frame that pictures tell themselves, where no viewer turns them."""
    if any(facts[mark.image].orientation != 1 for mark in marks):
        return []
    return [MarkFrame(factor) for factor in _full(marks, facts)]


def _outside(marks: Sequence[Mark], facts: Facts) -> int:
    return sum(not inside(mark, facts[mark.image].size_px) for mark in marks)


def inside(mark: Mark, size_px: tuple[int, int]) -> bool:
    """Whether a mark lies in its picture."""
    return -0.5 <= mark.x <= size_px[0] - 0.5 and -0.5 <= mark.y <= size_px[1] - 0.5


def _alike(one: MarkFrame, other: MarkFrame, marks: Sequence[Mark], facts: Facts) -> bool:
    """Whether two frames are the same for these pictures."""
    pairs = zip(one.stored(marks, facts), other.stored(marks, facts), strict=True)
    return all(math.hypot(a.x - b.x, a.y - b.y) < 1.0 for a, b in pairs)


# Two marks of a point, and places that both pictures show, (n, 2) each.
_Carried = tuple[Mark, Mark, Floats, Floats]


def _carried(marks: Sequence[Mark], folder: Mapping[str, Path]) -> list[_Carried]:
    """Marks that features carry over from one picture to another."""
    by_point = attrgetter("point")
    of_point = [list(some) for _, some in groupby(sorted(marks, key=by_point), key=by_point)]
    some_pairs = [list(islice(combinations(some, 2), MOST_PAIRS)) for some in of_point]
    # Pairs of different points first.
    pairs = [pair for turn in zip_longest(*some_pairs) for pair in turn if pair is not None]
    seen: dict[str, tuple[str, Features] | None] = {}
    reduced = MatchingPlan(features=FeatureSettings(longest_px=LONGEST_PX, most=2000))
    carried: list[_Carried] = []
    for first, second in pairs[: 2 * MOST_PAIRS]:
        one, other = (_features(mark.image, folder, seen, reduced) for mark in (first, second))
        if one is None or other is None or first.image == second.image:
            continue
        rows = matches_of(one, other, reduced)
        if len(rows) >= FEWEST:
            here, there = one[1].pixels[rows[:, 0]], other[1].pixels[rows[:, 1]]
            carried.append((first, second, here.astype(np.float64), there.astype(np.float64)))
        if len(carried) == MOST_PAIRS:
            break
    return carried


def _features(
    name: str, folder: Mapping[str, Path], seen: dict[str, tuple[str, Features] | None], reduced: MatchingPlan
) -> tuple[str, Features] | None:
    """Features of a reduced picture with their key, in pixels of the stored grid."""
    if name not in seen:
        try:
            seen[name] = features_of(folder[name], reduced)
        except (PhotocalError, KeyError, OSError):
            seen[name] = None
    return seen[name]


def _miss(frame: MarkFrame, carried: Sequence[_Carried], facts: Facts) -> float:
    """By how much marks of one point miss each other, share of the diagonal."""
    misses = []
    for one, other, here, there in carried:
        first, second = frame.stored([one, other], facts)
        place = np.array([first.x, first.y])
        near = np.argsort(np.linalg.norm(here - place, axis=1))[:NEAREST]
        # The ground near a mark is level enough for an affine transformation.
        design = np.column_stack([here[near] - place, np.ones(len(near))])
        found = np.linalg.lstsq(design, there[near], rcond=None)[0][2]
        diagonal = math.hypot(*facts[second.image].size_px)
        misses.append(math.hypot(*(found - [second.x, second.y])) / diagonal)
    return float(np.median(misses))


def settle_marks(
    marks: Sequence[Mark], points: Collection[str], facts: Sequence[ImageFacts], folder: Mapping[str, Path]
) -> tuple[list[Mark], MarkFrame, list[tuple[Mark, Finding]], list[Finding]]:
    """Settle marks before any work.

    points: names of those that are known.
    folder: where the pictures lie, by name.
    returns: marks of known points in pictures that are there, px of the stored grid; the frame of the
        pictures that they were made in; marks that cannot be used, each with the finding that says why; and
        what else was found.
    """
    pictures, names = {image.name: image for image in facts}, frozenset(points)
    left_out = [(mark, cause) for mark in marks if (cause := _unknown(mark, names, pictures)) is not None]
    lost = {id(mark) for mark, _ in left_out}
    here = [mark for mark in marks if id(mark) not in lost]
    frame, findings, usable = AS_STORED, list[Finding](), True
    if here:
        choice = choose_frame(here, pictures, folder)
        usable = choice.sure or not choice.fractions
        if choice.sure and choice.chosen != AS_STORED:
            frame = choice.chosen
            findings.append(_reframed(choice))
    kept = list[Mark]()
    for given, mark in zip(here, frame.stored(here, pictures), strict=True):
        if usable and inside(mark, pictures[mark.image].size_px):
            kept.append(mark)
            continue
        figures = {"image": mark.image, "x": mark.x, "y": mark.y}
        left_out.append((given, Finding("mark-outside", "doubtful", mark.point, figures)))
    return kept, frame, left_out, findings


def _unknown(mark: Mark, points: Collection[str], pictures: Collection[str]) -> Finding | None:
    """What a mark names that is not there; None for a mark that can be used."""
    subject = f"{mark.point} ({mark.image})"
    if mark.point not in points:
        return Finding("unknown-mark", "doubtful", subject, cause="no-such-point")
    if mark.image not in pictures:
        return Finding("unknown-mark", "doubtful", subject, cause="no-such-picture")
    return None


def _reframed(choice: FrameChoice) -> Finding:
    own, best = choice.fit_of(AS_STORED), choice.fits[0]
    figures = {"frame": str(choice.chosen), "n": float(choice.pairs), "outside": float(own.outside)}
    if np.isnan(best.miss) or choice.fractions:
        return Finding("marks-reframed", "doubtful", figures=figures, clauses=("all-fall-inside",))
    figures |= {"percent": 100.0 * best.miss, "percent_as_stored": 100.0 * own.miss}
    return Finding("marks-reframed", "doubtful", figures=figures, clauses=("pairs-meet",))
