"""Look as a person uses it, in Chromium: find, see, leave out, run again; keyboard; names that are code."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]

from photocal.measurement.marks import read_marks
from tests.photocal.desk.client import opened
from tests.photocal.desk.look.surveys import GROSS_IMAGE, GROSS_POINT, with_control
from tests.photocal.desk.watch import serious, watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 60_000
# A run takes ten seconds where nobody else works.
RUN_MS = 300_000
HOSTILE = "<img src=x onerror=window.hacked=1>"


@contextmanager
def looking(
    browser: Browser, folder: Path, cache: Path, language: str = "en-US", place: str = ""
) -> Iterator[Page]:
    """Open the window at Look on a field laptop; nothing may go wrong in it, and nobody else be asked."""
    with opened(folder, cache) as client:
        page = browser.new_page(viewport={"width": 1366, "height": 768}, locale=language)
        page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        wrong = watched(page, client.url)
        page.goto(f"{client.url}/#/look{place}")
        expect(page.locator(".findings .summary")).to_be_visible()
        yield page
        page.close()
        assert wrong == [], wrong


def lit(page: Page) -> int:
    """How many stations, points and footprints are lit on the map."""
    asked = (
        "document.getElementById('view-map').blockMap.getLayers().getArray().at(-1).getSource().getFeatures()"
    )
    return int(page.evaluate(f"{asked}.length"))


def test_a_gross_mark_is_found_seen_left_out_and_its_reason_certified(
    browser: Browser, finished: Path, tmp_path: Path
) -> None:
    reason = "mark on the plate's edge"
    with looking(browser, finished, tmp_path / "cache") as page:
        expect(page.locator(".summary .sign")).to_contain_text("usable with reservations")
        finding = page.locator(".finding", has_text=GROSS_POINT).first
        finding.get_by_role("button").first.click()
        worst = page.locator(".crop").first
        expect(worst).to_contain_text(GROSS_IMAGE)
        expect(worst).to_have_class("crop far")
        expect(page.locator("#picture-name")).to_have_value(GROSS_IMAGE)
        worst.get_by_role("button", name=f"Leave out {GROSS_POINT} in {GROSS_IMAGE}").click()
        page.get_by_label("Reason").fill(reason)
        page.get_by_role("dialog").get_by_role("button", name="Leave out").click()
        expect(page.locator(".left li")).to_contain_text(reason)
        expect(page.locator(".crop").first.locator(".out")).to_have_text("left out")
        page.get_by_role("button", name="Run again").click()
        expect(page.locator(".summary .sign")).to_have_text("✓ usable", timeout=RUN_MS)
        expect(page.locator(".waiting")).to_have_count(0)
        expect(page.locator(".finding", has_text=reason)).to_be_visible()
    certified = json.loads((finished / "work/certificate/certificate.json").read_text(encoding="utf-8"))
    (note,) = [note for note in certified["notes"] if note["code"] == "left-out-by-hand"]
    assert reason in note["text"]
    assert "plate&#39;s edge" in (finished / "work/certificate/certificate.html").read_text(encoding="utf-8")


def test_one_selection_lights_up_everywhere(browser: Browser, made: Path, tmp_path: Path) -> None:
    with looking(browser, made, tmp_path / "cache") as page:
        expect(page.locator("#view-map canvas").first).to_be_visible()
        assert lit(page) == 0
        page.locator(".thumb", has_text="p3.png").click()
        # The browser tells of a new address in a message of its own, which may come after the click.
        expect(page).to_have_url(re.compile(r"#/look/image/p3\.png$"))
        expect(page.locator("#picture-name")).to_have_value("p3.png")
        # Its footprint and its station.
        assert lit(page) == 2
        page.evaluate("location.hash = '#/look/point/P4'")
        expect(page.locator(".strip .head")).to_contain_text("P4")
        crops = page.locator(".crop").count()
        assert lit(page) == 1 + crops
        page.keyboard.press("3")
        expect(page.locator("#view-plots .u-over").first).to_be_visible()
        page.keyboard.press("2")
        expect(page.locator("#view-space canvas")).to_be_visible()
        page.keyboard.press("1")
        page.keyboard.press("Escape")
        assert lit(page) == 0


def test_the_map_follows_the_mouse_at_once(browser: Browser, made: Path, tmp_path: Path) -> None:
    """What nobody has clicked yet is dragged, and zoomed by the wheel."""
    with looking(browser, made, tmp_path / "cache") as page:
        expect(page.locator("#view-map canvas").first).to_be_visible()
        box = page.locator("#view-map .plane").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        _, scale = resting(page)
        page.mouse.move(x, y)
        page.mouse.wheel(0, -400)
        page.wait_for_timeout(300)
        place, finer = resting(page)
        assert finer < 0.9 * scale
        page.mouse.down()
        page.mouse.move(x - 30, y, steps=5)
        page.mouse.move(x - 90, y, steps=5)
        dragged, _ = resting(page)
        page.mouse.up()
        # The first pixels decide whether it is a click.
        assert 60 < (dragged[0] - place[0]) / finer <= 90


def resting(page: Page) -> tuple[list[float], float]:
    """Centre of the map and metres of a pixel, when nothing moves any more."""
    view = "document.getElementById('view-map').blockMap.getView()"
    while page.evaluate(f"!{view}.getResolution() || {view}.getAnimating()"):
        page.wait_for_timeout(50)
    place, scale = page.evaluate(f"[{view}.getCenter(), {view}.getResolution()]")
    return place, scale


def test_all_of_it_by_keyboard(browser: Browser, finished: Path, tmp_path: Path) -> None:
    with looking(browser, finished, tmp_path / "cache") as page:
        first = page.locator("button.line").first
        first.focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        expect(page.locator(".finding").nth(1)).to_have_class("finding chosen")
        page.keyboard.press("Escape")
        page.keyboard.press(".")
        expect(page.locator("#picture-name")).to_have_value(re.compile(r"p\d\.png"))
        shown = page.locator("#picture-name").input_value()
        page.keyboard.press("l")
        expect(page.get_by_role("dialog")).to_contain_text(f"Leave out picture {shown}")
        page.keyboard.type("blurred")
        page.keyboard.press("Enter")
        expect(page.locator(".left li")).to_contain_text("blurred")
        expect(page.locator("#command")).to_contain_text("photocal run")
        page.locator("#tab-map").focus()
        page.keyboard.press("ArrowRight")
        expect(page.locator("#tab-space")).to_have_attribute("aria-selected", "true")
        expect(page.locator("#tab-space")).to_be_focused()


@pytest.mark.parametrize("view", ["map", "plots", "space"])
def test_axe_finds_nothing_serious(browser: Browser, made: Path, tmp_path: Path, view: str) -> None:
    with looking(browser, made, tmp_path / "cache") as page:
        page.locator(f"#tab-{view}").click()
        page.evaluate("location.hash = '#/look/point/P5'")
        expect(page.locator(".crop").first).to_be_visible()
        assert not (held := serious(page)), held


def test_an_orthophoto_is_switched_by_a_key(browser: Browser, finished: Path, tmp_path: Path) -> None:
    place = rasterio.Affine(0.05, 0.0, -30.0, 0.0, -0.05, 17.0)
    given = {"driver": "GTiff", "width": 1200, "height": 680, "count": 3, "dtype": "uint8"}
    with rasterio.open(finished / "ortho.tif", "w", transform=place, **given) as made:
        made.write(np.full((3, 680, 1200), 120, np.uint8))
    with looking(browser, finished, tmp_path / "cache", "pt-BR") as page:
        switch = page.get_by_role("checkbox", name="ortofoto")
        expect(switch).not_to_be_checked()
        with page.expect_response(lambda answer: "/api/look/ground/" in answer.url) as tile:
            switch.press("Space")
        assert tile.value.status == 200
        expect(switch).to_be_checked()
        assert not (held := serious(page)), held


def test_a_point_of_look_is_marked_at_its_place(browser: Browser, finished: Path, tmp_path: Path) -> None:
    """From the picture of a point to the place Mark, and back to the same point."""
    with_control(finished)
    with looking(browser, finished, tmp_path / "cache", place="/point/P3") as page:
        expect(page.locator(".crop").first).to_be_visible()
        image = page.locator("#picture-name").input_value()
        page.locator(".picture .bar").get_by_role("button", name="Mark").click()
        expect(page.locator(".marking[data-ready]")).to_be_visible()
        expect(page.locator("#point")).to_have_text("P3")
        expect(page.locator(".shot[data-active=true] .caption .name")).to_have_text(image)
        expect(page.locator(".shot[data-active=true] .frame[data-loaded=true]")).to_be_visible()
        page.keyboard.press("m")
        expect(page.locator(".shot[data-active=true] .caption button")).to_be_visible()
        (mark,) = read_marks(finished / "marks.csv")
        assert (mark.image, mark.point) == (image, "P3")
        page.go_back()
        expect(page.locator(".strip .head").first).to_contain_text("P3")


def test_it_speaks_portuguese(browser: Browser, made: Path, tmp_path: Path) -> None:
    with looking(browser, made, tmp_path / "cache", "pt-BR") as page:
        expect(page.locator(".summary .sign")).to_contain_text("utilizável com ressalvas")
        expect(page.locator(".finding").first).to_contain_text("erro grosseiro")
        expect(page.locator("#tab-plots")).to_have_text("Gráficos")


def test_names_that_would_be_code_are_names(browser: Browser, finished: Path, tmp_path: Path) -> None:
    """A control point of that name, from the tables to findings, map, crops and the dialogue."""
    for path in sorted((finished / "work").rglob("*")):
        if path.suffix in (".csv", ".json", ".toml"):
            path.write_text(path.read_text(encoding="utf-8").replace(GROSS_POINT, HOSTILE), encoding="utf-8")
    with looking(browser, finished, tmp_path / "cache") as page:
        finding = page.locator(".finding", has_text=HOSTILE).first
        finding.get_by_role("button").first.click()
        expect(page.locator(".strip .head")).to_contain_text(HOSTILE)
        page.locator(".crop").first.get_by_role("button").last.click()
        expect(page.get_by_role("dialog")).to_contain_text(HOSTILE)
        page.keyboard.press("Escape")
        for key in ("2", "3", "1"):
            page.keyboard.press(key)
            page.wait_for_timeout(300)
        assert page.evaluate("window.hacked") is None
        assert page.locator("img[src=x]").count() == 0
