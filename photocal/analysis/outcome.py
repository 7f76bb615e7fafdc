"""The analysis of a network: everything that can be said of a calibration."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.common_error import c_by_common_height
from photocal.adjustment.envelope import on_one_thread
from photocal.adjustment.groups import GroupTest
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.adjustment.state import State
from photocal.analysis import correlation
from photocal.analysis.estimates import (
    GROUPS,
    Estimates,
    FTest,
    Proposal,
    propose_removal,
    scaled,
    significance,
    without,
)
from photocal.analysis.lasers import of_lasers
from photocal.analysis.left_out import Checks, Within, WithoutParameter, left_out, within_flight
from photocal.analysis.lens_models import LensFit, lens_fits, of_lenses
from photocal.analysis.method import METHODS, MethodCheck, Shape, check_method, shape
from photocal.analysis.robust import CLOSED_FORM, apart, bootstrap, sandwich
from photocal.analysis.stability.methods import (
    IdealImage,
    Method,
    pose_of,
    rotation_misfit,
    sensor_grid,
    step_of,
    view,
)
from photocal.analysis.systematic_errors.findings import findings, of_datum, one_angle_photos
from photocal.analysis.systematic_errors.search import (
    AssumedSigma,
    ResidualMap,
    Search,
    VarianceComponent,
    camera_estimates,
    causes_in,
    search,
)
from photocal.analysis.systematic_errors.shifts import MOST_JOINT, ImageShift
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.findings.document import text
from photocal.findings.finding import Finding
from photocal.findings.harm import without_metres
from photocal.findings.texts import catalogue
from photocal.findings.verdict import judge, verdict_section
from photocal.geometry.camera import PARAMETERS, Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.hypotheses.findings import Slips, asked_of, no_slips
from photocal.hypotheses.search import SystematicErrors, straightened

_ROTATION = Method("ROT", "two principal distances", "equations", 3, False, (rotation_misfit,))
# Findings of terms that a lens model lacks.
_TERMS = ("radial", "decentring")
# Defects of a datum: 3 shifts, 3 turns and the scale; the same without the turns, which attitudes give.
_ALL, _SCALE_AND_PLACE = 7, 4
SCHEMA, ANALYSIS = "photocal.analysis/2", "analysis.json"


@dataclass(frozen=True)
class Effect:
    """Effect of one or more parameters over the format.

    largest_px, rms_px: displacement over the format when the others keep their values.
    remaining_largest_px, remaining_rms_px: the same when the others follow, as in an adjustment without these
        parameters, and the bundle is rotated back: what no other parameter can do.
    """

    parameters: tuple[str, ...]
    largest_px: float
    rms_px: float
    remaining_largest_px: float
    remaining_rms_px: float


def effects(camera: Camera, estimates: Estimates, reach: float = np.inf) -> tuple[Effect, ...]:
    """Give the effect of every parameter but c, and of the usual groups."""
    names = [name for name in estimates.names if name != "c"]
    groups = [tuple(name for name in group if name in names) for group in GROUPS]
    wanted = [(name,) for name in names] + [group for group in groups if len(group) > 1]
    grid = sensor_grid(camera.size_px)
    plane = pixel_to_plane(camera.size_px, camera.pitch, grid)
    grid = grid[np.linalg.norm(plane, axis=1) <= reach]
    pixels, full = _seen(camera, grid)
    step = step_of(_ROTATION, rotation_misfit, full)
    return tuple(_effect(camera, estimates, group, (pixels, full, step)) for group in wanted)


def _seen(camera: Camera, pixels: Floats) -> tuple[Floats, IdealImage]:
    """Pixels that have a ray: beyond the observations the polynomial may fold, and there is none."""
    plane = pixel_to_plane(camera.size_px, camera.pitch, pixels)
    kept = pixels[np.isfinite(undistorted(camera, plane)).all(axis=1)]
    return kept, view(camera, kept)


def _effect(
    camera: Camera,
    estimates: Estimates,
    removed: tuple[str, ...],
    seen: tuple[Floats, IdealImage, Floats],
) -> Effect:
    """Effect of parameters at pixels that have a ray, whose view and steps of the pose are known."""
    pixels, full, step = seen
    remaining = without(estimates, removed)
    followed = dict(zip(remaining.names, remaining.values.tolist(), strict=True))
    alone = left = (np.nan, np.nan)
    # Without these parameters there may be pixels without a ray, too.
    with suppress(IllPosedError):
        alone = _sizes(view(camera.changed(**dict.fromkeys(removed, 0.0)), pixels).ideal - full.ideal)
    # Without parameters that a weak flight mistakes for each other nothing brings the bundles together.
    with suppress(IllPosedError, NotConvergedError):
        other = view(camera.changed(**followed | dict.fromkeys(removed, 0.0)), pixels)
        pose = pose_of(_ROTATION, rotation_misfit, full, other, step)
        left = _sizes(rotation_misfit(full, other, pose))
    return Effect(removed, *alone, *left)


def _sizes(moved: Floats) -> tuple[float, float]:
    length = np.linalg.norm(moved, axis=1)
    return float(length.max()), float(np.sqrt(np.mean(length**2)))


@dataclass(frozen=True)
class CameraAnalysis:
    """The parameters of one camera, judged.

    variance_factor_of_tests: by which the covariance was scaled for them.
    significance: single, group and cumulative tests.
    correlations, correlations_with_exterior: over the threshold.
    within_flight: c, x0 and y0 over the flight; empty for a few images.
    """

    variance_factor_of_tests: float
    significance: tuple[FTest, ...]
    effects: tuple[Effect, ...]
    correlations: tuple[correlation.StrongCorrelation, ...]
    correlations_with_exterior: tuple[correlation.ExteriorCorrelation, ...]
    components: Proposal
    left_out: tuple[WithoutParameter, ...]
    within_flight: tuple[Within, ...] = ()


def analyse_camera(
    fit: AdjustedNetwork,
    camera: int,
    checks: Checks,
    alpha: float,
    threshold: float,
    done: Callable[[], None] = lambda: None,
) -> CameraAnalysis | None:
    """Judge the parameters of a camera."""
    estimates = camera_estimates(fit, camera)
    if not estimates.names:
        return None
    # Never better than promised: see `hidden.camera_findings`.
    factor = max(1.0, fit.solution.variance_factor)
    judged = scaled(estimates, factor)
    interior = fit.network.cameras[camera].with_values(fit.state.cameras[camera])
    of_camera = fit.network.exposures.camera[fit.network.rays.image] == camera
    reach = float(np.linalg.norm(fit.network.rays.plane[of_camera], axis=1).max(initial=0.0))
    return CameraAnalysis(
        factor,
        significance(judged, fit.solution.degrees_of_freedom, alpha),
        effects(interior, judged, reach),
        correlation.strong_correlations(judged, threshold),
        correlation.exterior_correlations(fit, camera, threshold, done),
        propose_removal(judged),
        left_out(fit, camera, checks, done),
        within_flight(fit, camera),
    )


@dataclass(frozen=True)
class Removal:
    """Parameters of a camera with some images left out together."""

    images: tuple[str, ...]
    parameters: dict[str, float]


@dataclass(frozen=True)
class Opinions:
    """Standard deviations of a camera by parameter; NaN where there were too few images.

    standard_error, standard_error_corrected: with images left out, and the same after the corrections.
    not_possible: images without which the rest is not determined; standard errors are then lower bounds.
    """

    formal: dict[str, float]
    standard_error: dict[str, float]
    sandwich: dict[str, float]
    bootstrap: dict[str, float] | None
    standard_error_corrected: dict[str, float]
    left_out: tuple[Removal, ...]
    not_possible: tuple[str, ...]

    def others(self, parameter: str) -> dict[str, float | None]:
        """Standard deviations of a parameter by other means than the adjustment; None for too few images.

        Leaving out images stands in for the sandwich where there are too few of them.
        """
        said = {name: _known(getattr(self, name), parameter) for name in ("sandwich", "bootstrap")}
        jackknife = _known(self.standard_error, parameter) if said["sandwich"] is None else None
        return {"jackknife": jackknife, **said}

    def largest(self, parameter: str, formal: float) -> tuple[float, str]:
        """Largest opinion that is more than a third above the formal one, and whose it is; else "formal".

        Where images cannot each be left out, what that says is a lower bound: "at_least", also for the
        formal one.
        """
        others = self.others(parameter)
        sigma, whose = max((value or 0.0, name) for name, value in others.items())
        if not (sigma > formal and apart(formal, sigma)):
            sigma, whose = formal, "formal"
        bound = self.not_possible and others["sandwich"] is None and whose in ("formal", "jackknife")
        return sigma, "at_least" if bound else whose


def _known(sigmas: dict[str, float] | None, parameter: str) -> float | None:
    sigma = (sigmas or {}).get(parameter, np.nan)
    return None if np.isnan(sigma) else sigma


@dataclass(frozen=True)
class ExteriorDifference:
    """Original minus adjusted exterior orientation over the images that have both.

    mean_m, rmse_m: X, Y, Z in the local frame of the block (east, north, up where it has a reference system).
    mean_arcsec, rmse_arcsec: omega, phi, kappa.
    """

    images: int
    mean_m: tuple[float, ...]
    rmse_m: tuple[float, ...]
    mean_arcsec: tuple[float, ...]
    rmse_arcsec: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """What the analysis of a network says: the content of `analysis.json`.

    findings: hidden errors, worst first.
    alpha, correlation_threshold: level of the F tests, and correlation from which pairs are named.
    cameras: by name, as all that follows; None for one without estimated parameters.
    lens_models: the models compared, its own first; empty where nothing is left to explain.
    observation_sigma: of the image coordinates, assumed and found, in the unit of the image plane.
    result_sha256: digest of the result.json that it belongs to.
    c_by_height: change of each camera's c with an error common to all observed heights of exposures, per m;
        None where that error is an unknown of the adjustment; cameras whose change is unknown are left out.
    """

    schema: str = SCHEMA
    findings: tuple[Finding, ...]
    variance_factor: float
    alpha: float
    correlation_threshold: float
    cameras: dict[str, CameraAnalysis | None]
    lens_models: dict[str, tuple[LensFit, ...]]
    observation_sigma: AssumedSigma
    groups: tuple[GroupTest, ...]
    variance_components: dict[str, tuple[VarianceComponent, ...]]
    image_shifts: tuple[ImageShift, ...]
    residual_maps: dict[str, ResidualMap | None]
    jackknife: dict[str, Opinions]
    bootstrap_draws: int
    network: Shape
    methods: tuple[MethodCheck, ...]
    exterior_difference: ExteriorDifference | None = None
    result_sha256: str = ""
    c_by_height: dict[str, float | None] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Say the verdict, as `photocal analyse` prints it."""
        return text((verdict_section(judge(self.findings), catalogue("en")),))


