"""Every place of the window in both languages: axe-core, keys alone, and no word of the other language."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.photocal.desk.client import opened
from tests.photocal.desk.watch import serious, watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PAGE = Path(__file__).resolve().parents[3] / "photocal" / "desk" / "page"
PATIENCE_MS = 120_000
# Each place, and what stands there when all of it has come.
PLACES = {
    "folder": "#chart canvas",
    "check": ".chart canvas",
    "run": ".verdict",
    "look": "#view-map canvas",
    "look/view/space": "#view-space canvas",
    "look/view/plots": "#view-plots .u-over",
    "look/point/G1": ".crop",
    "certificate": "iframe.preview",
    "mark": ".marking[data-ready]",
    "record": "main h1",
}
_TEXTS = """[...document.querySelectorAll("body *")]
  .filter((one) => one.getClientRects().length && !one.closest("[lang]:not(html)"))
  .flatMap((one) => [
    ...[...one.childNodes].filter((node) => node.nodeType === 3).map((node) => node.textContent),
    ...["title", "aria-label", "alt", "placeholder"].map((name) => one.getAttribute(name) ?? ""),
  ].map((text) => text.trim()).filter(Boolean))"""
_NAME = (
    """(one) => `${one.localName}#${one.id} ${one.getAttribute("aria-label") ?? one.textContent.trim()}`"""
)
# What takes the focus; of radio buttons the one that is chosen.
_STOPS = f"""[...document.querySelectorAll("a[href], button, input, select, textarea, summary, [tabindex]")]
  .filter((one) => one.checkVisibility({{ visibilityProperty: true }}) && !one.disabled && one.tabIndex >= 0)
  .filter((one) => one.type !== "radio" || one.checked).map({_NAME})"""
# Where the focus is, and whether one sees that it is there; within a page in the page nothing is asked.
_FOCUS = f"""(() => {{
  const one = document.activeElement;
  if (one === document.body) return ["", true];
  const style = getComputedStyle(one);
  const seen = style.outlineStyle !== "none" || style.boxShadow !== "none" || one.localName === "iframe";
  return [({_NAME})(one), seen];
}})()"""
# What a mouse presses and no key does.
_MOUSE_ALONE = """[...document.querySelectorAll("body *")]
  .filter((one) => one.getClientRects().length && getComputedStyle(one).cursor === "pointer")
  .filter((one) => !one.closest("a[href], button, input, select, textarea, label, summary, [tabindex]"))
  .map((one) => one.outerHTML.slice(0, 100))"""


def foreign(column: int) -> set[str]:
    """Texts that only the other language has; `column` is that of the page's own."""
    ours, theirs = set[str](), set[str]()
    for path in (PAGE, PAGE / "look", PAGE / "mark"):
        for texts in json.loads((path / "texts.json").read_text(encoding="utf-8")).values():
            ours.add(texts[column])
            theirs.add(texts[1 - column])
    return theirs - ours


def by_keys(page: Page) -> tuple[set[str], set[str]]:
    """Go through the page by the tabulator: what was never reached, and what does not show the focus."""
    wanted, reached, unseen = set(page.evaluate(_STOPS)), set[str](), set[str]()
    for _ in range(3 * len(wanted)):
        page.keyboard.press("Tab")
        name, seen = page.evaluate(_FOCUS)
        reached.add(name)
        if not seen:
            unseen.add(name)
        if wanted <= reached:
            break
    return wanted - reached, unseen


@pytest.mark.timeout(900)
@pytest.mark.parametrize(("column", "language"), [(0, "en-US"), (1, "pt-BR")])
def test_every_place_is_accessible_and_speaks_one_language(
    browser: Browser, finished: Path, tmp_path: Path, column: int, language: str
) -> None:
    theirs = foreign(column)
    folder = Path(shutil.copytree(finished, tmp_path / "site"))
    with opened(folder, tmp_path / "cache") as window:
        context = browser.new_context(viewport={"width": 1366, "height": 768}, locale=language)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        wrong = watched(page, window.url)
        for place, there in PLACES.items():
            page.goto(f"{window.url}/#/{place}")
            expect(page.locator(there).first).to_be_visible()
            page.wait_for_load_state("networkidle")
            assert not (held := serious(page)), (place, held)
            assert not (said := theirs.intersection(page.evaluate(_TEXTS))), (place, said)
            assert not (pressed := page.evaluate(_MOUSE_ALONE)), (place, pressed)
            unreached, unseen = by_keys(page)
            assert not unreached | unseen, (place, unreached, unseen)
        # What opens above a page.
        page.goto(f"{window.url}/#/look/image/p1.jpg")
        expect(page.locator(".thumb[aria-pressed=true]")).to_be_visible()
        page.keyboard.press("l")
        expect(page.get_by_role("dialog")).to_be_visible()
        assert not (held := serious(page)), held
        assert not (said := theirs.intersection(page.evaluate(_TEXTS))), said
        assert not wrong, wrong
        context.close()
