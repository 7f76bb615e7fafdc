"""Picture of the monitor's page, made by a recording of a simulated vehicle with its mishaps."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.acquire.live import free_port
from tests.acquire.monitor.field import NO_FIX, at_work
from tests.docs.shown import MONITOR, stamp

_PATIENCE_MS, _EVERY_S, _PICTURES, _MISSED = 240_000, 1.5, 12, (7, 8, 12)


@contextlib.contextmanager
def _monitored(folder: Path) -> Iterator[str]:
    port = free_port()
    command = ["-m", "acquire", "monitor", str(folder), "--page", "--address", f"127.0.0.1:{port}"]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield f"http://127.0.0.1:{port}/"
        finally:
            process.terminate()


def main() -> None:
    """Write it, where there is a browser to look with."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        print("no chromium: the picture of the monitor stays as it is")
        return
    from playwright.sync_api import sync_playwright

    with (
        tempfile.TemporaryDirectory() as folder,
        at_work(Path(folder)) as field,
        _monitored(Path(folder)) as url,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800}, locale="en-US")
        page.set_default_timeout(_PATIENCE_MS)
        for number in range(1, _PICTURES + 1):
            field.take_picture(feedback=number not in _MISSED)
            time.sleep(_EVERY_S)
        field.fix = NO_FIX
        page.goto(url)
        page.get_by_text("missed: 7-8, 12").first.wait_for()
        page.get_by_text("no fix", exact=False).first.wait_for()
        page.screenshot(path=MONITOR)
        browser.close()
    stamp(MONITOR)


if __name__ == "__main__":
    main()
