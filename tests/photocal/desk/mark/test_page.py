"""The place Mark as a person uses it: Chromium, mouse and touch, reload, and a server that is killed.

Waiting times are generous for busy machines; how fast the page is stands in the benchmark.
"""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from photocal.base.web import Address, serving
from photocal.desk.standing import marking_application
from photocal.measurement.marking.store import MarkStore, scene_of_folder
from photocal.measurement.marks import read_marks
from tests.photocal.desk.served import free_port, serving_at
from tests.photocal.desk.watch import serious, watched
from tests.photocal.measurement.marking.conftest import IMAGES, POINTS, Survey

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 60_000
expect.set_options(timeout=PATIENCE_MS)
COMMAND = "from photocal.commands.cli import main; main()"
Serve = Callable[..., subprocess.Popen[str]]
READY = ".marking[data-ready]"
# What the place knows, and the pictures that it shows.
STATE = "document.querySelector('.marking').marking.state"
SHOTS = (
    "[...document.querySelectorAll('.shot')].filter((one) => !one.hidden && one.dataset.empty === 'false')"
)
VIEW = f"{SHOTS}[0].querySelector('.frame').viewer"
MIDDLE = f"{VIEW}.inPicture({VIEW}.element.clientWidth / 2, {VIEW}.element.clientHeight / 2)"


@pytest.fixture(scope="module")
def mine(flown: Survey, tmp_path_factory: pytest.TempPathFactory) -> Survey:
    folder = tmp_path_factory.mktemp("marking") / "field"
    shutil.copytree(flown.folder, folder)
    return Survey(folder, flown.site, flown.points)


@pytest.fixture(scope="module")
def port() -> int:
    return free_port()


