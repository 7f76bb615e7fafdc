"""The certificate of a calibration: from the results of an adjustment to a printable document."""

import hashlib
import math
from collections.abc import Iterable

from photocal.base.errors import InputMalformedError
from photocal.block.results.result import Result
from photocal.findings.digits import relation
from photocal.findings.document import Document, Highlight, KeyValues, Piece, Section, Statement, Tone
from photocal.findings.finding import Finding, of_global_test
from photocal.findings.texts import Catalogue, finding_text, identity
from photocal.findings.verdict import Verdict, judge, verdict_text
from photocal.report import analysis_sections, block_sections, camera_sections, required_sections
from photocal.report.certificate_metadata import Metadata
from photocal.report.derived_figures import DerivedFigures, derived_figures
from photocal.report.derived_figures import verdict as keeps
from photocal.report.ministry_rows import Context
from photocal.report.sensor import sensor_residuals
from photocal.report.stored_analysis import AnalysedRun

WORDS = ("table", "figure", "page", "of", "contents")
# What nobody looked for is not known to be absent.
_NOT_ANALYSED = Finding("not-analysed", "doubtful")


def certificate(
    run: AnalysedRun, particulars: Metadata, say: Catalogue, warnings: tuple[Finding, ...] = ()
) -> Document:
    """Compose the certificate."""
    cameras = run.result.cameras
    calibrated = any(camera.free for camera in cameras.values())
    known = tuple(derived_figures(run, camera_id, particulars) for camera_id in cameras)
    _refuse_impossible(known, say)
    number = certificate_number(run, particulars, warnings)
    sections = _sections(run, particulars, known, warnings, number, say)
    limited = known if particulars.document.form else ()
    verdicts = _verdicts(run, known, limited, warnings, say)
    told = " ".join((verdicts[0].text, *verdicts[0].lines))
    return Document(
        language=say.language,
        title=say("title.certificate"),
        subtitle=say("title.subtitle" if calibrated else "title.subtitle_held", cameras=", ".join(cameras)),
        number=number,
        facts=_facts(run, particulars, number, say),
        highlights=_highlights(run, warnings, say),
        verdicts=verdicts,
        sections=(*analysis_sections.warning_sections(warnings, told, say), *sections),
        words={word: say(f"word.{word}") for word in WORDS},
    )


def certificate_number(run: AnalysedRun, particulars: Metadata, warnings: tuple[Finding, ...] = ()) -> str:
    """Make a certificate's number from date, inputs, software and particulars, in whatever language."""
    software = run.result.software
    files = (f"{f.path} {f.sha256}" for f in run.result.inputs)
    content = [f"{software.name} {software.version}", *files, repr(particulars), *map(identity, warnings)]
    digest = hashlib.sha256("\n".join(content).encode()).hexdigest()
    return f"PC-{particulars.date:%Y%m%d}-{digest[:8].upper()}"


def _facts(run: AnalysedRun, particulars: Metadata, number: str, say: Catalogue) -> KeyValues:
    software = run.result.software
    rows = [
        (say("title.number"), number),
        (say("title.date"), say.date(particulars.date)),
        (say("title.client"), particulars.document.client),
        (say("title.operator"), particulars.document.operator),
        (say("title.block"), run.result.block.name),
        (say("title.software"), f"{software.name} {software.version}"),
    ]
    return KeyValues(tuple((label, value) for label, value in rows if value))


def _highlights(run: AnalysedRun, warnings: tuple[Finding, ...], say: Catalogue) -> tuple[Highlight, ...]:
    cameras = run.result.cameras
    several = len(cameras) > 1
    shown: list[Highlight] = []
    for camera_id, camera in cameras.items():
        label = say("highlight.c_camera", camera=camera_id) if several else say("highlight.c")
        sigma, whose = run.stated(camera_id)
        c, printed, _ = say.measured(camera.value("c"), sigma)
        remark = say("highlight.sigma", sigma=printed, unit=camera.unit) if printed else say("word.held")
        if printed and (whose == "at_least" or sigma > camera.sigma_of("c")):
            formal = say.significant(camera.sigma_of("c"), 2)
            remark += say(f"highlight.sigma_{whose}", formal=formal, unit=camera.unit)
        shown.append(Highlight(label, f"{c} {camera.unit}", remark))
    if not several:
        shown.append(_principal_point(run, next(iter(cameras)), say))
    shown += [_residuals(run, say), _network(run, say)]
    return (*shown, _test(run, warnings, say), _checks(run, say))


