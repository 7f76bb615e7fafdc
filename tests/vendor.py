"""`make vendor`: libraries of the pages, fetched with npm in the versions of each vendor.toml.

Their files and licences are kept beside it, with their SHA-256; nothing is fetched when the page runs.
"""

from __future__ import annotations

import hashlib
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import tomlkit

ROOT = Path(__file__).resolve().parents[1]
LISTS = (
    ROOT / "photocal" / "desk" / "vendor" / "vendor.toml",
    ROOT / "tests" / "photocal" / "desk" / "vendor" / "vendor.toml",
    ROOT / "tests" / "docs" / "vendor" / "vendor.toml",
)


def fetch(name: str, version: str) -> dict[str, bytes]:
    """Give the files of a package of npm by their paths in it."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["npm", "pack", "--silent", f"{name}@{version}"]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL, timeout=300)
        (packed,) = Path(folder).glob("*.tgz")
        with tarfile.open(packed) as archive:
            opened = {member.name: archive.extractfile(member) for member in archive if member.isfile()}
            return {path.partition("/")[2]: file.read() for path, file in opened.items() if file is not None}


def kept(content: bytes, entry: dict[str, Any]) -> bytes:
    """Give a file as it is kept: with the one change that its entry names, if it does."""
    if "change" not in entry:
        return content
    old, new = (part.encode() for part in entry["change"])
    if content.count(old) != 1:
        raise ValueError(f"{entry['from']}: {old!r} does not stand there once")
    return content.replace(old, new)


def main() -> None:
    """Fetch all of them, and write their hashes into the lists."""
    for path in LISTS:
        listed = tomlkit.parse(path.read_text(encoding="utf-8"))
        for name, library in listed.items():
            files = fetch(name, library["version"])
            for target, entry in library["files"].items():
                content = kept(files[entry["from"]], entry)
                (path.parent / target).write_bytes(content)
                entry["sha256"] = hashlib.sha256(content).hexdigest()
        path.write_text(tomlkit.dumps(listed), encoding="utf-8")


if __name__ == "__main__":
    main()
