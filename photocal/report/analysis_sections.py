"""Sections of a certificate about the analysis: hidden errors, significance, correlations, method."""

import math
from collections.abc import Iterable

from photocal.analysis.outcome import Analysis, CameraAnalysis, Opinions
from photocal.findings.digits import symbol
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, finding_text, need_words
from photocal.geometry.camera import Camera
from photocal.report.document import Column, Paragraph, Piece, Section, Statement, Table, columns
from photocal.report.stored_analysis import Run


def hidden_errors(run: Run, say: Catalogue) -> Section:
    """List the hidden systematic errors, worst first, or say that nobody looked for them."""
    title = say("analysis.hidden")
    if run.analysis is None:
        return Section(title, (Paragraph(say("analysis.not_made")),))
    pieces: list[Piece] = [Paragraph(say("analysis.hidden_text"))]
    findings = run.analysis.findings
    if findings:
        heads = columns(say, "analysis", "grade<", "finding<")
        rows = tuple(
            (say("analysis.small" if finding.small else "analysis.large"), finding_text(finding, say))
            for finding in findings
        )
        pieces.append(Table(say("analysis.hidden_table"), heads, rows, widths=(0.14, 0.86)))
    else:
        pieces.append(Paragraph(say("analysis.none_found")))
    pieces.append(Paragraph(_sigma(run, run.analysis, say)))
    return Section(title, tuple(pieces))


def _sigma(run: Run, analysis: Analysis, say: Catalogue) -> str:
    camera = next(iter(run.result.cameras.values()))
    scale, unit = (1e3, "µm") if camera.unit == "mm" else (1.0, "px")
    sigma = analysis.observation_sigma
    figures = {
        name: say.significant(scale * getattr(sigma, name), 3)
        for name in ("assumed", "found", "lower", "upper")
    }
    return say("analysis.sigma", unit=unit, **figures)


def parameters(title: str, camera_id: str, run: Run, analysis: Analysis, say: Catalogue) -> Section:
    """Judge the parameters of one camera: tests, correlations, components, left out, jackknife."""
    record, camera = analysis.cameras[camera_id], run.result.cameras[camera_id]
    if record is None:
        return Section(title, (Paragraph(say("analysis.none_found")),))
    pieces: list[Piece] = [_tests(record, analysis.alpha, say)]
    pieces += _correlations(record, say)
    pieces += _components(record, say)
    if record.left_out:
        pieces.append(_left_out(record, camera, say))
    jackknife = analysis.jackknife.get(camera_id)
    if jackknife is not None:
        pieces.append(_jackknife(jackknife, camera, say))
    return Section(title, tuple(pieces))


def _tests(record: CameraAnalysis, alpha: float, say: Catalogue) -> Table:
    heads = ("tested<", "kind<", "statistic", "critical", "significant=", "effect [px]", "remaining [px]")
    effects = {effect.parameters: effect for effect in record.effects}
    rows = []
    for test in record.significance:
        # What a group of one says was said by the single test.
        effect = None if test.kind == "cumulative" else effects.get(test.parameters)
        px = (effect.largest_px, effect.remaining_largest_px) if effect else (math.nan,) * 2
        blank = say("word.none") if effect else ""
        rows.append(
            (
                " ".join(symbol(name) for name in test.parameters),
                say(f"test.{test.kind}"),
                say.significant(test.statistic, 4) if math.isfinite(test.statistic) else "∞",
                say.fixed(test.critical, 2),
                say("word.yes" if test.significant else "word.no"),
                *(say.fixed(v, 2) if math.isfinite(v) else blank for v in px),
            )
        )
    title = say("analysis.parameters_table", alpha=say.significant(alpha, 2))
    note = say("analysis.parameters_note", factor=say.significant(record.variance_factor_of_tests, 4))
    return Table(title, columns(say, "analysis", *heads), tuple(rows), note, dense=True)


def _correlations(record: CameraAnalysis, say: Catalogue) -> list[Table]:
    rows = [
        (f"{symbol(p.first)}–{symbol(p.second)}", say.fixed(p.value, 2), say(f"cause.{p.cause}"))
        for p in record.correlations
    ]
    for p in record.correlations_with_exterior:
        where = say("console.in_images", image=p.image, images=p.images)
        pair = f"{symbol(p.parameter)}–{symbol(p.element)}"
        rows.append((pair, say.fixed(p.value, 2), f"{where}: {say(f'cause.{p.cause}')}"))
    if not rows:
        return []
    heads = columns(say, "analysis", "pair<", "value", "cause<")
    return [Table(say("analysis.causes"), heads, tuple(rows), widths=(0.12, 0.1, 0.78))]


