"""Study: how soon does the page of `acquire monitor` show a lost fix and a missed picture?

Writes `docs/evidence/monitor.md`. A simulated field is recorded as `acquire record` does it, `acquire monitor
--page` reads the log as another process, Chromium shows the page. The time runs from the byte on the link
to the word on the page.

Run: `make evidence`, or `python -m tests.evidence.monitor`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from acquire.monitor.state import GRACE_NS
from tests.acquire.monitor.field import NO_FIX, RTK_FIXED, Field, at_work

ROUNDS = 20
FLUSHES_S = (0.5, 1.0)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "monitor.md"
# Answers with the time at which a text is on the page.
_SEEN = """([selector, text]) => new Promise((resolve) => {
  const look = () => [...document.querySelectorAll(selector)].some((e) => e.textContent.includes(text))
    ? resolve(Date.now()) : setTimeout(look, 5);
  look();
})"""


def main() -> None:
    """Run the study and write its table."""
    rows = []
    for flush_s in FLUSHES_S:
        for what, delays in study(flush_s).items():
            median, worst = np.median(delays), max(delays)
            rows.append(f"| {what} | {flush_s:g} s | {len(delays)} | {median:.2f} s | {worst:.2f} s |")
            sys.stderr.write(rows[-1] + "\n")
    lines = [
        "# How soon the live view shows what happens",
        "",
        "From the byte on the link to the word on the page: a simulated field, the recorder,",
        f"`acquire monitor --page` in a process of its own, and Chromium, on two cores; {ROUNDS} events of",
        f"each kind, at random moments. A picture counts as missed {GRACE_NS / 1e9:g} s after its trigger,",
        "or when the feedback of a later one arrives first. Required: within 2 s at the recorder's default",
        "setting (`flush_s = 0.5`).",
        "",
        "| event | `flush_s` | events | median | worst |",
        "|---|---|---|---|---|",
        *rows,
        "",
        "Made by `python -m tests.evidence.monitor`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")


def study(flush_s: float) -> dict[str, list[float]]:
    """Return the delays of each kind of event, seconds."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with tempfile.TemporaryDirectory() as name, at_work(Path(name), flush_s) as field:
        command = [
            sys.executable,
            "-m",
            "acquire",
            "monitor",
            name,
            "--page",
            "--address",
            "127.0.0.1:0",
        ]
        with (
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
            sync_playwright() as playwright,
        ):
            assert server.stdout is not None
            url = server.stdout.readline().removeprefix("open ").strip()
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            page = browser.new_page()
            page.goto(url)
            field.take_picture()
            _seen(page, "#cameras", "1 triggered")
            found = _events(page, field)
            browser.close()
            server.terminate()
    return found


def _events(page: Page, field: Field) -> dict[str, list[float]]:
    chance = np.random.default_rng(1)
    found: dict[str, list[float]] = {"fix lost": [], "fix back": [], "picture missed": []}

    def timed(what: str, happen: Callable[[], object], selector: str, text: Callable[[], str]) -> None:
        time.sleep(chance.uniform(0.2, 1.4))
        begun = time.time()
        happen()
        found[what].append(_seen(page, selector, text()) - begun)

    def fix(kind: int) -> None:
        field.fix = kind
        field.tell_fix()

    for _ in range(ROUNDS):
        timed("fix lost", lambda: fix(NO_FIX), "#receivers .word", lambda: "no fix")
        timed("fix back", lambda: fix(RTK_FIXED), "#receivers .card:last-child", lambda: "RTK fixed")
        field.take_picture()
        timed(
            "picture missed",
            lambda: field.take_picture(feedback=False),
            "#alarms li",
            lambda: f"no feedback for picture {field.pictures}",
        )
    return found


def _seen(page: Page, selector: str, text: str) -> float:
    return float(page.evaluate(_SEEN, [selector, text])) / 1000


if __name__ == "__main__":
    main()
