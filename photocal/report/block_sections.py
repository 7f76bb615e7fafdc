"""Sections of a certificate about the adjustment as a whole: method, orientations, checks, test, inputs."""

import math
from collections import Counter

import numpy as np

from photocal.base.arrays import Floats
from photocal.block.results.result import CENTRES, TURNS
from photocal.findings.digits import decimals_of, probability, symbol
from photocal.findings.document import (
    Column,
    KeyValues,
    Paragraph,
    PicturePart,
    Piece,
    Section,
    TablePart,
    said_table,
)
from photocal.findings.texts import Catalogue
from photocal.report.camera_sections import ROWS
from photocal.report.figures import difference_histograms, difference_map
from photocal.report.sensor import RADIAL
from photocal.report.stored_analysis import AnalysedRun

ARCSECONDS = 3600.0


def method(title: str, run: AnalysedRun, say: Catalogue) -> Section:
    """Say how the calibration was done and from what."""
    result = run.result
    models = sorted({camera.model for camera in result.cameras.values()})
    texts = [say("method.text"), *(say(f"method.model_{m.removeprefix('brown-')}") for m in models)]
    pieces: list[Piece] = [Paragraph(" ".join([*texts, _terms(run, say)])), _block_facts(run, say)]
    heads = ("group<", "group_n", "group_chi2", "group_redundancy", "group_factor")
    rows = tuple(
        (
            say(f"group.{g.name}") if f"group.{g.name}" in say.messages else g.name,
            str(g.observations),
            say.fixed(g.chi_squared, 2),
            say.fixed(g.redundancy, 1),
            say.fixed(g.chi_squared / g.redundancy, 3) if g.redundancy > 0.0 else say("word.none"),
        )
        for g in result.groups
    )
    if rows:
        pieces.append(said_table(say, "method.groups", heads, rows))
    return Section(title, tuple(pieces))


def _terms(run: AnalysedRun, say: Catalogue) -> str:
    """The polynomial of the distortion with the terms that some camera of the block has."""
    cameras = [camera for camera in run.result.cameras.values() if not camera.lens.relative]
    if not cameras:
        return ""
    used = {name for camera in cameras for name in camera.used}
    balanced = any(camera.reference_radius for camera in cameras)
    radial = [
        f"{symbol(name)} {f'(r{power} − R₀{power})' if balanced else f'r{power}'}"
        for name, power in zip(RADIAL, "²⁴⁶⁸", strict=True)
        if name in used
    ]
    swell = [f"{symbol(name)} r{power}" for name, power in (("P3", "²"), ("P4", "⁴")) if name in used]
    decentring = {"x": "P₁ (r² + 2x²) + 2 P₂ x y", "y": "P₂ (r² + 2y²) + 2 P₁ x y"}
    sums = {}
    for axis, text in decentring.items():
        parts = [f"{axis} ({' + '.join(radial)})"] if radial else []
        if swell:
            parts.append(f"({text}) (1 + {' + '.join(swell)})")
        elif used & {"P1", "P2"}:
            parts.append(text)
        sums[axis] = " + ".join(parts)
    return say("method.terms", dx=sums["x"], dy=sums["y"]) if sums["x"] else say("method.no_terms")


def _block_facts(run: AnalysedRun, say: Catalogue) -> KeyValues:
    result = run.result
    roles = Counter(run.result.points.role)
    kind = result.block.datum
    if kind == "control" and not roles.get("control"):
        kind = "positions"
    block, height = result.block, f"method.height_{result.block.height}"
    bent, plane = block.refraction, block.frame == "local" and not block.curvature
    straight = say("method.not_modelled")
    counts = {role: roles.get(role, 0) for role in ("control", "check", "tie")}
    facts = {
        "title.block": block.name,
        "method.datum": say(f"method.datum_{kind}") if kind in ("control", "positions", "free") else kind,
        "method.frame": block.frame,
        "method.height": say(height) if height in say.messages else block.height,
        "method.refraction": straight if bent is None else say("method.coefficient", k=say.fixed(bent, 3)),
        "method.curvature": straight if plane else say("method.modelled"),
        "method.images": str(len(result.images)),
        "method.points": say("method.points_value", **counts),
        "method.observations": str(result.observations),
        "method.unknowns": str(result.unknowns),
        "method.dof": str(result.degrees_of_freedom),
        "method.iterations": str(result.iterations),
        "method.unit": f"{block.observation_unit}, {say(f'word.{block.observation_axes}')}",
    }
    return KeyValues(tuple((say(key), text) for key, text in facts.items() if text or key != "method.height"))


