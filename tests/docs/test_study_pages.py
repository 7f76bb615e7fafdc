"""docs/studies: each page is made again from the commands of its study, and names all that was printed."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.report.studies.study import read_study, shipped
from tests.docs import study_pages

# Printed figures that agreed when the chapters were written: fewer is a step back.
AGREEING = {"canon-elph": 417, "dcs460": 1968, "ixus220": 44, "phantom4pro": 22, "tank": 438}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(AGREEING))
def test_a_page_is_what_its_commands_answer(name: str, tmp_path: Path) -> None:
    made = study_pages.repeated(name, tmp_path / name)
    assert [figure for figure in made.figures if not figure.agrees and not figure.why] == []
    assert made.printed[0] >= AGREEING[name]
    assert all((study_pages.FOLDER / f"{name}-{one.file}").is_file() for one in made.study.picture)
    page = (study_pages.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    assert page == study_pages.page(name, made), "run `make manual`"


def test_the_readme_lists_the_studies() -> None:
    assert set(shipped()) == set(AGREEING)
    readme = study_pages.README.read_text(encoding="utf-8")
    assert readme == study_pages.with_list(readme, study_pages.read_pages()), "run `make manual`"


@pytest.mark.shared
@pytest.mark.parametrize("name", sorted(AGREEING))
def test_every_printed_table_is_named(name: str, shared: Path) -> None:
    """Repeated, read as input, or listed with the reason why it is not."""
    there = {path.name for path in (shared / "reference" / name).glob("*.csv")}
    study = read_study(shipped()[name])
    named = {name for given in study.input for name in given.tables}
    named |= {name for left in study.not_repeated for name in left.tables}
    assert there - named - {Path(table.printed).name for table in study.table} == set()
    page = (study_pages.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    assert [table for table in there if table not in page] == []


@pytest.mark.shared
@pytest.mark.parametrize("name", sorted(AGREEING))
def test_printed_figures_are_those_of_the_print(name: str, shared: Path) -> None:
    """Tables beside the study are those of the transcription, perhaps with fewer columns or rows."""
    for path in (shipped()[name] / "printed").glob("*.csv"):
        source = shared / "reference" / name / path.name
        if source.is_file():
            head, *rows = path.read_text(encoding="utf-8").splitlines()
            theirs = source.read_text(encoding="utf-8")
            numbers = {cell for row in rows for cell in row.split(",") if cell}
            own = {"tolerance"} & set(head.split(","))
            assert own or [cell for cell in numbers if cell.strip('"') not in theirs] == [], path.name
