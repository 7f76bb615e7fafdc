"""Slips that people make in control lists, by `photocal new`: taken as they are meant, or named by line."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pyproj import Transformer

from photocal.measurement.marks import read_marks
from tests.photocal.conftest import Answer
from tests.photocal.run.test_control_tables import control, sexagesimal
from tests.photocal.run.typed_site import CRS, Row, site_folder

Photocal = Callable[..., Answer]
Rows = Sequence[Row]
TO_DEGREES = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
CORNER = 0.5


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight, rendered once."""
    return tmp_path_factory.mktemp("rendered")


def new(photocal: Photocal, folder: Path, *more: str) -> dict[str, Any]:
    said = photocal("new", folder, "--json", "--crs", CRS, *more)
    assert said.code == 0, said.err
    return dict(json.loads(said.out))


def points(rows: Rows) -> dict[str, tuple[float, float, float]]:
    return {row.name: row.place for row in rows}


def comma(value: float) -> str:
    return f"{value:.3f}".replace(".", ",")


def places(rows: Rows, head: str, line: str, *, decimal: str = ".") -> str:
    """A table of the points; n, e, u and the degrees in the line."""
    lines = [head]
    for name, (east, north, up) in points(rows).items():
        longitude, latitude = TO_DEGREES.transform(east, north)
        cells = {"e": f"{east:.3f}", "n": f"{north:.3f}", "u": f"{up:.3f}"}
        cells = {key: cell.replace(".", decimal) for key, cell in cells.items()}
        degrees = {"lat": sexagesimal(latitude, "N", "S"), "lon": sexagesimal(longitude, "E", "W")}
        lines.append(line.format(p=name, **cells, **degrees))
    return "\n".join(lines) + "\n"


def shown(rows: Rows, head: str = "", between: str = ",", decimal: str = ".", half: float = CORNER) -> str:
    """A table of the marks; of other programs pixels count from the corner."""
    cells = (
        (row.image, row.name, *(f"{v + half:.2f}".replace(".", decimal) for v in (row.x, row.y)))
        for row in rows
    )
    return head + "\n".join(between.join(row) for row in cells) + "\n"


PLAIN = ("points.csv", "name,E,N,Z", "{p},{e},{n},{u}")
# Files with their encodings, and their texts.
TABLES: dict[str, Callable[[Rows], dict[tuple[str, str], str]]] = {
    "one table, semicolons and decimal commas": lambda rows: {
        ("pontos.csv", "utf-8"): "Ponto;Este;Norte;Cota;Coluna;Linha;Imagem\n"
        + "".join(
            ";".join([r.name, *map(comma, (*r.place, r.x + CORNER, r.y + CORNER)), r.image]) + "\n"
            for r in rows
        )
    },
    "degrees, minutes, seconds beside a system": lambda rows: {
        ("points.csv", "utf-8"): places(rows, "Name;Latitude;Longitude;Height", "{p};{lat};{lon};{u}"),
        ("marks.csv", "utf-8"): shown(rows, "image,point,x,y\n", half=0.0),
    },
    "Poland, X to the north, Windows letters": lambda rows: {
        ("osnowa.csv", "cp1250"): places(
            rows, "Nr punktu;X (północ);Y (wschód);H", "{p};{n};{e};{u}", decimal=","
        ),
        ("pomiar.csv", "cp1250"): shown(rows, "zdjęcie;punkt;x;y\n", ";", ","),
    },
    "France, Windows letters": lambda rows: {
        ("points.csv", "cp1252"): places(rows, "N° point;Est;Nord;Altitude", "{p};{e};{n};{u}", decimal=","),
        ("mesures.csv", "cp1252"): shown(rows, "Cliché;Point;Colonne;Ligne\n", ";", ","),
    },
    "Brazil": lambda rows: {
        ("apoio.csv", "cp1252"): places(
            rows, "Ponto;Coord. E;Coord. N;Altitude", "{p};{e};{n};{u}", decimal=","
        ),
        ("medidas.csv", "cp1252"): shown(rows, "Foto;Ponto;Coluna;Linha\n", ";", ","),
    },
    "two texts without heads": lambda rows: {
        ("coords.txt", "utf-8"): places(rows, "", "{p} {e} {n} {u}").lstrip(),
        ("marks.txt", "utf-8"): shown(rows, between=" "),
    },
    "points before pictures": lambda rows: {
        ("coords.txt", "utf-8"): places(rows, "", "{p} {e} {n} {u}").lstrip(),
        ("marks.txt", "utf-8"): shown(
            [replace(row, image=row.name, name=row.image) for row in rows], between=" "
        ),
    },
    "blanks behind names": lambda rows: {
        ("points.csv", "utf-8"): places(rows, "name,E,N,Z", "{p}  ,{e},{n},{u}"),
        ("marks.csv", "utf-8"): shown(
            [replace(row, image=f"{row.image} ", name=f" {row.name}") for row in rows],
            "image,point,x,y\n",
            half=0.0,
        ),
    },
    "small and large letters": lambda rows: {
        ("points.csv", "utf-8"): places(rows, *PLAIN[1:]),
        ("marks.csv", "utf-8"): shown(
            [replace(row, image=row.image.upper(), name=row.name.lower()) for row in rows],
            "image,point,x,y\n",
            half=0.0,
        ),
    },
    "mark, returns, and the end of a text of DOS": lambda rows: {
        ("gcp_list.txt", "utf-8-sig"): "\r\n".join([CRS, *(row.text() for row in rows)]) + "\r\n\x1a"
    },
}


