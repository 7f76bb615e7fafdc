"""The whole check of a block: three methods side by side, systematic errors, what cannot be separated.

Differences at ground points with the standard deviations that the method predicts for them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special
from scipy.linalg import block_diag

from photocal.adjustment.envelope import on_one_thread
from photocal.adjustment.network import covariance_matrices
from photocal.analysis.accuracy.assessment import Assessment, assess
from photocal.analysis.accuracy.discrepancies import Discrepancies
from photocal.analysis.accuracy.standard import Question, Standard
from photocal.analysis.georeferencing.causes import (
    Mistyped,
    Separation,
    causes_of,
    ground_findings,
    mistyped_of,
    typed_slips,
)
from photocal.analysis.georeferencing.direct import leaves_open
from photocal.analysis.georeferencing.methods import (
    METHODS,
    Degradation,
    Georeferenced,
    Method,
    as_adjusted,
    degraded,
    is_adjustment_of,
    of_method,
    stands_for,
)
from photocal.analysis.georeferencing.prepared import (
    checkable,
    in_local_frame,
    with_attitude_angles,
    with_shutters,
)
from photocal.analysis.searched_block import SearchedBlock
from photocal.base.arrays import Floats
from photocal.base.ellipses import ellipses
from photocal.base.errors import IllPosedError, PhotocalError
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, Role
from photocal.block.network import block_frame
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text
from photocal.hypotheses.findings import Slips, no_slips
from photocal.hypotheses.search import SystematicErrors

# Two-sided 0.1 %, Baarda's usual choice (1968) for single tests.
CRITICAL_W = float(-special.ndtri(policy.significance / 2.0))


@dataclass(frozen=True)
class JointTest:
    """All check points together: their adjusted coordinates have most of their errors in common.

    chi_squared, p_value: d' C^-1 d with the covariance C of all adjusted points together and of the survey,
        and its two-sided probability with `degrees_of_freedom`.
    mean, mean_sigma (3,): mean difference and its standard deviation from C, m.
    mean_p_value: probability of so large a mean without a bias.
    """

    degrees_of_freedom: int
    chi_squared: float
    p_value: float
    mean: Floats
    mean_sigma: Floats
    mean_p_value: float

    @property
    def exceeds(self) -> bool:
        """Whether errors are larger than their covariance explains (0.1 %)."""
        return self.p_value < policy.significance and self.chi_squared > self.degrees_of_freedom

    @property
    def biased(self) -> bool:
        """Whether the mean is larger than its covariance explains (0.1 %)."""
        return self.mean_p_value < policy.significance


def joint_test(d: Floats, covariance: Floats) -> JointTest:
    """Judge differences jointly."""
    factor = np.linalg.cholesky(covariance)
    chi_squared = float(np.sum(np.linalg.solve(factor, d.ravel()) ** 2))
    average = np.tile(np.eye(3), len(d)) / len(d)
    of_mean = average @ covariance @ average.T
    mean = d.mean(axis=0)
    along = float(mean @ np.linalg.solve(of_mean, mean))
    tail = min(float(special.chdtrc(d.size, chi_squared)), float(special.chdtr(d.size, chi_squared)))
    sigma = np.sqrt(np.diag(of_mean))
    return JointTest(d.size, chi_squared, 2.0 * tail, mean, sigma, float(special.chdtrc(3, along)))


@dataclass(frozen=True)
class Differences:
    """Computed minus surveyed coordinates of the ground points of one role.

    d (n, 3): m.
    product_sigma, survey_sigma (n, 3): predicted standard deviation of the computed coordinates, and that
        which the survey states of its own, m; 0 where it states none.
    covariance (n, 3, 3): predicted for d: of product and survey together; of a fitted point, of its residual.
    w (n, 3): d over its predicted standard deviation; NaN where that is zero.
    distance (n,): d' C^-1 d, chi-squared with 3 degrees of freedom when the prediction holds; NaN where C is
        singular.
    ellipses: of the computed position, in the X, Y plane.
    joint: all check points together; None where their covariance is not known.
    rest: the same of those that are not suspected, where some are, and others are left.
    """

    role: Role
    names: tuple[str, ...]
    d: Floats
    xyz: Floats
    product_sigma: Floats
    survey_sigma: Floats
    covariance: Floats
    w: Floats
    distance: Floats
    ellipses: tuple[Floats, Floats]
    joint: JointTest | None = None
    rest: JointTest | None = None

    def discrepancies(self) -> Discrepancies:
        """Give them to the statistics and the standards."""
        return Discrepancies(self.names, self.d, self.xyz)

    @cached_property
    def rmse(self) -> Floats:
        """Root mean square of the differences in X, Y, Z, m; NaN without points."""
        return rms(self.d)

    @cached_property
    def predicted(self) -> Floats:
        """Root mean square of the predicted sigmas of the computed coordinates, m; NaN without points."""
        return rms(self.product_sigma)

    @cached_property
    def survey(self) -> Floats:
        """Root mean square of the sigmas that the survey states, m; NaN without points."""
        return rms(self.survey_sigma)

    @property
    def suspected(self) -> tuple[str, ...]:
        """Points of this group whose difference the prediction does not explain, were it the only one."""
        return self.suspected_at(policy.family_significance)

    def suspected_at(self, level: float) -> tuple[str, ...]:
        """Points whose difference the prediction does not explain: any of sound ones with this probability.

        All of them together are one family of tests (Holm 1979).
        """
        tested = np.flatnonzero(np.isfinite(self.distance))
        p = special.chdtrc(3, self.distance[tested])
        order = np.argsort(p, kind="stable")
        enough = p[order] <= level / np.arange(len(p), 0, -1)
        rejected = tested[order[: len(p) if enough.all() else int(np.argmin(enough))]]
        return tuple(self.names[k] for k in sorted(rejected.tolist()))

    @property
    def ratio(self) -> float:
        """Root of the mean of d' C^-1 d / 3: 1 when errors are as large as predicted."""
        known = self.distance[np.isfinite(self.distance)]
        return float(np.sqrt(known.mean() / 3.0)) if len(known) else float("nan")