def relative_orientations(title: str, run: AnalysedRun, say: Catalogue) -> tuple[Section, ...]:
    """Make the table of cameras on a frame; nothing without one."""
    heads = run.result.heads
    if not heads:
        return ()
    quantities = [(name, "mm") for name in "xyz"] + [(name, "(°)") for name in ("rx", "ry", "rz")]
    quantities.append(("t", "ms"))
    heads_of: list[str | Column] = [
        "camera<",
        "exposures",
        *(Column(name, unit) for name, unit in quantities),
    ]
    heads_of += [Column(f"σ {name}", unit.replace("(°)", "(″)")) for name, unit in quantities]
    rows, strong = [], []
    for head in heads:
        places = [head.values[name] for name in CENTRES]
        turns = [head.values[name] for name in TURNS]
        later = head.values["time"]
        values = [say.fixed(1e3 * v.value, 2) for v in places]
        values += [say.fixed(angle, 5) for angle in head.rotation_deg]
        values.append(say.fixed(1e3 * later.value, 3))
        sigmas = [1e3 * v.sigma for v in places] + [ARCSECONDS * v.sigma for v in turns] + [1e3 * later.sigma]
        row = (f"{head.camera} / {head.of}", str(head.exposures), *values, *(_sigma(s, say) for s in sigmas))
        rows.append(row)
        names, matrix = head.free, np.array(head.correlation)
        strong += [
            say("heads.pair", camera=head.camera, a=names[j], b=names[i], r=say.fixed(float(matrix[i, j]), 2))
            for i in range(len(names))
            for j in range(i)
            if abs(matrix[i, j]) > 0.9
        ]
    note = say("heads.note") + (" " + say("heads.strong", pairs="; ".join(strong)) if strong else "")
    return (Section(title, (said_table(say, "heads.table", heads_of, rows, note, dense=True),)),)


