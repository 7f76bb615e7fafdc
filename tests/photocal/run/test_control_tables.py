"""Control tables as spreadsheets of several countries and people's habits leave them, by `photocal new`."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from photocal.findings.texts import catalogue
from photocal.measurement.marks import read_marks
from photocal.measurement.place_tables import read_places
from photocal.run.control_files import HEADS
from tests.photocal.run.test_exported_tables import Photocal
from tests.photocal.run.test_new_project import picture

# Curitiba, at the pictures of the folder, in the zone EPSG:32722.
POINTS = {
    "G1": (677864.123, 7184231.456, 912.4),
    "G2": (677880.5, 7184250.25, 911.913),
    "G3": (677850.75, 7184270.0, 913.001),
    "G4": (677870.0, 7184290.125, 912.222),
}
TO_DEGREES = Transformer.from_crs("EPSG:32722", "EPSG:4326", always_xy=True)
TO_EARTH = Transformer.from_crs("EPSG:32722", "EPSG:4978", always_xy=True)
FOOT_M = 0.3048
UNSTATED = "whether the control points' heights are ellipsoidal or orthometric"


def table(head: str, row: str, *, comma: bool = False, below: str = "") -> str:
    """Write a head, a row for each point, and what stands below."""
    lines = []
    for k, (name, (east, north, up)) in enumerate(POINTS.items()):
        longitude, latitude = TO_DEGREES.transform(east, north)
        x, y, z = TO_EARTH.transform(east, north, up)
        values = {"lat": f"{latitude:.10f}", "lon": f"{longitude:.10f}", "k": k + 1}
        values |= {"dms": sexagesimal(latitude, "N", "S"), "dmo": sexagesimal(longitude, "E", "O")}
        values |= {
            "ft_e": f"{east / FOOT_M:.4f}",
            "ft_n": f"{north / FOOT_M:.4f}",
            "ft_z": f"{up / FOOT_M:.4f}",
        }
        values |= {"mm_e": f"{east * 1000:.0f}", "mm_n": f"{north * 1000:.0f}", "mm_z": f"{up * 1000:.0f}"}
        grouped = {"g_e": f"{east:,.3f}", "g_n": f"{north:,.3f}"}
        values |= {key: v.translate(str.maketrans(",.", ".,")) for key, v in grouped.items()}
        values |= {"x": f"{x:.4f}", "y": f"{y:.4f}", "z": f"{z:.4f}"}
        line = row.format(p=name, E=east, N=north, Z=up, **values)
        lines.append(line.replace(".", ",") if comma else line)
    return "\n".join([head, *lines]) + "\n" + below


def sexagesimal(value: float, positive: str, negative: str) -> str:
    """Degrees, minutes and seconds with the letter of the hemisphere."""
    seconds = round(abs(value) * 3600, 6)
    degrees, minutes = int(seconds // 3600), int(seconds % 3600 // 60)
    return f"{degrees}° {minutes:02d}' {seconds % 60:09.6f}\" {positive if value > 0 else negative}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", 20.0 * k)
    return tmp_path


def new(photocal: Photocal, folder: Path, *options: str) -> dict[str, list[str]]:
    said = photocal("new", folder, "--json", *options)
    assert said.code == 0, said.err
    found: dict[str, list[str]] = json.loads(said.out)
    return found


def control(folder: Path) -> dict[str, tuple[float, ...]]:
    with (folder / "control.csv").open(encoding="utf-8") as rows:
        return {row["point"]: tuple(float(row[axis]) for axis in "XYZ") for row in csv.DictReader(rows)}


def key(folder: Path, name: str) -> str:
    lines = (folder / "project.toml").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith(f"{name} = ")).split('"')[1]


# File, encoding, text, and the kind of heights that it states ("?": it does not).
TABLES = {
    "Brazil: a title, a total, Windows accents": (
        "pontos.csv",
        "cp1252",
        "Levantamento GNSS;;;;\n;;;;\n"
        + table(
            "Ponto;Descrição;Norte (m);Este (m);Altitude Elipsoidal (m)",
            "{p};marco;{N};{E};{Z}",
            comma=True,
            below="Total;4;;;\n",
        ),
        "ellipsoidal",
    ),
    "Brazil: groups of thousands": (
        "pontos.csv",
        "utf-8",
        table("Ponto;E;N;H ortom.", "{p};{g_e};{g_n};{Z}"),
        "orthometric",
    ),
    "Brazil: degrees, minutes, seconds": (
        "pontos.csv",
        "cp1252",
        table("Ponto;Latitude;Longitude;Altitude geométrica", "{p};{dms};{dmo};{Z}", comma=True),
        "ellipsoidal",
    ),
    "Germany: a row of units, a byte order mark": (
        "Passpunkte.csv",
        "utf-8-sig",
        table(
            "Punktnr.;Rechtswert;Hochwert;Ellipsoidische Höhe\n;[m];[m];[m]", "{p};{E};{N};{Z}", comma=True
        ),
        "ellipsoidal",
    ),
    "France": (
        "points.csv",
        "cp1252",
        table("Matricule;X (m);Y (m);Altitude orthométrique", "{p};{E};{N};{Z}", comma=True),
        "orthometric",
    ),
    "Italy: UTF-16": (
        "punti.csv",
        "utf-16",
        table("Nome punto;Est;Nord;Quota ellissoidica", "{p};{E};{N};{Z}", comma=True),
        "ellipsoidal",
    ),
    "Spain": (
        "puntos.csv",
        "cp1252",
        table("Nº;Coord. X;Coord. Y;Cota ortométrica", "{p};{E};{N};{Z}", comma=True),
        "orthometric",
    ),
    "feet": (
        "points.csv",
        "utf-8",
        table("Point,Northing (ft),Easting (ft),Elevation (ft)", "{p},{ft_n},{ft_e},{ft_z}"),
        "?",
    ),
    "feet without brackets": (
        "points.csv",
        "utf-8",
        table("Point,Northing_ft,Easting_ft,Elev_ft", "{p},{ft_n},{ft_e},{ft_z}"),
        "?",
    ),
    "millimetres": (
        "points.csv",
        "utf-8",
        table("Name;East [mm];North [mm];Height [mm]", "{p};{mm_e};{mm_n};{mm_z}"),
        "?",
    ),
    "north before east, without heads": (
        "points.txt",
        "utf-8",
        table("", "{p},{N},{E},{Z},GCP{k}").lstrip(),
        "?",
    ),
    "empty rows, a mean": (
        "points.csv",
        "utf-8",
        table("name,E,N,Z\n", "{p},{E},{N},{Z}\n,,,", below="\n\nMean,677866.3,7184260.4,912.4\n"),
        "?",
    ),
    "geocentric beside degrees": (
        "points.csv",
        "utf-8",
        table("name,longitude,latitude,height,x,y,z", "{p},{lon},{lat},{Z},{x},{y},{z}"),
        "ellipsoidal",
    ),
    "a map beside degrees": (
        "points.csv",
        "utf-8",
        table("name,longitude,latitude,height,x,y,z", "{p},{lon},{lat},{Z},{E},{N},{Z}"),
        "?",
    ),
    "Greek letters": (
        "points.csv",
        "utf-8",
        table("Point,φ,λ,h ellip", "{p},{lat},{lon},{Z}"),
        "ellipsoidal",
    ),
    "both kinds of heights that are one": (
        "survey.csv",
        "utf-8",
        table("Name,Easting,Northing,Elevation,Ellipsoidal height", "{p},{E},{N},{Z},{Z}"),
        "ellipsoidal",
    ),
    "units in the cells": (
        "points.csv",
        "utf-8",
        table("Point,Easting,Northing,Height", "{p},{E} m,{N} m,{Z} m"),
        "?",
    ),
}


@pytest.mark.parametrize("kind", list(TABLES))
def test_a_table_as_people_make_it_is_read(folder: Path, photocal: Photocal, kind: str) -> None:
    name, encoding, text, height = TABLES[kind]
    (folder / name).write_bytes(text.encode(encoding))
    found = new(photocal, folder)
    assert list(control(folder)) == list(POINTS)
    for one, place in zip(POINTS.values(), control(folder).values(), strict=True):
        assert place == pytest.approx(one, abs=0.0006)
    assert key(folder, "crs") == "EPSG:32722"
    assert key(folder, "height") == height
    assert any(UNSTATED in line for line in found["asked"]) is (height == "?")


@pytest.mark.parametrize(
    "head",
    [
        "Point,E,N,H,sE (mm),sN (mm),sH (mm)",
        "Point,E [m],N [m],H [m],sE [mm],sN [mm],sH [mm]",
        "Point,E,N,H,sE,sN,sH\n,m,m,m,mm,mm,mm",
        "Point,E,N,H,sE,sN,sH\n,(m),(m),(m),(mm),(mm),(mm)",
    ],
)
def test_sigmas_have_units_of_their_own(folder: Path, photocal: Photocal, head: str) -> None:
    """Of 8 mm people made 8 m, and such control held nothing."""
    (folder / "points.csv").write_text(table(head, "{p},{E:.3f},{N:.3f},{Z:.3f},8,9,15"))
    new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as rows:
        sigmas = {tuple(float(row[key]) for key in ("sX", "sY", "sZ")) for row in csv.DictReader(rows)}
    assert sigmas == {(0.008, 0.009, 0.015)}


@pytest.mark.parametrize(
    ("head", "height"),
    [
        ("Ellip. Height", "ellipsoidal"),
        ("Ellipsoidal height", "ellipsoidal"),
        ("ellipsoidal_height [m]", "ellipsoidal"),
        ("h ellip", "ellipsoidal"),
        ("HAE", "ellipsoidal"),
        ("Altura elipsoidal", "ellipsoidal"),
        ("Altitude ortométrica", "orthometric"),
        ("Orthometric", "orthometric"),
        ("Ortho. Height", "orthometric"),
        ("Elevation (EGM96)", "orthometric"),
        ("Height above MSL", "orthometric"),
        ("Elevation", "?"),
        ("Height (geoid model)", "?"),
    ],
)
def test_a_head_says_the_kind_of_heights(folder: Path, photocal: Photocal, head: str, height: str) -> None:
    (folder / "p.csv").write_text(
        table(f"Name,Easting,Northing,Geoid separation,{head}", "{p},{E},{N},-3.1,{Z}")
    )
    found = new(photocal, folder)
    assert key(folder, "height") == height
    assert control(folder)["G1"][2] == 912.4
    assert any(f"by {head!r}" in line for line in found["found"]) is (height != "?")


def test_what_a_person_says_of_heights_stands_before_the_head(folder: Path, photocal: Photocal) -> None:
    (folder / "p.csv").write_text(table("Name,Easting,Northing,Orthometric height", "{p},{E},{N},{Z}"))
    found = new(photocal, folder, "--height", "ellipsoidal")
    assert key(folder, "height") == "ellipsoidal"
    assert any("'Orthometric height' of p.csv states orthometric" in line for line in found["doubtful"])


def test_feet_stay_in_a_map_in_feet(folder: Path, photocal: Photocal) -> None:
    """EPSG:2263 counts in US survey feet; a point in New York, by its definition in the register."""
    place = Transformer.from_crs("EPSG:4326", "EPSG:2263", always_xy=True).transform(-74.0, 40.7)
    east, north = (f"{value:.4f}" for value in place)
    (folder / "p.csv").write_text(f"Name,Easting (ftUS),Northing (ftUS),Elev (ftUS)\nG1,{east},{north},100\n")
    for name in folder.glob("*.jpg"):
        name.unlink()
    picture(folder / "a0.jpg", None)
    found = new(photocal, folder, "--crs", "EPSG:2263")
    assert key(folder, "crs") == "EPSG:32618"
    east_m, north_m, up_m = control(folder)["G1"]
    degrees = Transformer.from_crs("EPSG:32618", "EPSG:4326", always_xy=True).transform(east_m, north_m)
    assert degrees == pytest.approx((-74.0, 40.7), abs=1e-7)
    assert up_m == pytest.approx(100 * 1200 / 3937, abs=1e-3)
    assert not any("as its headings state" in line for line in found["found"])


@pytest.mark.parametrize(
    ("words", "checks", "doubt"),
    [
        (("GCP", "GCP", "GCP", "CP"), {"G4"}, False),
        (("CP", "CP", "CP", "check"), {"G4"}, False),
        (("CP", "CP", "CP", "CP"), {"G1", "G2", "G3", "G4"}, True),
    ],
    ids=["check points beside gcp", "control points beside check", "either"],
)
def test_cp_is_a_control_or_a_check_point_by_what_stands_beside_it(
    folder: Path, photocal: Photocal, words: tuple[str, ...], checks: set[str], doubt: bool
) -> None:
    head, *rows = table("name,E,N,Z,role", "{p},{E},{N},{Z},").splitlines()
    listed = [head, *(row + word for row, word in zip(rows, words, strict=True))]
    (folder / "points.csv").write_text("\n".join(listed) + "\n", encoding="utf-8")
    found = new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as made:
        assert {row["point"] for row in csv.DictReader(made) if row["role"] == "check"} == checks
    told = [line for lines in found.values() for line in lines if "may mean control or check" in line]
    assert len(told) == doubt


def test_the_system_that_a_table_names_is_taken(folder: Path, photocal: Photocal) -> None:
    text = table("Name,Easting,Northing,Elevation,CS name", "{p},{E},{N},{Z},SIRGAS 2000 / UTM zone 22S")
    (folder / "survey.csv").write_text(text)
    new(photocal, folder)
    assert key(folder, "crs") == "EPSG:31982"


def minutes(value: float, letters: str) -> str:
    """Degrees and decimal minutes with the letter of the hemisphere, positive and negative."""
    whole = int(abs(value))
    return f"{whole}° {60 * (abs(value) - whole):.8f}' {letters[value < 0]}"


def packed(value: float) -> str:
    """Degrees, minutes and seconds as one number."""
    seconds = round(abs(value) * 3600, 6)
    text = f"{int(seconds // 3600)}{int(seconds % 3600 // 60):02d}{seconds % 60:09.6f}"
    return text if value > 0 else f"-{text}"


@pytest.mark.parametrize("kind", ["minutes", "hyphens", "packed"])
def test_degrees_in_other_signs(folder: Path, photocal: Photocal, kind: str) -> None:
    rows = ["name,lat,lon,h ell"]
    for name, (east, north, up) in POINTS.items():
        longitude, latitude = TO_DEGREES.transform(east, north)
        said = {
            "minutes": [minutes(latitude, "NS"), minutes(longitude, "EW")],
            "hyphens": [
                re.sub("[°']", "-", sexagesimal(value, *letters)).replace(" ", "").replace('"', "")
                for value, letters in ((latitude, "NS"), (longitude, "EW"))
            ],
            "packed": [packed(latitude), packed(longitude)],
        }[kind]
        rows.append(",".join([name, *said, str(up)]))
    (folder / "p.csv").write_text("\n".join(rows) + "\n")
    new(photocal, folder)
    for name, place in control(folder).items():
        assert place == pytest.approx(POINTS[name], abs=2e-3)


def test_decimal_commas_between_quotes_are_no_thousands(folder: Path, photocal: Photocal) -> None:
    """Heights such as "913,001" alone would be groups of thousands; eastings and northings are not."""
    rows = [f'{name},"{e:.3f}","{n:.3f}","{h:.3f}"' for name, (e, n, h) in POINTS.items()]
    text = "\n".join(["name,E,N,Z", *(row.replace(".", ",") for row in rows)]) + "\n"
    (folder / "p.csv").write_text(text)
    new(photocal, folder)
    for name, place in control(folder).items():
        assert place == pytest.approx(POINTS[name], abs=1e-3)


def test_survey_feet_are_known_by_their_name(folder: Path, photocal: Photocal) -> None:
    foot = 1200 / 3937
    heads = ",".join(f"{axis} (US survey ft)" for axis in ("Easting", "Northing", "Elevation"))
    rows = [",".join([name, *(f"{v / foot:.5f}" for v in place)]) for name, place in POINTS.items()]
    (folder / "p.csv").write_text("\n".join([f"name,{heads}", *rows]) + "\n")
    new(photocal, folder)
    for name, place in control(folder).items():
        assert place == pytest.approx(POINTS[name], abs=1e-3)


@pytest.mark.parametrize(
    ("head", "control_word", "check_word"),
    [
        ("Classe", "Controle", "Checagem"),
        ("Função", "Ponto de apoio", "Ponto de verificação"),
        ("Art", "Passpunkt", "Kontrollpunkt"),
        ("Kind", "GCP", "CP"),
        ("Role", "Ground control", "Independent check points"),
    ],
)
def test_roles_are_known_by_their_words(
    folder: Path, photocal: Photocal, head: str, control_word: str, check_word: str
) -> None:
    words = {name: check_word if name == "G3" else control_word for name in POINTS}
    rows = [f"{name},{e},{n},{h},{words[name]}" for name, (e, n, h) in POINTS.items()]
    (folder / "p.csv").write_text("\n".join([f"name,E,N,Z,{head}", *rows]) + "\n", encoding="utf-8")
    found = new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as made:
        assert {row["point"] for row in csv.DictReader(made) if row["role"] == "check"} == {"G3"}
    assert not any("neither control nor check" in line for line in found["doubtful"])


def test_a_file_of_check_points_alone_has_no_control(folder: Path, photocal: Photocal) -> None:
    (folder / "check points.csv").write_text(table("name,E,N,Z", "{p},{E},{N},{Z}"))
    found = new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as made:
        assert {row["role"] for row in csv.DictReader(made)} == {"check"}
    assert "all points are check points: none places the block" in found["missing"]


@pytest.mark.parametrize("nothing", ["", "-", "n/a", "sem"])
def test_a_point_without_height_holds_the_plane(folder: Path, photocal: Photocal, nothing: str) -> None:
    text = table("name,E,N,Z,role", "{p},{E},{N},{Z},", below=f"G5,677850,7184270,{nothing},\n")
    (folder / "p.csv").write_text(text + f"G6,677851,7184280,{nothing},check\n")
    found = new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as made:
        rows = {row["point"]: row for row in csv.DictReader(made)}
    assert set(rows) == {*POINTS, "G5"}
    assert (float(rows["G5"]["sX"]), rows["G5"]["sZ"]) == (0.02, "")
    assert "points without height: G5; used in plan only" in found["doubtful"]
    assert any("Z of G6 is empty" in line for line in found["missing"] + found["doubtful"])


def test_names_that_differ_in_capitals_only_are_told(folder: Path, photocal: Photocal) -> None:
    text = table("name,E,N,Z", "{p},{E},{N},{Z}", below="g1,677868,7184231,912\n")
    (folder / "p.csv").write_text(text)
    assert any("G1 and g1 differ in capitals only" in line for line in new(photocal, folder)["doubtful"])


@pytest.mark.parametrize(
    "heads", ["Horizontal accuracy,Vertical accuracy", "HRMS (m),VRMS (m)", "Lateral RMS,Elevation RMS"]
)
def test_sigmas_of_the_plane_in_one_column(folder: Path, photocal: Photocal, heads: str) -> None:
    (folder / "p.csv").write_text(table(f"name,E,N,Z,{heads}", "{p},{E},{N},{Z},0.011,0.019"))
    new(photocal, folder)
    with (folder / "control.csv").open(encoding="utf-8") as made:
        assert {(row["sX"], row["sY"], row["sZ"]) for row in csv.DictReader(made)} == {
            ("0.0110", "0.0110", "0.0190")
        }


@pytest.mark.parametrize(
    ("file", "system", "crs", "said"),
    [
        ("survey.prj", "EPSG:31982", "EPSG:31982", "(SIRGAS 2000 / UTM zone 22S), by survey.prj"),
        ("SURVEY.QPJ", "EPSG:31982", "EPSG:31982", "by SURVEY.QPJ"),
        ("survey.prj", "EPSG:4674", "EPSG:32722", "in degrees; the coordinates of survey.csv are not"),
        ("survey.prj", "", "EPSG:32722", "survey.prj names no coordinate system that is known"),
        ("area.prj", "EPSG:31983", "EPSG:32722", ""),
    ],
)
def test_the_system_beside_a_table_is_taken(
    folder: Path, photocal: Photocal, file: str, system: str, crs: str, said: str
) -> None:
    (folder / "survey.csv").write_text(table("Name,E,N,Z", "{p},{E},{N},{Z}"))
    (folder / file).write_text(CRS(system).to_wkt("WKT1_ESRI") if system else "no system")
    found = new(photocal, folder)
    assert key(folder, "crs") == crs
    assert control(folder) == POINTS
    assert any(line.endswith(said) for line in found["found"] + found["missing"])


@pytest.mark.parametrize("placed", [True, False])
@pytest.mark.parametrize(
    ("head", "turned", "said"),
    [
        ("name,X,Y,Z", True, "north comes before east in survey.csv"),
        ("name,E,N,Z", False, "E and N of the"),
    ],
)
def test_north_before_east_is_seen(
    tmp_path: Path, photocal: Photocal, head: str, placed: bool, turned: bool, said: str
) -> None:
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", 20.0 * k if placed else None)
    (tmp_path / "survey.csv").write_text(table(head, "{p},{N},{E},{Z}"))
    found = new(photocal, tmp_path, "--crs", "EPSG:31982")
    order = (0, 1, 2) if turned else (1, 0, 2)
    assert control(tmp_path) == {name: tuple(place[k] for k in order) for name, place in POINTS.items()}
    (line,) = (one for one in found["found"] + found["doubtful"] if said in one)
    assert turned or "exchanged" in line


def test_degrees_are_in_the_datum_beside_the_table(folder: Path, photocal: Photocal) -> None:
    (folder / "survey.csv").write_text(table("Name,lat,lon,h ell", "{p},{lat},{lon},{Z}"))
    (folder / "survey.prj").write_text(CRS("EPSG:4618").to_wkt("WKT1_ESRI"))
    new(photocal, folder)
    # SAD69 lies some 70 m from WGS 84 in Brazil.
    away = [np.hypot(*np.subtract(place[:2], POINTS[name][:2])) for name, place in control(folder).items()]
    assert all(50 < metres < 90 for metres in away)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("G5,677850,,912", "line 6: Y of G5 is empty"),
        ("G5,677850,about 7184270,912", "Y of G5 is 'about 7184270', not a number as in the other rows"),
        (",677850,7184270,912", "line 6: the point has no name"),
        ("Average,677850,7184270,912", "line 6: Average is computed from the other rows"),
        ("G1,677850,7184270,912", "line 6: G1 is listed twice, with other coordinates before"),
    ],
)  # fmt: skip
def test_a_row_that_is_no_point_is_named_and_costs_nothing_else(
    folder: Path, photocal: Photocal, row: str, said: str
) -> None:
    (folder / "p.csv").write_text(table("name,E,N,Z", "{p},{E},{N},{Z}", below=f"{row}\n"))
    found = new(photocal, folder)
    assert control(folder) == POINTS
    (left,) = (line for line in found["missing"] + found["doubtful"] if "not used" in line)
    assert left.endswith(said)


def test_rows_that_are_no_points_are_named_in_portuguese(folder: Path, photocal: Photocal) -> None:
    text = table("name,E,N,Z", "{p},{E},{N},{Z}", below="G1,1,2,3\nG5,1,,2\nSoma,1,2,3\n")
    (folder / "p.csv").write_text(text)
    found = new(photocal, folder, "--lang", "pt-BR")
    left = [line.split(": ", 2)[2] for line in found["missing"] + found["doubtful"] if "não usado" in line]
    assert sorted(left) == [
        "G1 aparece duas vezes, antes com outras coordenadas",
        "Soma é calculado a partir das outras linhas",
        "falta Y de G5",
    ]


@pytest.mark.parametrize(
    ("name", "head"), [("marks.txt", "Filename,GCP Label,PixelX,PixelY"), ("marks.csv", "image,point,x,y")]
)
def test_marks_as_fractions_become_pixels(folder: Path, photocal: Photocal, name: str, head: str) -> None:
    """Pictures have 160 by 120 pixels; the middle of the first pixel is (0, 0)."""
    (folder / "points.csv").write_text(table("name,E,N,Z", "{p},{E},{N},{Z}"))
    (folder / name).write_text(f"{head}\na0.jpg,G1,0.5,0.25\na1.jpg,G1,0.625,0.75\na0.jpg,G2,0.125,0.5\n")
    found = new(photocal, folder)
    written = "marks.csv" if name != "marks.csv" else "read-marks.csv"
    assert [(mark.image, mark.x, mark.y) for mark in read_marks(folder / written)] == [
        ("a0.jpg", 79.5, 29.5),
        ("a1.jpg", 99.5, 89.5),
        ("a0.jpg", 19.5, 59.5),
    ]
    assert any("between 0 and 1, taken as fractions of width and height" in line for line in found["found"])


def test_a_list_of_odm_may_be_a_spreadsheet(folder: Path, photocal: Photocal) -> None:
    rows = [
        f"{e},{n},{h},{20 + k}.5,30.5,a{k % 3}.jpg,{p}" for k, (p, (e, n, h)) in enumerate(POINTS.items())
    ]
    (folder / "gcp_list.csv").write_text("\n".join(["EPSG:31982,,,,,,", *rows]) + "\n")
    found = new(photocal, folder)
    assert control(folder) == POINTS
    assert key(folder, "crs") == "EPSG:31982"
    assert any("4 marks in 3 images" in line for line in found["found"])


def test_markers_without_a_reference_are_in_the_zone_of_the_pictures(
    folder: Path, photocal: Photocal
) -> None:
    """They were taken for a local system, in which the pictures' positions count for nothing."""
    places = {name: 'x="{}" y="{}" z="{}"'.format(*place) for name, place in POINTS.items()}
    markers = "".join(
        f'<marker id="{k}" label="{name}"><reference {place} enabled="true"/></marker>'
        for k, (name, place) in enumerate(places.items())
    )
    seen = "".join(
        f'<marker marker_id="{k}"><location camera_id="0" pinned="true" x="{20 + k}" y="30"/></marker>'
        for k in range(len(places))
    )
    (folder / "markers.xml").write_text(
        f'<document><chunk><cameras><camera id="0" label="a0"/></cameras><markers>{markers}</markers>'
        f'<frames><frame id="0"><markers>{seen}</markers></frame></frames></chunk></document>'
    )
    new(photocal, folder)
    assert control(folder) == POINTS
    assert key(folder, "crs") == "EPSG:32722"


