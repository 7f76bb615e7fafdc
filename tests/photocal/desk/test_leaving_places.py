"""Places that are left while they wait: late styles, and answers that come when another place is shown."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.photocal.desk.client import opened
from tests.photocal.desk.watch import watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 120_000


@pytest.fixture
def page(browser: Browser, finished: Path, tmp_path: Path) -> Iterator[Page]:
    """The window on a folder that was processed, at Record; nothing may go wrong in it."""
    folder = Path(shutil.copytree(finished, tmp_path / "site"))
    with opened(folder, tmp_path / "cache") as window:
        made = browser.new_page(viewport={"width": 1366, "height": 768}, locale="en-US")
        made.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        wrong = watched(made, window.url)
        made.goto(f"{window.url}/#/record")
        expect(made.locator("main h1")).to_be_visible()
        yield made
        seen = list(wrong)
        made.close()
        assert seen == [], seen


@contextmanager
def held(page: Page, pattern: str) -> Iterator[list[Route]]:
    """Requests that wait while the block runs, and are answered afterwards."""
    waiting: list[Route] = []
    page.route(pattern, lambda route: waiting.append(route))
    yield waiting
    for request in waiting:
        request.continue_()
    page.unroute(pattern)


def go(page: Page, place: str) -> None:
    page.evaluate("place => { location.hash = `#/${place}`; }", place)


def test_look_waits_for_its_styles(page: Page) -> None:
    with held(page, "**/look/look.css"):
        with page.expect_response("**/api/look"), page.expect_response("**/api/look/findings*"):
            go(page, "look/point/G1")
        # All else has come; a map that was drawn by now would have no height.
        page.wait_for_timeout(1000)
        assert page.locator(".loading").is_visible()
    expect(page.locator("#view-map canvas").first).to_be_visible()
    expect(page.locator(".crop").first).to_be_visible()


@pytest.mark.parametrize(
    ("place", "asked"),
    [
        ("run", "run"),
        ("mark", "mark/state"),
        ("look", "look"),
        ("certificate", "certificate"),
    ],
)
def test_a_late_answer_is_not_drawn_into_the_place_that_followed(page: Page, place: str, asked: str) -> None:
    with held(page, f"**/api/{asked}") as waiting:
        with page.expect_request(f"**/api/{asked}"):
            go(page, place)
        go(page, "record")
        expect(page.locator("main h1")).to_be_visible()
        page.wait_for_timeout(200)
        before = [page.locator(part).inner_text() for part in ("#step", "#command")]
    assert waiting
    page.wait_for_timeout(1500)
    assert page.evaluate("location.hash") == "#/record"
    after = [page.locator(part).inner_text() for part in ("#step", "#command")]
    assert after == before, after
    # Keys belong to the place that is shown.
    page.keyboard.press("?")
    expect(page.locator("dialog[open]")).to_have_count(0)
