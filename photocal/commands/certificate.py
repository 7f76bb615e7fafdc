"""`photocal certificate`: the certificate of an adjustment as HTML, PDF and JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from acquire.console import answer, progress
from photocal.commands.options import argument, option

if TYPE_CHECKING:
    import datetime as dt


def certificate(
    run: Annotated[Path, argument("Folder that `photocal adjust` wrote.")],
    output: Annotated[Path, option("Folder for the certificate.", "-o", "--output")],
    language: Annotated[str, option("Language: en or pt-BR.")] = "en",
    date: Annotated[str | None, option("Day of the certificate, YYYY-MM-DD; today if not given.")] = None,
    block: Annotated[
        Path | None,
        option(
            "Block folder of the run, or its set-up file, when it is not found near it: the certificate "
            "carries the inputs for `photocal verify`."
        ),
    ] = None,
    particulars: Annotated[
        Path | None,
        option("TOML file: camera, campaign, positioning system, equipment, validity, responsible."),
    ] = None,
    client: Annotated[str, option("For whom.")] = "",
    operator: Annotated[str, option("By whom.")] = "",
    images: Annotated[
        Path | None, option("Folder of the pictures: their EXIF tells camera, aperture, focus and firmware.")
    ] = None,
    as_json: Annotated[bool, option("Print what was written as JSON.", "--json")] = False,
) -> None:
    """Write the certificate of a calibration: HTML page, PDF and JSON.

    Example: `photocal certificate run -o certificate --block block --language pt-BR`
    """
    from photocal.measurement.image_facts import read_facts, told_conditions
    from photocal.measurement.image_file import list_images
    from photocal.report.issue import FORMS, issue
    from photocal.report.signing import own_key
    from photocal.results.origin import CARRIED
    from photocal.run.summary import told_beside

    pictures = told_conditions([read_facts(path) for path in list_images(images)] if images else [])
    own = own_key()
    with progress("certificate", 4) as step:
        document = issue(
            run,
            output,
            day=_day(date),
            language=language,
            block=block,
            particulars=particulars,
            client=client,
            operator=operator,
            key=own.fingerprint if own else "",
            told=told_beside(run),
            pictures=pictures,
            done=lambda: step(1),
        )
    written = [str(output / name) for name in (*FORMS, CARRIED) if (output / name).exists()]
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
