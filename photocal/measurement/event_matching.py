"""Which image belongs to which event: alignment on the differences of time, never on the order alone.

Where times leave several alignments open, as shots at equal intervals do, positions of the images decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.base.arrays import Flags, Floats, Integers, nearest
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy
from photocal.measurement.image_metadata import ImageMetadata, clock_time_s, stated_places
from photocal.measurement.listed_positions import PICTURE_SIGMA_M, SIGMAS, in_plane

_LEAST_PAIRS = 4
_SIGMAS = 4.0
# Quartz clocks of cameras gain or lose less.
_LARGEST_DRIFT = 100e-6
# What an alignment leaves over costs so much a row of successive ones, as one cause loses them, and so much
# each: about the logarithm of how rarely that happens.
_ROW, _EACH = 3.0, 1.0
# An alignment is the only one where every other one costs so much more, and so many times as much, or pairs
# less than this share of its images.
_MARGIN, _TIMES, _SHARE = 10.0, 1 / 0.6, 0.6


class UnrelatedImagesError(IllPosedError):
    """Nothing shows that images are of the flight: few, of other times, or most of them beside all events."""


@dataclass(frozen=True)
class Matching:
    """Images of a camera and events that belong together.

    camera, names: of the camera and of its images, where they are known by more than their times.
    image, event (n,): indices of the pairs, in the order of time.
    unmatched_images, unmatched_events: indices of the rest.
    ambiguous_images: of the unmatched images those with several possible events.
    offset_s, drift: event time = image time + offset + drift * (image time - first image time).
    scatter_s: robust standard deviation of the residuals.
    residual_s (n,): event less predicted time of each pair.
    rival: how many images the best other alignment pairs.
    """

    image: Integers
    event: Integers
    unmatched_images: Integers
    unmatched_events: Integers
    ambiguous_images: Integers
    offset_s: float
    drift: float
    offset_sigma_s: float
    drift_sigma: float
    scatter_s: float
    residual_s: Floats
    rival: int = 0
    camera: str = ""
    names: tuple[str, ...] = ()


def no_matching(images: int) -> Matching:
    """Images of a camera that belong to no events: it misses none."""
    none, unknown = np.zeros(0, dtype=np.int64), (np.nan,) * 5
    return Matching(none, none, np.arange(images), none, none, *unknown, np.zeros(0))


@dataclass(frozen=True)
class Places:
    """Where images and events say that they are.

    images, events (n, 3): latitude, longitude (deg), height (m); NaN where not known.
    late_s: from when to when a position of an image may have been measured before the exposure.
    """

    images: Floats
    events: Floats
    late_s: tuple[float, float]


def match(
    image_s: Floats,
    event_s: Floats,
    *,
    resolution_s: float,
    largest_offset_s: float = 60.0,
    places: Places | None = None,
) -> Matching:
    """Match the times of images to those of events by another clock.

    image_s, event_s (n,): times in seconds since any origin that both share up to the offset; any order.
    largest_offset_s: bound of the offset between the clocks.
    places: decide between alignments that the times leave open.
    returns: pairs that are each other's only candidates; everything else is listed as unmatched.
    raises UnrelatedImagesError: when there are too few common moments.
    raises IllPosedError: when a second offset explains nearly as much (shots at equal intervals): the pairs
        would be guessed.
    """
    images, events = np.argsort(image_s, kind="stable"), np.argsort(event_s, kind="stable")
    x, y = np.asarray(image_s, float)[images], np.asarray(event_s, float)[events]
    if min(len(x), len(y)) < _LEAST_PAIRS:
        raise UnrelatedImagesError(
            f"{len(x)} images and {len(y)} events: at least {_LEAST_PAIRS} of each are needed to align them",
            "give events and images of the same flight",
        )
    if places is not None:
        places = replace(places, images=places.images[images], events=places.events[events])
    reach = _reach(x, y, resolution_s)
    offset, rival = _best_offset(x, y, reach, largest_offset_s, places)
    reach += _LARGEST_DRIFT * float(x[-1] - x[0]) / 2
    a, b, scatter, sigmas = _refine(x, y, offset, reach)
    # Of whole seconds nothing scatters beyond their half but what the clock itself does.
    rounded = policy.mad_to_sigma * resolution_s / 4
    beyond = resolution_s / 2 + _SIGMAS * float(np.sqrt(max(scatter**2 - rounded**2, (rounded / 8) ** 2)))
    reach = max(min(_SIGMAS * scatter, beyond, reach), 1e-4)
    predicted = x + a + b * (x - x[0])
    of_image, image_rivals = _partners(predicted, y, reach)
    of_event, event_rivals = _partners(y, predicted, reach)
    rows = np.arange(len(x))
    mutual = (of_image >= 0) & ~image_rivals
    mutual &= np.where(of_image >= 0, (of_event[of_image] == rows) & ~event_rivals[of_image], False)
    # What nobody else can be meant by may scatter so much more.
    late = 12.0
    _add_late(predicted, y, of_image, mutual, min(late * scatter, float(np.median(np.diff(y))) / 2))
    left, right = rows[mutual], of_image[mutual]
    taken = np.zeros(len(y), bool)
    taken[right] = True
    ambiguous = (of_image >= 0) & ~mutual
    return Matching(
        images[left],
        events[right],
        images[~mutual],
        events[~taken],
        images[ambiguous],
        a,
        b,
        *sigmas,
        scatter,
        y[right] - predicted[left],
        rival,
    )


def _add_late(predicted: Floats, y: Floats, of_image: Integers, mutual: Flags, reach: float) -> None:
    """Pair, in place, images and events that are left over and have nobody else within a wider reach."""
    # Cameras stamp a picture late now and then, by far more than they usually scatter; never early.
    half = reach / 2
    free = np.setdiff1d(np.arange(len(y)), of_image[of_image >= 0])
    lone = np.flatnonzero(of_image < 0)
    to_event, event_rivals = _partners(predicted[lone] - half, y, half)
    to_image, image_rivals = _partners(y[free] + half, predicted, half)
    of_event = np.full(len(y), -1)
    of_event[free[~image_rivals]] = to_image[~image_rivals]
    paired = (to_event >= 0) & ~event_rivals
    paired &= of_event[to_event] == lone
    # A row of them is one loss: no strays of their own.
    strays = _rows(free) * _rows(lone)
    by_chance = reach * strays / float(np.ptp(y))
    # So many such pairs have to be less probable than this where the strays fall at random.
    chance = 5e-4
    if special.pdtrc(int(paired.sum()) - 1, by_chance) < chance:
        of_image[lone[paired]], mutual[lone[paired]] = to_event[paired], True


def _rows(numbers: Integers) -> int:
    """Count the rows of successive numbers."""
    return 0 if not len(numbers) else 1 + int((np.diff(numbers) > 1).sum())


def _reach(x: Floats, y: Floats, resolution: float) -> float:
    """How far an image may lie from its event at the right offset: rounded, and by clocks that scatter."""
    # Clocks that tell hundredths do not keep them, and whole seconds have room enough.
    scatter_s = 0.25
    drift = _LARGEST_DRIFT * float(x[-1] - x[0]) / 2
    # No image is near two events at once.
    least = 0.45 * float(np.median(np.diff(y)))
    return min(resolution / 2 + min(1.5 * resolution, scatter_s), least) + drift


def _candidates(x: Floats, y: Floats, reach: float, largest: float) -> Floats:
    """Offsets that bring most images near an event, one for each reach."""
    # So many are looked into, of so many within the reach.
    most, steps = 200, 4
    difference = (y[None, :] - x[:, None]).ravel()
    found = np.sort(difference[np.abs(difference) <= largest + reach])
    if not len(found):
        return found
    cell = np.round(found * (steps / reach))
    cell = cell[np.diff(cell, prepend=-np.inf) > 0]
    # Between the ends of whole seconds, near which all may lie, there may be none.
    cell = np.unique(cell[:, None] + np.arange(-steps, steps + 1))
    offsets = cell * (reach / steps)
    # How many differences lie within the reach of each; of equal ones the nearest to the mean of these.
    low = np.searchsorted(found, offsets - reach)
    high = np.searchsorted(found, offsets + reach, side="right")
    votes = (high - low).astype(float)
    total = np.concatenate([[0.0], np.cumsum(found - found[0])])
    mean = found[0] + (total[high] - total[low]) / np.maximum(votes, 1.0)
    votes -= np.abs(offsets - mean) / (2 * reach)
    begins = np.flatnonzero(np.diff(np.floor(cell / steps), prepend=-np.inf) > 0)
    top = np.argsort(-np.maximum.reduceat(votes, begins), kind="stable")[:most]
    ends = np.append(begins[1:], len(cell))
    slices = zip(begins[top].tolist(), ends[top].tolist(), strict=True)
    return np.array([offsets[begin + int(np.argmax(votes[begin:end]))] for begin, end in slices])


def _best_offset(
    x: Floats, y: Floats, reach: float, largest: float, places: Places | None
) -> tuple[float, int]:
    """Return the offset that leaves least over, and what the best other one pairs; refuse where both do."""
    offsets = _candidates(x, y, reach, largest)
    if not len(offsets):
        raise _far_apart(x, y, reach, largest)
    partner = _paired(x, y, offsets, reach)
    pairs, cost = (partner >= 0).sum(axis=1), _cost(partner, len(y))
    best = int(np.argmin(cost))
    other = _others(partner, best)
    near = (cost < np.maximum(cost[best] + _MARGIN, _TIMES * cost[best])) & (pairs > _SHARE * pairs[best])
    ambiguous = (other & near).any()
    if ambiguous and places is not None and 2 * pairs[best] > min(len(x), len(y)):
        late = np.array([_lateness(row, y, places) if near[k] else np.inf for k, row in enumerate(partner)])
        least, most = places.late_s
        fits = (late >= least) & (late <= most)
        if fits.any():
            best = int(np.argmin(np.where(fits, cost, np.inf)))
            other, margin = _others(partner, best), (most - least) / 4
            ambiguous = (other & (late >= least - margin) & (late <= most + margin)).any()
    second = int(np.argmin(np.where(other, cost, np.inf))) if other.any() else -1
    rival = int(pairs[second]) if second >= 0 else 0
    if pairs[best] < _LEAST_PAIRS or ambiguous:
        offset, further = offsets[best], offsets[second]
        what = (
            f"the match is ambiguous: an offset of {offset:+.3f} s pairs {pairs[best]} of {len(x)} images, "
            f"one of {further:+.3f} s pairs {rival}"
        )
        remedy = "narrow the offset of the clocks, or use a camera that stamps fractions of a second"
        if 2 * pairs[best] > len(x):
            raise IllPosedError(what, remedy)
        raise UnrelatedImagesError(what, remedy)
    return float(offsets[best]), rival


def _others(partner: Integers, best: int) -> Flags:
    """Which alignments pair most images otherwise than the best one."""
    same = ((partner == partner[best]) & (partner[best] >= 0)).sum(axis=1)
    return np.asarray(2 * same < (partner[best] >= 0).sum())


def _paired(x: Floats, y: Floats, offsets: Floats, reach: float) -> Integers:
    """Events that images come onto with each of some offsets, each once (offsets, images); -1: none."""
    partner, _ = _partners((x[None, :] + offsets[:, None]).ravel(), y, reach)
    partner = partner.reshape(len(offsets), len(x))
    again = (partner[:, 1:] == partner[:, :-1]) & (partner[:, 1:] >= 0)
    partner[:, 1:][again] = -1
    return partner


def _cost(partner: Integers, events: int) -> Floats:
    """What alignments leave over of images and events, by rows of successive ones and by each."""
    taken = np.zeros((len(partner), events), dtype=np.bool_)
    of, image = np.nonzero(partner >= 0)
    taken[of, partner[of, image]] = True
    cost = np.zeros(len(partner))
    for left in (partner < 0, ~taken):
        begins = left[:, 1:] & ~left[:, :-1]
        cost += _ROW * (begins.sum(axis=1) + left[:, 0]) + _EACH * left.sum(axis=1)
    return cost


def _lateness(partner: Integers, y: Floats, places: Places) -> float:
    """By how much positions of images are late if each belongs to its partner, s; infinite if none fits."""
    known = (partner >= 0) & np.isfinite(places.images[:, :2]).all(axis=1)
    known[known] = np.isfinite(places.events[partner[known]]).all(axis=1)
    if known.sum() < _LEAST_PAIRS:
        return np.inf
    event = partner[known]
    ours, theirs = in_plane(places.events[event], places.images[known])
    velocity = np.gradient(ours, y[event] + 1e-6 * np.arange(len(event)), axis=0)
    square = np.sum(velocity**2, axis=1)
    # What hovers is nowhere late.
    moves = square > 1.0
    if moves.sum() < _LEAST_PAIRS:
        return np.inf
    apart, velocity, square = (ours - theirs)[moves], velocity[moves], square[moves]
    late = float(np.median(np.sum(apart * velocity, axis=1) / square))
    left = float(np.median(np.linalg.norm(apart - late * velocity, axis=1)))
    return late if left < SIGMAS * PICTURE_SIGMA_M else np.inf


def _far_apart(x: Floats, y: Floats, reach: float, largest: float) -> IllPosedError:
    """Tell a clock that is far off from images of another flight: only the one fits with some offset."""
    cause = f"no event lies within {largest:g} s of an image"
    try:
        offset, _ = _best_offset(x, y, reach, np.inf, None)
        hits = int((_paired(x, y, np.array([offset]), reach) >= 0).sum())
    except IllPosedError:
        hits = 0
    if 2 * hits > len(x):
        return IllPosedError(
            f"{cause}, but {hits} of {len(x)} images fit if their clock is {-offset:+.0f} s off",
            f"if it was, give --clock-offset {abs(offset) + 1:.0f}, or clock_offset_s under [flight]",
        )
    return UnrelatedImagesError(
        f"{cause}, and no other clock offset makes them fit: images of another flight",
        "take the images of this flight, or its log",
    )


def _partners(from_s: Floats, to_s: Floats, reach: float) -> tuple[Integers, Flags]:
    """Return the nearest partner within reach (-1: none) and whether there is more than one."""
    low = np.searchsorted(to_s, from_s - reach)
    high = np.searchsorted(to_s, from_s + reach, side="right")
    return np.where(high > low, nearest(to_s, from_s), -1), high - low > 1


def _refine(
    x: Floats, y: Floats, offset: float, reach: float
) -> tuple[float, float, float, tuple[float, float]]:
    """Return offset, drift, scatter and the sigmas of both, by narrowing the reach step by step."""
    a, b = offset, 0.0
    scatter = reach
    covariance: Floats = np.zeros((2, 2))
    for _ in range(12):
        partner, rivals = _partners(x + a + b * (x - x[0]), y, reach)
        used = (partner >= 0) & ~rivals
        if used.sum() < _LEAST_PAIRS:
            break
        t, d = x[used] - x[0], y[partner[used]] - x[used]
        design = np.stack([np.ones_like(t), t], axis=1)
        weight = np.ones(len(t))
        for _ in range(10):
            # Where images and events are few, no drift is taken from them that no clock has.
            known = np.array([0.0, scatter / _LARGEST_DRIFT])
            root = np.sqrt(weight)
            (a, b), *_ = np.linalg.lstsq(
                np.vstack([design * root[:, None], known]), np.append(d * root, 0.0), rcond=None
            )
            residual = d - a - b * t
            scatter = max(policy.mad_to_sigma * float(np.median(np.abs(residual))), 1e-6)
            weight = np.minimum(1.0, 1.5 * scatter / np.maximum(np.abs(residual), 1e-12))
        prior = np.diag([0.0, (scatter / _LARGEST_DRIFT) ** 2])
        covariance = np.asarray(scatter**2 * np.linalg.pinv(design.T @ (design * weight[:, None]) + prior))
        narrower = max(_SIGMAS * scatter, 1e-4)
        if narrower >= 0.9 * reach:
            break
        reach = narrower
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return float(a), float(b), scatter, (float(sigmas[0]), float(sigmas[1]))


def match_images(
    images: Sequence[ImageMetadata], utc_s: Floats, places: Floats, largest_offset_s: float
) -> tuple[list[tuple[str, ...]], list[Matching]]:
    """Match images to events, camera by camera.

    utc_s (n,): times of the events, s since 1970; places (n, 3): where these were, as of `Places`.
    returns: names of the images of each event, and the matching of each camera.
    raises IllPosedError: when those of one may belong to several events; when those of none belong to any: a
        telephone's among them need not.
    """
    names: list[tuple[str, ...]] = [()] * len(utc_s)
    matches, refusals = list[Matching](), list[UnrelatedImagesError]()
    for camera in dict.fromkeys(image.camera for image in images):
        of_camera = [image for image in images if image.camera == camera]
        image_s = np.array([clock_time_s(image) for image in of_camera]) - utc_s[0]
        facts = [image.facts for image in of_camera]
        precise = sum(f is not None and f.position_sigma_m[0] > 0 for f in facts)
        # A receiver that states its sigma gives the position at the exposure, others a last one.
        late_s = (-0.25, 0.25) if 2 * precise > len(facts) else (-0.5, 1.0)
        try:
            matching = match(
                image_s,
                utc_s - utc_s[0],
                resolution_s=max(image.resolution_s for image in of_camera),
                largest_offset_s=largest_offset_s,
                places=Places(stated_places(facts), places, late_s),
            )
        except UnrelatedImagesError as refusal:
            refusals.append(refusal)
            matching = no_matching(len(of_camera))
        for i, e in zip(matching.image.tolist(), matching.event.tolist(), strict=True):
            names[e] = (*names[e], of_camera[i].name)
        matches.append(replace(matching, camera=camera, names=tuple(image.name for image in of_camera)))
    if len(refusals) == len(matches):
        raise refusals[0]
    return names, matches
