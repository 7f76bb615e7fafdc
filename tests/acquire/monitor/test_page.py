"""The page as a person sees it: a live recording, a browser, and a server that dies and returns.

Waiting times are generous for busy machines; how fast the page is stands in docs/evidence/monitor.md.
"""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from photocal.base.web import Address, serving
from tests.acquire.monitor.conftest import Monitor
from tests.acquire.monitor.field import NO_FIX, RTK_FIXED, Field, at_work

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

PATIENCE_MS = 120_000
expect.set_options(timeout=PATIENCE_MS)
# Counts the tones that the page begins.
COUNT_TONES = """
  window.tones = 0;
  const create = AudioContext.prototype.createOscillator;
  AudioContext.prototype.createOscillator = function () { window.tones += 1; return create.call(this); };
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recording")


@pytest.fixture(scope="module")
def field(folder: Path) -> Iterator[Field]:
    with at_work(folder) as working:
        working.take_picture()
        yield working


@pytest.fixture(scope="module")
def server(field: Field, folder: Path, monitor: Monitor, port: int) -> subprocess.Popen[str]:
    file = str(folder / "debrief.json")
    process, line = monitor(folder, "--page", "--address", f"127.0.0.1:{port}", "--debrief", file)
    assert line == f"open http://127.0.0.1:{port}/"
    return process


@pytest.fixture
def page(browser: Browser, server: subprocess.Popen[str], port: int) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    context.add_init_script(COUNT_TONES)
    opened = context.new_page()
    problems: list[str] = []
    foreign: list[str] = []
    opened.on("pageerror", lambda error: problems.append(str(error)))
    opened.on("request", lambda r: foreign.append(r.url) if f"127.0.0.1:{port}/" not in r.url else None)
    opened.goto(f"http://127.0.0.1:{port}/")
    expect(opened.locator("#overall")).not_to_have_text("connecting")
    # What tests before have left open is confirmed; a feed that follows shows it.
    if opened.locator("#heard").is_visible():
        opened.click("#heard")
        expect(opened.locator("#banner")).to_be_hidden()
    yield opened
    assert problems == [], problems
    assert [url for url in foreign if not url.startswith("data:")] == []
    context.close()


def until(page: Page, condition: str) -> None:
    """Wait for a condition; the page forbids the evaluation of texts, also that of Playwright's own wait."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(50)


def fix_of(name: str) -> str:
    return f"#receivers .card:has(.name:text('{name}')) .top .word"


def test_the_state_of_all_links_is_there(page: Page, field: Field) -> None:
    for name in ("vehicle", "rover", "base"):
        row = page.locator(f".link[data-link={name}]")
        expect(row.locator(".word")).to_have_text("receiving")
        expect(row.locator(".rate").first).not_to_have_text("0.0 /s")
    expect(page.locator(fix_of("rover"))).to_have_text("RTK fixed")
    expect(page.locator("#receivers")).to_contain_text(re.compile(r"17 satellites.*1\.4 cm accuracy"))
    # The rover says nothing of the age of its corrections: it is that of the last one that was sent to it.
    expect(page.locator("#receivers")).to_contain_text(re.compile(r"corrections [0-9.]+ s old"))
    expect(page.locator("#rest")).to_contain_text(re.compile(r"GB free.*in step"))
    expect(page.locator("#map")).to_have_attribute("aria-label", re.compile("tracks rover, vehicle; [1-9]"))
    assert page.evaluate("[...map.layers.keys()]") == [
        "track rover",
        "track vehicle",
        "picture vehicle",
        "station base",
    ]


def test_the_page_speaks_portuguese(browser: Browser, server: subprocess.Popen[str], port: int) -> None:
    """By the browser's language or by ?lang; a button changes it, and the choice is kept."""
    assert server.poll() is None
    context = browser.new_context(viewport={"width": 1280, "height": 800}, locale="pt-BR")
    page = context.new_page()
    page.goto(f"http://127.0.0.1:{port}/")
    expect(page.locator("html")).to_have_attribute("lang", "pt-BR")
    expect(page.locator(".link[data-link=rover] .word")).to_have_text("recebendo")
    expect(page.locator(".link[data-link=rover] .rate").first).to_have_text(re.compile(r"^\d+,\d /s$"))
    expect(page.locator(fix_of("rover"))).to_have_text("RTK fixo")
    expect(page.locator("#receivers")).to_contain_text(re.compile(r"correções de \d+,\d s atrás"))
    expect(page.locator("#rest")).to_contain_text(re.compile(r"\d+,\d GB livres.*em sincronia"))
    expect(page.locator("#map")).to_have_attribute("aria-label", re.compile("Mapa: trajetórias rover"))
    expect(page.locator("h2").first).to_have_text("Alarmes (UTC)")
    page.get_by_role("button", name="English").click()
    expect(page.locator(".link[data-link=rover] .word")).to_have_text("receiving")
    expect(page.locator("h2").first).to_have_text("Alarms (UTC)")
    page.reload()
    expect(page.locator("html")).to_have_attribute("lang", "en")
    page.goto(f"http://127.0.0.1:{port}/?lang=pt-BR")
    expect(page.locator("#sound")).to_have_text("Som desligado")
    context.close()


