"""The certificate: what it says, in both languages and both forms."""

from __future__ import annotations

import copy
import datetime as dt
import io
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from defusedxml import ElementTree
from pypdf import PdfReader
from typer.testing import CliRunner

from photocal.base.errors import InputMalformedError
from photocal.commands.cli import app
from photocal.findings.document import Document, KeyValues, Paragraph, PicturePart, TablePart, html, pdf
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text, remedy_text, sentence
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata, read_particulars
from photocal.report.stored_analysis import AnalysedRun, read_run
from tests.photocal.findings.test_findings import every_finding, fragments

DAY = dt.date(2026, 11, 21)
VOID = {"meta", "br", "col", "link", "img", "hr"}


class Outline(HTMLParser):
    """Checks that tags close in order; collects ids, links and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self._attributes(attrs)

    def handle_startendtag(self, _tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._attributes(attrs)

    def _attributes(self, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.references += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("style", "script"):
            self.text.append(data)


def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    assert parser.open == []
    return parser


def words(document: Document) -> str:
    """All text of the paper, without line ends."""
    reader = PdfReader(io.BytesIO(pdf(document, DAY)))
    return re.sub(r"\s+", " ", " ".join(page.extract_text() for page in reader.pages))


def test_page_is_whole_and_needs_nothing_else(document: Document) -> None:
    page = html(document)
    parser = outline(page)
    assert len(parser.ids) == len(set(parser.ids))
    assert all(reference.startswith("#") for reference in parser.references)
    assert not re.findall(r"url\((?!#)", page)
    assert "<script" not in page


def test_given_text_is_escaped(document: Document) -> None:
    page = html(document)
    assert "Client &lt;b&gt;&amp;&lt;/b&gt; Sons" in page
    assert "Client <b>&</b> Sons" in words(document)


def test_same_run_gives_the_same_bytes(document: Document, invented_run: AnalysedRun) -> None:
    particulars = read_particulars(None, DAY, client="Client <b>&</b> Sons", operator="Laboratório")
    again = certificate(invented_run, particulars, catalogue(document.language))
    assert html(again) == html(document)
    assert pdf(again, DAY) == pdf(document, DAY)


def test_number_does_not_depend_on_language_but_on_content(invented_run: AnalysedRun) -> None:
    numbers = [
        certificate(invented_run, Metadata(date=DAY), catalogue(code)).number for code in ("en", "pt-BR")
    ]
    other = certificate(invented_run, read_particulars(None, DAY, client="other"), catalogue("en")).number
    assert numbers[0] == numbers[1] != other
    assert re.fullmatch(r"PC-20261121-[0-9A-F]{8}", numbers[0])


def test_every_row_has_every_column(document: Document) -> None:
    tables = [
        piece for section in document.sections for piece in section.pieces if isinstance(piece, TablePart)
    ]
    assert len(tables) >= 8
    for table in tables:
        assert all(len(row) == len(table.columns) for row in table.rows), table.caption


def test_pictures_are_sound(document: Document) -> None:
    figures = [
        piece for section in document.sections for piece in section.pieces if isinstance(piece, PicturePart)
    ]
    assert [figure.name for figure in figures] == [
        "correlation-1",
        "radial-1",
        "residuals-1",
        "checks-map",
        "checks-histograms",
    ]
    for figure in figures:
        assert ElementTree.fromstring(figure.svg).tag.endswith("svg")
        assert "date" not in figure.svg
        assert figure.alternative


@pytest.mark.shared
@pytest.mark.parametrize(
    ("language", "expected"),
    [
        (
            "en",
            [
                "20.4721 mm",
                "standard deviation 0.0086 mm",
                "−2.778",
                "8.2",
                "36.4",
                "−0.98",
                "χ² = 888.4",
                "accepted",
            ],
        ),
        (
            "pt-BR",
            [
                "20,4721 mm",
                "desvio-padrão 0,0086 mm",
                "−2,778",
                "8,2",
                "36,4",
                "−0,98",
                "χ² = 888,4",
                "aceito",
            ],
        ),
    ],
)
def test_published_calibration_in_both_forms(
    published_run: AnalysedRun, language: str, expected: list[str]
) -> None:
    document = certificate(published_run, Metadata(date=DAY), catalogue(language))
    # Blanks that no line breaks at are blanks.
    page = " ".join(outline(html(document)).text).replace("\u00a0", " ")
    paper = words(document)
    for text in expected:
        assert text in page
        assert text in paper
    for file in (*published_run.result.inputs, *published_run.files):
        assert file.sha256 in page
        assert file.sha256 in paper


@pytest.mark.shared
def test_table_rows_against_the_study(published_run: AnalysedRun) -> None:
    """Values, standard deviations and t as the study prints them, to two digits of the standard deviation."""
    document = certificate(published_run, Metadata(date=DAY), catalogue("en"))
    tables = [
        piece for section in document.sections for piece in section.pieces if isinstance(piece, TablePart)
    ]
    rows = {row[0]: row for table in tables if len(table.columns) == 7 for row in table.rows}
    assert rows["x₀"][2:] == ("−0.2201", "0.0060", "mm", "−36.4", "yes")
    assert rows["K₂"][2:] == ("2.91", "0.47", "10⁻⁷ mm⁻⁴", "6.2", "yes")
    assert rows["P₂"][2:] == ("1.04", "0.42", "10⁻⁵ mm⁻¹", "2.5", "yes")


def test_a_parameter_that_is_noise_is_called_so(invented_run: AnalysedRun) -> None:
    """K2 of the invented run is half of its standard deviation."""
    text = html(certificate(invented_run, Metadata(date=DAY), catalogue("en"))).replace("\u00a0", " ")
    assert "Not significant at the 95 % level: K₂." in text


def test_factor_is_given_and_not_applied(invented_run: AnalysedRun) -> None:
    text = html(certificate(invented_run, Metadata(date=DAY), catalogue("en")))
    assert "3412.50" in text
    assert "0.42" in text
    assert "refer to the a priori variance" in text
    assert "1.0551" in text


def test_refuted_standard_deviations_are_said_on_top_and_scaled_beside(run_folder: Path) -> None:
    path = run_folder / "result.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    factor = 1.5
    result["sigma0_squared"] = factor**2
    result["chi_squared"] = factor**2 * result["degrees_of_freedom"]
    result["global_test"]["accepted"] = False
    path.write_text(json.dumps(result), encoding="utf-8")
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"))
    assert document.verdicts[0].title == "Usable with reservations"
    assert any("1.50 times the stated" in line for line in document.verdicts[0].lines)
    assert all(one.tone != "good" for one in document.verdicts)
    tables = [p for s in document.sections for p in s.pieces if isinstance(p, TablePart)]
    orientation = next(t for t in tables if t.caption == "Interior orientation parameters")
    heads = [column.head for column in orientation.columns]
    row = next(row for row in orientation.rows if row[0] == "c")
    stated, scaled = (float(row[heads.index(name)]) for name in ("Std. dev.", "Scaled"))
    assert scaled == pytest.approx(factor * stated, rel=0.06)


def test_a_portuguese_certificate_with_every_warning_has_no_english_sentence(run_folder: Path) -> None:
    english, portuguese = catalogue("en"), catalogue("pt-BR")
    told = tuple(every_finding(portuguese))
    document = certificate(read_run(run_folder), Metadata(date=DAY), portuguese, told)
    page = " ".join(outline(html(document)).text)
    left = sorted(part for part in fragments(english) - fragments(portuguese) if part in page)
    assert left == []
    # The same search finds them in the English certificate.
    other = certificate(read_run(run_folder), Metadata(date=DAY), english, tuple(every_finding(english)))
    page = " ".join(outline(html(other)).text)
    assert sum(part in page for part in fragments(english)) > 250


def test_warnings_stand_before_everything_but_the_verdict(run_folder: Path) -> None:
    told = (Finding("antenna-height", "grave", figures={"shift_m": 1.8, "sigma_m": 0.1, "side": "above"}),)
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"), told)
    assert document.verdicts[0].title == "Not usable as it stands"
    assert all(one.tone != "good" for one in document.verdicts)
    many = tuple(every_finding(catalogue("en")))
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"), many)
    assert document.sections[0].title == "Warnings and notes of the processing"


def test_a_warning_stands_once_on_the_first_page(run_folder: Path) -> None:
    """What the verdict says in full is not said again below it; all others are listed."""
    say = catalogue("en")
    told = Finding("antenna-height", "grave", figures={"shift_m": 1.8, "sigma_m": 0.1, "side": "above"})
    document = certificate(read_run(run_folder), Metadata(date=DAY), say, (told,))
    page = " ".join(outline(html(document)).text).replace("\u00a0", " ")
    assert (page.count(sentence(told, say)), page.count(remedy_text(told, say))) == (1, 1)
    assert document.sections[0].title != "Warnings and notes of the processing"
    many = tuple(every_finding(say))
    document = certificate(read_run(run_folder), Metadata(date=DAY), say, many)
    verdict = " ".join((document.verdicts[0].text, *document.verdicts[0].lines))
    rows = [
        row[1] for piece in document.sections[0].pieces if isinstance(piece, TablePart) for row in piece.rows
    ]
    assert not any(row in verdict for row in rows)
    assert all(finding_text(one, say) in {*rows} or sentence(one, say) in verdict for one in many)


def test_what_a_laboratory_did_not_state_is_said(run_folder: Path) -> None:
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"))
    section = next(one for one in document.sections if one.title.startswith("Statements of the laboratory"))
    pairs = next(dict(piece.rows) for piece in section.pieces if isinstance(piece, KeyValues))
    (unstated,) = [
        one.text for one in section.pieces if isinstance(one, Paragraph) and "Not stated" in one.text
    ]
    assert {"Temperature", "Traceability"} <= set(unstated.removeprefix("Not stated: ").split(", "))
    assert unstated.endswith(", Authorised by.")
    assert pairs["Date of issue"]
    assert pairs["Decision rule"].startswith("simple acceptance")


def hold_camera(result: dict[str, Any]) -> None:
    camera = result["cameras"]["l1"]
    camera["correlation"] = {"names": [], "matrix": []}
    for parameter in camera["parameters"].values():
        parameter |= {"sigma": 0.0, "estimated": False}
    for name in ("K1", "K2"):
        camera["parameters"][name]["value"] = 0.0


def no_redundancy(result: dict[str, Any]) -> None:
    result |= {"degrees_of_freedom": 0, "sigma0_squared": None, "global_test": None}


def no_convergence(result: dict[str, Any]) -> None:
    result["converged"] = False


def no_checks(result: dict[str, Any]) -> None:
    result["checks"] = {"n": 0, "rmse_m": {"x": None, "y": None, "z": None}, "points": []}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (hold_camera, "held fixed: no calibration"),
        (no_redundancy, "The adjustment has no degrees of freedom"),
        (no_convergence, "The adjustment did not converge"),
        (no_checks, "No surveyed point was kept out"),
    ],
)
def test_unusual_runs_are_certified_for_what_they_are(
    run_folder: Path, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    path = run_folder / "result.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    change(result)
    path.write_text(json.dumps(result), encoding="utf-8")
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"))
    assert said in html(document)
    assert said.split()[0] in words(document)


def two_cameras(result: dict[str, Any]) -> None:
    camera = result["cameras"].pop("l1")
    result["cameras"] = {'front <1> & "co"': camera, "rear": copy.deepcopy(camera)}


def test_two_cameras_have_their_own_sections_and_numbers(run_folder: Path) -> None:
    """Equal tables of two cameras are two tables; names with special characters stay names."""
    path = run_folder / "result.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    two_cameras(result)
    path.write_text(json.dumps(result), encoding="utf-8")
    images = (run_folder / "images.csv").read_text(encoding="utf-8").replace(",l1,", ",rear,")
    (run_folder / "images.csv").write_text(
        images.replace(",rear,", ',"front <1> & ""co""",', 2), encoding="utf-8"
    )
    document = certificate(read_run(run_folder), Metadata(date=DAY), catalogue("en"))
    page = html(document)
    outline(page)
    for kind in ("Table", "Figure"):
        numbers = [int(n) for n in re.findall(rf"<b>{kind} (\d+)\.</b>", page)]
        assert numbers == list(range(1, len(numbers) + 1))
    assert 'Interior orientation: front <1> & "co"' in words(document)
    assert "Interior orientation: rear" in page


