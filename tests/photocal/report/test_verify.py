"""A certificate verifies with its inputs and with nothing else."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from photocal.base.errors import InputMalformedError, NotSignedError
from photocal.block.options import Wanted
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import BlockSource
from photocal.commands.cli import app
from photocal.report.issue import read_record
from photocal.report.verification import as_certified, differences, record_of, repeated

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="session")
def issued(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificate of the demo, with its inputs."""
    folder = tmp_path_factory.mktemp("issued")
    adjust_block(DEMO, folder / "run")
    assert call("analyse", folder / "run").exit_code == 0
    answer = call(
        "certificate", folder / "run", "-o", folder / "certificate", "--block", DEMO, "--date", "2026-11-21"
    )
    assert answer.exit_code == 0, answer.output
    return folder / "certificate"


@pytest.fixture(scope="session")
def again(issued: Path) -> dict[str, Any]:
    """The certificate made anew."""
    certified, folder = read_record(issued)
    return record_of(
        as_certified(repeated(certified, folder, BlockSource(issued / "inputs")), certified, folder),
        certified,
    )


@pytest.fixture
def elsewhere(issued: Path, tmp_path: Path) -> Path:
    """A copy of the certificate, as on another machine, to spoil."""
    return Path(shutil.copytree(issued, tmp_path / "elsewhere"))


def test_it_verifies_elsewhere(elsewhere: Path) -> None:
    answer = call("verify", elsewhere / "certificate.json", "--json")
    assert isinstance(answer.exception, NotSignedError)
    assert json.loads(answer.stdout)["verified"] is True
    # What the analysis of the certificate says on its first page is not called missing.
    assert not [line for line in json.loads(answer.stdout)["not_told"] if "y-scale" in line]


def test_it_verifies_with_other_arithmetic(elsewhere: Path) -> None:
    """Other kernels of the linear algebra, another number of threads: the last bits differ."""
    machine = {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from photocal.commands.cli import main; main()",
            "verify",
            elsewhere,
            "--json",
        ],
        env={**os.environ, **machine},
        cwd=elsewhere,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == NotSignedError.exit_code, done.stderr
    assert json.loads(done.stdout)["verified"] is True


def test_certificate_names_what_it_was_made_from(elsewhere: Path) -> None:
    content = json.loads((elsewhere / "certificate.json").read_text(encoding="utf-8"))
    assert [entry["path"] for entry in content["result"]["inputs"]] == [
        "block.toml",
        "images.csv",
        "points.csv",
        "observations.csv",
    ]
    assert set(content["documents"]) == {"certificate.html", "certificate.pdf"}
    assert len(content["technical_reports"]["dcs460"]) == 47
    assert content["result"]["cameras"]["dcs460"]["parameters"]["c"]["value"] == pytest.approx(
        20.50047, abs=1e-5
    )


@settings(max_examples=8)
@given(data=st.data())
def test_one_changed_digit_in_any_input_is_named(issued: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["block.toml", "images.csv", "points.csv", "observations.csv"]))
    path = issued / "inputs" / name
    content = path.read_bytes()
    digits = [i for i, byte in enumerate(content) if chr(byte).isdigit()]
    at = data.draw(st.sampled_from(digits))
    other = data.draw(st.sampled_from([d for d in b"0123456789" if d != content[at]]))
    try:
        path.write_bytes(content[:at] + bytes([other]) + content[at + 1 :])
        answer = call("verify", issued, "--json")
        assert answer.exit_code != 0
        said = json.loads(answer.stdout)
        assert said["verified"] is False
        assert len(said["changed_inputs"]) == 1
        assert name in said["changed_inputs"][0]
        assert name in str(answer.exception)
    finally:
        path.write_bytes(content)


def test_what_the_run_estimated_and_rejected_is_repeated(tmp_path: Path) -> None:
    """Variance components and data snooping change every figure: without them nothing would verify."""
    adjust_block(DEMO, tmp_path / "run", "w", wanted=Wanted(components=True))
    assert call("certificate", tmp_path / "run", "-o", tmp_path / "c", "--block", DEMO).exit_code == 0
    answer = call("verify", tmp_path / "c", "--json")
    assert isinstance(answer.exception, NotSignedError)
    assert json.loads(answer.stdout)["verified"] is True
    content = json.loads((tmp_path / "c" / "certificate.json").read_text(encoding="utf-8"))
    assert content["result"]["variance_components"]
    assert content["result"]["snooping"] == "w"


def test_missing_input_is_named(elsewhere: Path) -> None:
    (elsewhere / "inputs" / "points.csv").unlink()
    assert "points.csv is missing" in str(call("verify", elsewhere).exception)
    assert isinstance(call("verify", elsewhere, "--block", DEMO).exception, NotSignedError)


def change(folder: Path, *steps: Any, to: Any) -> None:
    path = folder / "certificate.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    place = content
    for step in steps[:-1]:
        place = place[step]
    place[steps[-1]] = to
    path.write_text(json.dumps(content), encoding="utf-8")


