"""The step `certificate`: of a run folder, with the files next to it."""

from dataclasses import dataclass
from pathlib import Path

from photocal.base.progress_bars import progress
from photocal.block.results.folder import CARRIED
from photocal.findings.document import Document
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import list_images
from photocal.measurement.picture_tests import told_conditions
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import FORMS, issue
from photocal.report.keys import own_key
from photocal.report.options import CertificateOptions
from photocal.run.summary import flown_figures, stage_findings


@dataclass(frozen=True)
class Certificate:
    """A certificate that was written.

    Attributes
    ----------
    document
        Its content: number, title, highlights and sections.
    files
        What was written.
    """

    document: Document
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        """Say number, highlights and files."""
        shown = self.document
        return "\n".join(
            [
                f"{shown.title} {shown.number}",
                *(f"  {item.label}: {item.value} ({item.remark})" for item in shown.highlights),
                *(f"  {path}" for path in self.files),
            ]
        )


def certificate(
    run: str | Path, output: str | Path, *, options: CertificateOptions | None = None
) -> Certificate:
    """Write the certificate of a calibration: HTML page, PDF and JSON.

    Parameters
    ----------
    run
        Folder that `adjust` wrote (`photocal.write_result`, `photocal adjust`).
    output
        Folder for the certificate.
    options
        Language, day, particulars, and the block when it is not found near the run.

    Returns
    -------
    Certificate
        The document and its files.

    Raises
    ------
    ConfigurationError
        For an invalid date, or a principal distance that was only guessed.
    InputNotFoundError, InputMalformedError
        For inputs that cannot be read or have changed.
    OutputError
        When the folder cannot be written.

    Examples
    --------
    >>> import photocal
    >>> options = photocal.CertificateOptions(client="Mapping Ltd")
    >>> [path.name for path in photocal.certificate("run", "certificate", options=options).files]
    ['certificate.html', 'certificate.pdf', 'certificate.json', 'inputs']
    """
    asked, run, output = options or CertificateOptions(), Path(run), Path(output)
    images = [] if asked.images is None else list_images(Path(asked.images))
    pictures = told_conditions([read_facts(path) for path in images])
    day, key = asked.day(), own_key()
    with progress("certificate", 4) as step:
        given = read_particulars(
            asked.particulars,
            day,
            client=asked.client,
            operator=asked.operator,
            form=asked.form,
            key=key.fingerprint if key else "",
            pictures=pictures,
            flown=flown_figures(run),
        )
        document = issue(
            run,
            output,
            given,
            language=asked.language or "en",
            block=asked.block,
            warnings=stage_findings(run),
            done=lambda: step(1),
        )
    written = tuple(output / name for name in (*FORMS, CARRIED) if (output / name).exists())
    return Certificate(document, written)
