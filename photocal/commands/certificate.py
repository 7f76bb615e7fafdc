"""`photocal certificate`: the certificate of an adjustment as HTML, PDF and JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer, progress

if TYPE_CHECKING:
    import datetime as dt

    from photocal.report.run import Run


def certificate(
    run: Annotated[Path, typer.Argument(help="Folder that `photocal adjust` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the certificate.")],
    language: Annotated[str, typer.Option(help="Language: en or pt-BR.")] = "en",
    date: Annotated[
        str | None, typer.Option(help="Day of the certificate, YYYY-MM-DD; today if not given.")
    ] = None,
    block: Annotated[
        Path | None,
        typer.Option(
            help="Block folder of the run: the certificate then carries the inputs for `photocal verify`."
        ),
    ] = None,
    particulars: Annotated[
        Path | None,
        typer.Option(
            help="TOML file: camera, campaign, positioning system, equipment, validity, responsible."
        ),
    ] = None,
    client: Annotated[str, typer.Option(help="For whom.")] = "",
    operator: Annotated[str, typer.Option(help="By whom.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write the certificate of a calibration: HTML page, PDF and JSON.

    Example: `photocal certificate run -o certificate --block block --language pt-BR`
    """
    from acquire.outputs import output_folder
    from photocal.report.carried_inputs import FOLDER, carry
    from photocal.report.catalogue import catalogue
    from photocal.report.certificate import certificate as compose
    from photocal.report.html import html
    from photocal.report.particulars import read_particulars
    from photocal.report.pdf import pdf
    from photocal.report.record import NAME, record, with_documents
    from photocal.report.run import read_run

    day = _day(date)
    say = catalogue(language)
    given = read_particulars(particulars, day, client=client, operator=operator)
    with progress("certificate", 4) as step:
        results = read_run(run)
        inputs = _inputs(run, results, block)
        step(1)
        document = compose(results, given, say)
        step(1)
        forms = {"certificate.html": html(document).encode(), "certificate.pdf": pdf(document, day)}
        step(1)
        forms[NAME] = with_documents(record(results, given, say), forms)
        step(1)
    with output_folder(output) as folder:
        for name, content in forms.items():
            (folder / name).write_bytes(content)
        if inputs is not None:
            carry(results, inputs, folder)
    written = [str(output / name) for name in forms] + ([str(output / FOLDER)] if inputs is not None else [])
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


def _inputs(folder: Path, run: Run, block: Path | None) -> Path | None:
    """Find the files that the run was made from; None when nobody named them and they are not near."""
    from drivers.errors import InputNotFoundError
    from photocal.commands.run_block import block_of_run

    result = {"inputs": [vars(file) for file in run.result.inputs]}
    try:
        return block_of_run(folder, result, block, Path.cwd())
    except InputNotFoundError:
        return None


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
