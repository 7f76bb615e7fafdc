"""Issuing a certificate: HTML page, PDF and JSON, with the inputs that it was made from."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from pathlib import Path

from acquire.outputs import output_folder
from drivers.errors import ConfigurationError, InputNotFoundError
from photocal.findings.catalogue import catalogue
from photocal.findings.finding import Finding
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import read_particulars
from photocal.report.document import Document
from photocal.report.pages import html, pdf
from photocal.report.record import NAME, record, with_documents
from photocal.report.stored_analysis import Run, read_run
from photocal.results.origin import Source, block_of_run, carry
from photocal.results.result import Result

FORMS = ("certificate.html", "certificate.pdf", NAME)


def issue(
    run: Path,
    output: Path,
    *,
    day: dt.date,
    language: str = "en",
    block: Path | None = None,
    particulars: Path | None = None,
    client: str = "",
    operator: str = "",
    key: str = "",
    told: tuple[Finding, ...] = (),
    pictures: Mapping[str, Mapping[str, str]] | None = None,
    done: Callable[[], None] = lambda: None,
) -> Document:
    """Write the certificate of a run.

    block: block folder or set-up file of the run; looked for near it when not given. Its files are carried.
    particulars: TOML file with what a person gives.
    key: fingerprint of the key by which it will be signed; printed.
    pictures: what they say of camera and conditions, by section and key of the particulars.
    raises PhotocalError: for inputs that cannot be read or have changed, and for figures that cannot be
        right.
    """
    say = catalogue(language)
    given = read_particulars(particulars, day, client=client, operator=operator, key=key, pictures=pictures)
    results = read_run(run)
    _refuse_a_guess(run, results.result)
    source = _source(run, results, block)
    done()
    document = certificate(results, given, say, told)
    done()
    forms = printed(document, day)
    done()
    forms[NAME] = with_documents(record(results, given, say, told), forms)
    done()
    with output_folder(output) as folder:
        for name, content in forms.items():
            (folder / name).write_bytes(content)
        if source is not None:
            carry(results.result.inputs, source, folder)
    return document


def printed(document: Document, day: dt.date) -> dict[str, bytes]:
    """Print a certificate: HTML page and PDF by the names of their files."""
    return {FORMS[0]: html(document).encode(), FORMS[1]: pdf(document, day)}


def _refuse_a_guess(run: Path, result: Result) -> None:
    """Refuse cameras whose c was neither given nor estimated; older runs do not say it."""
    guessed = [name for name, camera in result.cameras.items() if camera.guessed]
    if guessed:
        raise ConfigurationError(
            f"the principal distance of camera {guessed[0]} is a guess that was held",
            where=run,
            remedy="name c under estimate, or give its calibrated value and remove guessed = true",
        )


def _source(folder: Path, run: Run, block: Path | None) -> Source | None:
    """Find what the run was made from; None when nobody named it and it is not near."""
    try:
        return block_of_run(folder, run.result, block, Path.cwd())
    except InputNotFoundError:
        return None
