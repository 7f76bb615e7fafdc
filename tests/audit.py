"""`make audit`: what the program is delivered with: licences, hashes, wheels, bill of materials, one wheel.

Writes docs/evidence/supply_chain.md, and the bill of materials (CycloneDX) beside the wheel in dist. Ends
with an error where a licence is not known to fit, a package is not locked by its hashes, or two builds of the
wheel differ.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from email.message import Message
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import cast

ROOT = Path(__file__).resolve().parents[1]
LOCK, PAGE, DIST = ROOT / "requirements.lock", ROOT / "docs" / "evidence" / "supply_chain.md", ROOT / "dist"
BILL = DIST / "photocal.cdx.json"
TIMEOUT_S = 600
# Licences that allow a program under Apache-2.0 to be delivered with the package as it is, by the words of
# their identifiers and classifiers. LGPL: pymavlink, a library that is imported and may be exchanged.
FIT = re.compile(
    r"MIT|BSD|0BSD|Apache|ISC|PSF|Python Software Foundation|Zlib|CC0|Unlicense|MPL|Mozilla|AFL|LLVM|DFSG"
    r"|LGPL|Lesser|HPND"
)
PLATFORMS = {
    # Named one by one, since pip takes no older tag for granted; 2_5 is that of wheels for any Linux.
    "Linux x86-64": (
        "manylinux_2_28_x86_64",
        "manylinux_2_17_x86_64",
        "manylinux2014_x86_64",
        "manylinux_2_5_x86_64",
    ),
    "Linux arm64": ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64"),
    "Windows": ("win_amd64",),
    "macOS arm64": ("macosx_14_0_arm64", "macosx_12_0_arm64", "macosx_11_0_arm64"),
}
_MISSING = re.compile(r"No matching distribution found for ([A-Za-z0-9._-]+)")


def name_of(text: str) -> str:
    """Give the one spelling of a package's name."""
    return re.sub(r"[-_.]+", "-", text).lower()


def locked(text: str) -> dict[str, tuple[str, int]]:
    """Give version and number of hashes of each package of a lock."""
    found = {}
    for entry in re.split(r"\n(?=[A-Za-z0-9])", text.replace("\\\n", " ")):
        head = re.match(r"([A-Za-z0-9._-]+)==([^\s;]+)", entry)
        if head:
            found[name_of(head[1])] = head[2], entry.count("--hash=sha256:")
    return found


def licence(package: Distribution) -> str:
    """Give the licence that a package states: its expression, else its classifiers, else its text."""
    stated = cast("Message", package.metadata)
    classifiers = (
        c.rpartition(" :: ")[2] for c in stated.get_all("Classifier", []) if c.startswith("License")
    )
    text = (stated.get("License") or "").partition("\n")[0]
    return stated.get("License-Expression") or "; ".join(classifiers) or text or "not stated"


def fits(stated: str) -> bool:
    """Whether each part of a licence, or one of the alternatives, is known to fit."""
    return any(
        all(FIT.search(part) for part in re.split(r" AND |; ", choice))
        for choice in re.split(r" OR ", stated.strip("()"))
    )


