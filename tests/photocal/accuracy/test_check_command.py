from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.errors import PhotocalError
from photocal.cli import app, main

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
    content = json.loads(figures.output)
    assert content["schema"] == "photocal.check/1"
    assert content["sign"] == "reference minus product"
    assert content["components"]["h"]["mean_m"] == pytest.approx(0.215)
    assert content["components"]["h"]["bias_test"]["biased"]
    assert "too low" in text.output
    assert "precision class A (bias removed), accuracy class A" in text.output
    planimetry = content["standards"][0]
    assert (planimetry["product"], planimetry["accuracy_class"]) == ("planimetry", "A")


def test_a_single_standard(table: Path) -> None:
    arguments = ["check", "--discrepancies", str(table), "--standard", "asprs-2024", "--json"]
    content = json.loads(CliRunner().invoke(app, arguments).output)
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
