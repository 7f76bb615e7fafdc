"""What may not go wrong in any page of the window, while a browser shows it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import ConsoleMessage, Page

AXE = Path(__file__).parent / "vendor" / "axe.min.js"
_LOUD = ("warning", "error")
# Refusals and servers that tests kill are told by the page; drivers warn of 3-D without a graphics card, and
# OpenSeadragon of a tile that came after another picture was chosen.
_EXPECTED = ("Failed to load resource", "[.WebGL-", "WebGL: ", "Ignoring tile")


def watched(page: Page, url: str) -> list[str]:
    """Collect what goes wrong in a page from now on: errors, warnings, dialogues, and whom else it asks."""
    problems = list[str]()

    def read(message: ConsoleMessage) -> None:
        """Keep what the browser warns of, as styles that the page's policy forbids."""
        if message.type in _LOUD and not message.text.startswith(_EXPECTED):
            problems.append(message.text)

    ours = (url, "data:", "blob:", "about:")
    page.on("console", read)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("dialog", lambda dialog: problems.append(f"a name was run: {dialog.message}"))
    page.on("request", lambda asked: None if asked.url.startswith(ours) else problems.append(asked.url))
    return problems


def serious(page: Page) -> list[str]:
    """What axe-core holds against the page, that is serious or critical; a page within it is another's."""
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'], iframes: false })")
    return [
        f"{one['id']}: {one['nodes'][0]['html'][:120]}"
        for one in found["violations"]
        if one["impact"] in ("serious", "critical")
    ]
