"""`photocal forms`: sheets to print for the field and the laboratory."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import answer, option


def forms(
    output: Annotated[Path, option("PDF to write.", "-o", "--output")],
    kinds: Annotated[str, option("station, flight, targets, laboratory, rover, separated by commas.")] = (
        "station,flight,targets"
    ),
    plan: Annotated[
        Path | None, option("plan.geojson of `photocal plan`: a station sheet for each of its points.")
    ] = None,
    stations: Annotated[int, option("Places of the camera before a test field.", min=1, max=20)] = 3,
    language: Annotated[str, option("Language: en or pt-BR.", "--lang", "--language")] = "en",
    as_json: Annotated[bool, option("Print what was written as JSON.", "--json")] = False,
) -> None:
    """Write sheets to print: GNSS stations, flight log, targets, laboratory, test of a rover.

    Example: `photocal forms -o forms.pdf --plan plan/plan.geojson --language pt-BR`
    """
    import datetime as dt

    from photocal.base.files import output_file
    from photocal.findings.document import pdf
    from photocal.findings.texts import catalogue
    from photocal.report.forms import field_forms, planned_places

    places = () if plan is None else planned_places(plan)
    names = [name.strip() for name in kinds.split(",") if name.strip()]
    document = field_forms(names, places, catalogue(language), stations)
    content = pdf(document, dt.datetime.now().astimezone().date())
    with output_file(output) as aside:
        aside.write_bytes(content)
    titles = [section.title for section in document.sections]
    answer(
        as_json,
        lambda: {"file": str(output), "sheets": titles},
        lambda: "\n".join([*titles, f"written to {output}"]),
    )
