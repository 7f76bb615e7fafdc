"""Tables of control points as receivers and programs export them, in four languages, by `photocal new`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.evidence.mutilated_lists import pictures
from tests.photocal.conftest import Answer

PLACES = {
    "G1": (425397.763, 4583557.553, 212.5),
    "G2": (425472.25, 4583562.5, 213.25),
    "G3": (425437.5, 4583592.0, 211.0),
}
HEAD = "name,easting,northing,height"
ROW, UNKNOWN = "{p},{E},{N},{Z}", "Nr.;Wert A;Wert B;Wert C"
Photocal = Callable[..., Answer]


def written(row: str, *head: str, comma: bool = False) -> str:
    """The heads, and a row for each point."""
    rows = [row.format(p=name, E=east, N=north, Z=up) for name, (east, north, up) in PLACES.items()]
    return "\n".join([*head, *([line.replace(".", ",") for line in rows] if comma else rows)]) + "\n"


# File, head, and a row.
TABLES = {
    "trimble": ("job.csv", "Point ID,Northing,Easting,Elevation,Feature Code", "{p},{N},{E},{Z},gcp"),
    "emlid": (
        "survey.csv",
        "Name,Easting,Northing,Elevation,Longitude,Latitude,Ellipsoidal height",
        "{p},{E},{N},{Z},-81.9,41.3,178.2",
    ),
    "leica": (
        "job.txt",
        "Point Id\tEasting [m]\tNorthing [m]\tOrtho. Height [m]\tCode",
        "{p}\t{E}\t{N}\t{Z}\tGCP",
    ),
    "leica quality": ("job.txt", "Point ID;Easting;Northing;Ellip. Height;CQ 3D", "{p};{E};{N};{Z};0.012"),
    "german": ("Passpunkte.csv", "Punktnummer;Rechtswert;Hochwert;Höhe", "{p};{E};{N};{Z}"),
    "german blanks": ("werte.txt", "Punkt Nord Ost Hoehe", "{p} {N} {E} {Z}"),
    "portuguese": ("apoio.csv", "Ponto;Coordenada E;Coordenada N;Altitude Geométrica", "{p};{E};{N};{Z}"),
    "spanish": ("datos.csv", "Punto;Este;Norte;Elevación", "{p};{E};{N};{Z}"),
    "with a title": (
        "gcp.csv",
        "Points of 12/03/2024;;;\n\n# SIRGAS2000\nNome;E(m);N(m);H(m)",
        "{p};{E};{N};{Z}",
    ),
    "numbered": ("gcp.csv", "id,name,easting,northing,height", "1,{p},{E},{N},{Z}"),
}
COMMAS = ("german", "portuguese", "spanish")


def new(photocal: Photocal, folder: Path, name: str, content: bytes) -> dict[str, list[str]]:
    pictures(folder)
    (folder / name).write_bytes(content)
    said = photocal("new", folder, "--crs", "EPSG:32617", "--json")
    assert said.code == 0, said.err
    found: dict[str, list[str]] = json.loads(said.out)
    return found


def control(folder: Path) -> dict[str, tuple[float, ...]]:
    with (folder / "control.csv").open(encoding="utf-8") as table:
        return {row["point"]: tuple(float(row[axis]) for axis in "XYZ") for row in csv.DictReader(table)}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("kind", list(TABLES))
def test_what_receivers_export_is_read(tmp_path: Path, photocal: Photocal, kind: str, encoding: str) -> None:
    name, head, row = TABLES[kind]
    text = written(row, head, comma=kind in COMMAS)
    found = new(photocal, tmp_path / "f", name, text.encode(encoding))
    assert control(tmp_path / "f") == PLACES
    assert not any("not used" in line for line in found["missing"])


@pytest.mark.parametrize(
    ("row", "head", "again", "said"),
    [
        (ROW, (HEAD,), "G1,425397.763,4583557.553,212.5", "listed twice"),
        (ROW, (HEAD,), "G1,1,2,3", "twice, with other coordinates before"),
        (ROW, ("title", HEAD), "G1,1,2,3", "line 6: G1 is listed twice, with other coordinates before"),
        ("{p} {E} {N} {Z}", (), "G1 425397.763 4583557.553 212.5", "line 4: G1 is listed twice"),
    ],
)  # fmt: skip
def test_a_point_that_is_listed_twice_costs_only_its_row(
    tmp_path: Path, photocal: Photocal, row: str, head: tuple[str, ...], again: str, said: str
) -> None:
    text = written(row, *head) + again + "\n"
    found = new(photocal, tmp_path / "f", f"points.{'csv' if head else 'txt'}", text.encode())
    assert control(tmp_path / "f") == PLACES
    assert next(line for line in found["missing"] if "not used" in line).endswith(said)


def test_marks_under_the_heads_of_other_programs(tmp_path: Path, photocal: Photocal) -> None:
    folder = tmp_path / "f"
    pictures(folder)
    (folder / "points.csv").write_text(written("{p},{E},{N},{Z}", "label,X,Y,Z"))
    (folder / "seen.txt").write_text(
        "Filename,GCP Label,PixelX,PixelY,Zoom\na0,G1,100,60,1\nA1.JPG,G1,75,60,1\n"
    )
    said = photocal("new", folder, "--crs", "EPSG:32617", "--json")
    assert said.code == 0, said.err
    with (folder / "marks.csv").open() as table:
        marks = [tuple(row.values())[:4] for row in csv.DictReader(table)]
    # The corner of the upper-left pixel is (0, 0) there, its centre is here.
    assert [(image, float(x), float(y)) for image, _, x, y in marks] == [
        ("a0.jpg", 99.5, 59.5),
        ("a1.jpg", 74.5, 59.5),
    ]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("export.csv", written("{p};{E};{N};{Z}", UNKNOWN), "has no column X (found nr."),
        ("export.txt", written("{p};{E};{N};{Z}", UNKNOWN), "has no column X (found nr."),
        ("werte.txt", written("{p} {E} {N}"), "werte.txt"),
        ("notes.txt", "Flown on 12 March, 10 pictures.\nWind 3 m/s\n", None),
    ],
)  # fmt: skip
def test_a_table_of_places_is_named_where_it_cannot_be_read(
    tmp_path: Path, photocal: Photocal, name: str, text: str, said: str | None
) -> None:
    found = new(photocal, tmp_path / "f", name, text.encode())
    left = [line for line in found["missing"] if "not used" in line]
    assert (said in left[0]) if said else not left


def test_json_that_is_no_list_is_named_in_our_words(tmp_path: Path, photocal: Photocal) -> None:
    found = new(photocal, tmp_path / "f", "points.json", b'[{"cameras": {}}]')
    (left,) = (line for line in found["missing"] if "not used" in line)
    assert "is not a ground_control_points.json: it has no points" in left