def exposure_difference(exposures: Floats, reference: Floats) -> tuple[int, Floats, Floats]:
    """Compare orientations (omega, phi, kappa, X, Y, Z; NaN where there is none) with a reference.

    returns: number of images that have both, mean and RMSE (6,) of exposures less reference, rad and m.
    """
    d = exposures - reference
    d[:, :3] = (d[:, :3] + np.pi) % (2 * np.pi) - np.pi
    d = d[np.isfinite(d).all(axis=1)]
    return len(d), d.mean(axis=0), np.sqrt(np.mean(d**2, axis=0))


def rms(vectors: Sequence[Floats] | Floats) -> Floats:
    """Root mean square of each component of vectors, shape (n, 3) to (3,); NaN without any."""
    return np.sqrt(np.mean(np.square(vectors), axis=0)) if len(vectors) else np.full(3, np.nan)


def differences(block: Block, result: Georeferenced, role: Role) -> Differences:
    """Compare the ground points of one role with their survey."""
    of_role = block.points.role[result.points] == ROLES.index(role)
    index, fitted = result.points[of_role], result.fitted[of_role]
    surveyed = block.points.values[index]
    d = result.xyz[of_role] - surveyed
    product = result.covariance[of_role]
    stated = np.where(np.isfinite(block.points.sigma[index]), block.points.sigma[index], 0.0)
    cross = np.zeros((len(index), 3)) if block.points.cross is None else block.points.cross[index]
    survey = covariance_matrices(stated, cross)
    # The residual of a fitted observation: C_obs - C_adjusted (Mikhail 1976, eq. 7-17).
    covariance = np.where(fitted[:, None, None], survey - product, survey + product)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    # What is left of a held or hardly checked coordinate is rounding.
    tested = variance > 1e-6 * (np.diagonal(product, axis1=1, axis2=2) + stated**2) + 1e-18
    w = np.divide(d, np.sqrt(np.where(tested, variance, 1.0)), out=np.full_like(d, np.nan), where=tested)
    distance = np.full(len(d), np.nan)
    for k in np.flatnonzero(tested.all(axis=1)):
        eigenvalues = np.linalg.eigvalsh(covariance[k])
        if eigenvalues[0] > 1e-9 * eigenvalues[-1]:
            distance[k] = float(d[k] @ np.linalg.solve(covariance[k], d[k]))
    names = tuple(block.points.names[j] for j in index)
    sigma = np.sqrt(np.diagonal(product, axis1=1, axis2=2))
    told = Differences(
        *(role, names, d, surveyed, sigma, stated, covariance, w, distance),
        ellipses(product, policy.confidence),
    )
    if role == "check" and result.joint is not None and len(result.joint) == d.size:
        # Their survey is independent from point to point.
        whole = result.joint + block_diag(*survey)
        told = replace(told, joint=joint_test(d, whole))
        good = ~np.isin(names, told.suspected)
        if good.any() and not good.all():
            of_good = np.repeat(good, 3)
            told = replace(told, rest=joint_test(d[good], whole[np.ix_(of_good, of_good)]))
    return told


