"""The flown block of a run: measured once from the adjusted block, and repeated by the certificate."""

from __future__ import annotations

import csv
import datetime as dt
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from photocal.base.progress import quiet
from photocal.block.project import Project, read_project
from photocal.block.results.adjusted import adjust_block
from photocal.planning.options import FlownOptions
from photocal.products.raster import write_terrain
from photocal.products.terrain import Terrain
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import issue
from photocal.run.campaign import stages
from photocal.run.flown import flown_stage, measure_flown
from photocal.run.stage import Digests, draw_pictures, update_stage
from tests.photocal.analysis.georeferencing.flights import FOCAL_MM, PITCH_MM, Plan, fly
from tests.photocal.conftest import Answer

DAY = dt.date(2026, 11, 23)
# Exposure time (s) and sensitivity of the pictures in turn.
TAKEN = ((1 / 1000, 100), (1 / 2000, 400))
PROJECT = """
[project]
name = "field 9"
crs = "local"
height = "local"
output = "work"
[images]
folder = "images"
[certificate]
plan = "plan.json"
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A flight at 90 m and 130 m above level ground, with its pictures, plan and adjustment."""
    folder = tmp_path_factory.mktemp("flown")
    fly(folder / "block", np.random.default_rng(3), plan=Plan(relief_m=0.0))
    (folder / "images").mkdir()
    names = [line.split(",")[0] for line in (folder / "block" / "images.csv").read_text().split()[1:]]
    for k, name in enumerate(names):
        exif = Image.Exif()
        exposure, iso = TAKEN[k % 2]
        exif.get_ifd(0x8769).update({0x829A: exposure, 0x8827: iso})
        Image.new("L", (40, 30)).save(folder / "images" / f"{name}.jpg", exif=exif)
    # The images of the block are the pictures: they have their names.
    for path in (folder / "block").glob("*.csv"):
        named = re.sub(r"^(s\d_\d+),", r"\1.jpg,", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        path.write_text(named, encoding="utf-8")
    plan = {"levels": [{"height_m": 130.0, "gsd_m": 0.04875}, {"height_m": 90.0, "gsd_m": 0.03375}]}
    (folder / "plan.json").write_text(json.dumps(plan), encoding="utf-8")
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    adjust_block(folder / "block", folder / "calibration")
    return read_project(folder / "project.toml")


@pytest.fixture(scope="module")
def made(project: Project) -> Path:
    folder = project.path.parent
    made = folder / "flown"
    made.mkdir()
    draw = flown_stage(project, folder / "block", folder / "calibration").make(made, quiet)
    assert draw is not None
    draw(made)
    return made


def measured(block: Path, run: Path | None, files: FlownOptions | None = None) -> dict[str, Any]:
    flown = measure_flown(block, run, files)
    assert flown is not None
    return flown.figures


def test_the_stage_writes_figures_map_and_picture(made: Path) -> None:
    assert {path.name for path in made.iterdir()} == {
        *("flown.json", "flown.csv", "flown.gpkg", "flown.svg"),
        *("positions.csv", "positions.gpkg", "positions.svg"),
    }
    figures = json.loads((made / "flown.json").read_text(encoding="utf-8"))
    # 25 of 40 images at 90 m; their heights scatter by a metre.
    assert figures["height_m"]["median"] == pytest.approx(90.0, abs=2.5)
    assert figures["gsd_m"]["most"] == pytest.approx(130.0 * PITCH_MM / FOCAL_MM, rel=0.03)
    assert figures["planned"] == {"height_m": 90.0, "gsd_m": 0.03375}
    assert figures["exposure_ms"] == {"least": 0.5, "median": 0.75, "most": 1.0}
    assert (figures["iso"]["least"], figures["iso"]["most"]) == (100.0, 400.0)
    # 14 m/s over pixels of 3.375 cm in 1 ms, at 90 m.
    assert figures["smear_px"]["most"] == pytest.approx(14e-3 / 0.03375, rel=0.1)


def test_what_else_lies_beside_the_pictures_is_nothing_new(project: Project, tmp_path: Path) -> None:
    """A project written by `new` lies there, with the folder of its run."""
    folder = project.path.parent

    def kept() -> bool:
        stage = flown_stage(project, folder / "block", folder / "calibration")
        digests = Digests(tmp_path / "digests.json")
        return draw_pictures(update_stage(stage, tmp_path, digests, quiet), tmp_path, digests).kept

    assert not kept()
    (folder / "images" / "work").mkdir()
    (folder / "images" / "work" / "run.log").write_text("flown", encoding="utf-8")
    assert kept()


@pytest.mark.parametrize(
    ("language", "rows"),
    [
        ("en", {"iso": "100 – 400 (EXIF)", "exposure_time": "0.000500 – 0.00100 (EXIF)"}),
        ("pt-BR", {"iso": "100 – 400 (EXIF)", "exposure_time": "0,000500 – 0,00100 (EXIF)"}),
    ],
)
def test_a_certificate_repeats_them_and_verifies(
    project: Project, made: Path, language: str, rows: dict[str, str], tmp_path: Path,
    photocal: Callable[..., Answer],
) -> None:  # fmt: skip
    folder, figures = project.path.parent, json.loads((made / "flown.json").read_text(encoding="utf-8"))
    output = tmp_path / "certificate"
    given = read_particulars(None, DAY, flown=figures)
    issue(folder / "calibration", output, given, language=language, block=folder / "block")
    record = json.loads((output / "certificate.json").read_text(encoding="utf-8"))
    report = {row["key"]: row for row in record["technical_reports"]["cam"]}
    assert {key: report[key]["value"] for key in rows} == rows
    assert report["iso"]["origin"] == "given"
    mark = "," if language == "pt-BR" else "."
    least = f"{figures['height_m']['least']:.1f}".replace(".", mark)
    assert f"{least} m" in report["rtk_advice"]["value"]
    page = (output / "certificate.html").read_text(encoding="utf-8")
    section = page[page.index("The flown block" if language == "en" else "O bloco voado") :]
    assert f">90{mark}0</td>" in section  # planned height
    assert f">3{mark}38</td>" in section or f">3{mark}37</td>" in section  # planned ground sampling
    for key, factor in (("forward_overlap", 100.0), ("side_overlap", 100.0)):
        assert f">{factor * figures[key]['median']:.1f}</td>".replace(".", mark) in section
    said = photocal("verify", output, "--json")
    assert json.loads(said.out)["verified"] is True, said.err


def test_a_changed_figure_is_named(project: Project, made: Path, tmp_path: Path,
                                   photocal: Callable[..., Answer]) -> None:  # fmt: skip
    folder, figures = project.path.parent, json.loads((made / "flown.json").read_text(encoding="utf-8"))
    given = read_particulars(None, DAY, flown=figures)
    issue(folder / "calibration", tmp_path / "c", given, block=folder / "block")
    path = tmp_path / "c" / "certificate.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"tilt_over_5_deg": ', '"tilt_over_5_deg": 1'), encoding="utf-8")
    assert photocal("verify", tmp_path / "c").code != 0


def test_cameras_that_do_not_look_down_have_no_flown_block(project: Project, tmp_path: Path) -> None:
    block = tmp_path / "block"
    fly(block, np.random.default_rng(3), plan=Plan(relief_m=0.0))
    header, *rows = (block / "images.csv").read_text(encoding="utf-8").split()
    turned = [",".join([*row.split(",")[:5], "90", "0", "0"]) for row in rows]
    (block / "images.csv").write_text("\n".join([header, *turned, ""]), encoding="utf-8")
    assert measure_flown(block, None, only_nadir=True) is None
    assert not math.isnan(measured(project.path.parent / "block", None)["tilt_deg"]["median"])


def test_projects_of_pictures_have_the_stage(project: Project) -> None:
    names = [stage.name for stage in stages(project, DAY)]
    assert names.index("calibration") < names.index("flown") < names.index("certificate")


@pytest.mark.parametrize(("beside_m", "severity"), [(0.0, "note"), (0.6, "doubtful")])
def test_laser_distances_of_the_pictures_are_a_check(tmp_path: Path, beside_m: float, severity: str) -> None:
    """Distances to level ground at height 0, by height and tilt as the flight recorded them."""
    folder = tmp_path / "dense"
    fly(folder / "block", np.random.default_rng(3), plan=Plan(relief_m=0.0, tie=900))
    with (folder / "block" / "images.csv").open(encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            # M33 of the rotation is cos(omega) cos(phi).
            upright = math.cos(math.radians(float(row["omega"]))) * math.cos(math.radians(float(row["phi"])))
            distance = (float(row["Z"]) + beside_m) / upright
            packet = f'<rdf:Description drone-dji:LRFTargetDistance="{distance:.3f}"/>'
            Image.new("L", (40, 30)).save(tmp_path / f"{row['image']}.jpg", xmp=packet.encode())
    for path in (folder / "block").glob("*.csv"):
        named = re.sub(r"^(s\d_\d+),", r"\1.jpg,", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        path.write_text(named, encoding="utf-8")
    adjust_block(folder / "block", folder / "calibration")
    figures = measured(folder / "block", folder / "calibration", FlownOptions(images=tmp_path))
    (found,) = figures["findings"]
    assert (found["code"], found["severity"]) == ("laser-heights", severity)
    assert found["figures"]["bias_m"] == pytest.approx(beside_m, abs=0.15)
    # A terrain model 1 m higher, in place of the tie points.
    model = tmp_path / "terrain.tif"
    write_terrain(Terrain(np.full((400, 400), 1.0), (10.0, 0, -2000.0, 0, -10.0, 2000.0), "", ""), model)
    files = FlownOptions(images=tmp_path, terrain=model, terrain_heights="ellipsoidal")
    (found,) = measured(folder / "block", folder / "calibration", files)["findings"]
    assert found["figures"]["bias_m"] == pytest.approx(beside_m + 1.0, abs=0.15)
    assert found["severity"] == "doubtful"