def _test(run: AnalysedRun, warnings: tuple[Finding, ...], say: Catalogue) -> Highlight:
    test, judged = run.result.global_test, tested(run.result, warnings)
    if test is None or judged.severity == "untested":
        key = "untested" if run.result.degrees_of_freedom < 1 else "unclaimed"
        return Highlight(say("highlight.test"), say(f"highlight.{key}"), say(f"highlight.{key}_remark"))
    remark = say(
        "highlight.test_remark",
        chi2=say.fixed(run.result.chi_squared, 1),
        dof=run.result.degrees_of_freedom,
        p=relation(test.p_value, say.mark),
    )
    key = "accepted" if test.accepted else "equivalent" if judged.severity == "passed" else "refused"
    return Highlight(say("highlight.test"), say(f"highlight.{key}"), remark)


def _principal_point(run: AnalysedRun, camera_id: str, say: Catalogue) -> Highlight:
    camera = run.result.cameras[camera_id]
    (x, sigma_x, _), (y, sigma_y, _) = (
        say.measured(camera.value(n), run.stated(camera_id, n)[0]) for n in ("x0", "y0")
    )
    remark = say("word.held")
    if sigma_x and sigma_y:
        remark = say("highlight.x0y0_sigma", x=sigma_x, y=sigma_y, unit=camera.unit)
    return Highlight(say("highlight.x0y0"), f"{x}; {y} {camera.unit}", remark)


def _residuals(run: AnalysedRun, say: Catalogue) -> Highlight:
    parts = [sensor_residuals(run, camera_id) for camera_id in run.result.cameras]
    rays = sum(len(part.place) for part in parts)
    squares = [(len(part.place), *camera_sections.rms_px(part)) for part in parts]
    x, y = (math.sqrt(sum(s[0] * s[i] ** 2 for s in squares) / max(rays, 1)) for i in (1, 2))
    both = math.sqrt((x**2 + y**2) / 2)
    remark = say("highlight.rms_remark", x=say.fixed(x, 3), y=say.fixed(y, 3), rays=rays)
    return Highlight(say("highlight.rms"), f"{say.fixed(both, 3)} px", remark)


def _network(run: AnalysedRun, say: Catalogue) -> Highlight:
    result = run.result
    remark = say("highlight.network_remark", points=len(result.points.names), dof=result.degrees_of_freedom)
    text = say("highlight.network_value", images=len(result.images))
    return Highlight(say("highlight.network"), text, remark)


def _checks(run: AnalysedRun, say: Catalogue) -> Highlight:
    checks = run.result.checks
    label = say("highlight.checks")
    if checks.n == 0:
        return Highlight(label, say("highlight.checks_none"), say("highlight.checks_none_remark"))
    rmse = {axis: 1e3 * (checks.rmse_m[axis] or 0.0) for axis in "xyz"}
    axes = {axis: say.fixed(value, 1) for axis, value in rmse.items()}
    text = f"XY {say.fixed(math.hypot(rmse['x'], rmse['y']), 1)} mm; Z {axes['z']} mm"
    return Highlight(label, text, say("highlight.checks_remark", **axes, n=checks.n))


def overall(run: AnalysedRun, known: tuple[DerivedFigures, ...], warnings: tuple[Finding, ...]) -> Verdict:
    """Give the one verdict over everything that processing, adjustment and analysis found."""
    result = run.result
    analysed = (_NOT_ANALYSED,) if run.analysis is None else run.analysis.findings
    plausible = (finding for of in known for finding in of.findings)
    diverged = () if result.converged else (Finding("not-converged", "grave"),)
    # What the stages tell of the analysis is known beside all else: it counts before the analysis alone.
    found = (*diverged, *analysed, *plausible, tested(result, warnings), *warnings)
    return judged(result, found)


def certified(
    run: AnalysedRun, particulars: Metadata, say: Catalogue, warnings: tuple[Finding, ...]
) -> Verdict:
    """Give the verdict that a certificate will state, before anything of it is drawn; errors as of that."""
    known = tuple(derived_figures(run, camera_id, particulars) for camera_id in run.result.cameras)
    _refuse_impossible(known, say)
    return overall(run, known, warnings)


def judged(result: Result, findings: Iterable[Finding]) -> Verdict:
    """Judge over findings of an adjustment."""
    calibrated = any(camera.free for camera in result.cameras.values())
    return judge(findings, len(result.images), placed=result.block.datum != "free", calibrated=calibrated)


def tested(result: Result, findings: Iterable[Finding]) -> Finding:
    """Give the global test; where sigmas come from the residuals themselves it tests nothing."""
    estimated = any(finding.code == "sigmas-from-residuals" for finding in findings)
    estimated |= bool(result.variance_components)
    accepted = None if result.global_test is None else result.global_test.accepted
    return of_global_test(result.chi_squared, result.degrees_of_freedom, accepted, estimated=estimated)


