"""Field forms: every sheet in both languages, read back from the PDF, with the places of a plan."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.commands.cli import app
from photocal.findings.document import KeyValues, PicturePart, TablePart
from photocal.findings.texts import catalogue
from photocal.report.ministry_rows import FORMS, ROLLS_DEG, field_forms, planned_places


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    def place(kind: str, name: str, lon: float, lat: float) -> dict[str, object]:
        geometry = {"type": "Point", "coordinates": [lon, lat]}
        return {"type": "Feature", "geometry": geometry, "properties": {"kind": kind, "name": name}}

    line = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": []},
        "properties": {"kind": "strip"},
    }
    path = tmp_path / "plan.geojson"
    features = [line, place("control", "CO01", -51.2938, -28.8531), place("check", "CH01", -51.29, -28.85)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    return path


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_a_station_sheet_for_each_point_and_a_row_in_the_list(plan: Path, language: str) -> None:
    say = catalogue(language)
    sheets = field_forms(FORMS, planned_places(plan), say).sections
    assert len(sheets) == 2 + 4
    assert sheets[0].title.endswith("CO01")
    known = next(piece for piece in sheets[0].pieces if isinstance(piece, KeyValues)).rows
    assert [value for _, value in known[:4]][1:] == [
        say("forms.control"),
        say.fixed(-28.8531, 7),
        say.fixed(-51.2938, 7),
    ]
    assert all(value == "" for _, value in known[4:])
    assert any(isinstance(piece, PicturePart) for piece in sheets[0].pieces)
    targets = next(piece for piece in sheets[3].pieces if isinstance(piece, TablePart))
    assert [row[0] for row in targets.rows] == ["CO01", "CH01"]
    pictures = next(piece for piece in sheets[4].pieces if isinstance(piece, TablePart))
    assert len(pictures.rows) == 3 * len(ROLLS_DEG)
    for sheet in sheets:
        for piece in sheet.pieces:
            if isinstance(piece, TablePart):
                assert {len(row) for row in piece.rows} == {len(piece.columns)}


def test_the_command_sets_one_page_for_each_sheet(plan: Path, tmp_path: Path) -> None:
    pdf = tmp_path / "forms.pdf"
    done = CliRunner().invoke(
        app, ["forms", "-o", str(pdf), "--plan", str(plan), "--language", "pt-BR", "--json"]
    )
    assert done.exit_code == 0
    assert [title.split()[0] for title in json.loads(done.stdout)["sheets"]] == [
        "Estação",
        "Estação",
        "Registro",
        "Alvos",
    ]
    if shutil.which("pdftotext") is None:
        pytest.skip("needs poppler-utils")
    read = subprocess.run(["pdftotext", "-layout", pdf, "-"], check=True, capture_output=True)
    text = read.stdout.decode("utf-8")
    assert text.count("\f") == 4
    assert "−28,8531000" in text
    assert "Umidade" not in text


def test_what_is_no_form_and_no_plan(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="choose among station"):
        field_forms(["stations"], (), catalogue("en"))
    path = tmp_path / "plan.json"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(InputMalformedError, match=r"plan\.geojson"):
        planned_places(path)
