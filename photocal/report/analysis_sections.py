"""Sections of a certificate about the analysis: hidden errors, significance, correlations, method."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from photocal.analysis.correlation import ExteriorCorrelation, StrongCorrelation
from photocal.analysis.estimates import Components, FTest
from photocal.analysis.outcome import Analysis, CameraAnalysis, Effect, Opinions
from photocal.analysis.published import PublishedSet
from photocal.analysis.shutters import OF_SHUTTERS
from photocal.base.arrays import Floats
from photocal.findings.digits import Number, decimals_of, power_of_ten, symbol
from photocal.findings.document import Column, Paragraph, Piece, Section, TablePart, columns, said_table
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, finding_text, need_words, remedy_text, sentence
from photocal.findings.verdict import by_methods
from photocal.geometry.camera import Camera
from photocal.report.camera_sections import unit_of
from photocal.report.stored_analysis import AnalysedRun


def hidden_errors(run: AnalysedRun, say: Catalogue) -> Section:
    """List the hidden systematic errors, worst first, or say that nobody looked for them."""
    title = say("analysis.hidden")
    if run.analysis is None:
        return Section(title, (Paragraph(say("analysis.not_made")),))
    pieces: list[Piece] = [Paragraph(say("analysis.hidden_text"))]
    # What an adjustment estimates is not hidden.
    findings = [finding for finding in run.analysis.findings if finding.code not in OF_SHUTTERS]
    if findings:
        rows = (
            (say("analysis.small" if finding.small else "analysis.large"), finding_text(finding, say))
            for finding in findings
        )
        heads = ("grade<", "finding<")
        pieces.append(said_table(say, "analysis.hidden_table", heads, rows, widths=(0.14, 0.86)))
    else:
        pieces.append(Paragraph(say("analysis.none_found")))
    pieces.append(Paragraph(_sigma(run, run.analysis, say)))
    return Section(title, tuple(pieces))


def _sigma(run: AnalysedRun, analysis: Analysis, say: Catalogue) -> str:
    camera = next(iter(run.result.cameras.values()))
    scale, unit = (1e3, "µm") if camera.unit == "mm" else (1.0, "px")
    sigma = analysis.observation_sigma
    figures = {
        name: say.significant(scale * getattr(sigma, name), 3)
        for name in ("assumed", "found", "lower", "upper")
    }
    return say("analysis.sigma", unit=unit, **figures)


def parameters(title: str, camera_id: str, run: AnalysedRun, analysis: Analysis, say: Catalogue) -> Section:
    """Judge the parameters of one camera: tests, correlations, components, left out, jackknife."""
    record, camera = analysis.cameras[camera_id], run.result.cameras[camera_id]
    if record is None:
        return Section(title, (Paragraph(say("analysis.none_found")),))
    effects = {effect.parameters: effect for effect in record.effects}
    caption = say("analysis.parameters_table", alpha=say.significant(analysis.alpha, 2))
    note = say("analysis.parameters_note", factor=say.significant(record.variance_factor_of_tests, 4))
    tests = _tests(record.significance, effects, say)
    pieces: list[Piece] = [replace(tests, caption=caption, note=note, dense=True)]
    pairs: list[StrongCorrelation | ExteriorCorrelation] = [*record.correlations]
    pairs += record.correlations_with_exterior
    pieces += _correlations(pairs, analysis.correlation_threshold, say)
    pieces += _components(record, say)
    if record.left_out:
        pieces.append(_left_out(record, camera, say))
    jackknife = analysis.jackknife.get(camera_id)
    if jackknife is not None:
        pieces.append(_jackknife(jackknife, camera, say))
    return Section(title, tuple(pieces))


def _tests(tests: Iterable[FTest], effects: Mapping[tuple[str, ...], Effect], say: Catalogue) -> TablePart:
    heads = ["tested<", "kind<", "statistic", "critical", "significant="]
    heads += ["effect [px]", "remaining [px]"] if effects else []
    rows = []
    for test in tests:
        row = [
            " ".join(symbol(name) for name in test.parameters),
            say(f"test.{test.kind}"),
            say.significant(test.statistic, 4) if math.isfinite(test.statistic) else "∞",
            say.fixed(test.critical, 2),
            say("word.yes" if test.significant else "word.no"),
        ]
        # What a group of one says was said by the single test.
        effect = None if test.kind == "cumulative" else effects.get(test.parameters)
        if effects:
            px = (effect.largest_px, effect.remaining_largest_px) if effect else (math.nan,) * 2
            blank = say("word.none") if effect else ""
            row += [say.fixed(v, 2) if math.isfinite(v) else blank for v in px]
        rows.append(tuple(row))
    return TablePart("", columns(say, "analysis", *heads), tuple(rows))


def _correlations(
    pairs: Iterable[StrongCorrelation | ExteriorCorrelation], threshold: float, say: Catalogue
) -> list[TablePart]:
    rows = []
    for p in pairs:
        if isinstance(p, StrongCorrelation):
            pair, where = f"{symbol(p.first)}–{symbol(p.second)}", ""
        else:
            pair = f"{symbol(p.parameter)}–{symbol(p.element)}"
            where = say("console.in_images", image=p.image, images=p.images) + ": "
        rows.append((pair, say.fixed(p.value, 3), where + say(f"cause.{p.cause}")))
    if not rows:
        return []
    heads, limit = ("pair<", "value", "cause<"), say.as_given(threshold)
    return [said_table(say, "analysis.causes", heads, rows, widths=(0.12, 0.1, 0.78), threshold=limit)]


def _components(record: CameraAnalysis, say: Catalogue) -> list[Piece]:
    final = record.components.final
    heads = ("component<", "eigenvalue", "share [%]", "cumulative [%]")
    rows = (
        (str(n), say.fixed(value, 4), say.fixed(share, 2), say.fixed(total, 2))
        for n, (value, share, total) in enumerate(
            zip(final.eigenvalues, final.percent, final.cumulative_percent, strict=True), start=1
        )
    )
    remarks = " ".join(finding_text(remark, say) for remark in record.components.remarks)
    return [said_table(say, "analysis.components", heads, rows), Paragraph(remarks)]


def _left_out(record: CameraAnalysis, camera: Camera, say: Catalogue) -> TablePart:
    heads = (f"change_of_c [{camera.unit}]", "variance_factor", "rmse [mm]")
    none, sigma = say("word.none"), camera.sigma_of("c")
    # An adjustment without a parameter ends within a hundredth of a standard deviation: no digit says more.
    decimals = max(decimals_of(sigma, 3), 0) if sigma > 0.0 else 3
    rows = (
        (
            symbol(left.parameter),
            say.fixed(left.c, decimals),
            say.fixed(left.change_of_c, decimals),
            say.significant(left.sigma0_squared, 4) if math.isfinite(left.sigma0_squared) else none,
            _checks(left.check_rmse_m, say),
        )
        for left in record.left_out
    )
    return said_table(say, "analysis.left_out", ("without<", Column("c", camera.unit), *heads), rows)


def _checks(rmse_m: Floats | tuple[float, ...] | None, say: Catalogue) -> str:
    return say("word.none") if rmse_m is None else "; ".join(say.fixed(1e3 * v, 1) for v in rmse_m)


def _jackknife(record: Opinions, camera: Camera, say: Catalogue) -> TablePart:
    columns = [record.standard_error, record.standard_error_corrected, record.sandwich]
    columns += [] if record.bootstrap is None else [record.bootstrap]
    heads = (
        "parameter<",
        "formal",
        *("error", "corrected", "sandwich", "bootstrap")[: len(columns)],
        "unit<",
    )

    def row(name: str) -> tuple[str, ...]:
        """Write standard deviations with three digits, in the unit of the table of parameters."""
        formal = camera.sigma_of(name)
        exponent = say.measured(camera.value(name), formal)[2]
        sigmas = (
            say.significant(v / 10.0**exponent, 3) if math.isfinite(v) else say("word.none")
            for v in (formal, *(of[name] for of in columns))
        )
        return symbol(name), *sigmas, unit_of(camera, name, exponent)

    rows = map(row, record.standard_error)
    note = say("analysis.jackknife_note", count=len(record.left_out))
    return said_table(say, "analysis.jackknife", heads, rows, note)


def method_check(analysis: Analysis, say: Catalogue) -> Section:
    """Say what each method of calibration asks for and what the network has."""
    heads = ("method_name<", "requirement<", "found<", "needed<", "met<")
    rows, advice = [], list[str]()
    for method in analysis.methods:
        for need in method.requirements:
            words = need_words(need.code, need.figures, say)
            name = say(f"calibration_method.{method.method}")
            met = say("word.yes" if need.severity == "passed" else "word.no")
            rows.append((name, words["name"], words["found"], words["needed"], met))
            if need.severity != "passed" and words["advice"] not in advice:
                advice.append(words["advice"])
    widths = (0.17, 0.27, 0.22, 0.24, 0.1)
    table = said_table(say, "analysis.method_table", heads, rows, widths=widths, dense=True)
    kept = {True: say("analysis.satisfied"), False: say("analysis.not_satisfied")}
    named = ((say(f"calibration_method.{method.method}"), kept[method.met]) for method in analysis.methods)
    methods = "; ".join(": ".join(pair) for pair in named)
    pieces: list[Piece] = [Paragraph(say("analysis.method_text")), table, Paragraph(methods)]
    if advice:
        pieces.append(Paragraph(say("analysis.advice", advice="; ".join(advice))))
    return Section(say("analysis.method"), tuple(pieces))


def calibrated(run: AnalysedRun, say: Catalogue) -> list[Section]:
    """Values of each camera with the standard deviations that are stated."""
    listed = []
    for name, camera in run.result.cameras.items():
        rows = []
        for key in camera.free:
            sigma, whose = run.stated(name, key)
            value, spread, exponent = say.measured(camera.value(key), sigma)
            unit = power_of_ten(exponent, camera.unit if key in ("c", "x0", "y0") else "")
            rows.append((symbol(key), value, spread, unit, say(f"whose.{whose}")))
        heads = columns(say, "analysis", "parameter<", "estimate", "formal", "unit<", "of<")
        listed.append(Section(name, (TablePart("", heads, tuple(rows)),) if rows else ()))
    return listed


def analysed(run: AnalysedRun, say: Catalogue) -> list[Section]:
    """Everything that is known of a run by its analysis."""
    hidden, analysis = hidden_errors(run, say), run.analysis
    if analysis is None:
        return [hidden]
    told = (finding_text(one, say) for one in analysis.findings if one.code in OF_SHUTTERS)
    sections = [replace(hidden, pieces=(*hidden.pieces, *map(Paragraph, told)))]
    for name, camera in run.result.cameras.items():
        if analysis.cameras[name] is not None:
            section = parameters(f"{say('analysis.parameters')}: {name}", name, run, analysis, say)
            more = (*_lenses(camera, analysis, say), *_within(camera, analysis, say))
            sections.append(replace(section, pieces=(*section.pieces, *more)))
    return [*sections, method_check(analysis, say)]


def _lenses(camera: Camera, analysis: Analysis, say: Catalogue) -> list[TablePart]:
    """Models of the lens that were compared; of one that is no better, no images were left out."""
    none = say("word.none")
    heads = ("lens_model<", "terms<", "chi_squared", "left_out_sigma")
    more = (f"change_of_c [{camera.unit}]", "rmse [mm]")
    rows = tuple(
        (
            fit.model,
            " ".join(map(symbol, fit.terms)),
            say.fixed(fit.chi_squared, 1),
            say.fixed(fit.left_out, 3) if math.isfinite(fit.left_out) else none,
            say.significant(fit.change_of_c, 4) if math.isfinite(fit.change_of_c) else none,
            _checks(fit.check_rmse_m, say),
        )
        for fit in analysis.lens_models[camera.id]
    )
    return [said_table(say, "analysis.lenses", (*heads, *more), rows)] if len(rows) > 1 else []


def _within(camera: Camera, analysis: Analysis, say: Catalogue) -> list[TablePart]:
    """c, x0 and y0 in the thirds of the flight, against the first one."""
    judged = analysis.cameras[camera.id]

    def change(amount: float, sigma: float) -> str:
        """Write a change with its standard deviation."""
        return f"{Number(amount, say.mark):+.3g} ± {Number(sigma, say.mark):.2g}"

    rows = tuple(
        (
            symbol(parameter.parameter),
            *(change(amount, sigma) for amount, sigma in parameter.parts[1:]),
            f"{Number(parameter.p_value, say.mark):.2g}",
            "; ".join(
                say(f"course.{key}") + f" {change(amount, sigma)}"
                for key, (amount, sigma, _) in parameter.drifts.items()
            ),
        )
        for parameter in (judged.within_flight if judged else ())
    )
    heads = ("parameter<", "second", "third", "p_value", "course<")
    return [said_table(say, "analysis.within", heads, rows, unit=camera.unit)] if rows else []


def published(sets: Iterable[PublishedSet], threshold: float, say: Catalogue) -> list[Section]:
    """Tests, strong correlations and principal components of published sets."""
    sections = []
    for one in sets:
        tables: list[Piece] = [_tests(one.tests, {}, say)] if one.tests else []
        tables += _correlations(one.correlations, threshold, say)
        if one.components is not None:
            tables.append(_loadings(one, one.components, say))
        remarks = [*(one.removal.remarks if one.removal else ()), *([one.one_angle] if one.one_angle else [])]
        if remarks:
            tables.append(Paragraph(" ".join(finding_text(remark, say) for remark in remarks)))
        test = one.global_test
        if test is not None:
            figures = {"chi_squared": test.chi_squared, "critical": test.critical}
            verdict = "accepted" if test.accepted else "rejected"
            tables.append(Paragraph(say(f"published.global_{verdict}", **figures)))
        sections.append(Section(say("published.set", name=one.name) if one.name else "", tuple(tables)))
    return sections


def _loadings(one: PublishedSet, components: Components, say: Catalogue) -> TablePart:
    """Eigenvalues, their shares, values, and the correlation of each parameter with each component (MCCP)."""
    values = one.component_values
    heads = (Column("", align="left"), *(Column(f"Y{k + 1}") for k in range(len(components.names))))
    rows = (
        (say("published.eigenvalue"), components.eigenvalues, 4),
        (say("published.percent"), components.percent, 2),
        (say("published.cumulative"), components.cumulative_percent, 2),
        *(() if values is None else ((say("published.value"), values, 2),)),
        *((symbol(name), row, 2) for name, row in zip(components.names, components.loadings, strict=True)),
    )
    texts = ((label, *(say.fixed(v, digits) for v in values)) for label, values, digits in rows)
    return said_table(say, "analysis.components", heads, texts)


def warning_sections(findings: tuple[Finding, ...], verdict: str, say: Catalogue) -> list[Section]:
    """List warnings and notes, but for those that the verdict has in full."""
    tables, once = [], by_methods(findings)
    for kind in ("warning", "note"):
        every = [f for f in once if (f.severity == "note") == (kind == "note")]
        # The first remedy stands in the paragraph, before its line.
        further = [f for f in every if not (sentence(f, say) in verdict and remedy_text(f, say) in verdict)]
        texts = [finding_text(f, say) for f in further]
        heads = (Column(""), *columns(say, "warnings", f"{kind}<"))
        rows = tuple((str(n), text) for n, text in enumerate(texts, start=1))
        if rows:
            caption = say(f"warnings.table_{kind}" if len(texts) == len(every) else "warnings.table_further")
            tables.append(TablePart(caption, heads, rows, widths=(0.06, 0.94)))
    return [Section(say("warnings.section"), tuple(tables))] if tables else []
