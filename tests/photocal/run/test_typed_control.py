"""Control as people type it, from `photocal new` to the certificate: no slip costs the block."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from photocal.block.project import read_project
from photocal.geometry.systems import heights_at
from photocal.measurement.marks import read_marks
from photocal.run.project_checks import check_project
from tests.photocal.conftest import Answer
from tests.photocal.run.typed_site import CRS, MIDDLE, Row, resized, site_folder

WIDTH, HEIGHT = 480, 360
# How viewers show a stored mark, by the EXIF standard, in pixels from the edges.
SHOWN = {
    3: lambda x, y: (WIDTH - x, HEIGHT - y),
    6: lambda x, y: (HEIGHT - y, x),
    8: lambda x, y: (y, WIDTH - x),
}
# Sigmas of control of which nobody states any, m.
ASSUMED = (0.02, 0.02, 0.03)


Photocal = Callable[..., Answer]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight, rendered once."""
    return tmp_path_factory.mktemp("rendered")


def shown(orientation: int) -> Callable[[list[Row]], list[Row]]:
    """Marks as in a viewer that turns pictures by EXIF."""

    def turned(row: Row) -> Row:
        x, y = SHOWN[orientation](row.x + 0.5, row.y + 0.5)
        return replace(row, x=x - 0.5, y=y - 0.5)

    return lambda rows: [turned(row) for row in rows]


def from_below(rows: list[Row]) -> list[Row]:
    """Marks of a program whose rows count from the lower edge."""
    return [replace(row, y=HEIGHT - 1.0 - row.y) for row in rows]


def row_first(rows: list[Row]) -> list[Row]:
    """Marks whose columns stand in the other order."""
    return [replace(row, x=row.y, y=row.x) for row in rows]


def new(photocal: Photocal, folder: Path, *more: str) -> dict[str, Any]:
    said = photocal("new", folder, "--json", *more)
    assert said.code == 0, said.err
    found = json.loads(said.out)
    rows = found["rows"]
    # What was read is used or named.
    assert rows["read"] == rows["used"] + len(rows["not_used"])
    return dict(found)


def ran(photocal: Photocal, folder: Path, *more: str) -> str:
    said = photocal("run", folder, *more)
    assert said.code == 0, said.err
    return " ".join((said.out + said.err).split())


@pytest.mark.parametrize(
    ("change", "orientation", "named"),
    [
        (resized(0.5), 1, "of 1/2 of the size"),
        (resized(0.25), 1, "of 1/4 of the size"),
        (resized(2.0), 1, "of 2 of the size"),
        (shown(3), 3, "turned as EXIF orientation shows them"),
        (shown(6), 6, "turned as EXIF orientation shows them"),
        (shown(8), 8, "turned as EXIF orientation shows them"),
        # The pictures were turned back afterwards, and EXIF says nothing of it any more.
        (shown(3), 1, "turned by 180 degrees"),
        (shown(6), 1, "turned by 90 degrees"),
        (shown(8), 1, "turned by 270 degrees"),
        (lambda rows: resized(0.5)(shown(6)(rows)), 6, "of 1/2 of the size and turned as EXIF"),
        (from_below, 1, "with rows counted from the lower edge"),
        (lambda rows: resized(0.5)(from_below(rows)), 1, "of 1/2 of the size and with rows counted from"),
        (row_first, 1, "with row before column"),
    ],
    ids=[
        *("half", "quarter", "double", "exif-3", "exif-6", "exif-8", "180", "90", "270", "half-exif-6"),
        *("bottom", "half-bottom", "swapped"),
    ],
)
def test_marks_made_in_other_pictures_are_brought_to_these(
    pictures: Path,
    tmp_path: Path,
    photocal: Photocal,
    change: Callable[[list[Row]], list[Row]],
    orientation: int,
    named: str,
) -> None:
    """Expected: the marks as they are in the stored grid, to the two decimals of the list."""
    meant: list[Row] = []

    def spoil(rows: list[Row]) -> list[Row]:
        meant.extend(rows)
        return change(rows)

    site_folder(pictures, tmp_path / "f", spoil, orientation=orientation)
    found = new(photocal, tmp_path / "f")
    assert any(named in line for line in found["found"]), found
    marks = {(mark.image, mark.point): (mark.x, mark.y) for mark in read_marks(tmp_path / "f/marks.csv")}
    assert len(marks) == len(meant)
    for row in meant:
        assert marks[row.image, row.name] == pytest.approx((row.x, row.y), abs=0.03)
    # What may be chosen instead stands behind it, with marks as they would lie.
    best, *others = found["frames"]
    assert (best["chosen"], [other["chosen"] for other in others]) == (True, [False] * len(others))
    assert "1" in [other["frame"] for other in others]
    places = {(row.image, row.name): (row.x, row.y) for row in meant}
    assert best["marks"]
    for mark in best["marks"]:
        assert (mark["x"], mark["y"]) == pytest.approx(places[mark["image"], mark["point"]], abs=0.03)