@dataclass(frozen=True)
class Judged:
    """One method and what the ground points say about it.

    assessment: of the check points, by statistics and standards; None without check points.
    """

    result: Georeferenced
    control: Differences
    check: Differences
    assessment: Assessment | None

    @property
    def differences(self) -> tuple[Differences, ...]:
        """Those at check and at control points, where there are any."""
        return tuple(group for group in (self.check, self.control) if group.names)


@dataclass(frozen=True)
class BlockCheck:
    """The check of the georeferencing of a block.

    Attributes
    ----------
    judged
        Those methods that the block allows, in the order of `METHODS`.
    exposures
        None unless both the direct and the indirect method are there.
    systematic
        None without positions, or where they cannot be tested.
    mistyped
        Control points that contradict the others; the search for systematic errors leaves them out.
    slips
        The typing errors that explain the wrong control points.
    """

    block: Block
    judged: tuple[Judged, ...]
    refused: tuple[tuple[Method, str], ...]
    exposures: tuple[int, Floats, Floats] | None
    systematic: SystematicErrors | None
    separation: Separation | None
    plausibility: tuple[Finding, ...]
    mistyped: tuple[Mistyped, ...] = ()
    slips: Slips = no_slips

    def __repr__(self) -> str:
        """Say the errors at the ground points by each method, or why there are none."""
        lines = [f"{self.block.name}: {len(self.block.images.names)} images, product minus reference, m"]
        for judged in self.judged:
            method = judged.result.method
            for group in judged.differences:
                rms = " ".join(f"{value:.3f}" for value in group.rmse)
                lines.append(f"  {method}: {len(group.names)} {group.role} points, rms X Y Z {rms}")
            lines += [f"  {method}: no ground points"] * (not judged.differences)
        return "\n".join([*lines, *(f"  {method}: {reason}" for method, reason in self.refused)])

    def of(self, method: Method) -> Judged | None:
        """Give one method's result; None where the block does not allow it."""
        return next((judged for judged in self.judged if judged.result.method == method), None)