def test_a_debrief_stands_on_the_page_as_soon_as_it_is_written(page: Page, folder: Path) -> None:
    box = page.locator("#debrief")
    expect(box).to_be_hidden()
    findings = [
        {"severity": "grave", "text": "Strip 4: <b>fly</b> it again."},
        {"severity": "passed", "text": "c is as in the last certificate."},
    ]
    content: dict[str, Any] = {"verdict": {"text": "Do not leave."}, "findings": findings}
    (folder / "debrief.json").write_text(json.dumps(content), encoding="utf-8")
    expect(box.locator("p")).to_have_text("Do not leave.")
    expect(box.locator("li")).to_have_text(["Strip 4: <b>fly</b> it again."])
    # In flight: what was measured so far, and pictures that were reported and have not come.
    content |= {"summary": ["c 3654.5 ± 1.8 px"], "pictures": [], "live": {"waiting": 0}}
    (folder / "debrief.json").write_text(json.dumps(content), encoding="utf-8")
    expect(box.locator(".summary li").last).to_have_text("c 3654.5 ± 1.8 px")
    expect(box.locator(".summary li").first).to_have_text(
        re.compile("0 of [1-9][0-9]* reported pictures have been received")
    )
    # In the words of the other language, where the debrief has written them.
    own = {
        "verdict": "Não vá embora.",
        "summary": ["c 3654,5 ± 1,8 px"],
        "findings": ["Repetir a faixa 4.", "c"],
    }
    content |= {"said": {"pt-BR": own}}
    (folder / "debrief.json").write_text(json.dumps(content), encoding="utf-8")
    page.get_by_role("button", name="Português").click()
    expect(box.locator("p")).to_have_text("Não vá embora.")
    expect(box.locator(".findings li")).to_have_text(["Repetir a faixa 4."])
    expect(box.locator(".summary li")).to_have_text([re.compile("chegaram 0 de"), "c 3654,5 ± 1,8 px"])
    page.get_by_role("button", name="English").click()
    expect(box.locator("p")).to_have_text("Do not leave.")
    (folder / "debrief.json").unlink()
    expect(box).to_be_hidden()


def test_a_lost_fix_is_said_in_words_and_colour_and_told_until_it_is_heard(page: Page, field: Field) -> None:
    word = page.locator(fix_of("vehicle"))
    expect(word).to_have_text("RTK fixed")
    field.fix = NO_FIX
    expect(word).to_have_text("no fix")
    expect(word).to_have_attribute("data-level", "bad")
    banner = page.locator("#banner")
    expect(banner).to_contain_text("vehicle: fix dropped from RTK fixed to no fix")
    expect(page).to_have_title(re.compile("fix dropped"))
    field.fix = RTK_FIXED
    expect(word).to_have_text("RTK fixed")
    expect(banner).to_be_visible()
    page.reload()
    expect(banner).to_contain_text("fix dropped")
    page.click("#heard")
    expect(banner).to_be_hidden()
    page.reload()
    expect(page.locator("#alarms")).to_contain_text("fix dropped")
    expect(banner).to_be_hidden()


def test_a_missed_trigger_is_named_and_marked_on_the_map(page: Page, field: Field) -> None:
    number = field.take_picture(feedback=False)
    word = page.locator("#cameras .top .word")
    expect(word).to_have_text(re.compile(rf"missed: .*\b{number}$"))
    expect(page.locator("#cameras")).to_contain_text(f"{number} triggered")
    expect(page.locator("#banner")).to_contain_text(f"vehicle: no feedback for picture {number}")
    assert page.evaluate("map.layers.get('missed vehicle').labels").pop() == str(number)
    page.reload()
    expect(word).to_have_text(re.compile(rf"missed: .*\b{number}$"))


