"""The docs as a site: stages the pages in `build` for MkDocs; `make docs` then writes `build/site`."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build"
# Without it a page opened from a file is not searched; the theme would fetch it at every page.
_SHIM = Path(__file__).with_name("vendor") / "iframe-worker.js"
# Names of files and keys at the head of a row stay in one piece.
_STYLE = ".md-typeset td:first-child code { white-space: nowrap; }\n"
_REFERENCE = (
    "project-file", "block-folder", "recording", "monitor", "exposures", "pictures", "marking",
    "georeferencing-check", "faults", "exchange", "exit-codes", "nomenclature",
)  # fmt: skip
# Nothing is fetched by a reader, neither letters nor scripts, and a link that leads nowhere is an error.
_SITE: dict[str, Any] = {
    "site_name": "photocal",
    "docs_dir": "pages",
    "site_dir": "site",
    "use_directory_urls": False,
    "strict": True,
    "theme": {
        "name": "material",
        "font": False,
        "features": ["navigation.tabs", "navigation.indexes", "navigation.top", "content.code.copy"],
    },
    "plugins": ["search", "offline"],
    "extra": {"polyfills": [_SHIM.name]},
    "extra_css": ["site.css"],
    "markdown_extensions": ["tables", {"toc": {"permalink": True}}, "pymdownx.superfences"],
    "validation": {"links": {"not_found": "warn", "anchors": "warn", "unrecognized_links": "warn"}},
}


def navigation() -> list[Any]:
    """Give the pages in the order of the site."""
    return [
        {"Home": "README.md"},
        {"Install": "docs/install.md"},
        {"Guide": _pages("guide")},
        {"Commands": _pages("commands")},
        {"Reference": [f"docs/{name}.md" for name in _REFERENCE]},
        {"Python": ["docs/api.md", "docs/examples/README.md"]},
        {"Studies": _pages("studies")},
        {"Evidence": _pages("evidence")},
        {
            "Project": [
                *("docs/architecture.md", "CONTRIBUTING.md", "ROADMAP.md", "CHANGELOG.md"),
                *("CODE_OF_CONDUCT.md", "SECURITY.md"),
                *_pages("decisions"),
            ]
        },
    ]


def _pages(folder: str) -> list[str]:
    """Pages of a folder: its list first, then those that it links, in its order."""
    listed = (ROOT / "docs" / folder / "README.md").read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([\w.-]+\.md)\)", listed)
    return [f"docs/{folder}/{name}" for name in dict.fromkeys(["README.md", *linked])]


def stage() -> Path:
    """Copy the pages with what they link, and write the configuration of the site beside them."""
    pages = BUILD / "pages"
    shutil.rmtree(pages, ignore_errors=True)
    pages.mkdir(parents=True)
    for folder in ("docs", "configs"):
        shutil.copytree(ROOT / folder, pages / folder)
    for path in (*ROOT.glob("*.md"), ROOT / "LICENSE", ROOT / "CITATION.cff", ROOT / "Containerfile"):
        shutil.copy(path, pages)
    shutil.copy(_SHIM, pages)
    (pages / "site.css").write_text(_STYLE, encoding="utf-8")
    configuration = BUILD / "mkdocs.yml"
    # JSON is YAML.
    configuration.write_text(json.dumps({**_SITE, "nav": navigation()}, indent=1), encoding="utf-8")
    return configuration


if __name__ == "__main__":
    print(stage())
