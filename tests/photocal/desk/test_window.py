"""The window as a surveyor uses it: Chromium, from the folder to the signed certificate; a server that dies.

Waiting times are generous for busy machines.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.conftest import Once
from tests.photocal.desk.conftest import HOSTILE, fresh
from tests.photocal.desk.watch import serious, watched
from tests.photocal.run.typed_site import resized

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 300_000
expect.set_options(timeout=PATIENCE_MS)
FIELD_LAPTOP = {"width": 1366, "height": 768}


@pytest.fixture
def page(browser: Browser, port: int) -> Iterator[Page]:
    """A page that asks nobody else, and in which nothing goes wrong."""
    context = browser.new_context(viewport=FIELD_LAPTOP, locale="en-US")  # type: ignore[arg-type]
    opened = context.new_page()
    opened.set_default_timeout(PATIENCE_MS)
    problems = watched(opened, f"http://127.0.0.1:{port}/")
    yield opened
    # What is under way when the page is closed fails, and is no fault of the page.
    seen = list(problems)
    context.close()
    assert seen == [], seen


@pytest.mark.timeout(1500)
def test_from_the_folder_to_the_signed_certificate(
    page: Page, port: int, serve: Callable[[Path], subprocess.Popen[str]], once: Once, tmp_path: Path
) -> None:
    """A wrong system is corrected, a run is stopped and goes on, the server is killed and opened again."""
    home = tmp_path / "home"
    home.mkdir()
    # The list names the zone beside its own.
    fresh(once, home / HOSTILE, "desk-wrong-zone", positions=True, first="EPSG:2178")
    server = serve(home)
    page.goto(f"http://127.0.0.1:{port}/")

    page.get_by_role("button", name=HOSTILE).click()
    expect(page.locator("#rail .title span")).to_have_text(HOSTILE)
    page.get_by_role("button", name="Inspect this folder").click()
    expect(page.locator(".findings li").first).to_be_visible()
    expect(page.get_by_label("Coordinate system")).to_have_value(re.compile("EPSG:"))
    page.get_by_text("orthometric", exact=True).click()
    expect(page.get_by_role("radio", name=re.compile("orthometric"))).to_be_checked()
    assert not (held := serious(page)), held

    page.get_by_role("link", name=re.compile("Check")).click()
    page.get_by_role("button", name="Check now").click()
    mend = page.get_by_role("link", name=re.compile("Correct it: Coordinate system"))
    expect(mend).to_be_visible()
    assert not (held := serious(page)), held
    mend.click()
    system = page.get_by_label("Coordinate system")
    expect(system).to_be_focused()
    system.fill("puwg 1992")
    page.get_by_role("button", name=re.compile("EPSG:2180")).click()
    expect(page.locator("#command code")).to_have_text('in project.toml: crs = "EPSG:2180"')

    page.get_by_role("link", name=re.compile("Run")).click()
    page.get_by_role("button", name="Run", exact=True).click()
    expect(page.locator("ol.stages li[aria-current]")).to_be_visible()
    expect(page.locator("#command code")).to_contain_text("photocal run")
    page.get_by_role("button", name="Stop").click()
    expect(page.locator("main")).to_contain_text("Finished stages are kept")
    page.get_by_role("button", name="Continue").click()
    expect(page.locator("ol.stages li[aria-current]")).to_be_visible()

    # The run is a process of its own: the window that is opened again finds it.
    server.send_signal(signal.SIGKILL)
    server.wait()
    expect(page.locator("main [role=alert]")).to_contain_text("start photocal desk again")
    serve(home)
    page.reload()
    expect(page.locator("#rail .title span")).to_have_text(HOSTILE)
    expect(page.locator(".total .sign")).to_contain_text(re.compile("complete"))
    expect(page.locator(".verdict p").first).not_to_be_empty()
    assert not (held := serious(page)), held

    page.get_by_role("link", name=re.compile("Certificate")).first.click()
    page.get_by_label("Client").fill(HOSTILE)
    framed = page.frame_locator("iframe.preview")
    expect(framed.locator("body")).to_contain_text(HOSTILE)
    assert not (held := serious(page)), held
    page.get_by_label("Person or office").fill("Office for tests")
    page.get_by_role("button", name="Make a key").click()
    expect(page.locator("main")).to_contain_text("It will be signed by Office for tests")
    page.get_by_role("button", name="Write and issue again").click()
    sign = page.get_by_role("button", name="Sign", exact=True)
    expect(sign).to_be_visible()
    sign.click()
    expect(page.locator("#rail")).to_contain_text("signed")
    expect(page.locator("main .sign.good").first).to_contain_text("signed")
    with page.expect_download() as packed:
        page.get_by_role("link", name="Zip to send").click()
    sent = tmp_path / "sent.zip"
    shutil.copyfile(packed.value.path(), sent)
    page.locator("#sent").set_input_files(sent)
    expect(page.locator(".pane > section").last).to_contain_text("signed by a known key")


@pytest.mark.timeout(900)
def test_sizes_of_marks_are_chosen_in_the_pictures_by_keys(
    page: Page, port: int, serve: Callable[[Path], subprocess.Popen[str]], once: Once, tmp_path: Path
) -> None:
    serve(fresh(once, tmp_path / "half", "desk-half", change=resized(0.5)))
    page.goto(f"http://127.0.0.1:{port}/#/folder")
    page.get_by_role("button", name="Inspect this folder").press("Enter")
    half = page.get_by_role("radio", name="size × 1/2", exact=True)
    expect(half).to_be_checked()
    # A crop of each mark, in each row.
    assert page.locator(".frame-offer").count() > 1
    expect(page.locator(".frame-offer").first.locator("canvas")).to_have_count(3)
    assert not (held := serious(page)), held
    stored = page.get_by_role("radio", name="as the pictures are stored")
    stored.press("Space")
    expect(page.locator("#command code")).to_contain_text("--marks 1 --again")
    expect(stored).to_be_checked()
    expect(stored).to_be_focused()
    page.get_by_role("button", name="Português").press("Enter")
    expect(page.get_by_role("radio", name="como as imagens estão gravadas")).to_be_checked()


@pytest.mark.timeout(900)
def test_keys_alone_reach_every_step_and_the_language_changes(
    page: Page, port: int, serve: Callable[[Path], subprocess.Popen[str]], home: Path
) -> None:
    serve(home)
    page.goto(f"http://127.0.0.1:{port}/#/folder")
    expect(page.locator("main h1")).to_have_text("Folder")
    seen = set[str]()
    steps = {"#/folder", "#/check", "#/run", "#/look", "#/certificate", "#/record"}
    for _ in range(40):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.getAttribute('href')") or "")
        if steps <= seen:
            break
    assert steps <= seen
    page.locator("#rail a[href='#/record']").press("Enter")
    expect(page.locator("main h1")).to_have_text("Record")
    # The rail is drawn anew at each change, and the focus stays where it was.
    expect(page.locator("#rail a[href='#/record']")).to_be_focused()
    page.get_by_role("button", name="Português").press("Enter")
    expect(page.locator("main h1")).to_have_text("Gravar")
    expect(page.get_by_role("button", name="English")).to_be_focused()
    expect(page.locator("html")).to_have_attribute("lang", "pt-BR")
    page.reload()
    expect(page.locator("main h1")).to_have_text("Gravar")
    assert not (held := serious(page)), held


def test_a_telephone_shows_the_recording(
    browser: Browser, port: int, serve: Callable[[Path], subprocess.Popen[str]], home: Path
) -> None:
    serve(home)
    context = browser.new_context(viewport={"width": 390, "height": 800}, is_mobile=True, has_touch=True)
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{port}/#/record")
    expect(page.locator("main h1")).to_have_text("Record")
    expect(page.locator("#rail [aria-current]")).to_be_in_viewport()
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390
    context.close()
