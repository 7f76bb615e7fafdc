"""A certificate made anew from its inputs."""

from __future__ import annotations

import datetime as dt
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from photocal.block.model import InputFile
from photocal.exchange.formats import read_any_block
from photocal.findings.catalogue import Catalogue, catalogue
from photocal.findings.finding import Finding
from photocal.findings.texts import findings_of
from photocal.report.analysis_file import analyse_run
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Particulars, given_particulars
from photocal.report.issue import printed
from photocal.report.record import certified_result, plain_record
from photocal.report.stored_analysis import Run, read_run
from photocal.results.adjusting import adjust_block
from photocal.results.folder import RESULT
from photocal.results.more_tables import Wanted
from photocal.results.origin import CARRIED, Source, carry


def repeated(
    certified: dict[str, Any], folder: Path, source: Source, done: Callable[[], None] = lambda: None
) -> Run:
    """Adjust and analyse the certified inputs anew, as the certificate says that it was done.

    raises PhotocalError: as reading and adjusting do.
    """
    result = certified_result(certified, folder)
    with tempfile.TemporaryDirectory(prefix="photocal-verify-") as name:
        aside = Path(name)
        # Only what is certified takes part, whatever else lies beside it.
        carry(result.inputs, source, aside)
        copied = Source(aside / CARRIED, result.block.setup)
        wanted = Wanted(components=bool(result.variance_components))
        adjust_block(copied.path, aside / "run", result.snooping, wanted=wanted, read=read_any_block)
        done()
        analysis = certified.get("analysis")
        if analysis is not None:
            asked = analysis["alpha"], analysis["correlation_threshold"]
            draws = analysis.get("bootstrap_draws", 0)
            analyse_run(aside / "run", copied.path, *asked, lambda _: done(), draws=draws)
        return read_run(aside / "run")


def as_certified(run: Run, certified: dict[str, Any], folder: Path) -> Run:
    """Give a repeated run what no repetition can know: its block's name, the digests of the first run."""
    block = replace(run.result.block, name=certified_result(certified, folder).block.name)
    files = tuple(InputFile(**entry) for entry in certified["run_files"])
    first = next((file.sha256 for file in files if file.path == RESULT), "")
    analysis = None if run.analysis is None else replace(run.analysis, result_sha256=first)
    return replace(run, result=replace(run.result, block=block), files=files, analysis=analysis)


def record_of(run: Run, certified: dict[str, Any]) -> dict[str, Any]:
    """Make the certificate of a repeated run, comparable by `verification.differences`."""
    return plain_record(run, *_told_by(certified))


def pages_of(run: Run, certified: dict[str, Any]) -> dict[str, bytes]:
    """Print the certificate of a repeated run."""
    return printed(certificate(run, *_told_by(certified)), dt.date.fromisoformat(certified["date"]))


def _told_by(certified: dict[str, Any]) -> tuple[Particulars, Catalogue, tuple[Finding, ...]]:
    particulars = given_particulars(certified["particulars"], certified["date"])
    told = findings_of([*certified["warnings"], *certified["notes"]], "certificate.json")
    return particulars, catalogue(certified["language"]), told