def made(pictures: Path, folder: Path, files: Callable[[Rows], dict[tuple[str, str], str]]) -> list[Row]:
    """Make a folder with such tables, and give the rows that are meant."""
    typed = site_folder(pictures, folder)
    (folder / "gcp_list.txt").unlink()
    for (name, encoding), text in files(typed).items():
        (folder / name).write_bytes(text.encode(encoding))
    return typed


@pytest.mark.parametrize("kind", list(TABLES))
def test_a_list_is_taken_as_it_is_meant(
    pictures: Path, tmp_path: Path, photocal: Photocal, kind: str
) -> None:
    """Expected: the places and the marks that were typed, and no doubt."""
    meant = made(pictures, tmp_path / "f", TABLES[kind])
    found = new(photocal, tmp_path / "f")
    assert (found["asked"], found["doubtful"]) == ([], [])
    for name, place in points(meant).items():
        assert control(tmp_path / "f")[name] == pytest.approx(place, abs=0.002)
    read = "read-marks.csv" if "marks.csv" in {name for name, _ in TABLES[kind](meant)} else "marks.csv"
    marks = {(mark.image, mark.point): (mark.x, mark.y) for mark in read_marks(tmp_path / "f" / read)}
    assert len(marks) == len(meant)
    for row in meant:
        assert marks[row.image, row.name] == pytest.approx((row.x, row.y), abs=0.011)


def lacking(rows: Rows) -> dict[tuple[str, str], str]:
    """Heights of two points are empty."""
    text = places(rows, *PLAIN[1:])
    for name in ("G2", "G5"):
        line = next(line for line in text.splitlines() if line.startswith(name))
        text = text.replace(line, line.rpartition(",")[0] + ",")
    return {("points.csv", "utf-8"): text, ("marks.csv", "utf-8"): shown(rows, "image,point,x,y\n", half=0.0)}


def twofold(rows: Rows) -> dict[tuple[str, str], str]:
    """Each point is control, the first one check as well."""
    text = places(rows, "name,E,N,Z,role", "{p},{e},{n},{u},control")
    again = text.splitlines()[1].replace("control", "check")
    marks = shown(rows, "image,point,x,y\n", half=0.0)
    return {("points.csv", "utf-8"): f"{text}{again}\n", ("marks.csv", "utf-8"): marks}


def zeros(rows: Rows) -> dict[tuple[str, str], str]:
    """Two heights are written as 0."""
    none = [replace(r, place=(*r.place[:2], 0.0)) if r.name in ("G2", "G5") else r for r in rows]
    return {("gcp_list.txt", "utf-8"): "\n".join([CRS, *(row.text() for row in none)]) + "\n"}


def stray(rows: Rows) -> dict[tuple[str, str], str]:
    """Marks of a point that nobody has surveyed."""
    more = [*rows, replace(rows[0], name="G99")]
    return {
        ("points.csv", "utf-8"): places(rows, *PLAIN[1:]),
        ("marks.csv", "utf-8"): shown(more, "image,point,x,y\n", half=0.0),
    }


def dashes(rows: Rows) -> dict[tuple[str, str], str]:
    """A height is a dash."""
    lines = [row.text().replace(" 110.004 ", " - ") for row in rows]
    return {("gcp_list.txt", "utf-8"): "\n".join([CRS, *lines]) + "\n"}


def misspelled(rows: Rows) -> dict[tuple[str, str], str]:
    """The role of a point is no word of ours."""
    text = places(rows, "name,E,N,Z,role", "{p},{e},{n},{u},control").splitlines()
    text[2] = text[2].replace("control", "chekc")
    marks = shown(rows, "image,point,x,y\n", half=0.0)
    return {("points.csv", "utf-8"): "\n".join(text) + "\n", ("marks.csv", "utf-8"): marks}