def test_residuals_in_parquet_and_with_empty_cells(run_folder: Path) -> None:
    """A long block has its residuals as Parquet; an unchecked ray has no standardised residual."""
    whole = read_run(run_folder)
    path = run_folder / "residuals.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:8], "", ""])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    emptied = read_run(run_folder)
    assert np.isnan(emptied.result.residuals.standardised[0]).all()
    certificate(emptied, Metadata(date=DAY), catalogue("en"))
    table = pyarrow.csv.read_csv(path)
    path.unlink()
    pyarrow.parquet.write_table(table, run_folder / "residuals.parquet")
    again = read_run(run_folder)
    assert np.array_equal(again.result.residuals.image, whole.result.residuals.image)
    assert again.result.residuals.measured == pytest.approx(whole.result.residuals.measured)
    (run_folder / "residuals.parquet").write_bytes(b"PAR1 cut")
    with pytest.raises(InputMalformedError, match="Parquet"):
        read_run(run_folder)


def test_large_block_keeps_to_a_few_pages(large_folder: Path) -> None:
    document = certificate(read_run(large_folder), Metadata(date=DAY), catalogue("en"))
    reader = PdfReader(io.BytesIO(pdf(document, DAY)))
    assert len(reader.pages) < 10
    page = html(document)
    assert len(page) < 1_500_000
    assert "of 120" in page


def test_command_writes_both_files_and_says_where(run_folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    arguments = ["certificate", str(run_folder), "-o", str(output), "--date", "2026-11-21", "--json"]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    said = json.loads(answer.stdout)
    assert said["number"].startswith("PC-20261121-")
    assert (output / "certificate.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert (output / "certificate.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("extra", "message"), [(["--date", "21.11.2026"], "YYYY-MM-DD"), (["--language", "de"], "en, pt-BR")]
)
def test_command_refuses_and_leaves_nothing(
    run_folder: Path, tmp_path: Path, extra: list[str], message: str
) -> None:
    output = tmp_path / "out"
    answer = CliRunner().invoke(app, ["certificate", str(run_folder), "-o", str(output), *extra])
    assert message in str(answer.exception)
    assert not output.exists()


def test_spoilt_run_leaves_nothing(run_folder: Path, tmp_path: Path) -> None:
    (run_folder / "points.csv").unlink()
    answer = CliRunner().invoke(app, ["certificate", str(run_folder), "-o", str(tmp_path / "out")])
    assert "points.csv" in str(answer.exception)
    assert not (tmp_path / "out").exists()