def test_results_of_mmvii_are_called_so(folder: Path, photocal: Photocal) -> None:
    (folder / "Ori").mkdir()
    pose = '<CameraPose><NameImage>"a0.jpg"</NameImage></CameraPose>'
    written = f'<Root><Type>"MMVII_Serialization"</Type><Data>{pose}</Data></Root>'
    (folder / "Ori" / "Ori-PerspCentral-a0.jpg.xml").write_text(written)
    found = new(photocal, folder)
    (left,) = (line for line in found["missing"] if "not used" in line)
    assert "Ori has results of MMVII, which are not observations" in left
    said = photocal("adopt", folder, "-o", folder / "out")
    assert said.code != 0
    assert "has orientations of MMVII, whose form is not read" in said.err


@pytest.mark.parametrize(
    ("heads", "longitude"),
    [("Punkt;Länge;Breite;Höhe", 13.4), ("Ponto;Longitude;Latitude;Altitude", -13.4)],
)
def test_o_is_east_in_german_and_west_in_portuguese(heads: str, longitude: float, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"{heads}\nA;13°24'00\" O;52°30'00\" N;34,5\n", encoding="utf-8")
    _, (place,), _ = read_places(path, HEADS, (), catalogue("en"), degrees=True)
    assert place == pytest.approx([longitude, 52.5, 34.5])