@pytest.mark.parametrize(
    ("steps", "to", "named"),
    [
        (("result", "cameras", "dcs460", "parameters", "c", "value"), 20.500468, "parameters.c.value"),
        (("result", "cameras", "dcs460", "parameters", "K3", "sigma"), 1.55e-10, "parameters.K3.sigma"),
        (("result", "cameras", "dcs460", "correlation", "matrix", 3, 0), 0.5, "correlation.matrix[3][0]"),
        (("result", "chi_squared"), 764.0, "result.chi_squared"),
        (("result", "global_test", "accepted"), False, "global_test.accepted"),
        (("exposures", 2, "Z_m", "value"), 6.7, "exposures[4].Z_m.value"),
        (("technical_reports", "dcs460", 24, "value"), "12", "technical_reports.dcs460"),
        (("analysis", "findings", 0, "figures", "f"), 2100.0, "analysis.findings[y-scale].figures.f"),
        (("analysis", "cameras", "dcs460", "left_out", 0, "change_of_c"), -0.0096, "change_of_c"),
        (("analysis", "methods", 1, "met"), True, "analysis.methods[mixed-ranges].met"),
        (("number",), "PC-20261121-00000000", "number"),
    ],
)
def test_changed_figure_is_named(
    elsewhere: Path, again: dict[str, Any], steps: tuple[Any, ...], to: Any, named: str
) -> None:
    change(elsewhere, *steps, to=to)
    certified, _ = read_record(elsewhere)
    (found,) = differences(certified, again)
    assert named in found.place


@pytest.mark.parametrize(("share", "named"), [(0.01, False), (0.1, True)])
def test_c_without_a_parameter_is_known_to_a_hundredth_of_its_sigma(
    elsewhere: Path, again: dict[str, Any], share: float, named: bool
) -> None:
    """Such an adjustment ends somewhere within that, on another machine elsewhere."""
    camera, key = again["analysis"]["cameras"]["dcs460"], "change_of_c"
    sigma = again["result"]["cameras"]["dcs460"]["parameters"]["c"]["sigma"]
    to = camera["left_out"][0][key] + share * sigma
    change(elsewhere, "analysis", "cameras", "dcs460", "left_out", 0, key, to=to)
    certified, _ = read_record(elsewhere)
    assert [found.place.rpartition(".")[2] for found in differences(certified, again)] == [key] * named


@pytest.mark.parametrize(
    ("steps", "to"), [(("date",), "2026-11-22"), (("particulars", "document", "client"), "somebody else")]
)
def test_what_a_person_gave_is_part_of_the_number(elsewhere: Path, steps: tuple[str, ...], to: str) -> None:
    change(elsewhere, *steps, to=to)
    # The analysis says nothing about it and takes its time.
    change(elsewhere, "analysis", to=None)
    answer = call("verify", elsewhere, "--json")
    assert answer.exit_code != 0
    assert "number" in str(answer.exception)
    assert json.loads(answer.stdout)["verified"] is False


def test_changed_page_is_named(elsewhere: Path) -> None:
    change(elsewhere, "analysis", to=None)
    page = elsewhere / "certificate.html"
    page.write_text(page.read_text(encoding="utf-8").replace("20.5005", "20.5004"), encoding="utf-8")
    assert "certificate.html is not the one that was certified" in str(call("verify", elsewhere).exception)


def test_certificate_may_not_reach_outside_its_inputs(elsewhere: Path) -> None:
    change(elsewhere, "result", "inputs", 0, "path", to="../../etc/passwd")
    assert "lies outside the folder of the inputs" in str(call("verify", elsewhere).exception)


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '{"schema": "other/1"}', '{"schema": "photocal.certificate/1"}']
)
def test_what_is_no_certificate_is_refused_in_a_line(tmp_path: Path, content: str) -> None:
    (tmp_path / "certificate.json").write_text(content, encoding="utf-8")
    answer = call("verify", tmp_path)
    assert answer.exit_code != 0
    assert "certificate.json" in str(answer.exception)
    assert "\n" not in str(answer.exception)


def test_block_that_changed_since_is_refused_when_issuing(issued: Path, tmp_path: Path) -> None:
    block = Path(shutil.copytree(DEMO, tmp_path / "block"))
    with (block / "points.csv").open("a", encoding="utf-8") as stream:
        stream.write("\n")
    answer = call("certificate", issued.parent / "run", "-o", tmp_path / "out", "--block", block)
    assert "points.csv" in str(answer.exception)
    assert not (tmp_path / "out").exists()


def test_tolerances() -> None:
    base = {"c": {"value": 20.0, "sigma": 0.01}, "rms": 1e-9, "n": 5}
    assert differences(base, {"c": {"value": 20.0 + 5e-7, "sigma": 0.01}, "rms": 2e-9, "n": 5}) == []
    moved = differences(base, {"c": {"value": 20.0 + 5e-6, "sigma": 0.01}, "rms": 1e-9, "n": 5})
    assert [d.place for d in moved] == ["c.value"]
    assert [d.place for d in differences(base, {"c": base["c"], "n": 5})] == ["rms"]
    assert [d.place for d in differences([1, 2], [1, 2, 3], "list")] == ["list"]
    assert [d.place for d in differences({"a": None}, {"a": 0.0})] == ["a"]


@pytest.mark.parametrize(
    "changed",
    [
        {"number": 5},
        {"number": None},
        {"language": ["en"]},
        {"language": {}},
        {"particulars": []},
        {"documents": []},
        {"analysis": 5},
        {"analysis": {}},
        {"analysis": {"alpha": 0.1, "correlation_threshold": 0.8, "bootstrap_draws": 10**9}},
        {"date": "yesterday"},
        {"warnings": [5]},
        {"run_files": [{}]},
        {"result": []},
        {"result": {"inputs": [], "block": None}},
    ],
)
def test_fields_of_another_kind_are_refused_in_a_line(elsewhere: Path, changed: dict[str, Any]) -> None:
    for name, to in changed.items():
        change(elsewhere, name, to=to)
    answer = call("verify", elsewhere)
    assert isinstance(answer.exception, InputMalformedError)
    assert next(iter(changed)) in str(answer.exception)
    assert "\n" not in str(answer.exception)
