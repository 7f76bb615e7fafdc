"""Pictures of a real flight, from their folder to the signed certificate, without a terminal."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from tests.photocal.desk.client import opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

# Reduced, so that a test takes seconds: the tags that tell c in pixels are reduced with them.
_REDUCED, _PICTURES = 0.25, 7
_EXIF, _FOCAL_PLANE = 0x8769, (0xA20E, 0xA20F)
_PATIENCE_MS = 900_000


@pytest.fixture
def flight(shared: Path, tmp_path: Path) -> Path:
    """Seven pictures of one strip and its turn, a quarter of their size."""
    folder = tmp_path / "caliterra"
    folder.mkdir()
    for path in sorted((shared / "data" / "flight-caliterra-twelve").glob("*.jpg"))[:_PICTURES]:
        with Image.open(path) as picture:
            exif = picture.getexif()
            tags = exif.get_ifd(_EXIF)
            for key in _FOCAL_PLANE:
                tags[key] = float(tags[key]) * _REDUCED
            size = (round(picture.width * _REDUCED), round(picture.height * _REDUCED))
            picture.resize(size, Image.Resampling.LANCZOS).save(folder / path.name, exif=exif, quality=92)
    return folder


@pytest.mark.timeout(1800)
def test_a_real_flight_is_certified_without_a_terminal(
    browser: Browser, flight: Path, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 1366, "height": 768}, locale="en-US")
    page = context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    with opened(flight, tmp_path / "cache") as window:
        page.goto(f"{window.url}/")
        page.get_by_role("button", name="Inspect this folder").click()
        expect(page.locator(".findings")).to_contain_text("7 pictures", timeout=_PATIENCE_MS)
        # Central Texas: the zone is told by the pictures.
        expect(page.get_by_label("Coordinate system")).to_have_value("EPSG:32614")
        page.locator("#rail").get_by_text("Run").click()
        page.get_by_role("button", name="Run", exact=True).click()
        expect(page.locator(".total .sign")).to_have_text(re.compile("complete"), timeout=_PATIENCE_MS)
        page.get_by_role("link", name="To the certificate").click()
        page.get_by_label("Person or office").fill("Office for tests")
        page.get_by_role("button", name="Make a key").click()
        page.get_by_role("button", name="Sign", exact=True).click()
        expect(page.locator("main .sign.good").first).to_have_text(re.compile("signed"), timeout=_PATIENCE_MS)
        issued = window.get("/api/certificate").json["issued"]
        assert issued["signed"]
        assert (flight / "work" / "certificate" / "signature.json").is_file()
    assert problems == []
    context.close()