@dataclass(frozen=True, kw_only=True, repr=False)
class Outcome(Analysis):
    """An analysis with the adjustments behind it.

    Attributes
    ----------
    search
        The block adjusted without the errors that were found, and all candidates with their tests.
    findings
        Hidden errors, worst first.
    cameras
        By name significance, effects, correlations and components; None for one without estimated parameters.
    """

    search: Search


@on_one_thread
def analyse_network(
    network: Network,
    checks: Checks,
    alpha: float,
    threshold: float,
    done: Callable[[float], None] = lambda _: None,
    draws: int = 0,
    start: State | None = None,
    slips: Slips = no_slips,
) -> Outcome:
    """Adjust a network and analyse it; without control that contradicts itself where it cannot be otherwise.

    start: where the minimum is known to be near.
    raises IllPosedError, NotConvergedError: as the adjustment does.
    """
    with because("the calibrated block, whose residuals are analysed"):
        fitted, at_once = straightened(network, start)
    causes = causes_in(fitted, at_once, lambda: done(0.0))
    return analyse_adjusted(causes, checks, alpha, threshold, done, draws, slips)


@on_one_thread
def analyse_adjusted(
    causes: SystematicErrors,
    checks: Checks,
    alpha: float,
    threshold: float,
    done: Callable[[float], None] = lambda _: None,
    draws: int = 0,
    slips: Slips = no_slips,
) -> Outcome:
    """Analyse an adjusted network, in which causes were looked for.

    draws: of the bootstrap over images: as many more adjustments.
    slips: what names the typing errors of a control point.
    done: gets the share of the work that was done since it was called last.
    """
    fitted, network = causes.first, causes.first.network
    # Of the bootstrap: the same images are drawn again when a certificate is verified.
    seed = 1
    left, share = 1.0, 1.0 / (_steps(network) + draws)

    def step() -> None:
        """Tell of one adjustment more, within what was announced."""
        nonlocal left
        # Each error that is found makes more of them.
        now = min(share, left / 2)
        left -= now
        done(now)

    searched = search(causes, step)
    geometry = shape(network, fitted.state)
    drawn = bootstrap(fitted, draws, np.random.default_rng(seed), step) if draws else None
    # Lenses are compared where something is left that a lens may explain, when that is corrected which is
    # no matter of the lens.
    of_lens_terms = any(error.hypothesis.name in _TERMS for error in searched.causes.errors)
    base = fitted if of_lens_terms else searched.last
    listed = findings(searched, slips)
    suspected = {finding.subject for finding in listed if finding.code in (*_TERMS, "residual-map")}
    fits = tuple(
        lens_fits(base, k, checks, step) if camera.id in suspected else ()
        for k, camera in enumerate(network.cameras)
    )
    of_lens = of_lenses(base, fits)
    # A lens that the model cannot hold is no missing term of it.
    other = {finding.subject for finding in of_lens}
    kept = [finding for finding in listed if finding.code not in _TERMS or finding.subject not in other]
    names = [camera.id for camera in network.cameras]
    judged = [analyse_camera(fitted, k, checks, alpha, threshold, step) for k in range(len(names))]
    told = (*of_lens, *kept, *of_datum(searched), *one_angle_photos(fitted), *of_lasers(fitted))
    if _scale_is_open(fitted):
        told = tuple(without_metres(finding, asked_of(fitted)) for finding in told)
    return Outcome(
        findings=told,
        variance_factor=fitted.solution.variance_factor,
        alpha=alpha,
        correlation_threshold=threshold,
        cameras=dict(zip(names, judged, strict=True)),
        lens_models=dict(zip(names, fits, strict=True)),
        observation_sigma=searched.sigma,
        groups=searched.groups,
        variance_components={key: getattr(searched, key) for key in ("images", "axes", "cameras")},
        image_shifts=searched.shifts,
        residual_maps=dict(zip(names, searched.maps, strict=True)),
        jackknife=_opinions(searched, sandwich(fitted), drawn),
        bootstrap_draws=draws,
        network=geometry,
        methods=tuple(check_method(method, geometry) for method in METHODS),
        c_by_height=_c_by_height(fitted),
        search=searched,
    )


