"""Expanded uncertainty against the worked example of an R package (JCGM 100, G.4)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from photocal.commands.cli import app
from photocal.report.required_sections import combined


def test_welch_and_satterthwaite() -> None:
    """Inputs and figures of the example of metRology, welch.satterthwaite; k for 15 degrees of freedom."""
    u, freedom, k = combined([(0.1, float("inf")), (0.6, 6.0), (0.6, 8.0), (0.55, 3.0)])
    assert u == pytest.approx(1.016120, abs=1e-6)
    assert freedom == pytest.approx(15.60796, abs=1e-4)
    assert k == pytest.approx(2.131450, abs=1e-6)


def test_many_degrees_of_freedom_are_normal() -> None:
    assert combined([(0.1, float("inf"))])[2] == pytest.approx(1.959964, abs=1e-4)


def test_what_nobody_typed_comes_from_the_pictures(tmp_path: Path, run_folder: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for k, aperture in enumerate((2.8, 4.0)):
        exif = Image.Exif()
        exif[0x0110], exif[0x0131] = "FC6310", "v01.2"
        exif.get_ifd(0x8769).update({0x829D: aperture})
        Image.new("L", (40, 30)).save(pictures / f"{k}.jpg", exif=exif)
    given = tmp_path / "given.toml"
    given.write_text('[conditions]\nfirmware = "v02"\n', encoding="utf-8")
    asked = ["certificate", str(run_folder), "-o", str(tmp_path / "c"), "--particulars", str(given)]
    said = CliRunner().invoke(app, [*asked, "--images", str(pictures)])
    assert said.exit_code == 0, said.output
    record = json.loads((tmp_path / "c" / "certificate.json").read_text(encoding="utf-8"))
    assert record["particulars"]["camera"]["model"] == "FC6310 (EXIF)"
    assert record["particulars"]["conditions"]["aperture"] == "f/2.8, f/4 (EXIF)"
    assert record["particulars"]["conditions"]["firmware"] == "v02"
    assert record["particulars"]["conditions"]["focus"] == ""


@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("en", ("Radiometric annex", "0.283 cycles/px", "6.53 cm", "1012.5 hPa", "55 %")),
        ("pt-BR", ("Anexo radiométrico", "0,283 ciclos/px", "6,53 cm", "1012,5 hPa", "55 %")),
    ],
)
def test_the_example_prints_annex_and_air(
    tmp_path: Path, run_folder: Path, language: str, words: tuple[str, ...]
) -> None:
    example = Path(__file__).parents[3] / "configs" / "certificates" / "example_particulars.toml"
    # The example's camera is another one.
    parts = example.read_text(encoding="utf-8").split("\n\n")
    given = tmp_path / "given.toml"
    kept = [part for part in parts if part.startswith(("[conditions]", "[radiometry]"))]
    given.write_text("\n\n".join(kept), encoding="utf-8")
    asked = ["certificate", str(run_folder), "-o", str(tmp_path / "c"), "--particulars", str(given)]
    assert CliRunner().invoke(app, [*asked, "--language", language]).exit_code == 0
    page = (tmp_path / "c" / "certificate.html").read_text(encoding="utf-8")
    # Blanks that no line breaks at are blanks.
    page = page.replace("\u00a0", " ")
    for word in words:
        assert word in page