def _verdicts(
    run: AnalysedRun,
    known: tuple[DerivedFigures, ...],
    limited: tuple[DerivedFigures, ...],
    warnings: tuple[Finding, ...],
    say: Catalogue,
) -> tuple[Statement, ...]:
    """The verdict with its reasons first, then what limits it; nothing is green where it is not.

    limited: of those that the ministry's limits are asked of.
    """
    given = overall(run, known, warnings)
    final = given.outcome
    tone: Tone = {"passed": "good", "doubtful": "note"}.get(final.severity, "bad")  # type: ignore[assignment]
    paragraph, *lines = verdict_text(given, say, "judgement.listed")
    # A block absorbs what its calibration takes elsewhere.
    carried = final.code == "not-usable" and given.block in ("yes", "on-positions", "reserved")
    title = say("verdict.not-carried") if carried else say(f"verdict.{final.code}")
    verdicts = [Statement(tone, title, paragraph, tuple(lines))]
    if run.result.checks.n == 0:
        verdicts.append(Statement("note", say("verdict.unchecked_title"), say("verdict.unchecked")))
    acceptable = (of for of in limited if keeps(of.limits) != "not_determined")
    return (*verdicts, *(required_sections.acceptance_statement(of, final, say) for of in acceptable))


def _sections(
    run: AnalysedRun,
    particulars: Metadata,
    known: tuple[DerivedFigures, ...],
    warnings: tuple[Finding, ...],
    number: str,
    say: Catalogue,
) -> tuple[Section, ...]:
    cameras = run.result.cameras
    several = len(cameras) > 1
    readouts = {readout.camera: readout for readout in run.result.readouts}
    facts: tuple[Piece, ...] = tuple(
        camera_sections.camera_facts(name, camera, readouts.get(name), say)
        for name, camera in cameras.items()
    )
    sections = [Section(say("camera.section"), facts), block_sections.method(say("method.section"), run, say)]
    for position, (camera_id, camera) in enumerate(cameras.items(), start=1):
        name = str(position)
        # A correlation needs two estimated parameters.
        correlated = [camera] if len(camera.free) > 1 else []

        def title(key: str, camera_id: str = camera_id) -> str:
            """Write a title, with the camera where there are several."""
            return f"{say(key)}: {camera_id}" if several else say(key)

        sections += [
            camera_sections.interior_orientation(title("iop.section"), camera_id, run, say),
            *(camera_sections.correlations(title("correlation.section"), name, c, say) for c in correlated),
            camera_sections.radial_distortion(title("distortion.section"), name, run, camera_id, say),
            camera_sections.image_residuals(title("residuals.section"), name, run, camera_id, say),
        ]
        if run.analysis is not None and run.analysis.cameras.get(camera_id) is not None:
            name = title("analysis.parameters")
            sections.append(analysis_sections.parameters(name, camera_id, run, run.analysis, say))
    sections.append(required_sections.uncertainty(say("uncertainty.section"), run, particulars, say))
    sections.append(analysis_sections.hidden_errors(run, say))
    if run.analysis is not None:
        sections.append(analysis_sections.method_check(run.analysis, say))
    return (
        *sections,
        *block_sections.relative_orientations(say("heads.section"), run, say),
        block_sections.exterior_orientation(say("eop.section"), run, say),
        block_sections.check_points(say("checks.section"), run, say),
        block_sections.global_test(say("test.section"), run, say),
        *_judgements(run, particulars, known, overall(run, known, warnings).outcome, say),
        required_sections.laboratory(say("laboratory.section"), particulars, number, say),
        *required_sections.radiometry(say("radiometry.section"), particulars, say),
        block_sections.inputs(say("inputs.section"), run, say),
        required_sections.signature(say("signature.section"), particulars, say),
    )


def _judgements(
    run: AnalysedRun, particulars: Metadata, known: tuple[DerivedFigures, ...], final: Finding, say: Catalogue
) -> list[Section]:
    """Plausibility, flown block and equipment; the ministry's limits and form where they are asked for."""

    def title(key: str, of: DerivedFigures) -> str:
        """Write a title, with the camera where there are several."""
        return f"{say(key)}: {of.camera_id}" if len(known) > 1 else say(key)

    made = required_sections
    sections = [made.findings(title("plausibility.section", of), of.findings, say) for of in known]
    limited = known if particulars.document.form else ()
    sections += [made.acceptance(title("acceptance.section", of), of, final, say) for of in limited]
    sections += made.flown_block(say("flown.section"), particulars, say)
    sections += made.equipment(say("equipment.section"), particulars, say)
    contexts = (Context(run, particulars, of, say) for of in limited)
    return sections + [made.technical_report(title("ministry.section", c.facts), c) for c in contexts]


def _refuse_impossible(known: tuple[DerivedFigures, ...], say: Catalogue) -> None:
    """A figure that cannot be right is not printed."""
    for of in known:
        refused = [finding_text(finding, say) for finding in of.findings if finding.severity == "refused"]
        if refused:
            raise InputMalformedError(
                " ".join(refused), "correct the block or the particulars", where=f"camera {of.camera_id}"
            )