@pytest.fixture
def serve_mark(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Open the command on a project; gives the address that it prints."""
    running: list[subprocess.Popen[str]] = []

    def start(folder: Path) -> str:
        arguments = ["mark", folder, "--address", "127.0.0.1:0", "--cache", tmp_path / "cache"]
        command = [sys.executable, "-c", COMMAND, *map(str, arguments)]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        assert running[0].stdout is not None
        return running[0].stdout.readline().split()[1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def serve(mine: Survey, port: int) -> Iterator[Serve]:
    running: list[subprocess.Popen[str]] = []
    with serving_at(port) as start:

        def anew() -> subprocess.Popen[str]:
            for process in running:
                process.kill()
                process.wait()
            running.append(start("mark", mine.file, "--cache", mine.folder / "cache"))
            return running[-1]

        yield anew


def opened(page: Page, port: int) -> list[str]:
    """Open the page; returns what goes wrong in it and what it asks of others."""
    page.set_default_timeout(PATIENCE_MS)
    problems = watched(page, f"http://127.0.0.1:{port}/")
    page.goto(f"http://127.0.0.1:{port}/")
    expect(page.locator(READY)).to_be_visible()
    return problems


def until(page: Page, condition: str) -> None:
    """Wait for a condition; the page forbids the evaluation of texts, also that of Playwright's own wait."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(30)


def screen(page: Page, image: str, place: tuple[float, float]) -> tuple[float, float]:
    """Where the page shows a place of an image."""
    until(
        page,
        f"{SHOTS}.some((one) => one.dataset.image === '{image}' && one.dataset.point === {STATE}.point"
        " && one.querySelector('.frame').dataset.loaded === 'true')",
    )
    left, top = page.evaluate(
        f"""([image, x, y]) => {{
          const shot = {SHOTS}.find((one) => one.dataset.image === image);
          const frame = shot.querySelector(".frame");
          const [box, at] = [frame.getBoundingClientRect(), frame.viewer.onScreen([x, y])];
          return [box.left + at[0], box.top + at[1]];
        }}""",
        [image, *place],
    )
    return float(left), float(top)


def choose(page: Page, point: str) -> None:
    named = page.locator(".name").filter(has_text=re.compile(rf"^(✓ )?{point}$"))
    page.locator("#points li button", has=named).click()
    expect(page.locator("#point")).to_have_text(point)
    until(page, f"{STATE}.ranked.length > 0 && {SHOTS}[0].dataset.point === '{point}'")


def count(page: Page) -> int:
    return int(page.evaluate(f"{STATE}.marks.size"))


def marked(page: Page, number: int) -> None:
    until(page, f"{STATE}.marks.size === {number}")


def saved(survey: Survey) -> dict[tuple[str, str], tuple[float, float]]:
    return {(m.image, m.point): (m.x, m.y) for m in read_marks(survey.folder / "marks.csv")}


# Fifty targets are found one after the other: minutes where many programs want the processor.
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ten_points_in_five_images_from_clicks_to_residuals(
    browser: Browser, serve: Serve, mine: Survey, port: int
) -> None:
    process = serve()
    context = browser.new_context(viewport={"width": 1366, "height": 768})
    page = context.new_page()
    problems = opened(page, port)
    page.keyboard.press("6")
    rng = np.random.default_rng(7)
    made = 0
    for number in range(1, POINTS + 1):
        point = f"P{number}"
        choose(page, point)
        for image in mine.site.names:
            x, y = mine.truth(image, point)
            beside = rng.uniform(-2.5, 2.5, 2)
            page.mouse.click(*screen(page, image, (x + beside[0], y + beside[1])))
            made += 1
            marked(page, made)
    marks = saved(mine)
    assert len(marks) == POINTS * IMAGES
    errors = np.array([np.subtract(place, mine.truth(*key)) for key, place in marks.items()])
    assert np.hypot(*errors.T).max() < 0.1

    # Predictions were from exposures with sigmas; all targets lay where they were expected.
    page.click("#adjust")
    expect(page.locator(".marking[data-adjusted='1']")).to_be_visible()
    expect(page.locator("#sigma0")).to_have_text(re.compile(r"σ0 \d\.\d\d"))
    expect(page.locator("#images-source")).to_have_text("by adjusted marks")
    assert page.evaluate(f"[...{STATE}.residuals.values()].every((r) => Math.hypot(r.vx, r.vy) < 0.2)")

    # A mark that is moved loses its residual; the next adjustment points at it.
    page.keyboard.press("s")
    x, y = mine.truth("p3.png", "P4")
    choose(page, "P4")
    page.mouse.click(*screen(page, "p3.png", (x + 4, y)))
    until(page, f"Math.abs({STATE}.marks.get('p3.png\\nP4').sx - 1) < 1e-9")
    until(page, f"!{STATE}.residuals.has('p3.png\\nP4')")
    page.keyboard.press("a")
    expect(page.locator(".marking[data-adjusted='2']")).to_be_visible()
    expect(page.locator("#residuals li").first).to_contain_text("P4 in p3.png")
    page.keyboard.press("Control+z")
    until(
        page,
        f"[{STATE}.marks.get('p3.png\\nP4')].every((at) => Math.hypot(at.x - {x}, at.y - {y}) < 0.1)",
    )
    page.keyboard.press("s")

    before = saved(mine)
    page.reload()
    expect(page.locator(READY)).to_be_visible()
    assert count(page) == len(before)
    expect(page.locator("#point")).to_have_text("P4")
    process.kill()
    process.wait()
    assert saved(mine) == before
    expect(page.locator(".banner")).to_contain_text("does not answer")
    serve()
    expect(page.locator(".banner")).to_be_hidden()
    page.reload()
    expect(page.locator(READY)).to_be_visible()
    assert count(page) == len(before)
    assert problems == [], problems
    context.close()


@pytest.fixture
def empty(mine: Survey, serve: Serve, port: int) -> None:
    (mine.folder / "marks.csv").unlink(missing_ok=True)
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", port)):
            serve()


@pytest.mark.usefixtures("empty")
def test_keys_undo_redo_remove_and_move_marks(browser: Browser, mine: Survey, port: int) -> None:
    context = browser.new_context(viewport={"width": 1366, "height": 768})
    page = context.new_page()
    problems = opened(page, port)
    page.keyboard.press("1")
    first = page.evaluate(f"{STATE}.ranked[0].name")
    page.keyboard.press("ArrowDown")
    expect(page.locator("#point")).to_have_text("P2")
    page.keyboard.press("ArrowUp")
    expect(page.locator("#point")).to_have_text("P1")
    for step in (0, 1):
        image = page.evaluate(f"{STATE}.ranked[{step}].name")
        until(page, f"{SHOTS}[0].dataset.image === '{image}'")
        place = mine.truth(image, "P1")
        page.mouse.click(*screen(page, image, place))
        marked(page, step + 1)
        page.keyboard.press("ArrowRight")
    assert len(saved(mine)) == 2
    page.keyboard.press("Control+z")
    marked(page, 1)
    assert list(saved(mine)) == [(first, "P1")]
    page.keyboard.press("Control+z")
    marked(page, 0)
    assert not (mine.folder / "marks.csv").exists()
    expect(page.locator("#undo")).to_be_disabled()
    page.keyboard.press("Control+Shift+z")
    marked(page, 1)
    expect(page.locator(".caption .name").first).to_have_text(first)
    place = saved(mine)[first, "P1"]
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    until(page, f"Math.abs({STATE}.marks.get('{first}\\nP1').y - {place[1] - 0.1}) < 1e-3")
    assert np.allclose(saved(mine)[first, "P1"], (place[0] + 0.1, place[1] - 0.1), atol=1e-3)
    page.keyboard.press("Delete")
    marked(page, 0)
    page.keyboard.press("Control+z")
    marked(page, 1)
    assert problems == [], problems
    context.close()


@pytest.mark.usefixtures("empty")
def test_a_long_press_marks_and_two_fingers_zoom(browser: Browser, mine: Survey, port: int) -> None:
    context = browser.new_context(viewport={"width": 412, "height": 840}, has_touch=True, is_mobile=True)
    page = context.new_page()
    problems = opened(page, port)
    image = page.evaluate(f"{STATE}.ranked[0].name")
    touch = context.new_cdp_session(page)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    x, y = screen(page, image, mine.truth(image, "P1"))
    fingers("touchStart", (x, y))
    marked(page, 1)
    fingers("touchEnd")
    assert np.hypot(*np.subtract(saved(mine)[image, "P1"], mine.truth(image, "P1"))) < 0.1

    scale, x = page.evaluate(f"[{VIEW}.scale(), {MIDDLE}[0]]")
    fingers("touchStart", (150, 500))
    fingers("touchMove", (200, 500))
    fingers("touchEnd")
    until(page, f"Math.abs({MIDDLE}[0] - {x - 50 / scale}) < 1")
    fingers("touchStart", (180, 500), (230, 500))
    for step in range(1, 6):
        fingers("touchMove", (180 - 10 * step, 500), (230 + 10 * step, 500))
    fingers("touchEnd")
    until(page, f"Math.abs({VIEW}.scale() / {scale} - 3) < 0.05")
    assert count(page) == 1
    # A short tap neither marks nor moves. The press's own clock stands still, or a busy machine would make a
    # press of the tap: it must have been stopped.
    page.evaluate(
        """() => {
          window.presses = new Set();
          const [wait, stop] = [window.setTimeout, window.clearTimeout];
          window.setTimeout = (work, delay, ...rest) => {
            if (delay !== 450) return wait(work, delay, ...rest);
            presses.add(-1);
            return -1;
          };
          window.clearTimeout = (id) => presses.delete(id) || stop(id);
        }"""
    )
    before, seen = saved(mine), page.evaluate(MIDDLE)
    fingers("touchStart", (200, 500))
    until(page, "presses.size === 1")
    fingers("touchEnd")
    until(page, "presses.size === 0")
    assert page.evaluate(MIDDLE) == seen
    assert saved(mine) == before
    assert problems == [], problems
    context.close()


@pytest.mark.usefixtures("empty")
@pytest.mark.parametrize(("width", "height"), [(800, 1280), (390, 844)])
def test_all_controls_are_large_enough_for_a_finger(
    browser: Browser, port: int, width: int, height: int
) -> None:
    """44 px each way (WCAG 2.1, 2.5.5), and none beyond the edge."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, has_touch=True, is_mobile=True, color_scheme="dark"
    )
    page = context.new_page()
    problems = opened(page, port)
    page.locator("#panel-button").click()
    expect(page.locator("#panel")).to_be_visible()
    controls = page.evaluate(
        """() => [...document.querySelectorAll("button, select, input")]
          .filter((own) => own.checkVisibility())
          .map((own) => [own.id || own.textContent, own.getBoundingClientRect()])
          .map(([name, box]) => [name, box.width, box.height, box.right])"""
    )
    assert len(controls) > 20
    assert [one for one in controls if one[1] < 44 or one[2] < 44 or one[3] > width] == []
    assert problems == [], problems
    context.close()


def test_the_command_opens_the_whole_window_of_a_project_at_mark(
    browser: Browser, survey: Survey, serve_mark: Callable[..., str]
) -> None:
    """The rail has all steps; the place speaks both languages, and nobody is kept out of it."""
    survey.file.rename(survey.folder / "project.toml")
    url = serve_mark(survey.folder)
    page = browser.new_page(viewport={"width": 1366, "height": 768}, locale="pt-BR")
    page.set_default_timeout(PATIENCE_MS)
    problems = watched(page, url)
    page.goto(url)
    expect(page.locator(READY)).to_be_visible()
    expect(page).to_have_url(re.compile(r"#/mark/P1/p1\.png$"))
    expect(page.locator("#rail a.step")).to_have_count(7)
    expect(page.locator("#rail [aria-current]")).to_contain_text("Marcar")
    expect(page.locator(".caption .said").first).to_have_text("não marcado; na imagem: 100 %")
    expect(page.locator("#images-source")).to_have_text("pelas exposições")
    assert not (held := serious(page)), held
    page.get_by_role("button", name="English").click()
    expect(page.locator(".caption .said").first).to_have_text("not marked; in the picture: 100 %")
    expect(page.locator("#command code")).to_have_text(f"photocal mark {survey.folder}")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_contain_text("move the mark by 0.1 px")
    assert not (held := serious(page)), held
    page.get_by_role("button", name="Close").click()
    # Another place and back: the point stays chosen.
    choose(page, "P7")
    page.locator("#rail a[href='#/record']").click()
    expect(page.locator("main h1")).to_have_text("Record")
    page.go_back()
    expect(page.locator("#point")).to_have_text("P7")
    assert problems == [], problems
    page.close()


def test_pictures_without_a_project_have_the_place_alone(
    browser: Browser, survey: Survey, tmp_path: Path
) -> None:
    scene = scene_of_folder(survey.folder / "images", None, None)
    store = MarkStore(tmp_path / "mine.csv")
    app = marking_application(scene, store, tmp_path / "cache")
    with serving(app, Address("127.0.0.1", 0)) as url:
        page = browser.new_page(viewport={"width": 1366, "height": 768}, locale="en-US")
        page.set_default_timeout(PATIENCE_MS)
        problems = watched(page, url)
        page.goto(url)
        expect(page.locator(READY)).to_be_visible()
        expect(page.locator("#rail a.step")).to_have_count(1)
        expect(page.locator("#adjust")).to_be_disabled()
        page.keyboard.press("1")
        page.mouse.click(*screen(page, "p1.png", (240.0, 180.0)))
        expect(page.locator(".note")).to_have_text("Choose or add a point first.")
        name = "<img src=x onerror=alert(1)>"
        page.get_by_label("Name of a new point").fill(name)
        page.get_by_role("button", name="Add").click()
        expect(page.locator("#point")).to_have_text(name)
        page.keyboard.press("s")
        page.mouse.click(*screen(page, "p1.png", (240.0, 180.0)))
        marked(page, 1)
        expect(page.locator(".caption .said").first).to_contain_text("by hand")
        (mark,) = store.marks
        assert (mark.image, mark.point) == ("p1.png", name)
        assert (mark.x, mark.y) == pytest.approx((240.0, 180.0), abs=0.5)
        page.evaluate("location.hash = '#/folder'")
        expect(page).to_have_url(re.compile("#/mark"))
        assert not (held := serious(page)), held
        assert problems == [], problems
        page.close()
