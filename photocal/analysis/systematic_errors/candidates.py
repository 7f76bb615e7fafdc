"""What may be wrong with measured image coordinates: a field for each suspicion, its test, and drifts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.factored import factored
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.near import Removals
from photocal.adjustment.network import Network
from photocal.adjustment.normal import values_of
from photocal.adjustment.score import followed_by, score
from photocal.adjustment.state import State
from photocal.analysis.robust import FEWEST, groups_of, standard_error, state_without
from photocal.analysis.systematic_errors.refit import AdjustedNetwork, left_without, without_images
from photocal.base import policy
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import undistorted

PARTS = 3
# A third has at least so many images; what is left of a field beside the other unknowns, a share squared.
FEWEST_IMAGES, LEFT = 4, 1e-6
# Exposures are a flight when this share of the steps from one to the next has the usual length, this nearly.
REGULAR_SHARE = 0.6
REGULAR_SPACING = 0.3
# A drift of c is held against steps at so many places.
STEPS = 7


@dataclass(frozen=True)
class Within:
    """One parameter of a camera over a flight, each estimate beside all other unknowns, to first order.

    parts (3, 2): departure of each third from the first one, and its standard deviation.
    drifts: change from one end to the other, linear in "order" (of the exposures), "time" or "temperature",
        as far as these are known: amount, standard deviation, and F.
    statistic, p_value: F of all thirds together, and its probability in a camera that stays the same.
    """

    parameter: str
    parts: Floats
    drifts: dict[str, tuple[float, float, float]]
    statistic: float
    p_value: float


def order_of(time: Floats | None, images: Integers) -> Integers:
    """Order in which images of a camera were taken: by time where all are known, else as they are listed."""
    if time is None or not np.isfinite(time[images]).all():
        return images
    return np.asarray(images[np.argsort(time[images], kind="stable")])


def course(order: Integers, images: int) -> Floats:
    """From -1/2 for the first to 1/2 for the last image in an order; 0 for all others."""
    at = np.zeros(images)
    at[order] = np.linspace(-0.5, 0.5, len(order))
    return at


def change_of(values: Floats, plane: Floats, parameter: str) -> Floats:
    """Change of computed image coordinates, shape (n, 2), with c, x0 or y0, distortion left out."""
    if parameter == "c":
        return np.asarray((plane - values[1:3]) / values[0])
    return np.broadcast_to(np.eye(2)[PARAMETERS.index(parameter) - 1], plane.shape).copy()


def within_flight(fit: AdjustedNetwork, camera: int) -> tuple[Within, ...]:
    """Test c, x0 and y0 of a camera for a change within the flight; nothing for fewer than twelve images."""
    exposures = fit.network.exposures
    order = order_of(exposures.time, np.flatnonzero(exposures.camera == camera))
    if len(order) < PARTS * FEWEST_IMAGES:
        return ()
    third = np.full(len(exposures.camera), -1)
    for k, images in enumerate(np.array_split(order, PARTS)):
        third[images] = k
    courses = {"order": course(order, len(third))}
    for name, given in (("time", exposures.time), ("temperature", exposures.temperature)):
        if given is not None and np.isfinite(given[order]).all() and np.ptp(given[order]) > 0.0:
            courses[name] = np.zeros(len(third))
            courses[name][order] = (given[order] - given[order].mean()) / np.ptp(given[order])
    values, image = fit.solution.cameras[camera], fit.network.rays.image
    shares = np.array([third == k for k in range(1, PARTS)] + list(courses.values()))[:, image, None]
    names = ("c", "x0", "y0")
    fields = [change_of(values, fit.computed, name) * shares for name in names]
    scored = score(fit.factored, fit.solution.residuals, np.concatenate(fields))
    tested = []
    for k, name in enumerate(names):
        rows = slice(k * len(shares), (k + 1) * len(shares))
        if (scored.share[rows] > LEFT).all():
            tested.append(_within(fit, name, scored.slope[rows], scored.information[rows, rows], courses))
    return tuple(tested)


def _within(
    fit: AdjustedNetwork, name: str, slope: Floats, information: Floats, courses: Iterable[str]
) -> Within:
    """Test one parameter, from the normal equations of its thirds and its drifts."""
    from scipy import stats

    freedom = fit.solution.degrees_of_freedom
    count = PARTS - 1
    covariance = np.linalg.inv(information[:count, :count])
    amounts = -covariance @ slope[:count]

    def statistic(fall: float, unknowns: int) -> float:
        """F of a fall of chi-squared against what is left of it."""
        left = max(fit.solution.chi_squared - fall, 1e-300)
        return fall / unknowns / (left / (freedom - unknowns))

    together = statistic(float(-slope[:count] @ amounts), count)
    drifts = {}
    for k, key in enumerate(courses, start=count):
        normal, along = float(information[k, k]), float(slope[k])
        drifts[key] = -along / normal, normal**-0.5, statistic(along**2 / normal, 1)
    parts = np.vstack([[0.0, 0.0], np.column_stack([amounts, np.sqrt(np.diag(covariance))])])
    return Within(name, parts, drifts, together, float(stats.f.sf(together, count, freedom - count)))


@dataclass(frozen=True)
class Candidate:
    """A systematic error with one unknown amount.

    kind: "y-scale", "shear", "radial", "decentring", "rolling-shutter", "c-drift" or "c-step".
    parameter: the term of the camera model that is missing, or the first image after a step; else empty.
    displacement (n, 2): what must be added to the measured image plane coordinates for an amount of 1; zero
        for rays of other cameras. It is a function of the computed coordinates: of the measured ones, a field
        that shrinks the image would shrink the errors of measurement, too, and explain something in every
        block.
    """

    kind: str
    parameter: str
    camera: int
    displacement: Floats

    @property
    def name(self) -> str:
        """Kind and parameter, "radial K3"; unique for a camera."""
        return f"{self.kind} {self.parameter}".strip()


def candidates(network: Network, state: State, computed: Floats) -> tuple[Candidate, ...]:
    """List what the model of each camera does not already estimate, at the computed image coordinates."""
    camera_of_ray = network.exposures.camera[network.rays.image]
    all_candidates = []
    for k, camera in enumerate(network.cameras):
        of_camera = (camera_of_ray == k)[:, None]
        if not of_camera.any():
            continue
        current = camera.with_values(state.cameras[k])
        all_candidates += [
            Candidate(kind, term, k, field * of_camera) for kind, term, field in _of_camera(current, computed)
        ]
        motion = None if camera.rolling else _rolling_shutter(network, state, computed, k)
        if motion is not None:
            all_candidates.append(Candidate("rolling-shutter", "", k, motion * of_camera))
        all_candidates += _change_of_c(network, state, computed, k)[:1]
    return tuple(all_candidates)


def steps_of_c(network: Network, state: State, computed: Floats, camera: int) -> tuple[Candidate, ...]:
    """List steps of c at some places of the flight: what a drift must explain better than."""
    return _change_of_c(network, state, computed, camera)[1:]


def _change_of_c(network: Network, state: State, computed: Floats, camera: int) -> tuple[Candidate, ...]:
    """Give c as a drift from the first image to the last, then as steps; nothing for a few images."""
    exposures, image = network.exposures, network.rays.image
    order = order_of(exposures.time, np.flatnonzero(exposures.camera == camera))
    if len(order) < PARTS * FEWEST_IMAGES:
        return ()
    of_camera = exposures.camera[image] == camera
    change = change_of(state.cameras[camera], computed, "c") * of_camera[:, None]
    at = course(order, len(network.image_names))
    steps = np.unique(np.linspace(0, len(order), STEPS + 2).round().astype(int)[1:-1]).tolist()
    drift_and_steps = [Candidate("c-drift", "", camera, -at[image][:, None] * change)]
    for first in steps:
        side = np.where(at < at[order[first]], -0.5, 0.5)
        name = network.image_names[order[first]]
        drift_and_steps.append(Candidate("c-step", name, camera, -side[image][:, None] * change))
    return tuple(drift_and_steps)


def _of_camera(camera: Camera, plane: Floats) -> list[tuple[str, str, Floats]]:
    zero = np.zeros(len(plane))
    ideal, lens = camera.model == "brown-ideal", camera.lens
    x, y = (undistorted(camera, plane) if ideal else plane - camera.values[1:3]).T
    # Coefficients without unit: those of coordinates over c.
    scale = camera.value("c") if lens.relative else 1.0
    x, y = x / scale, y / scale
    estimated = {name for name, is_so in zip(PARAMETERS, camera.estimated, strict=True) if is_so}
    scale_term, shear_term = ("B2", "B1") if camera.affinity_form == "tank" else ("B1", "B2")
    terms = []
    if scale_term not in estimated:
        terms.append(("y-scale", "", np.column_stack([zero, plane[:, 1]])))
    if shear_term not in estimated:
        terms.append(("shear", "", np.column_stack([plane[:, 1], zero])))
    r2 = x * x + y * y
    orders = (n for n in (1, 2, 3, 4) if f"K{n}" in lens.terms and f"K{n}" not in estimated)
    if (order := next(orders, None)) is not None:
        power = order / 2 if camera.model == "pix4d-fisheye" else order
        terms.append(("radial", f"K{order}", scale * np.column_stack([x, y]) * (r2**power)[:, None]))
    if "P1" in lens.terms and "P1" not in estimated:
        terms.append(("decentring", "P1", scale * np.column_stack([r2 + 2 * x * x, 2 * x * y])))
    if "P2" in lens.terms and "P2" not in estimated:
        terms.append(("decentring", "P2", scale * np.column_stack([2 * x * y, r2 + 2 * y * y])))
    return terms


def _rolling_shutter(network: Network, state: State, computed: Floats, camera: int) -> Floats | None:
    """Give minus the image motion while the rows are read, for a readout as long as the exposure interval."""
    images = np.flatnonzero(network.exposures.camera == camera)
    if len(images) < 5:
        return None
    velocity = _per_interval(state.centre[images])
    if velocity is None:
        return None
    interior = network.cameras[camera]
    motion = np.zeros((len(network.image_names), 3))
    motion[images] = velocity
    image = network.rays.image
    q = np.einsum("nij,nj->ni", state.rotation[image], state.points[network.rays.point] - state.centre[image])
    dq = -np.einsum("nij,nj->ni", state.rotation[image], motion[image])
    c = state.cameras[camera, 0]
    dp = -c * (dq[:, :2] / q[:, 2:] - q[:, :2] * dq[:, 2:] / q[:, 2:] ** 2)
    # Rows are read from the top; the middle row is the reference.
    late = -computed[:, 1] / (interior.size_px[1] * interior.pitch[1])
    return np.asarray(-dp * late[:, None])


def _per_interval(centres: Floats) -> Floats | None:
    """Give the way flown per exposure interval, (n, 3); zero where a line has only one exposure."""
    steps = np.diff(centres, axis=0)
    length = np.linalg.norm(steps, axis=1)
    typical = float(np.median(length))
    regular = np.abs(length - typical) <= REGULAR_SPACING * typical
    if typical <= 0.0 or np.mean(regular) < REGULAR_SHARE:
        return None
    sums, count = np.zeros_like(centres), np.zeros(len(centres))
    for ends in (slice(None, -1), slice(1, None)):
        sums[ends] += steps * regular[:, None]
        count[ends] += regular
    return np.asarray(sums / np.maximum(count, 1.0)[:, None])


@dataclass(frozen=True)
class ExtraParameter:
    """Outcome of the test of one candidate.

    amount, sigma: estimate and a priori standard deviation, in the unit of the candidate.
    statistic, p_value: F = fall over the variance that remains, and its probability without the error.
    effect_px: largest displacement of a ray, px.
    by_images: the same probability by how the images differ, to first order; too small for few of them, see
        `agreed`.
    tested: candidates that were looked at: the level is shared by them (Bonferroni).
    alike: other candidates that explain the residuals as well: the network does not separate them.
    """

    candidate: Candidate
    amount: float
    sigma: float
    fall: float
    statistic: float
    p_value: float
    effect_px: float
    by_images: float = 0.0
    tested: int = 1
    alike: tuple[str, ...] = ()


def estimated_amounts(fit: AdjustedNetwork, tested: Sequence[Candidate]) -> list[ExtraParameter]:
    """Estimate each candidate's amount as one more unknown, to first order; of those that are determined."""
    if not tested:
        return []
    # What is added to the measurements is taken off the residuals, computed minus measured.
    fields = -np.array([term.displacement for term in tested])
    scored = score(fit.factored, fit.solution.residuals, fields)
    fields -= followed_by(fit.factored, scored.steps, scored.moved)
    outcomes = []
    for k in np.flatnonzero(scored.share > LEFT).tolist():
        candidate, slope, information = tested[k], float(scored.slope[k]), float(scored.information[k, k])
        amount = -slope / information
        outcome = judged(fit, candidate, amount, information**-0.5, slope**2 / information)
        corrected = fit.solution.residuals + amount * fields[k]
        images = int(np.sum(fit.network.exposures.camera == candidate.camera))
        sigma = _spread(fit, information, fields[k], corrected) * (images / max(images - 1, 1)) ** 0.5
        outcomes.append(replace(outcome, by_images=_probability(amount, sigma, images - 1)))
    return outcomes


