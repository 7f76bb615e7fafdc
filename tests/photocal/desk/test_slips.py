"""Slips of whoever uses the window: two windows, wrong values, empty forms, keys instead of the mouse."""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.photocal.desk.client import Client, opened
from tests.photocal.desk.watch import watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 60_000


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    """A folder of two flights, of which one was processed."""
    home = tmp_path / "home"
    shutil.copytree(finished, home / "first")
    (home / "second").mkdir()
    shutil.copyfile(home / "first" / "project.toml", home / "second" / "project.toml")
    return home


@pytest.fixture
def served(folder: Path, tmp_path: Path) -> Iterator[Client]:
    with opened(folder, tmp_path / "cache") as client:
        client.post("/api/open", {"path": "first"})
        yield client


@pytest.fixture
def page(browser: Browser, served: Client) -> Iterator[Page]:
    expect.set_options(timeout=PATIENCE_MS)
    made = browser.new_page(viewport={"width": 1366, "height": 768}, locale="en-US")
    made.set_default_timeout(PATIENCE_MS)
    wrong = watched(made, served.url)
    yield made
    seen = list(wrong)
    made.close()
    assert seen == [], seen


def at(page: Page, served: Client, place: str) -> None:
    page.goto(f"{served.url}/#/{place}")
    expect(page.locator("main h1").first).to_be_visible()


def test_what_is_meant_for_one_folder_is_not_done_in_another(
    page: Page, served: Client, folder: Path
) -> None:
    at(page, served, "folder")
    name = page.get_by_label("Name", exact=True)
    expect(name).to_have_value("site")
    # What the step asks when it begins is answered for the first folder.
    page.wait_for_load_state("networkidle")
    before = (folder / "second" / "project.toml").read_bytes()
    # The second window.
    served.post("/api/open", {"path": "second"})
    name.fill("Third")
    name.press("Tab")
    expect(page.locator("main [role=alert]").first).to_contain_text(
        "another window has opened the folder second"
    )
    assert (folder / "second" / "project.toml").read_bytes() == before
    page.get_by_role("link", name="Run").click()
    expect(page.locator("#rail .title span")).to_have_text("second")
    # From now on what is typed belongs there, which is said.
    expect(page.locator("main > .said [role=alert]")).to_contain_text("opened this folder, second")
    page.get_by_role("link", name="Folder").click()
    page.get_by_role("button", name="one folder up").click()
    page.get_by_role("button", name="first").click()
    expect(page.locator("#rail .title span")).to_have_text("first")
    expect(page.locator("main > .said")).to_have_count(0)


def test_a_button_that_is_drawn_anew_while_it_is_pressed_is_clicked(page: Page, served: Client) -> None:
    """A finger rests on a button for a tenth of a second; the step draws itself anew each second."""
    at(page, served, "run")
    start = page.locator("#start")
    expect(start).to_be_enabled()
    box = start.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    # Twice, so that one of them was asked for after the button was pressed.
    for _ in range(2):
        with page.expect_response("**/api/run"):
            pass
    page.wait_for_timeout(200)
    with page.expect_request("**/api/run/start"):
        page.mouse.up()
    # What has waited is drawn now: the run is seen to end.
    expect(page.locator("#stop")).to_be_hidden()
    expect(start).to_be_enabled()


def test_what_was_done_before_a_change_of_the_project_is_out_of_date(served: Client, folder: Path) -> None:
    def stands(step: str = "run") -> dict[str, str]:
        told: dict[str, str] = served.get("/api/desk").json["steps"][step]
        return told

    later = time.time() + 60
    os.utime(folder / "first" / "work" / ".digests.json", (later, later))
    assert stands() == {"state": "good", "word": "stands.run"}
    os.utime(folder / "first" / "control.csv", (later + 60, later + 60))
    assert stands() == {"state": "warn", "word": "stands.changed"}
    served.post("/api/check/start")
    os.utime(folder / "first" / ".desk" / "check.json", (later + 120, later + 120))
    assert stands("check")["word"] in ("stands.checked", "stands.problem")
    os.utime(folder / "first" / "project.toml", (later + 180, later + 180))
    assert stands("check") == {"state": "warn", "word": "stands.changed"}
    assert served.get("/api/check").json["changed"]


