"""Pictures of the guide's first chapter: what its own commands give, from the card to the certificate."""

from __future__ import annotations

import contextlib
import csv
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw

from tests.docs.certificate_picture import draw_page
from tests.docs.desk_pictures import SETTLES_MS, window
from tests.docs.shown import GUIDE

CHAPTER = GUIDE / "first.md"
# Pictures side by side, and how wide each is drawn, px.
_SHOWN, _WIDE, _BETWEEN = 3, 430, 6
_COLOURS = 128


def followed(folder: Path) -> Path:
    """Follow the commands of the chapter's first block; gives the folder of the project."""
    block = CHAPTER.read_text(encoding="utf-8").partition("```sh\n")[2].partition("```")[0]
    for line in block.splitlines():
        subprocess.run([sys.executable, "-m", *shlex.split(line)], cwd=folder, check=True)
    return folder / "practice" / "site"


def card(site: Path, picture: Path) -> None:
    """Draw some pictures of the card side by side, with the marks of the control points."""
    with (site / "marks.csv").open(encoding="utf-8", newline="") as file:
        marks = [*csv.DictReader(file)]
    paths = sorted((site / "images").iterdir())[:: 20 // _SHOWN][:_SHOWN]
    drawn = list[Image.Image]()
    for path in paths:
        with Image.open(path) as content:
            scale = _WIDE / content.width
            small = content.convert("RGB").resize((_WIDE, round(content.height * scale)))
        pen = ImageDraw.Draw(small)
        for mark in (mark for mark in marks if mark["image"] == path.name):
            # The centre of the first pixel is (0, 0).
            x, y = ((float(mark[name]) + 0.5) * scale for name in "xy")
            pen.ellipse((x - 9, y - 9, x + 9, y + 9), outline="#d55e00", width=3)
            pen.text((x + 12, y - 6), mark["point"], fill="#ffffff", stroke_width=2, stroke_fill="#000000")
        drawn.append(small)
    sheet = Image.new("RGB", ((_WIDE + _BETWEEN) * len(drawn) - _BETWEEN, drawn[0].height), "white")
    for k, small in enumerate(drawn):
        sheet.paste(small, (k * (_WIDE + _BETWEEN), 0))
    sheet.quantize(_COLOURS).save(picture, optimize=True)


def main() -> None:
    """Write them; those of the window and the certificate where there are programs to draw with."""
    with tempfile.TemporaryDirectory() as folder:
        site = followed(Path(folder))
        card(site, GUIDE / "first-card.png")
        draw_page(site / "work" / "certificate" / "certificate.pdf", GUIDE / "first-certificate.png")
        # The window shows the folder as it was typed.
        with contextlib.chdir(folder), window(Path("practice/site")) as (page, url):
            if page is not None:
                page.goto(f"{url}#/look")
                page.locator(".thumb").nth(2).click()
                page.wait_for_timeout(SETTLES_MS)
                page.screenshot(path=GUIDE / "first-look.png")


if __name__ == "__main__":
    main()
