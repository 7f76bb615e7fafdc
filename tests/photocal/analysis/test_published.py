"""Tables of the studies by the command, to the digits that they print."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.commands.cli import app


def analysed(*arguments: str | Path) -> list[dict[str, Any]]:
    done = CliRunner().invoke(app, ["analyse", *map(str, arguments), "--json"])
    assert done.exit_code == 0, done.output
    sets: list[dict[str, Any]] = json.loads(done.stdout)["sets"]
    return sets


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.shared
def test_canon_elph_table_10(shared: Path) -> None:
    """Single parameters; set 4 of the table is of another run, f of set 1 needs its fifth digit (digest)."""
    study = shared / "reference/canon-elph"
    printed = {(r["set"], r["parameter"]): r for r in rows(study / "table10_f_individual.csv")}
    compared = 0
    for one in analysed(study / "table06_09_iop_sets.csv", "--degrees-of-freedom", "2470"):
        for test in one["tests"]:
            row = printed[one["set"], test["parameters"][0]]
            if one["set"] == "4" or (one["set"], row["parameter"]) == ("1", "f"):
                continue
            assert test["statistic"] == pytest.approx(float(row["f_computed"]), rel=0.005)
            assert round(test["critical"], 2) == float(row["f_critical"])
            compared += 1
    assert compared == 59


@pytest.mark.shared
def test_canon_elph_table_11(shared: Path) -> None:
    """Groups of set 1, whose correlations are published; their rounding allows 1.940E+04 to 1.959E+04."""
    study = shared / "reference/canon-elph"
    matrix = study / "table12_correlation_set1.csv"
    (one,) = analysed(
        study / "table06_09_iop_sets.csv", "--matrix", matrix, "--set", "1", "--degrees-of-freedom", "2470"
    )
    groups = {tuple(t["parameters"]): t for t in one["tests"] if t["kind"] == "group"}
    assert 1.940e4 <= groups["x0", "y0"]["statistic"] <= 1.96e4
    for names, printed, critical in ((("P1", "P2"), 1.11e4, 2.3), (("A", "B"), 11.1, 2.3)):
        assert groups[names]["statistic"] == pytest.approx(printed, rel=0.005)
        assert round(groups[names]["critical"], 1) == critical
    assert round(groups["K1", "K2", "K3"]["critical"], 2) == 2.09


@pytest.mark.shared
@pytest.mark.parametrize("table", [2, 3, 4, 5])
def test_tank_tables_2_to_5(shared: Path, table: int) -> None:
    """Two decimals of the input move an eigenvalue by up to 0.010 (digest)."""
    study = shared / "reference/tank"
    (one,) = analysed(study / f"table0{table}_correlation.csv")
    printed = [float(r["eigenvalue"]) for r in rows(study / f"table0{table}_components.csv")]
    assert np.abs(np.array(one["components"]["eigenvalues"]) - printed).max() < 0.010
    assert one["tests"] == []


@pytest.mark.shared
def test_tank_table_2_from_its_refined_matrix(shared: Path) -> None:
    study = shared / "reference/tank"
    (one,) = analysed(study / "table02_correlation_refined_derived.csv")
    printed = rows(study / "table02_components.csv")
    for ours, column in (("percent", "percent"), ("cumulative_percent", "cumulative_percent")):
        assert [round(v, 2) for v in one["components"][ours]] == [float(r[column]) for r in printed]


TABLE = "parameter,value,std_dev\nc,20.5,0.01\nx0,0.1,0.02\n"


def test_a_covariance_is_as_good_as_correlations(tmp_path: Path) -> None:
    (tmp_path / "iop.csv").write_text(TABLE)
    (tmp_path / "r.csv").write_text("p,c,x0\nc,1,0.5\nx0,0.5,1\n")
    (tmp_path / "s.csv").write_text("p,c,x0\nc,1e-4,1e-4\nx0,1e-4,4e-4\n")
    first, second = (
        analysed(tmp_path / "iop.csv", "--matrix", tmp_path / name) for name in ("r.csv", "s.csv")
    )
    for name in ("eigenvalues", "percent"):
        assert first[0]["components"][name] == pytest.approx(second[0]["components"][name], rel=1e-12)
    # Of two parameters the eigenvalues are 1 + r and 1 - r.
    assert first[0]["components"]["eigenvalues"] == pytest.approx([1.5, 0.5])


@pytest.mark.parametrize(
    ("table", "matrix", "message"),
    [
        (TABLE.replace("std_dev", "unit"), None, "no standard deviations"),
        (TABLE + "c,20.5,0.01\n", None, "comes twice"),
        (TABLE, "p,c,y0\nc,1,0.5\ny0,0.5,1\n", "the matrix is of c y0, the table of c x0"),
        (TABLE, "p,c,x0\nc,1,0.5\nx0,0.4,1\n", "not a symmetric matrix"),
        (TABLE, "p,c,x0\nc,1,0.5\nx0,0.5,0\n", "not positive"),
        (TABLE.replace("0.02", "-0.02"), None, "not a positive number"),
    ],
)
def test_what_does_not_fit(tmp_path: Path, table: str, matrix: str | None, message: str) -> None:
    (tmp_path / "iop.csv").write_text(table)
    arguments = ["analyse", str(tmp_path / "iop.csv")]
    if matrix is not None:
        (tmp_path / "matrix.csv").write_text(matrix)
        arguments += ["--matrix", str(tmp_path / "matrix.csv")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code != 0
    assert message in " ".join(str(done.exception).split()) + done.output