def test_alarms_are_heard_once_a_person_has_allowed_sound(page: Page, field: Field) -> None:
    field.take_picture()
    field.take_picture(feedback=False)
    expect(page.locator("#banner")).to_be_visible()
    assert page.evaluate("tones") == 0
    page.click("#sound")
    expect(page.locator("#sound")).to_have_text("Sound on")
    # Each alarm has three tones, again and again.
    until(page, "tones >= 7")
    page.click("#heard")
    # A test tone, then whole alarms; after the confirmation none any more.
    told = page.evaluate("tones")
    assert told % 3 == 1
    page.wait_for_timeout(3000)
    assert page.evaluate("tones") == told
    page.click("#sound")
    field.take_picture(feedback=False)
    expect(page.locator("#banner")).to_be_visible()
    page.wait_for_timeout(500)
    assert page.evaluate("tones") == told


def test_the_head_is_the_worst_of_all_and_the_tiles_what_a_pilot_looks_for(page: Page, field: Field) -> None:
    overall, tiles = page.locator("#overall"), page.locator("#tiles")
    expect(tiles).to_contain_text(re.compile(r"off80 m.*armedAUTO.*15\.8 V, 81 %.*RTK fixed.*disk"))
    field.fix = NO_FIX
    expect(overall).to_have_text(re.compile("^vehicle: no fix"))
    expect(overall).to_have_attribute("data-level", "bad")
    field.fix = RTK_FIXED
    expect(overall).not_to_have_text(re.compile("no fix"))


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_no_name_on_the_map_is_covered_or_cut(page: Page, field: Field, width: int, height: int) -> None:
    for _ in range(4):
        field.take_picture(feedback=False)
    page.set_viewport_size({"width": width, "height": height})
    until(page, "(map.layers.get('missed vehicle')?.labels.length ?? 0) >= 4")
    # Those of the page as it was before it became so narrow count no more.
    page.evaluate("names.taken = []")
    until(page, "names.taken?.length > 5")
    boxes = page.evaluate("names.taken")
    room = page.evaluate("[$('map').clientWidth, $('map').clientHeight]")
    # The first ones are what lies over the map: scale, arrow, buttons, legend.
    shown = boxes[4:]
    assert len(shown) >= 3
    for number, (left, top, right, bottom) in enumerate(shown):
        assert 0 <= left < right <= room[0]
        assert 0 <= top < bottom <= room[1]
        for other in boxes[: 4 + number]:
            assert left >= other[2] or other[0] >= right or top >= other[3] or other[1] >= bottom
    for selector in ("#overall", "#tiles dd", "#sound"):
        for box in page.locator(selector).all():
            wide = box.evaluate("e => [e.scrollWidth, e.clientWidth, e.getBoundingClientRect().right]")
            assert wide[0] <= wide[1] + 1
            assert wide[2] <= width


def test_texts_of_a_vehicle_are_never_code(page: Page, field: Field) -> None:
    field.say("STATUSTEXT", severity=2, text=b"<img src=x onerror=tones=99><b>PreArm</b>")
    expect(page.locator("#alarms")).to_contain_text("says: <img src=x onerror=tones=99><b>PreArm</b>")
    assert page.locator("#alarms img, #banner img, #alarms b").count() == 0
    assert page.evaluate("tones") == 0


def test_the_map_can_be_moved_and_shows_all_again(page: Page) -> None:
    expect(page.locator("#fit")).to_have_attribute("aria-pressed", "true")
    before = page.evaluate("map.scale")
    page.mouse.move(400, 400)
    page.mouse.wheel(0, -500)
    until(page, f"map.scale > 2 * {before}")
    expect(page.locator("#fit")).to_have_attribute("aria-pressed", "false")
    centre = page.evaluate("map.centre")
    page.mouse.down()
    page.mouse.move(500, 430, steps=4)
    page.mouse.up()
    scale = page.evaluate("map.scale")
    moved = page.evaluate("map.centre")
    assert moved[0] - centre[0] == pytest.approx(-100 / scale)
    assert moved[1] - centre[1] == pytest.approx(30 / scale)
    page.click("#fit")
    expect(page.locator("#fit")).to_have_attribute("aria-pressed", "true")
    until(page, f"map.scale < 1.5 * {before}")


def test_distances_on_the_map_are_those_of_the_ellipsoid(page: Page) -> None:
    """A second of arc at 47.5 degrees: lengths of pyproj's geodesic on WGS 84."""
    from pyproj import Geod

    latitude, longitude = page.evaluate("map.origin")
    geod = Geod(ellps="WGS84")
    for step in ((1 / 3600, 0.0), (0.0, 1 / 3600)):
        here = page.evaluate("([a, b]) => map.place([a, b])", [latitude + step[0], longitude + step[1]])
        _, _, length = geod.inv(longitude, latitude, longitude + step[1], latitude + step[0])
        assert (here[0] ** 2 + here[1] ** 2) ** 0.5 == pytest.approx(length, rel=1e-5)


