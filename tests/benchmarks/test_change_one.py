"""One thing is changed in a project with pictures: seconds from the command to the verdict.

Twelve recorded pictures; five points and 30 marks are made from the tie points that a first run has adjusted.
Figures go to .benchmarks/change_one.json.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.block.folder import read_block
from tests.benchmarks.test_engine_speed import RESULTS

pytestmark = [pytest.mark.shared, pytest.mark.timeout(7200)]
REPEATS = 3
CONTROL = '\n[control]\npoints = "control.csv"\nmarks = "marks.csv"\n'
LEFT_OUT = '\n[[leave_out]]\nimage = "IMG_9430.jpg"\nreason = "blurred"\n'
ROLES = ("control", "control", "control", "check", "check")
MARKS_OF_A_POINT = 6
# Standard deviations: of points, m, and of marks, px.
SURVEYED_M, MARKED_PX = (0.02, 0.02, 0.03), 0.2


def photocal(folder: Path, *arguments: str) -> tuple[float, float]:
    """Seconds that pass until a command prints its verdict, and until it ends."""
    given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    given |= {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPYCACHEPREFIX": str(folder / "compiled")}
    command = [sys.executable, "-m", "photocal", *arguments]
    began, verdict = time.perf_counter(), float("nan")
    with subprocess.Popen(
        command, cwd=folder, env=given, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        said = []
        for line in process.stdout or ():
            if line.startswith("verdict"):
                verdict = time.perf_counter() - began
            said.append(line)
    assert process.returncode == 0, "".join(said)
    return verdict, time.perf_counter() - began


def with_control(folder: Path) -> None:
    """Make control and check points, and their marks, from tie points that many pictures show."""
    block, chance = read_block(folder / "work/block"), np.random.default_rng(3)
    with (folder / "work/calibration/points.csv").open(encoding="utf-8") as stream:
        places = {row["point"]: [float(row[axis]) for axis in "XYZ"] for row in csv.DictReader(stream)}
    seen = block.observations
    rays = np.bincount(seen.point, minlength=len(block.points.names))
    strong = [k for k in np.flatnonzero(rays >= MARKS_OF_A_POINT) if block.points.names[k] in places]
    ground = np.array([places[block.points.names[k]] for k in strong])
    low, high = ground[:, :2].min(axis=0), ground[:, :2].max(axis=0)
    points, marks = ["point,X,Y,Z,sX,sY,sZ,role"], ["image,point,x,y,sx,sy"]
    corners = [(0.05, 0.05), (0.95, 0.05), (0.95, 0.95), (0.05, 0.95), (0.5, 0.5)]
    for number, (corner, role) in enumerate(zip(corners, ROLES, strict=True), 1):
        near = np.linalg.norm((ground[:, :2] - low) / (high - low) - corner, axis=1)
        k = int(near.argmin())
        surveyed = ground[k] + chance.normal(0, SURVEYED_M)
        points.append(",".join([f"P{number}", *(f"{value:.3f}" for value in (*surveyed, *SURVEYED_M)), role]))
        for ray in np.flatnonzero(seen.point == strong[k])[:MARKS_OF_A_POINT]:
            x, y = seen.values[ray] + chance.normal(0, MARKED_PX, 2)
            name = block.images.names[seen.image[ray]]
            marks.append(f"{name},P{number},{x:.3f},{y:.3f},{MARKED_PX},{MARKED_PX}")
    (folder / "control.csv").write_text("\n".join(points) + "\n")
    (folder / "marks.csv").write_text("\n".join(marks) + "\n")
    project = folder / "project.toml"
    project.write_text(project.read_text() + CONTROL)


def nothing(_: Path) -> None:
    """Change nothing."""


def mark(folder: Path) -> None:
    path = folder / "marks.csv"
    head, first, *others = path.read_text().splitlines()
    image, point, x, *rest = first.split(",")
    moved = ",".join([image, point, f"{float(x) + 0.01:.3f}", *rest])
    path.write_text("\n".join([head, moved, *others]) + "\n")


def role(folder: Path) -> None:
    path = folder / "control.csv"
    path.write_text(path.read_text().replace(",check", ",control", 1))


def picture_left_out(folder: Path) -> None:
    path = folder / "project.toml"
    path.write_text(path.read_text() + LEFT_OUT)


@pytest.fixture(scope="module")
def site(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A project that was run, and how long it took from nothing, s."""
    folder = tmp_path_factory.mktemp("change")
    shutil.copytree(shared / "data/flight-caliterra-twelve", folder / "images")
    photocal(folder, "new", ".")
    photocal(folder, "run", "project.toml", "--until", "calibration")
    with_control(folder)
    shutil.rmtree(folder / "cache")
    _, whole = photocal(folder, "run", "project.toml")
    # Digests of files that were just written are not kept.
    time.sleep(2.5)
    photocal(folder, "run", "project.toml")
    return folder, whole


@pytest.mark.parametrize("change", [nothing, mark, role, picture_left_out])
def test_seconds_to_the_verdict(
    change: Callable[[Path], None],
    site: tuple[Path, float],
    tmp_path: Path,
    benchmark: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    saved, from_nothing = site
    seconds = []

    def changed() -> None:
        folder = tmp_path / "site"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(saved, folder)
        change(folder)
        seconds.append(photocal(folder, "run", "project.toml")[0])

    benchmark.pedantic(changed, rounds=REPEATS)
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / "change_one.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    known[change.__name__] = {"seconds": seconds, "from_nothing": from_nothing}
    file.write_text(json.dumps(known, indent=1) + "\n")
    middle = statistics.median(seconds)
    share = f"{middle / from_nothing:.3f} of the {from_nothing:.0f} s from nothing"
    with capsys.disabled():
        print(f"\n{change.__name__}: {middle:.2f} s to the verdict, {share}")