def _scale_is_open(fitted: AdjustedNetwork) -> bool:
    """Whether inner constraints alone give a network its scale."""
    network, defect = fitted.network, fitted.solution.datum_defect
    without_turns = defect == _SCALE_AND_PLACE and not len(network.relations.values)
    return network.datum_points is not None and (defect == _ALL or without_turns)


def _c_by_height(fitted: AdjustedNetwork) -> dict[str, float | None]:
    changes = c_by_common_height(fitted.factored)
    names = [camera.id for camera in fitted.network.cameras]
    return dict.fromkeys(names) if changes is None else dict(zip(names, changes.tolist(), strict=True))


def _opinions(search: Search, robust: Floats, drawn: Floats | None) -> dict[str, Opinions]:
    before, after = search.jackknife_first, search.jackknife_last
    opinions = {}
    for k, camera in enumerate(search.first.network.cameras):
        at = np.flatnonzero(camera.estimated).tolist()

        def named(values: Floats, at: list[int] = at) -> dict[str, float]:
            """Values by the names of the parameters that they belong to."""
            return {PARAMETERS[i]: float(values[i]) for i in at}

        removals = zip(before.left_out, before.cameras, strict=True)
        opinions[camera.id] = Opinions(
            named(np.sqrt(np.diag(search.first.solution.camera_covariance[k]))),
            named(before.standard_error[k]),
            named(robust[k]),
            None if drawn is None else named(drawn[k]),
            named(after.standard_error[k]),
            tuple(Removal(images, named(values[k])) for images, values in removals),
            before.not_possible,
        )
    return opinions


def _steps(network: Network) -> int:
    """Pieces of work of an analysis that finds nothing."""
    images = len(network.image_names)
    removals = images if images <= CLOSED_FORM else 1
    parameters = sum(len(camera.free) for camera in network.cameras)
    return removals + min(images, MOST_JOINT) + 2 * parameters + 3 * len(network.cameras)
