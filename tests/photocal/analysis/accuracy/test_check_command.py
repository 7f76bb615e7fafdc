from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.commands.cli import app, main

TABLE = "point,E,N,dE_cm,dN_cm,dh_cm\n" + "".join(
    f"P{i},{457000 + 100 * (i % 4)},{7553000 + 120 * (i // 4)},"
    f"{(-1) ** i * 2 + i % 3},{i % 5 - 2},{20 + i % 4}\n"
    for i in range(12)
)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "check.csv"
    path.write_text(TABLE, encoding="utf-8")
    return path


def test_text_and_json_say_the_same(table: Path) -> None:
    arguments = ["check", "--discrepancies", str(table), "--scale", "1:1000", "--interval", "1"]
    text = CliRunner().invoke(app, arguments)
    figures = CliRunner().invoke(app, [*arguments, "--json"])
    assert text.exit_code == figures.exit_code == 0
    content = json.loads(figures.stdout)
    assert content["schema"] == "photocal.check/2"
    assert content["sign"] == "product minus reference"
    assert content["components"]["h"]["mean_m"] == pytest.approx(-0.215)
    assert content["components"]["h"]["correction_m"] == pytest.approx(0.215)
    assert content["components"]["h"]["bias_test"]["biased"]
    assert "too low" in text.output
    assert "precision class A (bias removed), accuracy class A" in text.output
    planimetry = content["standards"][0]
    assert (planimetry["product"], planimetry["accuracy_class"]) == ("planimetry", "A")


def test_a_single_standard(table: Path) -> None:
    arguments = ["check", "--discrepancies", str(table), "--standard", "asprs-2024", "--json"]
    content = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert [entry["standard"] for entry in content["standards"]] == ["asprs-2024"]
    assert content["standards"][0]["vertical"]["class_cm"] == pytest.approx(21.6)


def test_figures_are_written_and_repeat_byte_for_byte(table: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        arguments = ["check", "--discrepancies", str(table), "--figures", str(tmp_path / name)]
        assert CliRunner().invoke(app, arguments).exit_code == 0
    for name in ("residual_map.pdf", "histograms.pdf"):
        content = (tmp_path / "one" / name).read_bytes()
        assert content.startswith(b"%PDF")
        assert content == (tmp_path / "two" / name).read_bytes()


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (["--scale", "1:zero"], 5),
        (["--scale", "0"], 5),
        (["--interval", "-1"], 5),
        (["--confidence", "90"], 5),
        (["--standard", "iso-19157"], 3),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    table: Path,
    options: list[str],
    code: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "argv", ["photocal", "check", "--discrepancies", str(table), *options])
    with pytest.raises(SystemExit) as exit_status:
        main()
    captured = capsys.readouterr()
    assert exit_status.value.code == code
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["check", "--discrepancies", str(tmp_path / "none.csv")])
    assert isinstance(result.exception, PhotocalError)
    assert result.exception.exit_code == 3


def test_products_are_judged_at_check_points(tmp_path: Path) -> None:
    """An orthomosaic whose targets stand 0.20 m too far east, and a terrain model that is 0.50 m too high."""
    rng = np.random.default_rng(4)
    cell, side = 0.05, 600
    east, north = 500_000.0, 7_500_000.0
    column, row = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    image = np.full((side, side), 90.0) + rng.normal(0.0, 2.0, (side, side))
    lines = ["point,E,N,h"]
    for k in range(6):
        x, y = 5.0 + 4.0 * (k % 3) * 1.7, 6.0 + 9.0 * (k // 3)
        lines.append(f"C{k},{east + x},{north + y},{100.0 + 0.1 * k}")
        there = np.hypot(column * cell - (x + 0.20), (side - row) * cell - y) <= 0.25
        image[there] = 240.0
    transform = rasterio.Affine(cell, 0.0, east, 0.0, -cell, north + side * cell)
    shape = {"driver": "GTiff", "width": side, "height": side, "count": 1, "crs": "EPSG:32722"}
    with rasterio.open(tmp_path / "ortho.tif", "w", dtype="uint8", transform=transform, **shape) as file:
        file.write(image.clip(0, 255).astype("uint8"), 1)
    with rasterio.open(tmp_path / "dtm.tif", "w", dtype="float32", transform=transform, **shape) as file:
        file.write(np.full((side, side), 100.5, dtype="float32"), 1)
    (tmp_path / "check.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = ["check", "--points", str(tmp_path / "check.csv"), "--ortho", str(tmp_path / "ortho.tif")]
    arguments += ["--target-diameter", "0.5", "--dtm", str(tmp_path / "dtm.tif"), "--scale", "1:1000"]
    arguments += ["--height-kind", "orthometric", "--dtm-height-kind", "orthometric", "--json"]
    answer = CliRunner().invoke(app, [*arguments, "--figures", str(tmp_path / "figures")])
    assert answer.exit_code == 0, answer.exception
    content = json.loads(answer.stdout)
    # The product lies to the east and is too high.
    assert content["components"]["E"]["mean_m"] == pytest.approx(0.20, abs=0.01)
    assert content["components"]["N"]["mean_m"] == pytest.approx(0.0, abs=0.01)
    assert content["components"]["h"]["mean_m"] == pytest.approx(0.50 - 0.25, abs=1e-3)
    assert len(content["likeness"]) == 6
    assert (tmp_path / "figures" / "residual_map.pdf").exists()


def test_there_is_one_thing_to_check(table: Path) -> None:
    answer = CliRunner().invoke(app, ["check", "--points", str(table), "--discrepancies", str(table)])
    assert "one thing to check" in str(answer.exception)