def estimated_amount(fit: AdjustedNetwork, candidate: Candidate) -> ExtraParameter | None:
    """Estimate the amount of one candidate, as `estimated_amounts` does; None where it is not determined."""
    return next(iter(estimated_amounts(fit, (candidate,))), None)


def judged(
    fit: AdjustedNetwork, candidate: Candidate, amount: float, sigma: float, fall: float
) -> ExtraParameter:
    """Make the F test of a fall of the sum of squares."""
    from scipy import stats

    redundancy = fit.solution.degrees_of_freedom - 1
    left = max(fit.solution.chi_squared - fall, 1e-300)
    statistic = fall / (left / redundancy)
    pitch = fit.network.cameras[candidate.camera].pitch
    moved = np.abs(amount) * np.linalg.norm(candidate.displacement / np.array(pitch), axis=1)
    p_value = float(stats.f.sf(statistic, 1, redundancy))
    return ExtraParameter(candidate, amount, sigma, fall, statistic, p_value, float(moved.max(initial=0.0)))


def agreed(fit: AdjustedNetwork, candidate: Candidate, amount: float) -> float:
    """Probability of an amount that is none, by how the images differ about it; 1 where too few can be asked.

    The F test takes rays for independent. What matching, focus or a moving shutter do to one image they do to
    all of its rays, and the next image has it otherwise: a test over images as they are (Liang and Zeger
    1986) sees that. With many images by the sandwich, see `robust.sandwich`, with few by the jackknife.
    """
    camera = fit.network.cameras[candidate.camera]
    images = int(np.sum(fit.network.exposures.camera == candidate.camera))
    freedom = images - int(camera.estimated.sum()) - 1
    if freedom >= FEWEST:
        scored = score(fit.factored, fit.solution.residuals, -candidate.displacement[None])
        checked = np.maximum(fit.solution.redundancy, policy.LEAST_CHECKED)
        weighed = fit.solution.residuals / np.sqrt(checked)
        shown = -candidate.displacement - followed_by(fit.factored, scored.steps, scored.moved)[0]
        sigma = _spread(fit, float(scored.information[0, 0]), shown, weighed) * (images / freedom) ** 0.5
        return _probability(amount, sigma, freedom)
    amounts = _left_out(fit, candidate)
    return _probability(amount, float(standard_error(amounts)), len(amounts) - 1)


