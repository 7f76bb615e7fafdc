"""Study of the verdict at the field's edge at full size: each fault named, a clean flight silent?

Writes `docs/evidence/debrief.md`. A flight with pictures of 20 megapixels is simulated with its logs, and
debriefed as it is and with one fault at a time; a camera of the last certificate is given each time, as a
crew would. Features of pictures that a fault leaves alone are kept, as they are in the field.

Run: `make evidence`, or `python -m tests.evidence.debrief [PICTURES [FOLDER]]`; a folder keeps the flight.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from acquire.simulate.world.configuration import read_configuration
from photocal.base.progress import quiet
from photocal.block.project import read_project
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.geometry.camera import Camera
from photocal.run.debrief.verdict import debrief
from tests.photocal.run.debrief.conftest import (
    BOTH,
    EXIF,
    FOCAL_MM,
    SERIAL,
    TAKEN,
    edited,
    names,
    smeared,
)
from tests.simulated import FLIGHT, LINKS, import_log, simulate

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "debrief.md"
# The flight "survey" has so many pictures, of 1824 px; here they are three times as long, and all is higher.
KNOWN, PICTURES, LONGER, HIGHER = 42, 60, 3, 2.4


@dataclass(frozen=True)
class Fault:
    """What is done to a flight, and the findings that must be among those of its debrief.

    zoom: c of the last certificate over the true one.
    """

    name: str
    expected: frozenset[str]
    make: Callable[[Path, Path], None] = lambda _site, _slipped: None
    zoom: float = 1.0


def plan(pictures: int) -> dict[str, Any]:
    """Tables of the flight that differ from "survey"."""
    given = read_configuration(FLIGHT)
    wider = HIGHER * math.sqrt(pictures / KNOWN)
    area = [(east * wider, north * wider) for east, north in given.plan.area_m]
    passes = [
        {**one.model_dump(), "height_m": HIGHER * one.height_m, "speed_m_s": HIGHER * one.speed_m_s}
        for one in given.plan.passes
    ]
    camera = given.camera.model_dump(exclude_unset=True)
    width, height = camera["size_px"]
    camera |= {name: LONGER * camera[name] for name in ("fx", "fy", "cx", "cy")}
    camera |= {"size_px": (LONGER * width, LONGER * height), "pitch_mm": camera["pitch_mm"] / LONGER}
    whole = given.plan.model_dump(exclude_unset=True, by_alias=True)
    targets = given.targets.model_dump() | {"side_m": HIGHER}
    return {"plan": {**whole, "area_m": area, "pass": passes}, "camera": camera, "targets": targets}


def fly(folder: Path, tables: dict[str, Any]) -> Path:
    """Simulate a flight and import its log, once; its site."""
    site = folder / "site"
    if not (site / "flight.mcap").exists():
        simulate(folder, **tables)
        import_log(site)
    return site


def last_camera(site: Path, zoom: float) -> Camera:
    """Camera of the last certificate: the true one, or another."""
    true = json.loads((site.parent / "truth" / "truth.json").read_text(encoding="utf-8"))["camera"]
    camera = read_configuration(FLIGHT, {"camera": plan(KNOWN)["camera"]}).camera
    distortion = (camera.k1, camera.k2, camera.k3, camera.p1, camera.p2)
    pinhole = Pinhole(camera.size_px, zoom * camera.fx, zoom * camera.fy, camera.cx, camera.cy, *distortion)
    known = from_pinhole(pinhole, true["id"], "last certificate")
    return replace(known, sigma=np.where(known.values == known.value("c"), 0.05, 0.0))


def _without(*which: int) -> Callable[[Path, Path], None]:
    def make(site: Path, _: Path) -> None:
        paths = names(site)
        for k in which:
            paths[k].unlink()

    return make


def _edited(which: slice, change: Callable[[Any], Any], exif: dict[int, Any] | None = None) -> Any:
    def make(site: Path, _: Path) -> None:
        for path in names(site)[which]:
            edited(path, change, exif)

    return make


def _cut(site: Path, _: Path) -> None:
    path = names(site)[7]
    content = path.read_bytes()[:300_000]
    path.unlink()
    path.write_bytes(content)


def _three_days_before(site: Path, _: Path) -> None:
    for path in names(site):
        with Image.open(path) as image:
            taken = image.getexif().get_ifd(EXIF)[TAKEN]
        edited(path, lambda image: image, dict.fromkeys((TAKEN, BOTH), taken.replace(":15 ", ":12 ")))


def _no_base(site: Path, _: Path) -> None:
    import_log(site, ("vehicle", "rover"))


def _slipped(site: Path, slipped: Path) -> None:
    for link in LINKS:
        for path in slipped.glob(f"{link}.*"):
            shutil.copyfile(path, site / path.name)
    import_log(site)


def _smeared(image: Any) -> Any:
    """Moved by a dozen pixels while the shutter was open."""
    return smeared(smeared(smeared(image)))


FAULTS = (
    Fault("none", frozenset()),
    Fault(
        "three pictures missing in a strip",
        frozenset({"events-without-image", "strip-gap"}),
        _without(7, 8, 9),
    ),
    Fault("four pictures blurred", frozenset({"pictures-blurred"}), _edited(slice(20, 24), _smeared)),
    Fault(
        "two pictures too bright",
        frozenset({"pictures-too-bright"}),
        _edited(slice(30, 32), lambda image: image.point(lambda grey: min(255, 3 * grey))),
    ),
    Fault(
        "two pictures too dark",
        frozenset({"pictures-too-dark"}),
        _edited(slice(12, 14), lambda image: image.point(lambda grey: grey // 6)),
    ),
    Fault("a picture cut on the card", frozenset({"pictures-unreadable"}), _cut),
    Fault(
        "zoom of the last six changed",
        frozenset({"lens-changed"}),
        _edited(slice(-6, None), lambda image: image, {FOCAL_MM: 12.3}),
    ),
    Fault("c 0.5 % off the last certificate", frozenset({"c-changed"}), zoom=1.005),
    Fault(
        "a picture of another camera",
        frozenset({"pictures-of-other-camera"}),
        _edited(slice(15, 16), lambda image: image, {SERIAL: "9999"}),
    ),
    Fault(
        "the card of another flight",
        frozenset({"exposures-unknown"}),
        _three_days_before,
    ),
    Fault("positions float (slips every five seconds)", frozenset({"positions-not-fixed"}), _slipped),
    Fault("the base did not run", frozenset({"no-ppk"}), _no_base),
)


def judged(fault: Fault, site: Path, slipped: Path) -> str:
    """Line of the table of one fault."""
    with tempfile.TemporaryDirectory(dir=site.parent) as scratch:
        # Pictures are shared, so that a copy costs nothing.
        copy = Path(shutil.copytree(site, Path(scratch) / "site", copy_function=os.link))
        (copy / "flight.mcap").unlink()
        shutil.copyfile(site / "flight.mcap", copy / "flight.mcap")
        for path in (one for link in LINKS for one in copy.glob(f"{link}.*")):
            path.unlink()
            shutil.copyfile(site / path.name, path)
        fault.make(copy, slipped)
        began = time.perf_counter()
        made = debrief(
            read_project(copy / "project.toml"), os.cpu_count() or 1, quiet, (last_camera(site, fault.zoom),)
        )
        seconds = time.perf_counter() - began
    codes = {finding.code for finding in made.findings if not finding.small}
    named = "yes" if fault.expected <= codes and (fault.expected or not codes) else "no"
    beside = ", ".join(sorted(codes - fault.expected)) or "-"
    return f"| {fault.name} | {named} | {made.verdict.code} | {beside} | {seconds:.0f} |"


def main(pictures: int, folder: Path) -> None:
    """Fly, debrief with each fault, write the page."""
    cache = folder / "cache"
    first = "in the first flight, too" if cache.exists() else "except in the first flight"
    os.environ["XDG_CACHE_HOME"] = str(cache)
    tables = plan(pictures)
    site = fly(folder / "flight", tables)
    slips = {"faults": ["cycle_slips"], "fault_sizes": {"slips_per_hour": 720.0}}
    slipped = fly(folder / "slipped", {**tables, **slips, "level": "observations"})
    lines = list[str]()
    for fault in FAULTS:
        lines.append(judged(fault, site, slipped))
        sys.stderr.write(f"{lines[-1]}\n")
    count = len(names(site))
    page = [
        "# The debrief at full size",
        "",
        f"Made by `python -m tests.evidence.debrief {pictures}`: {count} pictures of 5472 x 3648 px,",
        "simulated with their logs, without a fault and with one fault at a time. Named: a finding reports",
        "the fault. Other: further findings that are more than notes. Seconds: features of unchanged",
        f"pictures are reused, {first}. With the card of another flight, that is",
        "reported as the reason why exposures are unknown.",
        "",
        "| fault | named | verdict | other | s |",
        "|---|---|---|---|---|",
        *lines,
    ]
    OUTPUT.write_text("\n".join(page) + "\n", encoding="utf-8")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(
            int(sys.argv[1]) if len(sys.argv) > 1 else PICTURES,
            Path(sys.argv[2]) if len(sys.argv) > 2 else Path(scratch),
        )
