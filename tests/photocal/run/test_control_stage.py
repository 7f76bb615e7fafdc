"""`photocal run --until control`, and what becomes of control that `new` has not settled."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from photocal.adjustment.network import RELATIONS
from photocal.block.folder import read_block
from photocal.block.results.folder import read_result
from photocal.run.block import known_distances
from tests.photocal.conftest import Answer
from tests.photocal.run.typed_site import Row, resized, site_folder

Photocal = Callable[..., Answer]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight, rendered once."""
    return tmp_path_factory.mktemp("rendered")


def project_of(photocal: Photocal, folder: Path, *more: str) -> None:
    said = photocal("new", folder, *more)
    assert said.code == 0, said.err


def test_every_mark_is_used_or_named(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    folder = tmp_path / "f"
    typed = site_folder(pictures, folder)
    project_of(photocal, folder)
    marks, control = folder / "marks.csv", folder / "control.csv"
    lost = ["p1.jpg,Q9,10,10,1,1", "gone.jpg,G1,10,10,1,1", "p2.jpg,G6,-40,10,1,1"]
    kept = [line for line in marks.read_text().splitlines() if not line.startswith("p2.jpg,G6,")]
    marks.write_text("\n".join([*kept, *lost]) + "\n")
    control.write_text(control.read_text().replace("G3,6346", "G3,7346"))
    said = photocal("run", folder, "--until", "control", "--json")
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert [stage["stage"] for stage in told["stages"]] == ["control"]
    assert told["control"]["points"]["control"] == 6
    counted = told["control"]["marks"]
    assert counted["read"] == len(kept) - 1 + 3
    assert counted["used"] == len(kept) - 1 <= len(typed)
    assert counted["not_used"] == [
        "Mark of Q9 (p1.jpg) is not used: no control point has this name.",
        "Mark of G1 (gone.jpg) is not used: this picture is not in the folder, or cannot be used.",
        "Mark of G6 in p2.jpg is not used: it lies outside the picture (\N{MINUS SIGN}40, 10).",
    ]
    assert any("G3 lies 100 km from the others" in one["text"] for one in told["warnings"])
    # People read the same on one screen.
    said = photocal("run", folder, "--until", "control")
    assert f"6 control and 0 check points, {counted['used']} of {counted['read']} marks" in said.out


def test_an_absent_marks_file_is_told_before_any_work(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    folder = tmp_path / "f"
    site_folder(pictures, folder)
    project_of(photocal, folder)
    (folder / "marks.csv").unlink()
    said = photocal("run", folder, "--until", "control")
    assert said.code == 0, said.err
    (told,) = (line for line in said.err.splitlines() if "marks-absent" in line)
    assert "The marks file marks.csv does not exist" in told
    # Nothing was adjusted, so that nothing is judged.
    assert "verdict       none before the stage `analysis`" in said.out


def test_marks_of_other_pictures_are_told_before_any_work(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    folder = tmp_path / "f"
    site_folder(pictures, folder, resized(0.5))
    # A person insists that they are as stored.
    project_of(photocal, folder, "--marks", "1")
    told = json.loads(photocal("run", folder, "--until", "control", "--json").out)
    assert told["control"]["marks"]["made_in"] == "1/2"
    (warning,) = told["warnings"]
    assert warning["code"] == "marks-reframed"
    assert "--again --marks '1/2'" in warning["text"]


@pytest.mark.slow
def test_a_run_takes_them_so_and_no_distance_ends_it(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """Expected: the control at its survey to centimetres; one end of a distance has no place in the block."""

    def spoil(rows: list[Row]) -> list[Row]:
        single = next(row for row in rows if row.name == "G6")
        x, y, z = single.place
        return resized(0.5)([row for row in rows if row.name != "G6"]) + resized(0.5)(
            [replace(single, place=(x + 9, y, z))]
        )

    folder = tmp_path / "f"
    typed = site_folder(pictures, folder, spoil)
    project_of(photocal, folder, "--marks", "1")
    (folder / "distances.csv").write_text("from,to,value,sigma\nG1,G6,20.0,0.01\nG1,G3,14.0089,0.01\n")
    project = folder / "project.toml"
    project.write_text(project.read_text().replace("[control]", '[control]\ndistances = "distances.csv"', 1))
    said = photocal("run", folder)
    assert said.code == 0, said.err
    text = " ".join((said.out + said.err).split())
    assert "made in pictures of another size" in text
    certificate = (folder / "work/certificate/certificate.html").read_text(encoding="utf-8")
    assert re.search("made in pictures of another size", certificate)
    assert "G6 is not a point of the block" in " ".join(re.sub("<[^>]*>", " ", certificate).split())
    block = read_block(folder / "work/block")
    kinds = block.relations.kind.tolist()
    assert kinds.count(list(RELATIONS).index("distance")) == 1
    points = read_result(folder / "work/calibration").points
    adjusted = dict(zip(points.names, points.values, strict=True))
    for row in typed:
        if row.name != "G6":
            assert adjusted[row.name] == pytest.approx(row.place, abs=0.06)


def test_a_distance_to_a_point_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "distances.csv"
    path.write_text("from,to,value,sigma\nA,B,2.5,0.01\nB,C,1.0,0.01\nC,D,3.0,0.01\n")
    given, findings = known_distances(path, ("A", "B"), ("A", "B", "C", "D"))
    assert given.values.tolist() == [2.5]
    assert [(one.code, one.figures["missing"]) for one in findings] == [
        ("distance-left-out", ("C",)),
        ("distance-left-out", ("C", "D")),
    ]