def test_marks_as_they_are_stored_are_left_alone(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    site_folder(pictures, tmp_path / "f", orientation=6)
    assert not any(line.startswith("marks") for line in new(photocal, tmp_path / "f")["found"])


@pytest.mark.parametrize("name", ["PUWG1992", "CS92", "ETRF2000-PL / CS92", "EPSG:2180", "Poland CS92"])
def test_systems_by_the_names_that_people_give_them(
    pictures: Path, tmp_path: Path, photocal: Photocal, name: str
) -> None:
    site_folder(pictures, tmp_path / "f", first=name)
    found = new(photocal, tmp_path / "f")
    assert found["asked"] == []
    assert 'crs = "EPSG:2180"' in (tmp_path / "f/project.toml").read_text()


def test_a_system_that_may_be_several_is_asked_for_with_the_candidates(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    site_folder(pictures, tmp_path / "f", first="UTM 34N")
    found = new(photocal, tmp_path / "f", "--crs", "UTM zone 34N")
    (asked,) = found["asked"]
    assert asked.startswith("crs: what is 'UTM zone 34N'?")
    assert 1 <= asked.count("EPSG:") <= 5


def test_absent_pictures_twins_and_single_marks_are_named_before_any_work(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    def spoil(rows: list[Row]) -> list[Row]:
        x, y, z = rows[0].place
        kept = [row for row in rows if row.name != "G6"] + [row for row in rows if row.name == "G6"][:1]
        twin = [replace(row, place=(x, y, z + 0.5), name="G7", x=row.x + 9) for row in rows[:2]]
        near = [replace(row, place=(x + 0.2, y, z), name="G8", y=row.y + 9) for row in rows[:2]]
        return [*kept, *twin, *near]

    site_folder(pictures, tmp_path / "f", spoil, absent=("p4.jpg", "p5.jpg"))
    told = " ".join(new(photocal, tmp_path / "f")["doubtful"])
    assert "2 pictures of 8 not in the folder: p4.jpg, p5.jpg" in told
    assert re.search(r"G1 and G7 have one position, with the heights 110 and 110\.5", told)
    assert "G1 and G8 are 0.20 m apart" in told
    assert "G6" in told
    assert {mark.image for mark in read_marks(tmp_path / "f/marks.csv")}.isdisjoint({"p4.jpg", "p5.jpg"})


def gross(slip: str) -> Callable[[list[Row]], list[Row]]:
    """A third of the points with one slip."""
    to_next = Transformer.from_crs(CRS, "EPSG:32633", always_xy=True)

    def spoiled(row: Row) -> Row:
        x, y, z = row.place
        if row.name not in ("G2", "G4"):
            return row
        if slip == "5 m":
            return replace(row, place=(x + (5.0 if row.name == "G2" else -5.0), y, z))
        if slip == "swapped":
            return replace(row, place=(y, x, z))
        return replace(row, place=(*to_next.transform(x, y), z))

    return lambda rows: [spoiled(row) for row in rows]


@pytest.mark.slow
@pytest.mark.parametrize("positions", [False, True], ids=["control alone", "with positions"])
@pytest.mark.parametrize("slip", ["5 m", "swapped", "zone"])
def test_a_third_of_the_control_may_be_gross(
    pictures: Path, tmp_path: Path, photocal: Photocal, slip: str, positions: bool
) -> None:
    """Expected: both points named, the others hold the block to centimetres, and the certificate says it."""
    typed = site_folder(pictures, tmp_path / "f", gross(slip), positions=positions)
    more = ("--height", "orthometric") if positions else ()
    found = new(photocal, tmp_path / "f", *more)
    assert found["asked"] == []
    if slip == "swapped":
        assert sum("E and N are exchanged" in line for line in found["doubtful"]) == 2
    said = ran(photocal, tmp_path / "f")
    for name in ("G2", "G4"):
        assert re.search(
            rf"Control point {name} (and the intersection of its rays disagree: by|lies)", said
        ), said
    assert not re.search(r"Control point G[1356]", said)
    work = tmp_path / "f/work"
    points = (work / "calibration/points.csv").read_text().splitlines()
    head = points[0].split(",")
    place = {
        cells[0]: dict(zip(head, cells, strict=True)) for cells in (line.split(",") for line in points[1:])
    }
    for row in typed:
        if row.name in ("G1", "G3", "G5", "G6"):
            adjusted = [float(place[row.name][axis]) for axis in "XYZ"]
            assert adjusted == pytest.approx(row.place, abs=0.06)
    assert (work / "certificate/certificate.pdf").exists()


@pytest.mark.slow
def test_a_free_block_is_certified_as_calibrated_not_placed(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """Each point marked once: nothing of a map on any page, and why on the first."""

    def single(rows: Sequence[Row]) -> list[Row]:
        return list({row.name: row for row in rows}.values())

    site_folder(pictures, tmp_path / "f", single, first="PUWG1992")
    assert new(photocal, tmp_path / "f")["asked"] == []
    ran(photocal, tmp_path / "f")
    certificate = tmp_path / "f/work/certificate"
    for name in ("certificate.html", "certificate.json"):
        text = (certificate / name).read_text(encoding="utf-8")
        assert "not georeferenced" in text
        for word in ("EPSG", "PUWG", "CS92", "orthometric", r"\b63(45|46)\d\d\.\d", r"\b485[23]\d\d\.\d"):
            assert not re.search(word, text), (name, word)


def test_the_answers_to_a_question_are_taken(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    """Positions as receivers without corrections give them need no geoid beside orthometric control."""
    site_folder(pictures, tmp_path / "f", positions=True)
    (asked,) = new(photocal, tmp_path / "f")["asked"]
    assert asked.startswith("height: ")
    project = tmp_path / "f/project.toml"
    for answer in ("ellipsoidal", "orthometric"):
        project.write_text(re.sub('height = "[^"]*"', f'height = "{answer}"', project.read_text()))
        check_project(read_project(project))


@pytest.mark.parametrize(
    ("first", "height", "asked"),
    [
        ("EPSG:4978", "", "crs: control that WGS 84 would place "),
        ("EPSG:2180+5773", "ellipsoidal", "height: EPSG:2180+5773 has heights of its own (EGM96 height)"),
        ("EPSG:2180+5773", "", ""),
        ("EPSG:2180+5773", "orthometric", ""),
    ],
)
def test_what_run_would_refuse_is_asked_before(
    pictures: Path, tmp_path: Path, photocal: Photocal, first: str, height: str, asked: str
) -> None:
    """Without positions no grid is needed: a system with heights of its own is answer enough."""
    site_folder(pictures, tmp_path / "f", first=first)
    found = new(photocal, tmp_path / "f", *(("--height", height) if height else ()))
    if asked:
        (line,) = found["asked"]
        assert line.startswith(asked)
        return
    assert found["asked"] == []
    check_project(read_project(tmp_path / "f/project.toml"))


def test_geocentric_control_comes_to_a_map(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    """Points of a map system, typed as geocentric ones, are where they were, in the zone of their place."""
    there = Transformer.from_crs(CRS, "EPSG:4978", always_xy=True)
    back = Transformer.from_crs(CRS, "EPSG:32634", always_xy=True)
    meant: dict[str, tuple[float, ...]] = {}

    def typed(rows: list[Row]) -> list[Row]:
        meant.update({row.name: (*back.transform(*row.place[:2]), row.place[2]) for row in rows})
        return [replace(row, place=there.transform(*row.place)) for row in rows]

    site_folder(pictures, tmp_path / "f", typed, first="EPSG:4978")
    found = new(photocal, tmp_path / "f")
    assert found["asked"] == []
    project = read_project(tmp_path / "f/project.toml")
    assert (project.crs, project.height) == ("EPSG:32634", "ellipsoidal")
    with (tmp_path / "f/control.csv").open() as table:
        placed = {row["point"]: row for row in csv.DictReader(table)}
    assert placed.keys() == meant.keys()
    for name, row in placed.items():
        assert [float(row[axis]) for axis in "XYZ"] == pytest.approx(meant[name], abs=0.002)
        # Nobody has stated them: they are along the axes of a map whatever those of the list are.
        assert [float(row["s" + axis]) for axis in "XYZ"] == list(ASSUMED)


def test_stated_sigmas_of_geocentric_control_are_turned(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """Two metres along the earth's axis are 2 cos(latitude) to the north and 2 sin(latitude) upwards."""
    there = Transformer.from_crs(CRS, "EPSG:4978", always_xy=True)
    meant = {row.name: row.place for row in site_folder(pictures, tmp_path / "f")}
    (tmp_path / "f/gcp_list.txt").unlink()
    table = ["point,X,Y,Z,sX,sY,sZ"]
    for name, place in meant.items():
        x, y, z = there.transform(*place)
        table.append(f"{name},{x:.4f},{y:.4f},{z:.4f},0.001,0.001,2")
    (tmp_path / "f/points.csv").write_text("\n".join(table) + "\n")
    new(photocal, tmp_path / "f", "--crs", "EPSG:4978")
    degrees = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(*MIDDLE[:2])
    latitude = np.radians(degrees[1])
    with (tmp_path / "f/control.csv").open() as written:
        rows = list(csv.DictReader(written))
    assert [row["point"] for row in rows] == list(meant)
    for row in rows:
        assert float(row["sX"]) == pytest.approx(0.001, rel=1e-3)
        assert float(row["sY"]) == pytest.approx(2 * np.cos(latitude), rel=1e-4)
        assert float(row["sZ"]) == pytest.approx(2 * np.sin(latitude), rel=1e-4)


def test_control_of_a_map_in_feet_comes_to_metres(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    """EPSG:2180 with a unit of its own: 1200/3937 m, the US survey foot, by its definition."""
    foot = 1200 / 3937
    feet = Transformer.from_crs(CRS, "EPSG:32634", always_xy=True)
    meant: dict[str, tuple[float, ...]] = {}

    def typed(rows: list[Row]) -> list[Row]:
        meant.update({row.name: (*feet.transform(*row.place[:2]), row.place[2]) for row in rows})
        return [
            replace(row, place=(row.place[0] / foot, row.place[1] / foot, row.place[2] / foot))
            for row in rows
        ]

    own = "+proj=tmerc +lat_0=0 +lon_0=19 +k=0.9993 +x_0=500000 +y_0=-5300000 +ellps=GRS80 +units=us-ft"
    site_folder(pictures, tmp_path / "f", typed, first=own)
    found = new(photocal, tmp_path / "f")
    assert any("in US survey foot, transformed to EPSG:32634" in line for line in found["found"])
    assert not any(line.startswith("crs") for line in found["asked"])
    with (tmp_path / "f/control.csv").open() as table:
        placed = {row["point"]: row for row in csv.DictReader(table)}
    assert placed.keys() == meant.keys()
    for name, row in placed.items():
        # Typed to the millimetre of a foot.
        assert [float(row[axis]) for axis in "XYZ"] == pytest.approx(meant[name], abs=0.001)
        assert [float(row["s" + axis]) for axis in "XYZ"] == list(ASSUMED)


def test_heights_of_precise_positions_ask_for_their_geoid(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """With the vertical systems of the place, and of each whether its grid is here."""
    folder = tmp_path / "f"
    site_folder(pictures, folder, positions=True)
    rows = ["EPSG:2180", *(f"p{k}.jpg {634600 + k} 485300 130 0 0 0 0.02 0.03" for k in range(1, 9))]
    (folder / "geo.txt").write_text("\n".join(rows) + "\n")
    (asked,) = new(photocal, folder, "--height", "orthometric")["asked"]
    assert asked.startswith("crs: with the system of its heights")
    for code, name in heights_at(52.2, 20.97):
        assert f'"EPSG:2180+{code}" ({name}; ' in asked
    assert "photocal fetch-grids EPSG:2180+" in asked
    assert 'without one: position_sigma_m = "free"' in asked
    # What is answered against the advice is refused in a second, with the same candidates.
    project = folder / "project.toml"
    project.write_text(project.read_text().replace('crs = "?"', 'crs = "EPSG:2180"'))
    said = photocal("run", folder)
    assert said.code == 5
    assert '"EPSG:2180+5773" (EGM96 height)' in said.err
    project.write_text(project.read_text().replace('"EPSG:2180"', '"EPSG:2180+5773"'))
    said = photocal("run", folder)
    assert said.code == 5
    assert "photocal fetch-grids EPSG:2180+5773" in said.err
    assert not (folder / "work/.stages").exists()


def test_again_keeps_what_a_person_wrote(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    """Answers, comments and rows stay; a point that came to the list since is added and shown."""
    folder = tmp_path / "f"

    def without_the_last(rows: list[Row]) -> list[Row]:
        return [row for row in rows if row.name != "G6"]

    typed = site_folder(pictures, folder, without_the_last, positions=True)
    new(photocal, folder)
    project, control = folder / "project.toml", folder / "control.csv"
    text = project.read_text().replace('height = "?"', 'height = "orthometric"  # by the survey office')
    project.write_text(text.replace('lens = "unknown"', 'lens = "given"'))
    control.write_text(control.read_text().replace("0.0300,control", "0.0300,check", 1))
    kept = project.read_text()
    said = photocal("new", folder)
    assert said.code != 0
    assert "--again" in said.err
    site_folder(pictures, tmp_path / "later", positions=True)
    (folder / "gcp_list.txt").write_bytes((tmp_path / "later/gcp_list.txt").read_bytes())
    found = new(photocal, folder, "--again")
    assert project.read_text() == kept
    assert not [line for line in found["asked"] if line.startswith("height")]
    assert [line for line in found["changed"] if line.startswith("+ control.csv: G6,")]
    assert control.read_text().count("check") == 1
    points = {mark.point for mark in read_marks(folder / "marks.csv")}
    assert points == {row.name for row in typed} | {"G6"}
    # Once more there is nothing to add.
    before = {path: path.stat().st_mtime_ns for path in (folder / "project.toml", folder / "control.csv")}
    assert new(photocal, folder, "--again")["changed"] == []
    # Results of what did not change stay up to date.
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())


def test_again_names_points_that_the_list_now_has_elsewhere(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """A correction in the surveyor's list does not reach the table that is read: that is said."""
    folder = tmp_path / "f"
    site_folder(pictures, folder, positions=True)
    new(photocal, folder)
    given, control = folder / "gcp_list.txt", folder / "control.csv"
    row = next(line for line in control.read_text().splitlines() if line.startswith("G2,"))
    east = row.split(",")[1]
    typed = next(word for word in given.read_text().split() if word.replace(",", ".").startswith(east[:9]))
    given.write_text(given.read_text().replace(typed, typed.replace(typed[:6], str(int(typed[:6]) + 1), 1)))
    doubts = new(photocal, folder, "--again")["doubtful"]
    assert [line for line in doubts if "control.csv is kept" in line and "coordinates of G2:" in line]
    assert row in control.read_text().splitlines()
    control.unlink()
    assert not [line for line in new(photocal, folder, "--again")["doubtful"] if "is kept" in line]
    assert row not in control.read_text().splitlines()


def test_again_reads_tables_as_spreadsheets_save_them(
    pictures: Path, tmp_path: Path, photocal: Photocal
) -> None:
    """Another encoding and quotes are the same table; an emptied one is refused in a line."""
    folder = tmp_path / "f"
    site_folder(pictures, folder, positions=True)
    new(photocal, folder)
    control = folder / "control.csv"
    text = control.read_text()
    control.write_text(text.replace("\nG1,", '\n"G1",'))
    assert new(photocal, folder, "--again")["changed"] == []
    control.write_bytes((text + "Ação,1.0,2.0,3.0,0.02,0.02,0.03,control\n").encode("latin-1"))
    assert new(photocal, folder, "--again")["changed"] == []
    control.write_bytes(b"")
    refused = photocal("new", folder, "--again")
    assert (refused.code, refused.err.count("\n")) == (3, 1)
    assert "control.csv: is empty" in refused.err
