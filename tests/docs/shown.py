"""Pictures of the docs carry a fingerprint of what they show: a test says which one is older."""

from __future__ import annotations

import hashlib
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tests.docs.rooms import ROOT

MONITOR = ROOT / "docs" / "monitor.png"
GUIDE = ROOT / "docs" / "guide"
# What is seen on a page: its elements, their look and their words.
_SEEN = {".html", ".css", ".json", ".svg"}
_KEY = "shows"


def sources() -> dict[Path, Path]:
    """Return each picture with the folder of the page that it shows."""
    return {MONITOR: ROOT / "acquire" / "monitor"}


def fingerprint(folder: Path) -> str:
    """Return the hash of what is seen of a page."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in _SEEN:
            digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def stamp(picture: Path) -> None:
    """Write into a picture what it shows."""
    said = PngInfo()
    said.add_text(_KEY, fingerprint(sources()[picture]))
    with Image.open(picture) as content:
        content.load()
        content.save(picture, pnginfo=said, optimize=True)


def shown(picture: Path) -> str:
    """Return the hash of what a picture shows; empty where nobody has stamped it."""
    with Image.open(picture) as content:
        return str(content.info.get(_KEY, ""))