def _components(record: CameraAnalysis, say: Catalogue) -> list[Piece]:
    final = record.components.final
    heads = columns(say, "analysis", "component<", "eigenvalue", "share [%]", "cumulative [%]")
    rows = tuple(
        (str(n), say.fixed(value, 4), say.fixed(share, 2), say.fixed(total, 2))
        for n, (value, share, total) in enumerate(
            zip(final.eigenvalues, final.percent, final.cumulative_percent, strict=True), start=1
        )
    )
    remarks = " ".join(finding_text(remark, say) for remark in record.components.remarks)
    return [Table(say("analysis.components"), heads, rows), Paragraph(remarks)]


def _left_out(record: CameraAnalysis, camera: Camera, say: Catalogue) -> Table:
    first, *others = columns(
        say, "analysis", "without<", f"change_of_c [{camera.unit}]", "variance_factor", "rmse [mm]"
    )
    none = say("word.none")
    rows = tuple(
        (
            symbol(left.parameter),
            say.significant(left.c, 7),
            say.significant(left.change_of_c, 3),
            say.significant(left.sigma0_squared, 4) if math.isfinite(left.sigma0_squared) else none,
            none
            if left.check_rmse_m is None
            else "; ".join(say.fixed(1e3 * v, 1) for v in left.check_rmse_m),
        )
        for left in record.left_out
    )
    return Table(say("analysis.left_out"), (first, Column("c", camera.unit), *others), rows)


def _jackknife(record: Opinions, camera: Camera, say: Catalogue) -> Table:
    heads = ["parameter<", "formal", "error", "corrected", "sandwich"]
    heads += [] if record.bootstrap is None else ["bootstrap"]

    def small(value: float) -> str:
        # Coefficients have any power of ten: three digits and the exponent, as Python writes them.
        return f"{value:.3g}".replace(".", say.mark) if math.isfinite(value) else say("word.none")

    rows = tuple(
        (
            symbol(name),
            small(camera.sigma_of(name)),
            small(error),
            small(record.standard_error_corrected[name]),
            small(record.sandwich[name]),
            *([] if record.bootstrap is None else [small(record.bootstrap[name])]),
        )
        for name, error in record.standard_error.items()
    )
    note = say("analysis.jackknife_note", count=len(record.left_out))
    return Table(say("analysis.jackknife"), columns(say, "analysis", *heads), rows, note)


def method_check(analysis: Analysis, say: Catalogue) -> Section:
    """Say what each method of calibration asks for and what the network has."""
    heads = columns(say, "analysis", "method_name<", "requirement<", "found<", "needed<", "met<")
    rows, advice = [], list[str]()
    for method in analysis.methods:
        for need in method.requirements:
            words = need_words(need.code, need.figures, say)
            name = say(f"calibration_method.{method.method}")
            met = say("word.yes" if need.severity == "passed" else "word.no")
            rows.append((name, words["name"], words["found"], words["needed"], met))
            if need.severity != "passed" and words["advice"] not in advice:
                advice.append(words["advice"])
    table = Table(
        say("analysis.method_table"), heads, tuple(rows), widths=(0.17, 0.27, 0.22, 0.24, 0.1), dense=True
    )
    pieces: list[Piece] = [Paragraph(say("analysis.method_text")), table]
    if advice:
        pieces.append(Paragraph(say("analysis.advice", advice="; ".join(advice))))
    return Section(say("analysis.method"), tuple(pieces))


def warned(findings: Iterable[Finding], title: str, text: str, say: Catalogue) -> list[Statement]:
    """Say at the head of a document that there are findings which are not small, if there are."""
    large = [finding for finding in findings if not finding.small]
    if not large:
        return []
    return [Statement("bad", say(title), say(text, count=len(large), first=finding_text(large[0], say)))]


def warning_sections(findings: tuple[Finding, ...], say: Catalogue) -> list[Section]:
    """List warnings and notes."""
    tables = []
    for kind in ("warning", "note"):
        texts = [finding_text(f, say) for f in findings if (f.severity == "note") == (kind == "note")]
        heads = (Column(""), *columns(say, "warnings", f"{kind}<"))
        rows = tuple((str(n), text) for n, text in enumerate(texts, start=1))
        if rows:
            tables.append(Table(say(f"warnings.table_{kind}"), heads, rows, widths=(0.06, 0.94)))
    return [Section(say("warnings.section"), tuple(tables))] if tables else []