@on_one_thread
def check_block(
    block: Block,
    standards: tuple[Standard, ...],
    question: Question,
    simulate: tuple[Degradation, np.random.Generator] | None = None,
    done: Callable[[str], None] = lambda _: None,
    *,
    on_the_job: bool = False,
    known: SearchedBlock | None = None,
) -> BlockCheck:
    """Georeference a block three ways and judge it at its ground points.

    on_the_job: whether camera and mounting of the direct method are those of the integrated one, not those
        that the block states; they always are where it leaves some of them open.
    known: the block adjusted before: what a method would adjust again is taken from there.

    raises IllPosedError: when no method can be computed; the message has what was found in the ground points.
    """
    plausibility = ground_findings(block)
    done("plausibility")
    places, typed = block.points.values, block
    try:
        block = with_attitude_angles(checkable(in_local_frame(with_shutters(block))))
    except PhotocalError as refusal:
        raise type(refusal)(_with_findings(str(refusal), plausibility), where=block.name) from refusal
    if known is not None and not is_adjustment_of(known.adjusted, typed, block):
        known = None
    judged, refused = dict[Method, Judged](), dict[Method, str]()
    # A flight that is its own calibration takes it from the integrated method, and so does a block that
    # leaves camera or mounting open: start values are not known values.
    for method in ("integrated", "direct", "indirect"):
        try:
            source, note = block, ""
            if method == "direct" and simulate is not None:
                source, note = degraded(block, *simulate), simulate[0].note
            calibrates = on_the_job or leaves_open(source)
            own = judged["integrated"].result.calibration if calibrates and "integrated" in judged else None
            near = judged["integrated"].result if "integrated" in judged else None
            if known is not None and method == stands_for(block):
                result = as_adjusted(source, method, known.adjusted)
            else:
                result = of_method(source, method, note, own if method == "direct" else None, near)
            judged[method] = _judge(source, places, result, standards, question)
        except PhotocalError as refusal:
            refused[method] = str(refusal)
        done(method)
    # The minimum of the method is that of the search: it has the same observations.
    same: Method = "integrated" if len(block.positions.image) else "indirect"
    near = next((judged[method].result for method in (same, "integrated") if method in judged), None)
    shared = known is not None and near is not None and near.adjusted is known.adjusted.minimum
    systematic, apart = causes_of(block, near, found=known.causes if known is not None and shared else None)
    to_given = (lambda local: local) if typed.frame == "local" else block_frame(typed).to_given
    slips = typed_slips(typed, block.points.names, block.points.values, to_given)
    mistyped = mistyped_of(systematic, slips)
    if not judged:
        reasons = "; ".join(f"{method}: {refused[method]}" for method in METHODS)
        wrong = "".join(f"control point {point.point} contradicts the others; " for point in mistyped)
        message = _with_findings(f"{wrong}no method can be computed: {reasons}", plausibility)
        raise IllPosedError(message, where=block.name)
    done("systematic errors")
    return BlockCheck(
        block,
        tuple(judged[method] for method in METHODS if method in judged),
        tuple((method, refused[method]) for method in METHODS if method in refused),
        exposure_difference(judged["direct"].result.exposures, judged["indirect"].result.exposures)
        if {"direct", "indirect"} <= judged.keys()
        else None,
        systematic,
        apart,
        plausibility,
        mistyped,
        slips,
    )


def _with_findings(message: str, findings: tuple[Finding, ...]) -> str:
    """A refusal together with what was found in the input: the cause stands there."""
    say = catalogue("en")
    return f"{message}. {' '.join(finding_text(finding, say) for finding in findings)}".strip()


def _judge(
    block: Block, places: Floats, result: Georeferenced, standards: tuple[Standard, ...], question: Question
) -> Judged:
    """Judge one method; maps show the points at their places as given."""
    index = {name: k for k, name in enumerate(block.points.names)}

    def at_given_places(role: Role) -> Differences:
        """Differences with the coordinates that the block has, not those of the local frame."""
        group = differences(block, result, role)
        return replace(group, xyz=places[np.array([index[name] for name in group.names], dtype=np.int64)])

    check = at_given_places("check")
    if question.gsd_m is None:
        question = replace(question, gsd_m=_ground_pixel(block, result))
    assessment = assess(check.discrepancies(), standards, question) if len(check.names) else None
    if assessment is not None:
        # Its t takes points as independent; those of a block share most errors: the joint test judges.
        components = tuple(replace(component, bias=None) for component in assessment.components)
        assessment = replace(assessment, components=components)
    return Judged(result, at_given_places("control"), check, assessment)


def _ground_pixel(block: Block, result: Georeferenced) -> float | None:
    """Median size of a pixel at the check points, m; None where the method has no exposures."""
    place = np.full((len(block.points.names), 3), np.nan)
    place[result.points] = result.xyz
    place[~block.points.of_role("check")] = np.nan
    seen, camera = block.observations, block.images.camera[block.observations.image]
    per_metre = np.array([interior.pitch[0] / interior.value("c") for interior in block.cameras])[camera]
    size = per_metre * np.linalg.norm(result.exposures[seen.image, 3:] - place[seen.point], axis=1)
    return float(np.nanmedian(size)) if np.isfinite(size).any() else None
