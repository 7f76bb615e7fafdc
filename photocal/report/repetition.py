"""A certificate made anew from its inputs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from photocal.exchange.any_block import read_any_block
from photocal.findings.catalogue import catalogue
from photocal.report.analysis_file import analyse_run
from photocal.report.certificate_metadata import given_particulars
from photocal.report.record import certified_result, plain_record
from photocal.report.stored_analysis import read_run
from photocal.report.warning_sections import ProcessingWarnings
from photocal.results.adjusting import adjust_block
from photocal.results.more_tables import Wanted
from photocal.results.origin import CARRIED, Source, carry


def repeated(
    certified: dict[str, Any], folder: Path, source: Source, done: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Adjust and analyse the certified inputs anew, as the certificate says that it was done.

    Parameters
    ----------
    certified : dict
        Machine-readable certificate.
    folder : Path
        Where it lies, for messages.
    source : Source
        The inputs, all with their certified digests.
    done : callable
        Called after each adjustment.

    Returns
    -------
    dict
        What the certificate should say, comparable by `verification.differences`.

    Raises
    ------
    PhotocalError
        As reading and adjusting do.
    """
    particulars = given_particulars(certified["particulars"], certified["date"])
    result, say = certified_result(certified, folder), catalogue(certified["language"])
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
            analyse_run(aside / "run", copied.path, *asked, done)
        told = ProcessingWarnings(tuple(certified["warnings"]), tuple(certified["notes"]))
        again = plain_record(read_run(aside / "run"), particulars, say, told)
    # A block that does not name itself is called as its folder, which is another one here.
    again["result"]["block"]["name"] = certified["result"]["block"].get("name")
    return again
