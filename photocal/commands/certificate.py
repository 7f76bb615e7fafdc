"""`photocal certificate`: the certificate of an adjustment as HTML, PDF and JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer

if TYPE_CHECKING:
    import datetime as dt


def certificate(
    run: Annotated[Path, typer.Argument(help="Folder that `photocal adjust` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the certificate.")],
    language: Annotated[str, typer.Option(help="Language: en or pt-BR.")] = "en",
    date: Annotated[
        str | None, typer.Option(help="Day of the certificate, YYYY-MM-DD; today if not given.")
    ] = None,
    client: Annotated[str, typer.Option(help="For whom.")] = "",
    operator: Annotated[str, typer.Option(help="By whom.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write the certificate of a calibration: one HTML page and a PDF.

    Example: `photocal certificate run -o certificate --language pt-BR`
    """
    from acquire.outputs import output_folder
    from photocal.report.catalogue import catalogue
    from photocal.report.certificate import certificate as compose
    from photocal.report.html import html
    from photocal.report.particulars import Particulars
    from photocal.report.pdf import pdf
    from photocal.report.run import read_run

    day = _day(date)
    say = catalogue(language)
    particulars = Particulars(day, client, operator)
    document = compose(read_run(run), particulars, say)
    page, paper = html(document), pdf(document, day)
    with output_folder(output) as folder:
        (folder / "certificate.html").write_text(page, encoding="utf-8")
        (folder / "certificate.pdf").write_bytes(paper)
    written = [str(output / name) for name in ("certificate.html", "certificate.pdf")]
    answer(
        as_json,
        lambda: {
            "number": document.number,
            "files": written,
            "highlights": {item.label: item.value for item in document.highlights},
        },
        lambda: "\n".join(
            [
                f"{document.title} {document.number}",
                *(f"  {item.label}: {item.value} ({item.remark})" for item in document.highlights),
                *(f"  {path}" for path in written),
            ]
        ),
    )


def _day(date: str | None) -> dt.date:
    import datetime as dt

    from drivers.errors import ConfigurationError

    if date is None:
        return dt.datetime.now().astimezone().date()
    try:
        return dt.date.fromisoformat(date)
    except ValueError:
        raise ConfigurationError(
            f"{date!r} is no date", where="--date", remedy="write it as YYYY-MM-DD"
        ) from None