def contradicting(rows: Rows) -> dict[tuple[str, str], str]:
    """A table beside the list has another place of a point."""
    moved = [replace(r, place=(r.place[0] + 3, *r.place[1:])) if r.name == "G3" else r for r in rows]
    listed = "\n".join([CRS, *(row.text() for row in rows)]) + "\n"
    return {("gcp_list.txt", "utf-8"): listed, ("points.csv", "utf-8"): places(moved, *PLAIN[1:])}


def spreadsheet(_: Rows) -> dict[tuple[str, str], str]:
    """Points in a file of a spreadsheet."""
    return {("pontos.xlsx", "utf-8"): "PK"}


@pytest.mark.parametrize(
    ("files", "english", "portuguese"),
    [
        (
            misspelled,
            "points.csv, line 3: the role 'chekc' is neither control nor check",
            "points.csv, line 3: a função 'chekc' não é control nem check",
        ),
        (
            contradicting,
            "points.csv has other places of G3 than gcp_list.txt",
            "points.csv tem coordenadas de G3 diferentes das de gcp_list.txt",
        ),
        (
            spreadsheet,
            "pontos.xlsx: has no sheet and no layer that can be",
            "pontos.xlsx: não tem planilha nem",
        ),
        (lacking, "points without height: G2, G5; used in plan only", "sem altitude: G2, G5; usados só em"),
        (
            twofold,
            "points.csv, line 8: G1 is listed twice, as control point and as check point",
            "points.csv, line 8: G1 aparece duas vezes, como ponto de apoio e como ponto de verificação",
        ),
        (
            zeros,
            "the height of G5 is 0, those of the others are about 110.0",
            "a altitude de G5 é 0, as dos outros são de cerca de 110,0",
        ),
        (stray, "marked, but without coordinates: G99", "com marcas, mas sem coordenadas: G99"),
        (
            dashes,
            "gcp_list.txt, line 8: ground point is '-', not a number",
            "line 8: o ponto de apoio tem '-', que não",
        ),
    ],
)
def test_a_slip_is_named(
    pictures: Path,
    tmp_path: Path,
    photocal: Photocal,
    files: Callable[[Rows], dict[tuple[str, str], str]],
    english: str,
    portuguese: str,
) -> None:
    for k, (more, said) in enumerate((((), english), (("--lang", "pt-BR"), portuguese))):
        made(pictures, tmp_path / str(k), files)
        found = new(photocal, tmp_path / str(k), *more)
        assert any(said in line for line in (*found["doubtful"], *found["missing"])), found


def test_the_system_may_stand_in_a_comment(pictures: Path, tmp_path: Path, photocal: Photocal) -> None:
    site_folder(pictures, tmp_path / "f", first=f"# {CRS}")
    assert photocal("new", tmp_path / "f").code == 0
    assert f'crs = "{CRS}"' in (tmp_path / "f/project.toml").read_text()


@pytest.mark.parametrize("named", [False, True], ids=["names", "folders and names"])
def test_names_that_two_folders_have(
    pictures: Path, tmp_path: Path, photocal: Photocal, *, named: bool
) -> None:
    """Two flights of one camera: the marks of the other are not put into the pictures of one."""
    folder = tmp_path / "f"
    meant = site_folder(pictures, folder)
    called = {}
    for k, path in enumerate(sorted((folder / "images").glob("*.jpg"))):
        there = Path("ab"[k // 4], f"DJI_{k % 4:04}.jpg")
        (folder / "images" / there).parent.mkdir(exist_ok=True)
        path.rename(folder / "images" / there)
        called[path.name] = there.as_posix()
    listed = [replace(row, image=called[row.image] if named else called[row.image][2:]) for row in meant]
    (folder / "gcp_list.txt").write_text("\n".join([CRS, *(row.text() for row in listed)]) + "\n")
    found = new(photocal, folder)
    assert any(line == "4 pictures in images/b: not used" for line in found["found"])
    told = " ".join(found["doubtful"])
    assert ("pictures of the same names lie in a and in b" in told) is not named
    if named:
        assert "4 pictures of 8 not in the folder: b/" in told
        marks = {(mark.image, mark.point): mark.x for mark in read_marks(folder / "marks.csv")}
        of_a = {
            (called[row.image][2:], row.name): row.x for row in meant if called[row.image].startswith("a")
        }
        assert marks == pytest.approx(of_a, abs=0.011)
