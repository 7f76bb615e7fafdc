"""A project file of Pix4D (.p4d) beside pictures: its control and marks, by `photocal new` and `adopt`."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from pyproj import CRS, Transformer

from photocal.exchange.formats import read_foreign_project
from photocal.geometry.camera import camera
from tests.photocal.exchange.conftest import reconstruction_of, roles_of, shown, with_roles
from tests.photocal.exchange.pix4d_folder import write_params
from tests.photocal.run.test_exported_tables import Photocal
from tests.photocal.run.test_new_project import picture

# Near Curitiba, in the zone 22 south.
POINTS = {
    "G1": (677864.123, 7184231.456, 912.4, "3DGCP"),
    "G 2": (677880.5, 7184250.25, 911.913, "3DGCP"),
    "C3": (677850.75, 7184270.0, 913.001, "Checkpoint"),
    "H4": (677860.75, 7184260.0, 912.001, "1DGCP"),
    "mtp1": (0.0, 0.0, 0.0, "MTP"),
}
# Image, point, and the mark from the upper-left corner of the image.
MARKS = [
    ("a0.jpg", "G1", 12.5, 20.25),
    ("a1.jpg", "G1", 70.0, 30.0),
    ("a1.jpg", "C3", 5.0, 6.0),
    ("a0.jpg", "mtp1", 9.0, 9.0),
]


def p4d(path: Path, system: str, geoid: str = "", points: Sequence[str] = tuple(POINTS)) -> None:
    """Write a project file with the elements that its makers describe."""
    wkt = CRS(system).to_wkt("WKT1_GDAL").replace('"', "&quot;")
    degrees = Transformer.from_crs("EPSG:31982", "EPSG:4326", always_xy=True)
    rows = list[str]()
    for k, name in enumerate(points):
        east, north, up, kind = POINTS[name]
        longitude, latitude = degrees.transform(east, north) if east else (0.0, 0.0)
        plane = (0.0, 0.0, 0.0) if CRS(system).is_geographic else (east, north, up)
        place = " ".join(f'{axis}="{value!r}"' for axis, value in zip("xyz", plane, strict=True))
        place += f' lat="{latitude!r}" lng="{longitude!r}" alt="{up!r}"'
        rows.append(f'<GCP id="{k}" label="{name}" type="{kind}" {place}/>')
    images = "".join(
        f'<image path="D:/voo 3/{image}" enabled="true"><gps alt="0" lat="0" lng="0"/>'
        + "".join(
            f'<imageGCP id="{list(points).index(name)}" x="{x}" y="{y}"/>'
            for other, name, x, y in MARKS
            if other == image and name in points
        )
        + "</image>"
        for image in ("a0.jpg", "a1.jpg")
    )
    vertical = f'<verticalDef model="geoid" geoidName="{geoid}"/>' if geoid else ""
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<pix4dmapper><inputs>'
        f"<coordinateSystems><gcp><WKT>{wkt}</WKT>{vertical}</gcp></coordinateSystems>"
        f"<gcps>{''.join(rows)}</gcps><images>{images}</images></inputs></pix4dmapper>",
        encoding="utf-8",
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", 20.0 * k)
    return tmp_path


@pytest.mark.parametrize("system", ["EPSG:31982", "EPSG:4674"])
def test_new_reads_points_and_marks_of_a_project_file(system: str, folder: Path, photocal: Photocal) -> None:
    p4d(folder / "voo 3.p4d", system, "EGM 96 Geoid")
    said = photocal("new", folder, "--json")
    assert said.code == 0, said.err
    assert json.loads(said.out)["asked"] == []
    assert 'height = "orthometric"' in (folder / "project.toml").read_text()
    with (folder / "control.csv").open(encoding="utf-8") as table:
        rows = {row["point"]: row for row in csv.DictReader(table)}
    assert set(rows) == {"G1", "G 2", "C3", "H4"}
    for name in ("G1", "G 2", "C3"):
        assert [float(rows[name][axis]) for axis in "XYZ"] == pytest.approx(POINTS[name][:3], abs=2e-3)
    assert [rows[name]["role"] for name in ("G 2", "C3")] == ["control", "check"]
    assert (rows["H4"]["X"], rows["H4"]["sX"], float(rows["H4"]["Z"])) == ("", "", 912.001)
    with (folder / "marks.csv").open(encoding="utf-8") as table:
        marks = [
            (row["image"], row["point"], float(row["x"]), float(row["y"])) for row in csv.DictReader(table)
        ]
    # The centre of the upper-left pixel is (0, 0) here.
    assert sorted(marks) == sorted((i, p, x - 0.5, y - 0.5) for i, p, x, y in MARKS if p != "mtp1")


def test_what_is_no_project_of_pix4d_is_named(folder: Path, photocal: Photocal) -> None:
    (folder / "voo.p4d").write_text("<html/>")
    said = photocal("new", folder, "--json")
    assert any("is not a project of Pix4D" in line for line in json.loads(said.out)["missing"])


def test_adopt_takes_a_project_file_and_its_check_points(tmp_path: Path, photocal: Photocal) -> None:
    own = camera("0", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), {"c": 20.0})
    made = with_roles(shown(reconstruction_of((own,), 6, 40), 2), "control", *("tie",) * 4)
    params, project = tmp_path / "voo 3" / "1_initial" / "params", tmp_path / "voo 3.p4d"
    params.mkdir(parents=True)
    names = made.points.only(made.points.of_role("control")).names
    project.write_text(
        "<pix4dmapper><inputs><gcps>"
        + "".join(
            f'<GCP id="{k}" label="{name}" type="{"Checkpoint" if k % 2 else "3DGCP"}" x="1" y="2" z="3"/>'
            for k, name in enumerate(names)
        )
        + "</gcps></inputs></pix4dmapper>"
    )
    said = photocal("adopt", project, "-o", tmp_path / "again")
    assert said.code == 3
    assert "voo 3/1_initial/params" in said.err
    write_params(params, made)
    for given in (project, tmp_path):
        block = read_foreign_project(given).block
        roles = dict(zip(block.points.names, roles_of(block), strict=True))
        assert {name: roles[name] for name in names} == {
            name: "check" if k % 2 else "control" for k, name in enumerate(names)
        }
