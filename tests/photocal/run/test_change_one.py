"""One thing is changed in a project: the next run gives what a run from nothing gives, the verdict first."""

from __future__ import annotations

import csv
import datetime as dt
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.arrays import Floats
from photocal.base.progress import quiet
from photocal.block.project import read_project
from photocal.block.results.folder import read_result
from photocal.findings.texts import catalogue
from photocal.findings.verdict import Verdict, verdict_json
from photocal.run.campaign import run_project
from tests.evidence.judging import fly
from tests.independent.flights import Design, Errors
from tests.photocal.conftest import Answer

PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "ready"
"""
LEFT_OUT = """
[[leave_out]]
image = "IMG_0003"
reason = "blurred"
"""


def ran(folder: Path) -> tuple[Floats, Floats]:
    """Values and standard deviations of the camera and the exposures after a run up to the adjustment."""
    run_project(read_project(folder / "project.toml"), dt.date(2026, 1, 1), quiet, until="calibration")
    made = folder / "work" / "calibration"
    (camera,) = read_result(made).cameras.values()
    with (made / "images.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    value = [camera.value(name) for name in camera.free] + [
        float(row[axis]) for row in rows for axis in "XYZ"
    ]
    sigma = [camera.sigma_of(name) for name in camera.free]
    sigma += [float(row[f"s{axis}"]) for row in rows for axis in "XYZ"]
    return np.array(value), np.array(sigma)


def moved(folder: Path) -> None:
    path = folder / "ready" / "observations.csv"
    head, first, *others = path.read_text().splitlines()
    image, point, x, *rest = first.split(",")
    path.write_text("\n".join([head, ",".join([image, point, str(float(x) + 0.5), *rest]), *others]) + "\n")


def promoted(folder: Path) -> None:
    path = folder / "ready" / "points.csv"
    path.write_text(path.read_text().replace(",check", ",control", 1))


def left_out(folder: Path) -> None:
    with (folder / "project.toml").open("a") as file:
        file.write(LEFT_OUT)


@pytest.mark.parametrize("change", [moved, promoted, left_out])
def test_what_changes_ends_as_a_run_from_nothing(change: Callable[[Path], None], tmp_path: Path) -> None:
    site, new = tmp_path / "site", tmp_path / "new"
    fly(site / "ready", Design("small", images=12, per_image=60), Errors(), 0)
    (site / "project.toml").write_text(PROJECT)
    before, _ = ran(site)
    change(site)
    shutil.copytree(site, new, ignore=shutil.ignore_patterns("work"))
    (value, sigma), (expected, expected_sigma) = ran(site), ran(new)
    assert np.all(np.abs(value - expected) <= 0.01 * expected_sigma)
    assert sigma == pytest.approx(expected_sigma, rel=0.01)
    assert len(value) < len(before) or np.any(np.abs(value - before) > 0.01 * sigma)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    fly(tmp_path / "ready", Design("small", images=12, per_image=60), Errors(), 0)
    (tmp_path / "project.toml").write_text(PROJECT)
    return tmp_path


def brought(folder: Path, judged: Callable[[Verdict], None]) -> set[str]:
    """Run a project; the stages that were made."""

    def report(what: object) -> None:
        if isinstance(what, Verdict):
            judged(what)

    results = run_project(read_project(folder / "project.toml"), dt.date(2026, 1, 1), quiet, report=report)
    return {result.name for result in results if not result.kept}


def files(work: Path) -> dict[str, bytes]:
    """What a run gives to a person, but for the time that its stages took."""
    return {
        path.relative_to(work).as_posix(): path.read_bytes()
        for path in work.rglob("*")
        if path.is_file() and not path.relative_to(work).parts[0].startswith(".")
    }


def test_the_verdict_comes_before_the_certificate_and_all_pictures(site: Path) -> None:
    work, told = site / "work", list[dict[str, Any]]()

    def judged(verdict: Verdict) -> None:
        told.append(verdict_json(verdict, catalogue("en")))
        known = files(work)
        assert "georeferencing/check.json" in known
        assert not [name for name in known if name.startswith("certificate") or name.endswith(".pdf")]

    brought(site, judged)
    certified = json.loads((work / "certificate" / "certificate.json").read_text())
    assert told == [certified["verdict"]]
    pictures = {path.name for path in (work / "georeferencing").glob("*.pdf")}
    assert {"integrated_histograms.pdf", "indirect_residual_map.pdf"} <= pictures
    # A verdict that stands already is not told again.
    assert brought(site, judged) == set()
    assert len(told) == 1


def test_a_run_that_is_stopped_after_the_verdict_is_completed_by_the_next(site: Path, tmp_path: Path) -> None:
    new = tmp_path / "new"
    shutil.copytree(site, new, ignore=shutil.ignore_patterns("work", "new"))

    def stop(_: Verdict) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        brought(site, stop)
    assert brought(site, lambda _: None) == {"georeferencing", "certificate"}
    assert brought(site, stop) == set()
    brought(new, lambda _: None)
    whole = files(new / "work")
    assert files(site / "work") == whole
    # A change takes the old pictures away until there are new ones.
    moved(site)
    with pytest.raises(KeyboardInterrupt):
        brought(site, stop)
    assert not list((site / "work" / "georeferencing").glob("*.pdf"))


def test_a_person_reads_the_verdict_before_the_place_of_the_certificate(
    site: Path, photocal: Callable[..., Answer]
) -> None:
    said = photocal("run", site / "project.toml").out.splitlines()
    begin = [line.partition(" ")[0] for line in said]
    assert begin.count("verdict") == begin.count("certificate") == 1
    assert begin.index("verdict") < begin.index("certificate") == len(said) - 1
    again = [line.partition(" ")[0] for line in photocal("run", site / "project.toml").out.splitlines()]
    assert again.index("certificate") < again.index("verdict")
