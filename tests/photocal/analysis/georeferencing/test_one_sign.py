"""Every writer of discrepancies gives computed minus surveyed; the opposite is named a correction."""

from __future__ import annotations

import csv
import json
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]
MOVED_M = 0.5


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.fixture
def block(tmp_path: Path) -> tuple[Path, str]:
    """A block whose first check point was surveyed half a metre too far in X."""
    folder = fly(tmp_path / "flight", np.random.default_rng(31), plan=Plan(tie=50))
    points = rows(folder / "points.csv")
    wrong = next(row for row in points if row["role"] == "check")
    wrong["X"] = repr(float(wrong["X"]) + MOVED_M)
    with (folder / "points.csv").open("w", encoding="utf-8", newline="") as text:
        writer = csv.DictWriter(text, list(points[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(points)
    return folder, wrong["point"]


def said(photocal: Photocal, *arguments: str | Path) -> Any:
    answer = photocal(*arguments, "--json")
    assert answer.code == 0, answer.err
    return json.loads(answer.out)


def test_all_writers_of_a_check(photocal: Photocal, block: tuple[Path, str], tmp_path: Path) -> None:
    folder, name = block
    out = tmp_path / "out"
    content = said(photocal, "check", folder, "-o", out)
    assert content["sign"] == "product minus reference"
    for method, result in content["methods"].items():
        assert result["assessment"]["sign"] == content["sign"]
        east = result["assessment"]["components"]["E"]
        assert east["correction_m"] == -east["mean_m"] > 0
        with closing(sqlite3.connect(out / f"{method}.gpkg")) as database:
            sql = "SELECT dE_m FROM {} WHERE point = ?"
            drawn = [
                database.execute(sql.format(layer), (name,)).fetchone()[0]
                for layer in ("ground_points", "residual_vectors")
            ]
        assert drawn == pytest.approx([-MOVED_M] * 2, abs=0.2), method
    points = [point for one in content["methods"].values() for point in one["check"]["points"]]
    given = [point["dX_m"] for point in points if point["point"] == name]
    given += [float(row["dX_m"]) for row in rows(out / "ground_points.csv") if row["point"] == name]
    assert len(given) == 6
    text = photocal("check", folder, "--details").out
    given += [float(d) for d in re.findall(rf"^{name} +([+-][0-9.]+)", text, re.MULTILINE)]
    assert given == pytest.approx([-MOVED_M] * 9, abs=0.2)
    assert content["sign"] in text
    assert content["sign"] in (out / "report.md").read_text(encoding="utf-8")


def test_all_writers_of_an_adjustment_and_of_an_experiment(
    photocal: Photocal, block: tuple[Path, str], tmp_path: Path
) -> None:
    folder, name = block
    said(photocal, "adjust", folder, "-o", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    (adjusted,) = [point["dx"] for point in result["checks"]["points"] if point["point"] == name]
    toml = tmp_path / "experiment.toml"
    toml.write_text(f'block = "{folder.as_posix()}"\nmethods = ["integrated"]\n', encoding="utf-8")
    experiment = said(photocal, "check", "--experiment", toml, "-o", tmp_path / "runs")
    assert experiment["sign"] == "product minus reference"
    (run,) = experiment["runs"]
    (compared,) = [point["d_m"][0] for point in run["points"] if point["point"] == name]
    assert [adjusted, compared] == pytest.approx([-MOVED_M] * 2, abs=0.2)


def test_a_table_of_corrections_is_turned(photocal: Photocal, tmp_path: Path) -> None:
    for title in ("dE,dN", "correction_E,correction_N"):
        table = tmp_path / "table.csv"
        table.write_text(f"point,{title}\nA,0.5,0\nB,0.4,0.1\nC,0.6,0.2\n", encoding="utf-8")
        east = said(photocal, "check", "--discrepancies", table)["components"]["E"]
        assert (east["mean_m"], east["correction_m"]) == (pytest.approx(-0.5), pytest.approx(0.5))
