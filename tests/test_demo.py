"""What `make demo-dcs460` says and leaves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner, Result

from photocal.demo.__main__ import app


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo") / "output"


@pytest.fixture(scope="module")
def answer(output: Path) -> Result:
    return CliRunner().invoke(app, ["dcs460", "-o", str(output)])


def test_it_calibrates_the_published_camera(answer: Result, output: Path) -> None:
    assert answer.exit_code == 0, answer.output
    result = json.loads((output / "run" / "result.json").read_text())
    c = result["cameras"]["dcs460"]["parameters"]["c"]
    # Independently computed for the eleven photographs: 20.50047 mm, standard deviation 0.00945 mm.
    assert c["value"] == pytest.approx(20.50047, abs=1e-5)
    assert c["sigma"] == pytest.approx(0.00945, abs=5e-6)
    assert result["chi_squared"] == pytest.approx(764.07, abs=0.01)


def test_it_says_where_the_certificate_lies_and_what_it_says(answer: Result, output: Path) -> None:
    pages = output / "certificate"
    assert (pages / "certificate.html").read_text().startswith("<!")
    assert (pages / "certificate.pdf").read_bytes().startswith(b"%PDF-")
    assert str(pages / "certificate.html") in answer.output
    for words in ("Kodak DCS460", "20.5005 mm", "0.0094 mm", "accepted", "764.1"):
        assert words in answer.output


def test_the_flight_is_labelled_synthetic_and_readable(answer: Result, output: Path) -> None:
    assert "SYNTHETIC" in answer.output
    assert "810 frames" in answer.output
    assert "0 bytes belong to no valid frame" in answer.output
    assert "exposures: 29" in answer.output
    with (output / "flight.mcap").open("rb") as log:
        summary = make_reader(log).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {
        summary.channels[channel].topic: count
        for channel, count in summary.statistics.channel_message_counts.items()
    }
    assert counts["/vehicle/raw"] == 810
    assert counts["/camera/exposure"] == 29