@pytest.mark.parametrize(
    ("width", "height"), [(360, 640), (320, 480), (768, 1024), (1024, 600), (1920, 1080)]
)
def test_every_window_shows_the_fix_and_never_scrolls_sideways(page: Page, width: int, height: int) -> None:
    page.set_viewport_size({"width": width, "height": height})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for tile in page.locator("#tiles > div").all():
        expect(tile).to_be_in_viewport()
    canvas = page.locator("#map").bounding_box()
    assert canvas is not None
    assert canvas["width"] >= 300
    assert canvas["height"] >= 200


def test_a_dead_server_is_said_and_its_return_found(
    page: Page, server: subprocess.Popen[str], monitor: Monitor, folder: Path, port: int, field: Field
) -> None:
    number = field.take_picture(feedback=False)
    expect(page.locator("#cameras")).to_contain_text(f"{number} triggered")
    server.kill()
    server.wait()
    banner = page.locator("#banner")
    expect(banner).to_contain_text(re.compile(r"No connection since \d\d:\d\d:\d\d UTC"))
    expect(page.locator("body")).to_have_attribute("data-connection", "lost")
    latest = field.take_picture()
    expect(page.locator("#alarms")).to_be_attached()
    monitor(folder, "--page", "--address", f"127.0.0.1:{port}")
    # Without a reload: the page finds the server and reads on, the flight is there again from its beginning.
    expect(page.locator("body")).to_have_attribute("data-connection", "good")
    expect(page.locator("#cameras")).to_contain_text(f"{latest} triggered")
    # Nobody had confirmed the missed picture: the new server tells it still.
    expect(banner).to_contain_text(f"no feedback for picture {number}")
    page.click("#heard")
    expect(banner).to_be_hidden()
    assert len(page.evaluate("map.layers.get('track vehicle').places")) > 10


def test_nothing_listens_beyond_this_computer(folder: Path, monitor: Monitor, field: Field) -> None:
    addresses = ("--address", "127.0.0.1:0", "--foxglove", "--foxglove-address", "127.0.0.1:0")
    process, line = monitor(folder, "--page", *addresses)
    assert line.startswith("Foxglove: open a connection to ws://127.0.0.1:")
    assert process.stdout is not None
    assert process.stdout.readline().startswith("open http://127.0.0.1:")
    listening = listeners(process.pid)
    assert len(listening) == 3
    # 127.0.0.1 as Linux writes it; Foxglove's own server stands behind a gate, somewhere in 127.0.0.0/8.
    assert sorted(address == "0100007F" for address, _ in listening) == [False, True, True]
    assert {address[-2:] for address, _ in listening} == {"7F"}


def listeners(pid: int) -> list[tuple[str, int]]:
    """Return address and port of the listening sockets of a process (proc(5))."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        # A file that was open a moment ago may be closed by now.
        with contextlib.suppress(FileNotFoundError):
            target = str(entry.readlink())
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            parts = line.split()
            if parts[3] == "0A" and parts[9] in inodes:
                address, port = parts[1].split(":")
                found.append((address, int(port, 16)))
    return found


def test_beyond_this_computer_the_page_opens_with_its_token_only(browser: Browser) -> None:
    from acquire.monitor.page import Latest, application
    from acquire.monitor.state import ComputerState, RecordingState

    latest = Latest()
    latest.publish(
        RecordingState(look=ComputerState(time.time_ns(), "secret.mcap", 10, ended=False, free_bytes=None))
    )
    context = browser.new_context()
    with serving(application(latest), Address("0.0.0.0", 0)) as url:  # noqa: S104 - that is what is tested
        port = url.split(":")[2].split("/")[0]
        here = f"http://127.0.0.1:{port}"
        opened = context.new_page()
        for path in ("/", "/feed", "/monitor.js", "/monitor.css"):
            answer = opened.goto(here + path)
            assert answer is not None
            assert answer.status == 401
            assert "secret" not in opened.content()
        opened.goto(f"{here}/?token={url.split('token=')[1]}")
        expect(opened.locator("#file")).to_have_text("secret.mcap")
        # The token does not stay in the address, where it would be seen and copied.
        assert opened.url == f"{here}/"
    context.close()
