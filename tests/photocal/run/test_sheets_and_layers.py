"""Control in spreadsheets, shapefiles and GeoPackages beside the pictures, by `photocal new`."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest

from tests.photocal.run.test_control_tables import POINTS, TO_DEGREES, control, folder, new
from tests.photocal.run.test_exported_tables import Photocal

__all__ = ["folder"]
HEADS = ("Ponto", "Este (m)", "Norte (m)", "Altitude ortométrica (m)")
ROWS: list[Row] = [(name, *place) for name, place in POINTS.items()]
OFFICE = "http://schemas.openxmlformats.org"
Row = Sequence[str | float]
Cells = Sequence[Row]


def workbook(path: Path, sheets: Mapping[str, Cells]) -> None:
    """Write sheets as ECMA-376 has them, texts in their cells."""

    def cell(name: str, value: str | float) -> str:
        if isinstance(value, str):
            return f'<c r="{name}" t="inlineStr"><is><t>{escape(value)}</t></is></c>'
        return f'<c r="{name}"><v>{value!r}</v></c>'

    types = f"{OFFICE}/officeDocument/2006/relationships"
    main = f"{OFFICE}/spreadsheetml/2006/main"
    number = {name: k for k, name in enumerate(sheets, start=1)}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{OFFICE}/package/2006/content-types"><Default Extension="rels" '
            'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="xml"'
            ' ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"/>'
            '<Override PartName="/xl/workbook.xml" ContentType='
            '"application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/></Types>',
        )
        relations = f'<Relationships xmlns="{OFFICE}/package/2006/relationships">'
        archive.writestr(
            "_rels/.rels",
            f'{relations}<Relationship Id="r" Type="{types}/officeDocument" Target="xl/workbook.xml"/>'
            "</Relationships>",
        )
        listed = (f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for name, k in number.items())
        archive.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{main}" xmlns:r="{types}"><sheets>{"".join(listed)}</sheets></workbook>',
        )
        targets = (
            f'<Relationship Id="r{k}" Type="{types}/worksheet" Target="worksheets/sheet{k}.xml"/>'
            for k in number.values()
        )
        archive.writestr("xl/_rels/workbook.xml.rels", f"{relations}{''.join(targets)}</Relationships>")
        for name, k in number.items():
            rows = (
                f'<row r="{r}">'
                + "".join(cell(f"{'ABCDEFGH'[c]}{r}", v) for c, v in enumerate(row))
                + "</row>"
                for r, row in enumerate(sheets[name], start=1)
            )
            archive.writestr(
                f"xl/worksheets/sheet{k}.xml",
                f'<worksheet xmlns="{main}"><sheetData>{"".join(rows)}</sheetData></worksheet>',
            )


def layer(
    path: Path,
    places: Sequence[Sequence[float]],
    fields: Mapping[str, Sequence[str | float]],
    crs: str = "EPSG:32722",
    **options: object,
) -> None:
    """Write points in the well-known binary form, with heights if there are any."""
    import pyogrio  # type: ignore[import-untyped]

    kind = "Point Z" if len(places[0]) > 2 else "Point"
    head = struct.pack("<BI", 1, 1001 if kind == "Point Z" else 1)
    pyogrio.raw.write(
        path,
        np.array([head + struct.pack(f"<{len(place)}d", *place) for place in places], dtype=object),
        [np.array(v, dtype=object if isinstance(v[0], str) else float) for v in fields.values()],
        np.array(list(fields), dtype=object),
        geometry_type=kind,
        crs=crs,
        driver={".shp": "ESRI Shapefile", ".gpkg": "GPKG", ".geojson": "GeoJSON"}[path.suffix],
        **options,
    )


PLACES, NAMES = list(POINTS.values()), list(POINTS)
DEGREES = [(*TO_DEGREES.transform(*place[:2]), place[2]) for place in PLACES]


def with_commas(row: Row) -> list[str]:
    return [v if isinstance(v, str) else f"{v:.3f}".replace(".", ",") for v in row]


KINDS: dict[str, Callable[[Path], None]] = {
    "sheet": lambda at: workbook(at / "gcp.xlsx", {"Plan1": [HEADS, *ROWS]}),
    "titles": lambda at: workbook(
        at / "x.xlsx", {"Info": [["feito por", "Ana"]], "Pontos": [["Fazenda"], [], HEADS, *ROWS]}
    ),
    "texts": lambda at: workbook(at / "x.xlsx", {"P": [HEADS, *map(with_commas, ROWS)]}),
    "shapefile": lambda at: layer(at / "pts.shp", PLACES, {"nome": NAMES}),
    "heights as attribute": lambda at: layer(
        at / "pts.shp", [p[:2] for p in PLACES], {"nome": NAMES, "cota": [p[2] for p in PLACES]}
    ),
    "heights of zero": lambda at: layer(
        at / "pts.gpkg", [(*p[:2], 0.0) for p in PLACES], {"nome": NAMES, "cota": [p[2] for p in PLACES]}
    ),
    "degrees": lambda at: layer(at / "pts.geojson", DEGREES, {"name": NAMES}, "EPSG:4326"),
    # An attribute of the same name as ours is not the height of the point.
    "z of another kind": lambda at: layer(at / "p.shp", PLACES, {"nome": NAMES, "z": [1.0] * 4}),
    # What attributes say of the place may be in any system.
    "attributes": lambda at: layer(
        at / "p.gpkg", DEGREES, {"id": NAMES, "E": [1.0] * 4, "N": [2.0] * 4}, "EPSG:4326"
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_sheets_and_layers_are_read(folder: Path, photocal: Photocal, kind: str) -> None:
    KINDS[kind](folder)
    found = new(photocal, folder, "--height", "orthometric")
    assert not any("not used" in line for line in found["missing"])
    read = control(folder)
    assert list(read) == NAMES
    # Degrees have nine decimals in GeoJSON and go through UTM: a tenth of a millimetre.
    assert np.array(list(read.values())) == pytest.approx(np.array(PLACES), abs=2e-4)


def test_check_points_have_a_sheet_of_their_own(folder: Path, photocal: Photocal) -> None:
    workbook(folder / "p.xlsx", {"Checagem": [HEADS, *ROWS[3:]], "Apoio": [HEADS, *ROWS[:3]]})
    new(photocal, folder)
    rows = (folder / "control.csv").read_text(encoding="utf-8").splitlines()
    assert [row.split(",")[-1] for row in rows[1:]] == ["control"] * 3 + ["check"]


def test_a_file_of_check_points_that_comes_first_loses_no_control(folder: Path, photocal: Photocal) -> None:
    for name, some in (("checks.csv", ROWS[3:]), ("gcp.csv", ROWS[:3])):
        text = "\n".join(",".join(map(str, row)) for row in some)
        (folder / name).write_text(f"name,E,N,Z\n{text}\n")
    new(photocal, folder)
    rows = (folder / "control.csv").read_text(encoding="utf-8").splitlines()
    assert [row.split(",")[-1] for row in rows[1:]] == ["control"] * 3 + ["check"]


def test_marks_may_stand_in_another_sheet(folder: Path, photocal: Photocal) -> None:
    marks: Cells = [("image", "point", "x", "y"), ("a0.jpg", "G1", 10.5, 12.25), ("a1.jpg", "G1", 20.0, 13.0)]
    workbook(folder / "p.xlsx", {"pontos": [HEADS, *ROWS], "marcas": marks})
    new(photocal, folder)
    rows = (folder / "marks.csv").read_text(encoding="utf-8").splitlines()
    assert rows[1].split(",")[:4] == ["a0.jpg", "G1", "10.500", "12.250"]
    assert len(rows) == 3


def test_a_row_that_is_no_point_is_named_by_its_row_in_the_sheet(folder: Path, photocal: Photocal) -> None:
    bad = ("G3", ROWS[2][1], "?", ROWS[2][3])
    workbook(folder / "p.xlsx", {"P": [["Fazenda"], HEADS, *ROWS[:2], bad, ROWS[3]]})
    found = new(photocal, folder)
    assert list(control(folder)) == ["G1", "G2", "G4"]
    assert any("p.xlsx, row 5: Y of G3 is '?'" in line for line in found["missing"])


def no_shape(at: Path) -> None:
    layer(at / "gcp.shp", PLACES, {"nome": NAMES})
    (at / "gcp.shx").unlink()


def swollen(at: Path) -> None:
    """A workbook of some kilobytes whose sheet unpacks to far more than any list of control."""
    workbook(at / "p.xlsx", {"P": [HEADS, *ROWS]})
    with zipfile.ZipFile(at / "p.xlsx", "a", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/worksheets/sheet9.xml", bytes(70_000_000))


REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "no names": (lambda at: layer(at / "p.shp", PLACES, {"what": NAMES}), "names of the points"),
    "no heights": (lambda at: layer(at / "p.shp", [p[:2] for p in PLACES], {"nome": NAMES}), "no column Z"),
    "damaged": (lambda at: (at / "p.xlsx").write_bytes(b"PK\x03\x04" + bytes(99)), "that can be read"),
    "swollen": (swollen, "more than 64 MB of rows"),
    "notes": (lambda at: workbook(at / "p.xlsx", {"P": [["feito por", "Ana"]]}), "has no table"),
    "a part": (no_shape, "copy all its files again"),
    "drawing": (lambda at: (at / "p.dxf").write_text("0\nEOF\n"), "export them as CSV with the columns name"),
    "land": (
        lambda at: (at / "gcp.xml").write_text("<LandXML><CgPoints/></LandXML>"),
        "export points as CSV (name, east, north, height)",
    ),
    # N heads norths, no numbers.
    "table": (
        lambda at: (at / "gcp.csv").write_text("E,N,Z,what\n677864.1,7184231.4,912.4,G1\n"),
        "names of the points",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_has_no_points_that_can_be_used_is_named(folder: Path, photocal: Photocal, kind: str) -> None:
    make, said = REFUSED[kind]
    make(folder)
    found = new(photocal, folder)
    assert any("not used" in line and said in line for line in found["missing"])
    assert not (folder / "control.csv").exists()