def test_a_system_that_is_not_found_or_not_given_is_said(page: Page, served: Client) -> None:
    at(page, served, "folder")
    system = page.get_by_label("Coordinate system")
    system.fill("banana")
    expect(page.locator(".offers [role=status]")).to_contain_text("No system is called banana")
    system.fill("")
    # At once, while what was typed last is still looked up.
    page.get_by_role("button", name="Set").click()
    alert = page.locator("main [role=alert]").first
    expect(alert).to_contain_text("key project.crs is missing")
    page.wait_for_timeout(1000)
    expect(alert).to_contain_text("key project.crs is missing")


def test_three_lengths_of_which_one_is_no_number_are_said(page: Page, served: Client, folder: Path) -> None:
    file = folder / "first" / "project.toml"
    text = file.read_text()
    sigma = "position_sigma_m = [1.5, 1.5, 3.0]"
    file.write_text(
        text.replace("[images]", f"[images]\n{sigma}") if "position_sigma_m" not in text else text
    )
    before = file.read_bytes()
    at(page, served, "folder")
    east = page.get_by_label("east", exact=True)
    east.fill("1,5 m")
    east.press("Tab")
    alert = page.locator("main [role=alert]").first
    expect(alert).to_contain_text("1,5 m is not a number")
    expect(alert).to_be_in_viewport()
    assert file.read_bytes() == before


def test_a_wrong_particular_is_said_by_its_label_beside_the_preview(page: Page, served: Client) -> None:
    at(page, served, "certificate")
    hint = page.locator(".paper > .hint")
    expect(hint).to_contain_text("Preview")
    page.locator("summary", has_text="Conditions").click()
    page.get_by_label("Air temperature, °C").fill("warm")
    expect(hint).to_contain_text("Air temperature, °C = 'warm' is not a number")
    expect(hint).to_be_in_viewport()
    page.get_by_label("Air temperature, °C").fill("23,5")
    expect(hint).to_contain_text("Preview")
    # As long as the server takes it: what is pasted is cut where it is seen.
    expect(page.get_by_label("Comments")).to_have_attribute("maxlength", "2000")


def test_a_key_is_made_and_a_certificate_signed_by_the_enter_key(
    page: Page, served: Client, folder: Path
) -> None:
    at(page, served, "certificate")
    page.get_by_role("button", name="Make a key").click()
    # The browser asks for what is missing.
    expect(page.get_by_label("Person or office")).to_be_focused()
    page.get_by_label("Person or office").fill("Office")
    page.get_by_label("Passphrase").fill("secret")
    page.get_by_label("Passphrase").press("Enter")
    expect(page.locator("main")).to_contain_text("It will be signed by Office")
    page.get_by_label("Passphrase").fill("wrong")
    page.get_by_label("Passphrase").press("Enter")
    expect(page.locator("main [role=alert]").first).to_contain_text("the key cannot be opened")
    page.get_by_label("Passphrase").fill("secret")
    page.get_by_label("Passphrase").press("Enter")
    expect(page.locator("main .sign.good").first).to_contain_text("signed")
    assert (folder / "first" / "work" / "certificate" / "signature.json").is_file()


def test_a_check_is_made_again_in_the_language_that_was_chosen(page: Page, served: Client) -> None:
    at(page, served, "check")
    page.get_by_role("button", name="Check now").click()
    expect(page.get_by_role("button", name="Check again")).to_be_visible()
    page.get_by_role("button", name="Português").click()
    expect(page.get_by_role("button", name="Conferir de novo")).to_be_visible()
    expect(page.locator("main")).to_contain_text("Máquina")


def test_a_forged_certificate_is_told_in_the_language_of_the_window(served: Client, folder: Path) -> None:
    certificate = folder / "first" / "work" / "certificate"
    page = certificate / "certificate.html"
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", "Certified for all.</body>"), "utf-8")
    served.post("/api/language", {"language": "pt-BR"})
    told = served.post("/api/certificate/verify").json
    assert not told["verified"]
    assert told["problems"] == [
        "certificate.html não é o que foi certificado",
        "certificate.html não concorda com os valores",
    ]


def test_a_folder_that_was_taken_away_is_said_everywhere(page: Page, served: Client, folder: Path) -> None:
    at(page, served, "run")
    (folder / "first").rename(folder / "elsewhere")
    for place in ("run", "look", "certificate"):
        at(page, served, place)
        expect(page.locator("main")).to_contain_text(re.compile("does not exist|has no project.toml"))
