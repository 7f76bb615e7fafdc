"""Analysis of variance: scipy, a textbook's printed table, sequential fits, and the print of a study."""

from __future__ import annotations

import csv
import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from typer.testing import CliRunner

from photocal.analysis.accuracy.variance_analysis import analyse_variance
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.commands.cli import app

TABLE22 = Path(__file__).parents[4] / "configs/studies/canon-elph/printed/table22_check_rmse.csv"
# D. C. Montgomery, Design and Analysis of Experiments, 8th edition, table 5.1: life of batteries, hours.
BATTERIES = {
    ("1", "15"): (130, 155, 74, 180), ("1", "70"): (34, 40, 80, 75), ("1", "125"): (20, 70, 82, 58),
    ("2", "15"): (150, 188, 159, 126), ("2", "70"): (136, 122, 106, 115), ("2", "125"): (25, 70, 58, 45),
    ("3", "15"): (138, 110, 168, 160), ("3", "70"): (174, 120, 150, 139), ("3", "125"): (96, 104, 82, 60),
}  # fmt: skip


def indicators(labels: list[str]) -> NDArray[np.float64]:
    return np.array([[float(label == one) for one in sorted(set(labels))[1:]] for label in labels])


def fitted(columns: list[NDArray[np.float64]], values: NDArray[np.float64]) -> float:
    """Residual sum of squares of a linear model, by least squares."""
    design = np.column_stack([np.ones(len(values)), *columns])
    return float(np.sum((values - design @ np.linalg.lstsq(design, values, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("sizes", [(5, 5, 5), (3, 8, 4, 2)])
def test_one_factor_is_the_one_way_test(sizes: tuple[int, ...]) -> None:
    random = np.random.default_rng(len(sizes))
    groups = [random.normal(0.3 * k, 1.0, n) for k, n in enumerate(sizes)]
    labels = [str(k) for k, n in enumerate(sizes) for _ in range(n)]
    effect, residual = analyse_variance({"set": labels, "same": ["-"] * len(labels)}, np.concatenate(groups))
    peer = stats.f_oneway(*groups)
    assert effect.f == pytest.approx(peer.statistic, rel=1e-10)
    assert effect.p_value == pytest.approx(peer.pvalue, rel=1e-10)
    assert residual.degrees_of_freedom == sum(sizes) - len(sizes)


def test_two_factors_of_a_textbook() -> None:
    cells = [(*cell, float(hours)) for cell, lives in BATTERIES.items() for hours in lives]
    material, temperature, hours = zip(*cells, strict=True)
    made = analyse_variance({"material": material, "temperature": temperature}, np.array(hours))
    # Printed in its table 5.5; F there with two decimals.
    assert [one.degrees_of_freedom for one in made] == [2, 2, 4, 27]
    squares = (10683.72, 39118.72, 9613.78, 18230.75)
    assert [one.sum_of_squares for one in made] == pytest.approx(squares, abs=0.005)
    assert [one.f for one in made[:3]] == pytest.approx([7.91, 28.97, 3.56], abs=0.005)
    assert [one.p_value for one in made[:3]] == pytest.approx([0.0020, 0.0001, 0.0186], abs=0.00011)
    assert sum(one.share for one in made) == pytest.approx(1.0)


def test_three_factors_are_sequential_fits() -> None:
    random = np.random.default_rng(5)
    rows = list(product("abc", "xy", "1234"))
    factors = {name: [row[k] for row in rows] for k, name in enumerate(("set", "use", "pattern"))}
    values = random.normal(0, 1, len(rows)) + 2.0 * np.array(
        [row[1] == "y" and row[0] == "c" for row in rows]
    )
    made = {one.name: one for one in analyse_variance(factors, values)}
    columns = {name: indicators(list(labels)) for name, labels in factors.items()}
    for a, b in (("set", "use"), ("set", "pattern"), ("use", "pattern")):
        both = np.einsum("ni,nj->nij", columns[a], columns[b]).reshape(len(rows), -1)
        columns[f"{a} x {b}"] = both
    used: list[NDArray[np.float64]] = []
    for name, own in columns.items():
        before = fitted(used, values)
        used.append(own)
        assert made[name].sum_of_squares == pytest.approx(before - fitted(used, values), abs=1e-9)
        assert made[name].degrees_of_freedom == own.shape[1]
    rest = made["residual"]
    assert rest.sum_of_squares == pytest.approx(fitted(used, values))
    assert rest.degrees_of_freedom == 3 * 1 * 2
    assert made["set x use"].significant


def test_the_print_of_a_study() -> None:
    """14 triangulations of the Canon study: sets and uses, each pair once, by fits of the test's own."""
    done = CliRunner().invoke(app, ["check", "--variance", str(TABLE22), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)["variance"]
    with TABLE22.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sets, uses = (indicators([row[name] for row in rows]) for name in ("set", "iop_mode"))
    z = np.array([float(row["z_m"]) for row in rows])
    plane = np.hypot(*(np.array([float(row[name]) for row in rows]) for name in ("x_m", "y_m")))
    for name, values in (("z", z), ("plane", plane)):
        rest = fitted([sets, uses], values)
        f = [
            (fitted([other], values) - rest) / own.shape[1] / (rest / 6)
            for own, other in ((sets, uses), (uses, sets))
        ]
        assert [one["f"] for one in found[name][:2]] == pytest.approx(f, rel=1e-9)
    assert [one["share"] for one in found["z"]] == pytest.approx([0.861, 0.112, 0.028], abs=0.0006)
    text = " ".join(CliRunner().invoke(app, ["check", "--variance", str(TABLE22)]).output.split())
    assert "analysis of variance of z" in text
    own = CliRunner().invoke(app, ["check", "--variance", str(TABLE22), "--lang", "pt-BR"]).output
    of_z = own.partition("análise de variância de z (* a 5 %)")[2]
    assert re.findall(r"\d+,\d%", of_z)[:3] == ["86,1%", "11,2%", "2,8%"]


def test_what_cannot_be_analysed(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no factor varies"):
        analyse_variance({"a": ["x", "x"]}, np.array([1.0, 2.0]))
    with pytest.raises(ConfigurationError, match="nothing is repeated"):
        analyse_variance({"a": ["x", "y", "z"]}, np.array([1.0, 2.0, 4.0]))
    with pytest.raises(ConfigurationError, match="3 of 4 combinations of a, b occur"):
        analyse_variance({"a": ["x", "x", "y"], "b": ["1", "2", "1"]}, np.array([1.0, 2.0, 4.0]))
    table = tmp_path / "table.csv"
    table.write_text("set,rmse\n1,0.5\n")
    done = CliRunner().invoke(app, ["check", "--variance", str(table)])
    assert isinstance(done.exception, InputMalformedError)
    assert "rmse_m" in str(done.exception)


@pytest.mark.parametrize("values", [[2.0, 2.0, 2.0, 2.0], [1.0, np.nan, 2.0, 3.0]])
def test_values_without_a_variance_are_refused(values: list[float]) -> None:
    with pytest.raises(ConfigurationError, match=r"all values are equal|values are missing"):
        analyse_variance({"set": ["a", "a", "b", "b"]}, np.array(values))
