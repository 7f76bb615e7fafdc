"""The whole check of a block: three methods side by side, systematic errors, what cannot be separated."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.accuracy.assessment import Assessment, assess
from photocal.accuracy.standard import Question, Standard
from photocal.adjustment.envelope import on_one_thread
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, PhotocalError
from photocal.base.policy import policy
from photocal.block.model import Block, Role
from photocal.block.network import block_frame
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text
from photocal.georeferencing.causes import Mistyped, causes_of, mistyped_of, typed_slips
from photocal.georeferencing.differences import (
    Differences,
    ExposureDifference,
    differences,
    exposure_difference,
)
from photocal.georeferencing.direct import leaves_open
from photocal.georeferencing.ground_mistakes import ground_findings
from photocal.georeferencing.local import in_local_frame, with_attitude_angles
from photocal.georeferencing.methods import (
    METHODS,
    Degradation,
    Georeferenced,
    Method,
    checkable,
    degraded,
    of_method,
    with_shutters,
)
from photocal.georeferencing.separation import Separation
from photocal.hypotheses.findings import Slips, no_slips
from photocal.hypotheses.search import SystematicErrors


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
    """Everything that is said about a block.

    Attributes
    ----------
    judged
        Those methods that the block allows, in the order of `METHODS`.
    exposures
        None unless both the direct and the indirect method are there.
    systematic
        None without positions, or where they cannot be tested.
    mistyped
        Control points that contradict the others; systematic errors were looked for without them.
    slips
        What names the slips of the pen that made a control point wrong.
    """

    block: Block
    judged: tuple[Judged, ...]
    refused: tuple[tuple[Method, str], ...]
    exposures: ExposureDifference | None
    systematic: SystematicErrors | None
    separation: Separation | None
    plausibility: tuple[Finding, ...]
    mistyped: tuple[Mistyped, ...] = ()
    slips: Slips = no_slips

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
) -> BlockCheck:
    """Georeference a block three ways and judge it at its ground points.

    on_the_job: whether camera and mounting of the direct method are those of the integrated one, not those
        that the block states; they always are where it leaves some of them open.

    raises IllPosedError: when no method can be computed; the message has what was found in the ground points.
    """
    plausibility = ground_findings(block)
    done("plausibility")
    places, typed = block.points.values, block
    try:
        block = with_attitude_angles(checkable(in_local_frame(with_shutters(block))))
    except PhotocalError as refusal:
        raise type(refusal)(_with_findings(str(refusal), plausibility), where=block.name) from refusal
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
            near = judged["integrated"].result.adjusted if "integrated" in judged else None
            result = of_method(source, method, note, own if method == "direct" else None, near)
            judged[method] = _judge(source, places, result, standards, question)
        except PhotocalError as refusal:
            refused[method] = str(refusal)
        done(method)
    # The minimum of the method is that of the search: it has the same observations.
    same = "integrated" if len(block.positions.image) else "indirect"
    systematic, apart = causes_of(block, judged[same].result.adjusted if same in judged else None)
    to_given = (lambda local: local) if typed.frame == "local" else block_frame(typed).to_given
    slips = typed_slips(typed, block.points.names, block.points.values, to_given)
    mistyped = mistyped_of(systematic, slips)
    if coarsely_placed(block):
        systematic = None
    if not judged:
        reasons = "; ".join(f"{method}: {refused[method]}" for method in METHODS)
        wrong = "".join(f"; control point {point.point} contradicts the others" for point in mistyped)
        message = _with_findings(f"no method can be computed: {reasons}{wrong}", plausibility)
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


def coarsely_placed(block: Block) -> bool:
    """Whether nothing but navigation fixes, as pictures state them, places a block."""
    sigma = block.images.sigma[:, 3:]
    stated = sigma[np.isfinite(sigma).all(axis=1) & (sigma > 0.0).all(axis=1)]
    none_else = not len(block.positions.image) and not block.points.of_role("control").any()
    return bool(none_else and len(stated) and np.median(stated[:, :2]) > policy.coarse_m)
