"""No figure is broken over two lines: value, sigma and unit of each stand on one line of the page."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from photocal.findings.document import Document, Highlight, PicturePart, Statement, TablePart, html, pdf
from photocal.findings.texts import catalogue
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata
from photocal.report.stored_analysis import AnalysedRun
from tests.photocal.report.test_certificate import DAY, outline

# A number, with its sigma, and one unit that the certificate uses.
FIGURE = re.compile(
    r"[−+]?\d+(?:[.,]\d+)?(?: ± \d+(?:[.,]\d+)?)? (?:mm|cm|m|µm|px|ms|ppm|%)(?![\w/])|\d ± \d+[.,]\d+"
)


def texts(part: object) -> Iterator[str]:
    """Every running text of a part of a document; rows of tables have units in their heads."""
    if isinstance(part, str):
        yield part
    elif isinstance(part, tuple):
        for one in part:
            yield from texts(one)
    elif is_dataclass(part) and not isinstance(part, PicturePart | TablePart):
        for field in fields(part):
            yield from texts(getattr(part, field.name))


def figures(lines: Iterator[str]) -> Counter[str]:
    return Counter(found for line in lines for found in FIGURE.findall(" ".join(line.split())))


@pytest.fixture(params=["en", "pt-BR"])
def paper(request: pytest.FixtureRequest, published_run: AnalysedRun) -> Document:
    """The published calibration, whose sigmas need a line each."""
    return certificate(published_run, Metadata(date=DAY), catalogue(request.param))


def test_no_figure_of_the_paper_is_broken(paper: Document, tmp_path: Path) -> None:
    if shutil.which("pdftotext") is None:
        pytest.skip("needs poppler-utils")
    (tmp_path / "c.pdf").write_bytes(pdf(paper, DAY))
    read = subprocess.run(["pdftotext", "-layout", tmp_path / "c.pdf", "-"], check=True, capture_output=True)
    lines = read.stdout.decode("utf-8").splitlines()
    printed = figures(iter(lines))
    asked = figures(texts((paper.highlights, paper.verdicts, paper.sections)))
    assert sum(asked.values()) > 12
    assert {one: (n, printed[one]) for one, n in asked.items() if printed[one] < n} == {}


def test_headline_figures_stand_whole(paper: Document, tmp_path: Path) -> None:
    """Also where a narrow box would break them: a long c with its unit, and a statement."""
    if shutil.which("pdftotext") is None:
        pytest.skip("needs poppler-utils")
    long = "distance of the lens in the state that was calibrated for this flight"
    values = [f"{'x' * k} 3665.27 ± 1.25 px" for k in range(2, 26)]
    wide = tuple(Highlight("c", value, f"{long} {value}") for value in values)
    said = Statement("note", long, " ".join(f"{long[:k]} {k}.5 ± 0.25 mm" for k in range(3, 40)))
    shown = Document(
        "en", "t", "", "n", paper.facts, wide, (said,), (), paper.words
    )  # fmt: skip
    (tmp_path / "c.pdf").write_bytes(pdf(shown, DAY))
    read = subprocess.run(["pdftotext", "-layout", tmp_path / "c.pdf", "-"], check=True, capture_output=True)
    printed = figures(iter(read.stdout.decode("utf-8").splitlines()))
    assert printed["3665.27 ± 1.25 px"] == 2 * len(values)
    assert all(printed[f"{k}.5 ± 0.25 mm"] == 1 for k in range(3, 40))


def test_no_figure_of_the_page_may_break(paper: Document) -> None:
    """A browser breaks lines at plain blanks only."""
    shown = "\n".join(outline(html(paper)).text)
    assert FIGURE.findall(shown.replace("\N{NO-BREAK SPACE}", "~").replace("~", " "))
    assert FIGURE.findall(shown) == []