def without_wheel(platform: tuple[str, ...], packages: dict[str, tuple[str, int]]) -> list[str]:
    """Name the locked packages that have no wheel for a platform."""
    left, missing = dict(packages), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        while left:
            listed = Path(folder) / "listed.txt"
            listed.write_text("".join(f"{name}=={version}\n" for name, (version, _) in left.items()))
            flags = [flag for tag in platform for flag in ("--platform", tag)]
            command = [
                "install",
                "--dry-run",
                "--no-deps",
                "--only-binary=:all:",
                "--ignore-installed",
                "--quiet",
            ]
            into = ["--python-version", "3.12", "--target", f"{folder}/there", "-r", str(listed)]
            asked = [sys.executable, "-m", "pip", *command, *flags, *into]
            made = subprocess.run(asked, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
            if made.returncode == 0:
                return missing
            named = _MISSING.search(made.stderr)
            if named is None:
                raise SystemExit(f"the index cannot be asked: {made.stderr.strip()[-300:]}")
            missing.append(name_of(named[1]))
            del left[missing[-1]]
    return missing


def built(folder: Path) -> tuple[str, str]:
    """Build a wheel of what is committed, in a folder of its own; give its name and SHA-256."""
    folder.mkdir()
    archive = subprocess.run(
        ["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=True, timeout=TIMEOUT_S
    )
    subprocess.run(["tar", "-x"], cwd=folder, input=archive.stdout, check=True, timeout=TIMEOUT_S)
    when = subprocess.run(
        ["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run(
        [*command, "-w", "out", "."],
        cwd=folder,
        check=True,
        timeout=TIMEOUT_S,
        env={**os.environ, "SOURCE_DATE_EPOCH": when},
    )
    (wheel,) = (folder / "out").glob("*.whl")
    shutil.copy2(wheel, DIST / wheel.name)
    return wheel.name, hashlib.sha256(wheel.read_bytes()).hexdigest()


def bill_of_materials(maker: str) -> int:
    """Write the bill of materials of the lock (CycloneDX); give the number of its components."""
    command = [maker, "requirements", "--output-reproducible", "-o", str(BILL), str(LOCK)]
    subprocess.run(command, check=True, timeout=TIMEOUT_S, capture_output=True)
    return BILL.read_text(encoding="utf-8").count('"bom-ref"')


def main() -> None:
    """Audit, write the page, and end with an error where something does not hold."""
    DIST.mkdir(exist_ok=True)
    packages = locked(LOCK.read_text(encoding="utf-8"))
    here = {name_of(package.name): package for package in distributions()}
    stated = {name: licence(here[name]) for name in packages if name in here}
    wrong = [
        f"{name} has no hash in requirements.lock" for name, (_, hashes) in packages.items() if not hashes
    ]
    wrong += [
        f"{name}: licence {text!r} is not known to fit" for name, text in stated.items() if not fits(text)
    ]
    wrong += [
        f"{name} is installed as {here[name].version}, locked as {version}"
        for name, (version, _) in packages.items()
        if name in here and here[name].version != version
    ]
    gaps = {name: without_wheel(tags, packages) for name, tags in PLATFORMS.items()}
    components = bill_of_materials(sys.argv[1]) if len(sys.argv) > 1 else 0
    with tempfile.TemporaryDirectory() as folder:
        wheels = [built(Path(folder) / name) for name in ("first", "second")]
    if wheels[0] != wheels[1]:
        wrong.append("two builds of the wheel differ")
    PAGE.write_text(page(packages, stated, gaps, components, wheels), encoding="utf-8")
    if wrong:
        raise SystemExit("\n".join(wrong))


def page(
    packages: dict[str, tuple[str, int]],
    stated: dict[str, str],
    gaps: dict[str, list[str]],
    components: int,
    wheels: list[tuple[str, str]],
) -> str:
    """Write what was found."""
    hashes = sum(count for _, count in packages.values())
    same = "the same SHA-256" if wheels[0] == wheels[1] else "another SHA-256"
    known = sum(count > 0 for _, count in packages.values())
    rows = (
        ("packages locked with hashes", "all", f"{known} of {len(packages)}, {hashes} hashes"),
        (
            "licences that fit Apache-2.0",
            "all",
            f"{sum(map(fits, stated.values()))} of {len(stated)} installed",
        ),
        ("components of the bill of materials (CycloneDX)", "all locked", str(components)),
        ("two builds of the wheel in two folders", "one hash", same),
    )
    lines = [
        "# Supply chain: packages, licences, bill of materials",
        "",
        "Made by `make audit`. The lock names every package that is installed, by version and hashes of its",
        "files; `make setup` installs nothing else. The bill of materials is in the folder of the wheel.",
        "",
        "| what | required | seen |",
        "|---|---|---|",
        *(f"| {what} | {asked} | {seen} |" for what, asked, seen in rows),
        "",
        "## Wheels",
        "",
        "| platform | locked packages without a wheel |",
        "|---|---|",
        *(f"| {name} | {', '.join(missing) or 'none'} |" for name, missing in gaps.items()),
        "",
        "## Licences",
        "",
        "| licence as stated | packages |",
        "|---|---|",
        *(
            f"| {text} | {count}: {', '.join(sorted(n for n, of in stated.items() if of == text))} |"
            for text, count in Counter(stated.values()).most_common()
        ),
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
