"""Reading a run: what is sound is read, what is spoilt is refused in one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.block.results.folder import read_result, result_json


@pytest.mark.shared
def test_published_calibration_is_read(published_folder: Path) -> None:
    result = read_result(published_folder)
    camera = result.cameras["dcs460"]
    assert camera.value("c") == 20.472130583
    assert camera.sigma_of("c") == 8.61644e-3
    assert result.images.names == tuple(str(i) for i in range(1, 13))
    assert result.residuals.measured.shape == (457, 2)
    assert len(result.points.names) == 40


def test_hashes_of_the_files_are_those_of_sha256sum(run_folder: Path) -> None:
    import subprocess

    run = read_result(run_folder)
    for file in run.files:
        said = subprocess.run(
            ["sha256sum", run_folder / file.path], capture_output=True, text=True, check=True
        ).stdout
        assert said.split()[0] == file.sha256


def edit(folder: Path, change: Any) -> None:
    path = folder / "result.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    change(result)
    path.write_text(json.dumps(result), encoding="utf-8")


def refused(folder: Path, *words: str, error: type[PhotocalError] = InputMalformedError) -> None:
    with pytest.raises(error) as failure:
        read_result(folder)
    line = str(failure.value)
    assert "\n" not in line
    for word in words:
        assert word in line


@pytest.mark.parametrize("name", ["result.json", "images.csv", "points.csv", "residuals.csv"])
def test_missing_file_is_named(run_folder: Path, name: str) -> None:
    (run_folder / name).unlink()
    why = "has no" if name == "result.json" else "does not exist"
    refused(run_folder, name, why, error=InputNotFoundError)


@pytest.mark.parametrize("name", ["result.json", "images.csv", "points.csv", "residuals.csv"])
def test_empty_file_is_named(run_folder: Path, name: str) -> None:
    (run_folder / name).write_text("", encoding="utf-8")
    refused(run_folder, name, "empty", error=InputNotFoundError)


def test_folder_that_is_a_file(run_folder: Path) -> None:
    with pytest.raises(InputNotFoundError, match="folder was expected"):
        read_result(run_folder / "result.json")
    with pytest.raises(InputNotFoundError, match="no such folder"):
        read_result(run_folder / "elsewhere")


def test_row_cut_short_is_named_by_its_line(run_folder: Path) -> None:
    path = run_folder / "residuals.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(lines[:40]) + "\n" + lines[40][:20], encoding="utf-8")
    refused(run_folder, "residuals.csv, row 41", "cells")


def test_table_cut_between_rows_is_noticed(run_folder: Path) -> None:
    path = run_folder / "residuals.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(lines[:40]) + "\n", encoding="utf-8")
    refused(run_folder, "residuals.csv", "78 image observations", "200")


def test_number_that_is_none_is_named(run_folder: Path) -> None:
    path = run_folder / "images.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("12.25", "nan", 1), encoding="utf-8")
    refused(run_folder, "images.csv, line 2", "Y is not finite")


def test_missing_column_is_named(run_folder: Path) -> None:
    path = run_folder / "images.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("kappa", "yaw", 1), encoding="utf-8")
    refused(run_folder, "images.csv", "kappa")


def test_table_that_is_no_text(run_folder: Path) -> None:
    (run_folder / "points.csv").write_bytes(b"\xff\xfe\x00binary")
    refused(run_folder, "points.csv", "UTF-8")


def test_other_schema(run_folder: Path) -> None:
    edit(run_folder, lambda result: result.update(schema="photocal.adjustment/2"))
    refused(run_folder, "result.json", "photocal.adjustment/2")


def test_cut_json(run_folder: Path) -> None:
    path = run_folder / "result.json"
    path.write_text(path.read_text(encoding="utf-8")[:900], encoding="utf-8")
    refused(run_folder, "result.json, line", "not complete JSON")


def test_nan_in_json(run_folder: Path) -> None:
    edit(run_folder, lambda result: result.update(chi_squared=float("nan")))
    refused(run_folder, "NaN")


def _negative_sigma(result: Any) -> None:
    result["cameras"]["l1"]["parameters"]["K1"]["sigma"] = -1.0


def _short_matrix(result: Any) -> None:
    result["cameras"]["l1"]["correlation"]["matrix"].pop()


def _other_names(result: Any) -> None:
    result["cameras"]["l1"]["correlation"]["names"][0] = "P1"


def _no_distance(result: Any) -> None:
    result["cameras"]["l1"]["parameters"]["c"]["value"] = 0.0


def _no_pitch(result: Any) -> None:
    result["cameras"]["l1"]["unit"] = "mm"


def _text_for_number(result: Any) -> None:
    result["iterations"] = "six"


def _missing_key(result: Any) -> None:
    del result["global_test"]["p_value"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_negative_sigma, ("sigma of K1",)),
        (_short_matrix, ("correlation matrix is not 5 by 5",)),
        (_other_names, ("correlation names",)),
        (_no_distance, ("principal distance",)),
        (_no_pitch, ("pixel pitch",)),
        (_text_for_number, ("iterations",)),
        (_missing_key, ("global_test.p_value",)),
    ],
)
def test_contradictions_are_named(run_folder: Path, change: Any, words: tuple[str, ...]) -> None:
    edit(run_folder, change)
    refused(run_folder, "result.json", *words)


def test_table_of_another_run(run_folder: Path) -> None:
    path = run_folder / "residuals.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("IMG_0001", "IMG_0901"), encoding="utf-8")
    refused(run_folder, "IMG_0901", "images.csv")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_cut_is_refused_or_harmless(run_folder: Path, data: st.DataObject) -> None:
    """A file cut at any byte never gives another result, and never anything but one of our errors."""
    whole = read_result(run_folder)
    name = data.draw(st.sampled_from(["result.json", "images.csv", "residuals.csv"]))
    path = run_folder / name
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    try:
        again = read_result(run_folder)
        assert result_json(again)["cameras"] == result_json(whole)["cameras"]
        assert again.images.names == whole.images.names
        assert len(again.residuals) == len(whole.residuals)
    except PhotocalError:
        return
    finally:
        path.write_bytes(content)
