"""The page as a reader sees it: on a phone, on a laptop and in print."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from photocal.findings.document import html
from photocal.findings.texts import catalogue
from photocal.report.certificate import certificate
from photocal.report.certificate_metadata import Metadata
from photocal.report.stored_analysis import AnalysedRun

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module", params=["en", "pt-BR"])
def page_file(
    request: pytest.FixtureRequest, invented_run: AnalysedRun, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    document = certificate(invented_run, Metadata(date=dt.date(2026, 11, 21)), catalogue(request.param))
    path: Path = tmp_path_factory.mktemp("page") / "certificate.html"
    path.write_text(html(document), encoding="utf-8")
    return path


@pytest.mark.parametrize("width", [360, 768, 1440])
def test_page_never_scrolls_sideways(browser: Browser, page_file: Path, width: int) -> None:
    """Wide tables scroll within themselves; nothing else is wider than the window; no error, no request."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    problems: list[str] = []
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    requested: list[str] = []
    page.on("request", lambda request: requested.append(request.url))
    page.goto(page_file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert problems == [], problems
    assert requested == [page_file.as_uri()]
    page.close()


def test_pictures_have_size_and_names(browser: Browser, page_file: Path) -> None:
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(page_file.as_uri())
    pictures = page.locator("figure svg")
    assert pictures.count() == 5
    for i in range(3):
        box = pictures.nth(i).bounding_box()
        assert box is not None
        assert box["width"] > 200
        assert box["height"] > 100
        assert pictures.nth(i).get_attribute("aria-label")
    page.close()


def test_print_fits_the_paper(browser: Browser, page_file: Path) -> None:
    """In print no table is wider than the text: 174 mm of A4 at 96 dots per inch."""
    page = browser.new_page(viewport={"width": round(174 / 25.4 * 96), "height": 1000})
    page.emulate_media(media="print")
    page.goto(page_file.as_uri())
    widths = page.evaluate(
        "[...document.querySelectorAll('table, svg, dl')].map(e => e.getBoundingClientRect().width)"
    )
    assert max(widths) <= 174 / 25.4 * 96 + 1
    page.close()
