"""From events to exposures: where the camera was, how it was turned, and how sure that is.

Which image belongs to which event: alignment on the differences of time, never on the order alone.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Flags, Floats, Integers, nearest
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.policy import policy
from photocal.base.tables import TableColumns
from photocal.geometry.rotation import angles_from_matrix, left_jacobian, skew, turn_per_angle
from photocal.navigation.attitude import AttitudeSeries
from photocal.navigation.events import Events
from photocal.navigation.image_metadata import ImageMetadata, clock_time_s
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import LARGEST_GAP_S, InterpolatedPositions

_LEAST_PAIRS = 4
_SIGMAS = 4.0


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
    camera: str = ""
    names: tuple[str, ...] = ()


def no_matching(images: int) -> Matching:
    """Images of a camera that belong to no events: it misses none."""
    none, unknown = np.zeros(0, dtype=np.int64), (np.nan,) * 5
    return Matching(none, none, np.arange(images), none, none, *unknown, np.zeros(0))


def match(
    image_s: Floats,
    event_s: Floats,
    *,
    resolution_s: float,
    largest_offset_s: float = 60.0,
) -> Matching:
    """Match the times of images to those of events by another clock.

    image_s, event_s (n,): times in seconds since any origin that both share up to the offset; any order.
    largest_offset_s: bound of the offset between the clocks.
    returns: pairs that are each other's only candidates; everything else is listed as unmatched.
    raises UnrelatedImagesError: when there are too few common moments.
    raises IllPosedError: when a second offset explains nearly as many (shots at equal intervals): the pairs
        would be guessed.
    """
    # Quartz clocks of cameras gain or lose less.
    largest_drift = 100e-6
    images, events = np.argsort(image_s, kind="stable"), np.argsort(event_s, kind="stable")
    x, y = np.asarray(image_s, float)[images], np.asarray(event_s, float)[events]
    if min(len(x), len(y)) < _LEAST_PAIRS:
        raise UnrelatedImagesError(
            f"{len(x)} images and {len(y)} events: at least {_LEAST_PAIRS} of each are needed to align them",
            "give events and images of the same flight",
        )
    offset = _best_offset(x, y, resolution_s, largest_offset_s, largest_drift)
    a, b, scatter, sigmas = _refine(x, y, offset, resolution_s, largest_drift)
    reach = max(_SIGMAS * scatter, 1e-4)
    predicted = x + a + b * (x - x[0])
    of_image, image_rivals = _partners(predicted, y, reach)
    of_event, event_rivals = _partners(y, predicted, reach)
    rows = np.arange(len(x))
    mutual = (of_image >= 0) & ~image_rivals
    mutual &= np.where(of_image >= 0, (of_event[of_image] == rows) & ~event_rivals[of_image], False)
    # What nobody else can be meant by may scatter so much more.
    late = 12.0
    _add_late(predicted, y, of_image, mutual, late * scatter)
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


def _best_offset(x: Floats, y: Floats, resolution: float, largest: float, drift: float) -> float:
    """Return the offset that brings most images onto events; refuse when it is not the only one."""
    reach = 2 * resolution + drift * (x[-1] - x[0]) / 2
    middle = (x[-1] + x[0]) / 2
    difference = (y[None, :] - x[:, None]).ravel()
    candidates = np.sort(difference[np.abs(difference) <= largest + reach])
    if not len(candidates):
        raise _far_apart(x, y, resolution, largest, drift)
    # How many differences lie within the reach of each: the votes for it.
    votes = np.searchsorted(candidates, candidates + reach, side="right") - np.searchsorted(
        candidates, candidates - reach
    )
    best = candidates[int(np.argmax(votes))]
    best = float(np.median(candidates[np.abs(candidates - best) <= reach]))
    score = int(_hits(x, y, np.array([best]), reach)[0])
    apart = candidates[np.abs(candidates - best) > 3 * reach]
    top = apart[np.argsort(-votes[np.abs(candidates - best) > 3 * reach], kind="stable")[:200]]
    rival = int(_hits(x, y, top, reach).max(initial=0))
    certain = 0.6
    if score < _LEAST_PAIRS or rival > certain * score:
        raise (IllPosedError if 2 * score > len(x) else UnrelatedImagesError)(
            f"the match is ambiguous: an offset of {best:+.3f} s pairs {score} of {len(x)} images, "
            f"another one {rival} (middle of the flight at {middle:.0f} s)",
            "narrow the offset of the clocks, or use a camera that stamps fractions of a second",
        )
    return best


def _far_apart(x: Floats, y: Floats, resolution: float, largest: float, drift: float) -> IllPosedError:
    """Tell a clock that is far off from images of another flight: only the one fits with some offset."""
    cause = f"no event lies within {largest:g} s of an image"
    try:
        offset = _best_offset(x, y, resolution, np.inf, drift)
        hits = int(_hits(x, y, np.array([offset]), 2 * resolution + drift * (x[-1] - x[0]) / 2)[0])
    except IllPosedError:
        hits = 0
    if 2 * hits > len(x):
        return IllPosedError(
            f"{cause}, but {hits} of {len(x)} images fit if their clock is {-offset:+.0f} s off",
            f"if it was, write clock_offset_s = {abs(offset) + 1:.0f} under [flight], or correct their times",
        )
    return UnrelatedImagesError(
        f"{cause}, and no other clock offset makes them fit: images of another flight",
        "take the images of this flight, or its log",
    )


def _hits(x: Floats, y: Floats, offsets: Floats, reach: float) -> Integers:
    """Count the events that images come onto with each of some offsets."""
    partner, _ = _partners((x[None, :] + offsets[:, None]).ravel(), y, reach)
    pair = np.repeat(np.arange(len(offsets)), len(x)) * len(y) + partner
    return np.bincount(np.unique(pair[partner >= 0]) // len(y), minlength=len(offsets))


def _partners(from_s: Floats, to_s: Floats, reach: float) -> tuple[Integers, Flags]:
    """Return the nearest partner within reach (-1: none) and whether there is more than one."""
    low = np.searchsorted(to_s, from_s - reach)
    high = np.searchsorted(to_s, from_s + reach, side="right")
    return np.where(high > low, nearest(to_s, from_s), -1), high - low > 1


def _refine(
    x: Floats, y: Floats, offset: float, resolution: float, drift: float
) -> tuple[float, float, float, tuple[float, float]]:
    """Return offset, drift, scatter and the sigmas of both, by narrowing the reach step by step."""
    a, b = offset, 0.0
    span = x[-1] - x[0]
    reach = 2 * resolution + drift * span
    scatter = reach
    covariance = np.zeros((2, 2))
    for _ in range(12):
        partner, rivals = _partners(x + a + b * (x - x[0]), y, reach)
        used = (partner >= 0) & ~rivals
        if used.sum() < _LEAST_PAIRS:
            break
        t, d = x[used] - x[0], y[partner[used]] - x[used]
        design = np.stack([np.ones_like(t), t], axis=1)
        weight = np.ones(len(t))
        for _ in range(10):
            root = np.sqrt(weight)
            (a, b), *_ = np.linalg.lstsq(design * root[:, None], d * root, rcond=None)
            residual = d - a - b * t
            scatter = max(policy.mad_to_sigma * float(np.median(np.abs(residual))), 1e-6)
            weight = np.minimum(1.0, 1.5 * scatter / np.maximum(np.abs(residual), 1e-12))
        covariance = scatter**2 * np.linalg.pinv(design.T @ (design * weight[:, None]))
        narrower = max(_SIGMAS * scatter, 1e-4)
        if narrower >= 0.9 * reach:
            break
        reach = narrower
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return float(a), float(b), scatter, (float(sigmas[0]), float(sigmas[1]))


def names_cell(names: Sequence[str]) -> str:
    """Names of the images of one event as a cell: one as it is, several as a JSON list; empty for none."""
    plain = len(names) < 2 and not "".join(names).startswith("[")
    return "".join(names) if plain else json.dumps(names, ensure_ascii=False)


@dataclass(frozen=True, repr=False)
class Exposures(TableColumns):
    """Exposures of a flight, one row per event.

    Attributes
    ----------
    time
        GPS time of each.
    number
        Count of the device, shape (n,).
    placed
        Position (of the antenna, or of the camera, once `at_camera` was applied), velocity, covariance,
        status.
    attitude
        Of the body that carries the camera, with the effect of errors of the time in the covariance.
    cross
        Covariance of position (east, north, up, m) and turn of the body (rad), shape (n, 3, 3); NaN where
        unknown.
    images
        Names of the images, one for each camera that took one; none where none matched.
    height_kind
        Kind of the heights.
    carrier
        Of the body that the antenna is fixed to, where the camera is in a gimbal with its own attitude; None:
        the same body.
    above_take_off_m
        Height above the take-off point, where the images state it, shape (n,).
    """

    time: GpsTime
    number: Integers
    placed: InterpolatedPositions
    attitude: AttitudeSeries
    cross: Floats
    images: Sequence[tuple[str, ...]]
    height_kind: str
    carrier: AttitudeSeries | None = None
    above_take_off_m: Floats | None = None

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        """Say in one line how many there are, and what is known of them."""
        placed, named = int(self.placed.placed.sum()), sum(map(bool, self.images))
        known = f"{placed} with position, {int(self.attitude.known.sum())} with attitude, {named} with images"
        return f"Exposures: {len(self)} events, {known}; heights {self.height_kind}"

    @property
    def first_images(self) -> list[str]:
        """The image of each event, that of the first camera where several took one; empty without."""
        return [names[0] if names else "" for names in self.images]

    @property
    def angles(self) -> Floats:
        """Roll, pitch, yaw of the body that carries the camera, rad (n, 3); NaN where unknown."""
        return self.attitude.angles

    @property
    def angle_sigma(self) -> Floats:
        """Standard deviations of roll, pitch, yaw, rad (n, 3); NaN where unknown."""
        (sr, sp, _), (cr, cp, _) = np.sin(self.angles).T, np.cos(self.angles).T
        ones, zeros = np.ones_like(sp), np.zeros_like(sp)
        # The inverse of the turn per angle of the aerospace sequence (Diebel 2006, eq. 292).
        rows = [[ones, sr * sp / cp, cr * sp / cp], [zeros, cr, -sr], [zeros, sr / cp, cr / cp]]
        inverse = np.moveaxis(np.array(rows), (0, 1), (1, 2))
        covariance = inverse @ self.attitude.covariance @ np.swapaxes(inverse, 1, 2)
        return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)))

    def reason(self, row: int) -> str:
        """Return why an event has no position, empty where it has one."""
        if self.placed.placed[row]:
            return ""
        gap = float(self.placed.gap_s[row])
        if not np.isfinite(gap):
            return "outside the trajectory"
        return f"epochs around it are {gap:.1f} s apart (at most {LARGEST_GAP_S:g} s)"


def at_events(
    events: Events,
    placed: InterpolatedPositions,
    attitude: AttitudeSeries,
    time_sigma_s: Floats,
    images: Sequence[tuple[str, ...]],
    height_kind: str,
) -> Exposures:
    """Put positions and attitudes of the same instants together."""
    w = attitude.rate
    s2 = (time_sigma_s**2)[:, None, None]
    velocity = np.where(np.isfinite(placed.velocity_m_s), placed.velocity_m_s, 0.0)
    # An instant or an attitude of infinite sigma leaves what depends on it unknown: not a number.
    with np.errstate(invalid="ignore"):
        covariance = attitude.covariance + s2 * w[:, :, None] * w[:, None, :]
        cross = s2 * velocity[:, :, None] * w[:, None, :] + 0.0 * attitude.covariance
    timed = replace(attitude, covariance=covariance)
    return Exposures(events.time, events.number, placed, timed, cross, images, height_kind)


def at_camera(exposures: Exposures, rig: CameraOnBody) -> Exposures:
    """Return the exposures at the camera instead of the antenna."""
    if rig.lever_m is None:
        return exposures
    there = exposures.placed.placed
    correlated = exposures.carrier is None
    body = exposures.carrier if exposures.carrier is not None else exposures.attitude
    lacking = there & ~body.known
    if lacking.any():
        raise ConfigurationError(
            f"{int(lacking.sum())} exposures have no attitude to turn the lever arm with",
            "record ATTITUDE, or leave out the lever arm",
        )
    back = np.swapaxes(np.where(body.known[:, None, None], body.rotation, np.eye(3)), 1, 2)
    p = exposures.placed
    offset = -np.einsum("nij,j->ni", back, rig.lever_m)
    # The body turns by exp(-[t]x): -R' l changes by -R' [t]x l = R' [l]x t.
    jacobian = back @ skew(rig.lever_m)
    transposed = np.swapaxes(jacobian, 1, 2)
    covariance = p.covariance_m2 + back @ np.diag(rig.lever_sigma_m**2) @ np.swapaxes(back, 1, 2)
    covariance = covariance + jacobian @ body.covariance @ transposed
    cross = exposures.cross
    if correlated:
        both = cross @ transposed
        covariance = covariance + both + np.swapaxes(both, 1, 2)
        cross = cross + jacobian @ body.covariance
    placed = replace(p.moved(offset), covariance_m2=covariance)
    return replace(exposures, placed=placed, cross=cross)


def orientations(exposures: Exposures, rig: CameraOnBody) -> tuple[Floats, Floats]:
    """Return the exterior orientations: the body's attitude through camera axes and boresight.

    The boresight b turns the nominal camera axes A by exp([b]x); its own error and that of the attitude add,
    t = J s - exp([b]x) A t_body with J the left Jacobian of the rotation group at b (Chirikjian 2012, 10.86).

    returns: rotations (n, 3, 3) from east, north, up at each exposure to camera axes, boresight included, NaN
        where unknown; covariances (n, 6, 6) of east, north, up (m) and the turns t about the camera axes,
        rad: true = exp([t]x) rotation.
    """
    to_camera = np.asarray(Rotation.from_rotvec(rig.boresight).as_matrix() @ rig.axes)
    jacobian = left_jacobian(rig.boresight)
    of_boresight = jacobian @ np.diag(rig.boresight_sigma**2) @ jacobian.T
    covariance = np.empty((len(exposures), 6, 6))
    covariance[:, :3, :3] = exposures.placed.covariance_m2
    covariance[:, 3:, 3:] = to_camera @ exposures.attitude.covariance @ to_camera.T + of_boresight
    covariance[:, :3, 3:] = -exposures.cross @ to_camera.T
    covariance[:, 3:, :3] = np.swapaxes(covariance[:, :3, 3:], 1, 2)
    return to_camera @ exposures.attitude.rotation, covariance


def orientations_in_frame(rotation: Floats, covariance: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """Return omega, phi, kappa (rad) and the covariance of position and angles in other axes.

    rotation, covariance: of `orientations`; turn (n, 3, 3): from east, north, up to those axes.
    """
    angles = angles_from_matrix(rotation @ np.swapaxes(turn, 1, 2))
    safe = np.where(np.isfinite(angles), angles, 0.0)
    parts = (slice(0, 3), turn), (slice(3, 6), np.linalg.inv(turn_per_angle(safe)))
    turned = np.empty_like(covariance)
    # Block by block: where angles are unknown the positions are not.
    for rows, left in parts:
        for columns, right in parts:
            turned[:, rows, columns] = left @ covariance[:, rows, columns] @ np.swapaxes(right, 1, 2)
    return angles, turned


def match_images(
    images: list[ImageMetadata], events: Events, largest_offset_s: float
) -> tuple[list[tuple[str, ...]], list[Matching]]:
    """Match images to events, camera by camera.

    raises IllPosedError: when those of one may belong to several events; when those of none belong to any: a
        telephone's among them need not.
    """
    names: list[tuple[str, ...]] = [()] * len(events)
    matches, refusals = list[Matching](), list[UnrelatedImagesError]()
    event_s = (events.time.ns - events.time.ns[0]) / 1e9
    origin_s = float(events.time.to_utc().ns[0]) / 1e9
    for camera in dict.fromkeys(image.camera for image in images):
        of_camera = [image for image in images if image.camera == camera]
        image_s = np.array([clock_time_s(image) - origin_s for image in of_camera])
        resolution = max(image.resolution_s for image in of_camera)
        try:
            matching = match(image_s, event_s, resolution_s=resolution, largest_offset_s=largest_offset_s)
        except UnrelatedImagesError as refusal:
            refusals.append(refusal)
            matching = no_matching(len(of_camera))
        for i, e in zip(matching.image.tolist(), matching.event.tolist(), strict=True):
            names[e] = (*names[e], of_camera[i].name)
        matches.append(replace(matching, camera=camera, names=tuple(image.name for image in of_camera)))
    if len(refusals) == len(matches):
        raise refusals[0]
    return names, matches
