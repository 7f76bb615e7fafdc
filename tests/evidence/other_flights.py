"""Study: recorded sets of other people through `photocal new` and `photocal run`, as a stranger would.

Each set's files are copied to a folder of their own; what `new` asks for is filled in as stated here, nothing
else; then the project is run to a certificate or to a refusal. COLMAP's figures are those of the sets'
descriptions (SIMPLE_RADIAL, exhaustive matching). Writes `docs/evidence/other-flights.md`.

Run: `make evidence`, or `python -m tests.evidence.other_flights [NAME ...]`.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.commands.cli import app
from tests.photocal.measurement.site import SIDE, flight, texture

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
OUTPUT = ROOT / "docs" / "evidence" / "other-flights.md"
CHANGED = Path(__file__).with_name("other_flights_changed.md")


@dataclass(frozen=True)
class Recorded:
    """A recorded set.

    Attributes
    ----------
    files : tuple of str
        Patterns below the folder of the sets; folders are kept.
    peer : str
        COLMAP's images, tracks of three and more rays, rms of a coordinate (px).
    height : str
        What is filled in where `new` asks for the kind of heights.
    """

    name: str
    files: tuple[str, ...]
    peer: str = ""
    height: str = "ellipsoidal"


SETS = (
    Recorded("lewis", ("flight-lewis-ten/*",), "10 of 10, 2696, 0.713"),
    Recorded("caliterra", ("flight-caliterra-twelve/*",), "12 of 12, 9443, 0.677"),
    Recorded("sequoia-rgb", ("sequoia-rig/*RGB*",)),
    Recorded("sequoia-green", ("sequoia-rig/*GRE*",)),
    Recorded("sequoia-all", ("sequoia-rig/*",)),
    Recorded("brighton", ("uav-brighton-beach/images/*",), "18 of 18, 7040, 0.709"),
    Recorded("saisies", ("micmac-saisies-gcp/**/*",)),
    Recorded("sxb", ("dbat-sxb/**/*",)),
    Recorded("berlin", ("opensfm-berlin-gcp/**/*",)),
    Recorded("quadplane", ("mavlink-tlog-cuav-images/*.png", "mavlink-tlog-cuav-images/*.jpg")),
    Recorded("simulated", (), height="local"),
)


@dataclass(frozen=True)
class Outcome:
    """What became of a set: figures as they are shown, and the last line."""

    name: str
    peer: str
    pictures: int
    oriented: int | None
    tracks: int | None
    rms_px: float | None
    c: tuple[str, ...]
    certificate: bool
    verdict: str
    last: str


def copied(own: Recorded, folder: Path) -> None:
    """Copy the files of a set; the simulated flight gives its pictures and its control."""
    folder.mkdir(parents=True)
    if not own.files:
        simulated(folder)
        return
    for pattern in own.files:
        for path in sorted(DATA.glob(pattern)):
            if path.is_file():
                place = folder / path.relative_to(DATA).relative_to(pattern.split("/")[0])
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, place)


def simulated(folder: Path) -> None:
    """Pictures of level ground with control and check points that somebody has marked to half a pixel."""
    site, rng = flight(0), np.random.default_rng(3)
    site.render(texture(0, SIDE), folder)
    views = site.views
    ground = np.array([[x, y, 0.0] for x in (-6.0, 0.0, 6.0) for y in (-5.0, 1.0, 5.0)])
    points = ["point,X,Y,Z,sX,sY,sZ,role"]
    marks = ["image,point,x,y"]
    for k, place in enumerate(ground):
        points.append(
            f"P{k},{place[0]},{place[1]},{place[2]},0.005,0.005,0.005,{('control', 'check')[k % 2]}"
        )
        for image, name in enumerate(views.names):
            x, y = views.project(np.array([image]), place[None])[0]
            width, height = views.sizes()[image]
            if 20 < x < width - 20 and 20 < y < height - 20:
                dx, dy = rng.normal(0, 0.5, 2)
                marks.append(f"{name},P{k},{x + dx:.2f},{y + dy:.2f}")
    (folder / "points.csv").write_text("\n".join(points) + "\n", encoding="utf-8")
    (folder / "marked.csv").write_text("\n".join(marks) + "\n", encoding="utf-8")


def said(arguments: Sequence[str]) -> str:
    """Run a command; give its last line."""
    result = CliRunner().invoke(app, list(arguments))
    if isinstance(result.exception, PhotocalError):
        return f"error: {result.exception}".splitlines()[0]
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"TRACEBACK: {result.exception!r}"
    lines = [line for line in result.output.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def _named(last: str, folder: Path) -> str:
    """The last line without the place where the study stood."""
    return last.replace(str(folder.parent) + "/", "")


def outcome(own: Recorded, folder: Path) -> Outcome:
    """Take a set through `new` and `run`."""
    copied(own, folder)
    last = said(["new", str(folder)])
    project = folder / "project.toml"
    if project.is_file():
        text = project.read_text(encoding="utf-8")
        if 'crs = "?"' in text:
            # One that has no name: its heights are its own.
            text = re.sub(r'(?m)^(crs|height) = "[^"]*"', r'\1 = "local"', text)
        text = text.replace('height = "?"', f'height = "{own.height}"')
        project.write_text(text, encoding="utf-8")
        last = said(["run", str(project)])
    return outcome_of(own, folder, last)


def outcome_of(own: Recorded, folder: Path, last: str) -> Outcome:
    """Read what a run has left."""
    pictures = sum(path.suffix.lower() in (".jpg", ".tif", ".png") for path in _given(folder))
    work = folder / "work"
    measured = _json(work / "measurements" / "measurement.json")
    certificate = _json(work / "certificate" / "certificate.json")
    verdict = certificate.get("verdict", {}).get("text", "")
    return Outcome(
        own.name,
        own.peer,
        pictures,
        len(measured["images"]) if measured else None,
        measured["tracks"]["three_and_more_rays"] if measured else None,
        measured["rms_px"] if measured else None,
        tuple(_principal_distances(folder, certificate)),
        bool(certificate),
        verdict,
        _named(last, folder),
    )


def _given(folder: Path) -> list[Path]:
    """Files of a set, without what was made of it."""
    return [path for path in folder.rglob("*") if folder / "work" not in path.parents]


def _principal_distances(folder: Path, certificate: dict[str, Any]) -> Iterator[str]:
    """What a project starts from and what its certificate states, of each camera."""
    cameras = tomllib.loads((folder / "project.toml").read_text(encoding="utf-8")).get("camera", [])
    start = {own["id"]: own["parameters"]["c"] for own in cameras}
    for name, own in certificate.get("cameras", {}).items():
        stated = own["stated"]
        away = 100.0 * (start[name] / stated["value"] - 1.0)
        spread = f" ± {stated['sigma']:.2g} ({stated['of']}); start {away:+.1f} %"
        yield f"{stated['value']:.5g}" + (spread if stated["sigma"] > 0.0 else " held")


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def page(found: Sequence[Outcome]) -> str:
    """Write the outcomes as a table."""
    lines = [
        "# Other people's flights",
        "",
        "Made by `python -m tests.evidence.other_flights`: `photocal new`, then `photocal run`; only what",
        "`new` asks for was edited. COLMAP: images, tracks of three and more rays, rms of a coordinate. c:",
        "as the certificate states it, in the unit of the camera, with its standard deviation and the",
        "source of that. Sources: formal; sandwich (from the residuals of the images); jackknife (with",
        "images left out). Start: the deviation of the value in the pictures' tags from it.",
        "",
        "| set | pictures | oriented | tracks of 3 and more | rms (px) | COLMAP | c | certificate |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for own in found:
        rms = "" if own.rms_px is None else f"{own.rms_px:.2f}"
        ending = own.verdict if own.certificate else f"none: {own.last}"
        lines.append(
            f"| {own.name} | {own.pictures} | {own.oriented or ''} | {own.tracks or ''} | {rms} | {own.peer} "
            f"| {', '.join(own.c)} | {ending.replace('|', '/')[:260]} |"
        )
    return "\n".join(lines) + "\n\n" + CHANGED.read_text(encoding="utf-8")


def main(wanted: Sequence[str]) -> None:
    """Run the study."""
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        # What an earlier version has left in the cache of the user says nothing of this one.
        os.environ["XDG_CACHE_HOME"] = str(Path(scratch) / "cache")
        for own in SETS:
            if wanted and own.name not in wanted:
                continue
            found.append(outcome(own, Path(scratch) / own.name / "pictures"))
            print(found[-1], flush=True)
    if not wanted:
        OUTPUT.write_text(page(found), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
