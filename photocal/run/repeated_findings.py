"""The findings of a certificate, found again in its inputs: what it tells, and what it does not."""

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.base.errors import PhotocalError
from photocal.block.results.folder import CARRIED, BlockSource, carry
from photocal.exchange.formats import read_any_block
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_text, plain, subject_text
from photocal.findings.verdict import Verdict
from photocal.report.certificate import overall
from photocal.report.certificate_metadata import Metadata
from photocal.report.derived_figures import derived_figures
from photocal.report.stored_analysis import AnalysedRun
from photocal.run.summary import add_new, calibration_findings, causes_first, hidden_faults, same_matter

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class RepeatedFindings:
    """What was found again.

    verdict: over it, the adjustment, the analysis, and what of the issuer cannot be repeated.
    false: what the certificate does not tell as it is, a sentence each, though it tells of such a check.
    untold: the same, where it never told of any.
    taken: stages of which nothing can be repeated, with the codes that the issuer tells of them.
    """

    verdict: Verdict
    false: tuple[str, ...]
    untold: tuple[str, ...]
    taken: tuple[str, ...]


def repeated_findings(
    run: AnalysedRun,
    source: BlockSource,
    told: tuple[Finding, ...],
    particulars: Metadata,
    done: Callable[[], None] = lambda: None,
    say: Catalogue | None = None,
) -> RepeatedFindings:
    """Look again for everything that a certificate tells beside its figures.

    run: repeated from the inputs.
    source: the inputs.
    told: warnings and notes of the certificate.
    say: the language of the sentences; English where not given.
    """
    say = say or catalogue("en")
    with tempfile.TemporaryDirectory(prefix="photocal-verify-") as name:
        # Only what is certified is used, whatever else is in the folder.
        carry(run.result.inputs, source, Path(name))
        checked, refusal = _of_check(BlockSource(Path(name) / CARRIED, source.setup), done)
    found = {"calibration": tuple(calibration_findings(run.result))}
    if refusal is None:
        found["georeferencing"] = checked
    if run.analysis is not None:
        found["analysis"] = tuple(hidden_faults(run.analysis.findings))
    others = [finding for finding in told if finding.stage not in found]
    listed = list(others)
    for stage, findings in found.items():
        add_new(listed, (finding for finding in findings if finding.severity != "passed"), stage)
    again = causes_first(listed, _fixed_percent(others))
    # Who tells of one check has made them all; who tells of none may have adjusted alone.
    examined = any(finding.stage for finding in told)
    unchecked = any(finding.code == "not-checked" for finding in told)
    amiss: dict[bool, list[str]] = {True: [], False: []}
    # An adjustment alone states its analysis as figures, which are compared.
    stated = () if examined else found.get("analysis", ())
    for finding in again:
        if any(same_matter(finding, other) for other in stated):
            continue
        if finding.stage in found and (text := _amiss(finding, told, say)):
            amiss[examined and not (unchecked and finding.stage == "georeferencing")].append(text)
    for finding in told:
        if finding.stage in found and not any(same_matter(finding, other) for other in again):
            amiss[True].append(say("verified.not_found", name=_named(finding, say)))
    known = tuple(derived_figures(run, camera, particulars) for camera in run.result.cameras)
    return RepeatedFindings(
        overall(run, known, again),
        tuple(say("verified.false", text=text) for text in amiss[True]),
        tuple(amiss[False]),
        _taken(others, refusal),
    )


def _of_check(source: BlockSource, done: Callable[[], None]) -> tuple[tuple[Finding, ...], str | None]:
    """Findings of the three georeferencings of a block, as stage `georeferencing` makes them; or why none."""
    from photocal.analysis.accuracy.standard import Question
    from photocal.analysis.georeferencing.comparison import check_block
    from photocal.analysis.georeferencing.findings import block_findings
    from photocal.analysis.georeferencing.prepared import with_shutters
    from photocal.measurement.oriented_ties import NOT_PLACED

    try:
        block = with_shutters(read_any_block(source.path))
        if block.datum != "control":
            return (NOT_PLACED,), None
        check = check_block(block, (), Question(), done=lambda _: done(), on_the_job=True)
        return block_findings(check), None
    except PhotocalError as refusal:
        return (), str(refusal)


def _fixed_percent(findings: list[Finding]) -> float:
    shares = [f.figures.get("percent") for f in findings if f.code == "ppk-not-fixed"]
    return next((share for share in shares if isinstance(share, float)), 100.0)


def _amiss(finding: Finding, told: tuple[Finding, ...], say: Catalogue) -> str:
    """Say what a certificate does not tell of a finding as it is; empty where it does."""
    name = _named(finding, say)
    other = next((other for other in told if same_matter(finding, other)), None)
    if other is None:
        return say("verified.not_stated", name=name, text=finding_text(finding, say, plain))
    if other.severity != finding.severity:
        stated, found = say.term(other.severity), say.term(finding.severity)
        return say("verified.stated_otherwise", name=name, stated=stated, found=found)
    places = [key for key in (*finding.figures, *other.figures) if not _alike(finding, other, key)]
    return say("verified.stated_with", name=name, figure=places[0]) if places else ""


def _named(finding: Finding, say: Catalogue) -> str:
    """Name what a finding is about, and its subject."""
    topic, subject = say.term(finding.code), finding.subject
    return f"{topic} ({subject_text(finding, subject, say)})" if subject else topic


def _alike(finding: Finding, other: Finding, key: str) -> bool:
    return _same(finding.figures.get(key), other.figures.get(key))


def _same(a: Any, b: Any) -> bool:
    """Whether two figures are the same, but for the last digits."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, str) and isinstance(b, str):
        numbers = zip(_NUMBER.findall(a), _NUMBER.findall(b), strict=False)
        return _NUMBER.split(a) == _NUMBER.split(b) and all(_same_digits(*pair) for pair in numbers)
    # Two machines may write another last digit; a figure may differ by this share of itself.
    share = 1e-3
    if isinstance(a, int | float) and isinstance(b, int | float):
        return abs(a - b) <= share * max(abs(a), abs(b)) + 1e-6
    return bool(a == b)


def _same_digits(a: str, b: str) -> bool:
    """Whether two printed numbers differ by one in the last digit at most."""
    last = 10.0 ** -len(a.partition(".")[2])
    return len(a) == len(b) and abs(float(a) - float(b)) <= (1.01 * last if "." in a else 0.0)


def _taken(others: list[Finding], refusal: str | None) -> tuple[str, ...]:
    """Name the findings that nobody can repeat from the inputs; none stated is said, too."""
    stages: dict[str, list[str]] = {stage: [] for stage in ("ppk", "exposures", "measurements")}
    for finding in others:
        stages.setdefault(finding.stage or "without a stage", []).append(finding.code)
    told = (f"findings of {stage}: {', '.join(codes) or 'none stated'}" for stage, codes in stages.items())
    return (*told, *(() if refusal is None else (f"no check could be repeated: {refusal}",)))
