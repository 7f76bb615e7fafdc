"""Pictures of the desk in the guide, made by the program itself: a rendered flight, processed."""

from __future__ import annotations

import contextlib
import datetime as dt
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.base.progress import quiet
from photocal.base.web import Address, serving
from photocal.block.project import NAME, read_project
from photocal.desk.standing import application
from photocal.exchange.parts import Mark
from photocal.measurement.marking.store import write_marks
from photocal.run.campaign import run_project
from photocal.run.new_project import new_project
from tests.docs.shown import GUIDE
from tests.photocal.measurement.marking.conftest import POINTS, fly
from tests.photocal.run.typed_site import site_folder

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROOT = Path(__file__).parents[2]
# What each step shows when it is there.
STEPS = {
    "folder": "#chart canvas",
    "check": "table.plain",
    "run": "ol.stages li",
    "look": "main canvas",
    "certificate": "iframe.preview",
}
_PATIENCE_MS, SETTLES_MS = 400_000, 3_000
# What is marked wrong in the picture of the place Mark, and how far; sigma of the marks in column and row.
_WRONG, _BESIDE_PX, _SIGMA_PX = ("p2.png", 4), 0.8, (0.03, 0.03)
MARKING = ROOT / "docs" / "marking.png"
# Where the sources lie differs from one computer to the next.
_WITHOUT_PLACE = """root => {
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT)
    while (texts.nextNode()) texts.currentNode.data = texts.currentNode.data.replaceAll(root, "~/photocal")
}"""


@contextlib.contextmanager
def processed() -> Iterator[Path]:
    """A flight of eight rendered pictures with control, from its folder to the certificate."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "rendered").mkdir()
        site = Path(folder) / "warsaw"
        site_folder(Path(folder) / "rendered", site, positions=True)
        run_project(read_project(new_project(site, height="orthometric").path), dt.date(2026, 5, 1), quiet)
        # The window shows the folder as it was typed.
        os.chdir(folder)
        try:
            yield Path("warsaw")
        finally:
            os.chdir(before)


@contextlib.contextmanager
def window(site: Path, language: str = "en-US") -> Iterator[tuple[Page | None, str]]:
    """The window on a project on a field laptop, and its address; no page where there is no browser."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        print("no chromium: the pictures of the desk stay as they are")
        yield None, ""
        return
    from playwright.sync_api import sync_playwright

    with (
        tempfile.TemporaryDirectory() as cache,
        serving(application(site, Path(cache)), Address("127.0.0.1", 0)) as url,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1366, "height": 768}, locale=language)
        page.set_default_timeout(_PATIENCE_MS)
        yield page, url
        browser.close()


def main() -> None:
    """Write them, where there is a browser to look with."""
    with processed() as site, window(site) as (page, url):
        if page is None:
            return
        for step, shown in STEPS.items():
            page.goto(f"{url}#/{step}")
            page.wait_for_selector("main h1, main canvas")
            if step == "folder":
                page.get_by_role("button", name="Inspect again").click()
                page.wait_for_selector(".findings li")
            if step == "check":
                page.get_by_role("button", name="Check now").click()
            page.wait_for_selector(shown)
            if step == "certificate":
                page.get_by_text("Preview, number").wait_for()
            if step == "look":
                page.locator(".thumb").nth(2).click()
            page.wait_for_timeout(SETTLES_MS)
            page.evaluate(_WITHOUT_PLACE, str(ROOT))
            page.screenshot(path=GUIDE / f"desk-{step}.png")
        marked_wrong(page)


def marked_wrong(page: Page) -> None:
    """The place Mark: one mark lies beside its target, and an adjustment shows which."""
    # The window shows the folder as it was typed.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        survey = fly(Path("field"))
        survey.file.rename(survey.folder / NAME)
        marks = [
            Mark(image, f"P{k + 1}", x + _BESIDE_PX * ((image, k + 1) == _WRONG), y, _SIGMA_PX, "")
            for image in survey.site.names
            for k in range(POINTS)
            for x, y in [survey.truth(image, f"P{k + 1}")]
        ]
        write_marks(survey.folder / "marks.csv", marks)
        app = application(survey.folder, Path("cache"), "mark")
        with serving(app, Address("127.0.0.1", 0)) as url:
            page.goto(f"{url}#/mark/P{_WRONG[1]}/{_WRONG[0]}")
            page.locator(".marking[data-ready] .frame[data-loaded=true]").first.wait_for()
            page.keyboard.press("a")
            page.locator(".marking[data-adjusted]").wait_for()
            page.keyboard.press("c")
            page.wait_for_timeout(SETTLES_MS)
            page.screenshot(path=MARKING)


if __name__ == "__main__":
    main()