def exterior_orientation(title: str, run: AnalysedRun, say: Catalogue) -> Section:
    """Make the table of exterior orientations and the summary of their standard deviations."""
    n = len(run.result.images.names)
    order, which, remark = list(range(n)), "eop.table", ""
    if n > ROWS:
        size = np.linalg.norm(run.result.images.sigma[:, 3:], axis=1)
        order = [int(i) for i in np.argsort(-size, kind="stable")[: ROWS // 3]]
        which, remark = "eop.table_worst", say("eop.all")
    quantities = (("X", "m"), ("Y", "m"), ("Z", "m"), ("ω", "(°)"), ("φ", "(°)"), ("κ", "(°)"))
    heads: list[str | Column] = ["image<", *(Column(name, unit) for name, unit in quantities)]
    heads += [Column(f"σ {name}", "mm" if unit == "m" else "(″)") for name, unit in quantities]
    rows = _eop_rows(run, order, say)
    if run.result.scale:
        remark += say("eop.scaled", factor=say.fixed(run.result.scale, 3))
    note = say("eop.note", all=remark).strip()
    table = said_table(say, which, heads, rows, note, dense=True, shown=len(order), n=n)
    return Section(title, (_eop_quality(run, say), table) if n else (table,))


def _eop_rows(run: AnalysedRun, order: list[int], say: Catalogue) -> tuple[tuple[str, ...], ...]:
    images = run.result.images
    values = np.hstack([images.station, images.angles_deg])
    sigmas = np.hstack([images.sigma[:, 3:], np.degrees(images.sigma[:, :3])])
    # One number of decimals for a column, two digits of its median standard deviation.
    decimals = [_decimals(column) for column in sigmas.T]
    small = sigmas * ([1e3] * 3 + [ARCSECONDS] * 3)
    return tuple(
        (
            images.names[i],
            *(say.fixed(float(v), d) for v, d in zip(values[i], decimals, strict=True)),
            *(_sigma(float(s), say) for s in small[i]),
        )
        for i in order
    )


def _decimals(sigma: Floats) -> int:
    """Decimals for two digits of the median of standard deviations; six where everything is held."""
    free = sigma[sigma > 0.0]
    return min(max(decimals_of(float(np.median(free))), 0), 6) if free.size else 6


def _sigma(sigma: float, say: Catalogue) -> str:
    return say.fixed(sigma, max(decimals_of(sigma), 0)) if sigma > 0.0 else say("word.held")


def _eop_quality(run: AnalysedRun, say: Catalogue) -> TablePart:
    images = run.result.images
    sigma = np.hstack([1e3 * images.sigma[:, 3:], ARCSECONDS * np.degrees(images.sigma[:, :3])])
    spreads = (Column(f"σ {name}", "mm" if name in "XYZ" else "(″)") for name in "XYZωφκ")
    factor = run.result.scale
    rows = tuple(
        (say(f"eop.{key}"), *(_both(float(v), factor, say) for v in function(sigma, axis=0)))
        for key, function in (("least", np.min), ("median", np.median), ("most", np.max))
    )
    note = say("checks.scaled").strip() if factor else ""
    return said_table(say, "eop.quality", ("quantity<", *spreads), rows, note, n=len(images))


def check_points(title: str, run: AnalysedRun, say: Catalogue) -> Section:
    """Make the table of check points, or say that there are none."""
    checks, factor = run.result.checks, run.result.scale
    lengths = [_check_lengths(run, say)] if checks.lengths else []
    if checks.n == 0:
        return Section(title, (Paragraph(say("checks.none")), *lengths))
    heads = [f"Δ{axis}" for axis in "XYZ"]
    heads += [say(f"checks.{key}", axis=axis) for key in ("adjusted", "surveyed") for axis in "XYZ"]
    shown: tuple[str | Column, ...] = ("point<", *(Column(head, "mm") for head in heads))
    stated = np.array([s for p in checks.points for s in (p.sx, p.sy, p.sz) if s > 0.0])
    decimals = min(_decimals(1e3 * stated), 3) if stated.size else 1
    rows = [
        (
            p.point,
            *(say.fixed(1e3 * d, decimals) for d in (p.dx, p.dy, p.dz)),
            *(_both(1e3 * s, factor, say) for s in (p.sx, p.sy, p.sz)),
            *(_both(1e3 * u, None, say) if u else say("word.none") for u in (p.ux, p.uy, p.uz)),
        )
        for p in checks.points
    ]
    rmse = (say.fixed(1e3 * (checks.rmse_m[axis] or 0.0), decimals) for axis in "xyz")
    rows.append((say("checks.rmse"), *rmse, *[""] * 6))
    note = say("checks.note", n=checks.n) + (say("checks.scaled") if factor else "")
    table = said_table(say, "checks.table", shown, rows, note, dense=True)
    return Section(title, (table, *lengths, *_check_figures(run, say)))


def _check_lengths(run: AnalysedRun, say: Catalogue) -> TablePart:
    """Known distances that were not used, after VDI/VDE 2634 part 1: the largest error is the figure."""
    lengths, factor = run.result.checks.lengths, run.result.scale
    lengths_of = ("known [mm]", "error [mm]", "adjusted_length [mm]", "known_sigma [mm]")
    rows = (
        (
            f"{length.first}–{length.second}",
            say.fixed(1e3 * length.known, max(decimals_of(1e3 * length.known_sigma), 0)),
            say.fixed(1e3 * length.error, max(decimals_of(1e3 * max(length.sigma, length.known_sigma)), 0)),
            _both(1e3 * length.sigma, factor, say),
            _both(1e3 * length.known_sigma, None, say),
        )
        for length in lengths
    )
    worst = max(lengths, key=lambda length: abs(length.error))
    largest = say.significant(1e3 * abs(worst.error), 3)
    note = say("checks.lengths_note", n=len(lengths), largest=largest, line=f"{worst.first}–{worst.second}")
    return said_table(say, "checks.lengths", ("line<", *lengths_of), rows, note)


def _both(sigma: float, factor: float | None, say: Catalogue) -> str:
    """A standard deviation, in brackets what it is where the global test rejects it."""
    text = _sigma(sigma, say)
    return text if factor is None or sigma == 0.0 else f"{text} ({_sigma(factor * sigma, say)})"


def _check_figures(run: AnalysedRun, say: Catalogue) -> list[PicturePart]:
    """Map and histograms of the differences; two points and more make a picture."""
    checks = run.result.checks.points
    place = dict(zip(run.result.points.names, run.result.points.values, strict=True))
    known = [p for p in checks if p.point in place]
    if len(known) < 2:
        return []
    at = np.array([place[p.point] for p in known])
    d = np.array([(p.dx, p.dy, p.dz) for p in known])
    names = tuple(p.point for p in known)
    map_text = say("checks.map_alternative", n=len(known))
    bars_text = say("checks.histograms_alternative", n=len(known))
    return [
        PicturePart("checks-map", say("checks.map"), map_text, difference_map(names, at, d, say)),
        PicturePart("checks-histograms", say("checks.histograms"), bars_text, difference_histograms(d, say)),
    ]


def global_test(title: str, run: AnalysedRun, say: Catalogue) -> Section:
    """Say how the global test came out and what the a posteriori factor is."""
    result, test = run.result, run.result.global_test
    if result.sigma0_squared is None:
        return Section(title, (Paragraph(say("test.none")),))
    sigma0 = say.fixed(result.sigma0_squared, 4)
    squares = (say("test.chi2"), say.fixed(result.chi_squared, 2))
    rows = (squares, (say("method.dof"), str(result.degrees_of_freedom)), (say("test.sigma0"), sigma0))
    if test is None:
        return Section(title, (KeyValues(rows), Paragraph(say("test.unclaimed"))))
    interval = say("test.interval_value", lower=say.fixed(test.lower, 1), upper=say.fixed(test.upper, 1))
    rows_of_test = (
        *rows[:2],
        (say("test.interval", probability=percent(test.probability, say)), interval),
        (say("test.p"), probability(test.p_value, say.mark)),
        *rows[2:],
    )
    root = say.fixed(math.sqrt(max(result.sigma0_squared, 0.0)), 4)
    return Section(title, (KeyValues(rows_of_test), Paragraph(say("test.text", sigma0=sigma0, root=root))))


def percent(probability: float, say: Catalogue) -> str:
    """Write a probability in per cent without needless decimals."""
    return f"{100 * probability:.6g}".replace(".", say.mark)


def inputs(title: str, run: AnalysedRun, say: Catalogue) -> Section:
    """List the software and every file with its SHA-256."""
    software = run.result.software
    text = Paragraph(say("inputs.text", software=software.name, version=software.version))
    heads = ("file<", "bytes", Column(say("inputs.sha256"), "", "left", code=True))
    tables = (
        said_table(say, key, heads, [(f.path, str(f.bytes), f.sha256) for f in files], dense=True)
        for key, files in (("inputs.table", run.result.inputs), ("inputs.results", run.files))
    )
    return Section(title, (text, *tables))