def _spread(fit: AdjustedNetwork, information: float, shown: Floats, residuals: Floats) -> float:
    """Standard deviation of an amount when the residuals of an image are one observation of it.

    shown: change of the residuals by a unit of it, when all other unknowns follow.
    """
    pull = fit.network.rays.sigma**-2.0 * residuals
    by_image = np.bincount(fit.network.rays.image, np.einsum("rk,rk->r", shown, pull))
    return float(np.linalg.norm(by_image)) / information


def _probability(amount: float, sigma: float, freedom: int) -> float:
    from scipy import stats

    return float(2 * stats.t.sf(abs(amount) / sigma, freedom)) if sigma > 0.0 and freedom > 0 else 1.0


def _left_out(fit: AdjustedNetwork, candidate: Candidate) -> Floats:
    """What is left of an amount when images are left out, (m,)."""
    removals, amounts = Removals(fit.factored), []
    for out in groups_of(fit):
        try:
            network, state = without_images(fit.network, state_without(fit, removals, out), out)
            at = factored(network, state)
        except (IllPosedError, NotConvergedError):
            continue
        residuals, depth = np.empty(network.rays.plane.shape), np.empty(len(network.rays.image))
        evaluate(at.problem.design, values_of(at.problem, at.state), residuals, depth)
        kept = left_without(fit.network, out)[1]
        scored = score(at, residuals, -candidate.displacement[None, kept])
        if scored.share[0] > LEFT:
            amounts.append(-float(scored.slope[0]) / float(scored.information[0, 0]))
    return np.array(amounts)
