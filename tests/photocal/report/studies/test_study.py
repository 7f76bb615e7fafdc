"""`photocal study`: a shipped study, a study of one's own, and what is said of figures that differ."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.photocal.conftest import Answer

WORDS = "{ yes = true, no = false }"
OWN = """title = "Mine"
year = 2026
kind = "article"
place = "here"
asked = "Is 2 cm at 9 points a bias?"
concluded = "Yes."
input = []
[[command]]
name = "check"
line = "photocal check --moments moments.csv --confidence 0.95 --json"
[[table]]
title = "Table 1"
printed = "printed/t.csv"
answer = "check"
label = ["component"]
rounding = "two decimals"
figure = [
    { column = "t", ours = "sets/0/components/{component}/bias_test/t", absolute = true, within = 0.005 },
    { column = "bias", ours = "sets/0/components/{component}/bias_test/biased", words = WORDS },
]
""".replace("WORDS", WORDS)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    folder = tmp_path / "mine"
    (folder / "printed").mkdir(parents=True)
    (folder / "study.toml").write_text(OWN, encoding="utf-8")
    # t = 0.02 / 0.02 * 3 = 3 of nine points; the limit of 8 degrees of freedom is 2.306.
    (folder / "moments.csv").write_text("component,n,mean_m,std_m\nh,9,0.02,0.02\n", encoding="utf-8")
    (folder / "printed" / "t.csv").write_text("component,t,bias\nh,3.00,yes\n", encoding="utf-8")
    return folder


def test_the_shipped_studies_are_listed_and_repeated(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    assert set(json.loads(photocal("study", "--json").out)) == {
        "canon-elph",
        "dcs460",
        "ixus220",
        "phantom4pro",
        "tank",
    }
    said = photocal("study", "phantom4pro", "-o", tmp_path / "p4")
    assert said.code == 0, said.err
    assert "22 of 22 printed figures agree" in said.out
    with (tmp_path / "p4" / "results" / "compared.csv").open(encoding="utf-8") as stream:
        assert len(list(csv.DictReader(stream))) == 25
    again = photocal("study", "phantom4pro", "-o", tmp_path / "p4")
    assert "is not empty" in again.err


def test_a_study_of_ones_own_and_a_figure_that_differs(
    own: Path, photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    made = json.loads(photocal("study", own, "-o", tmp_path / "first", "--json").out)
    assert (made["agreeing"], made["figures"], made["unexplained"]) == (2, 2, 0)
    (own / "printed" / "t.csv").write_text("component,t,bias\nh,3.01,no\n", encoding="utf-8")
    said = photocal("study", own, "-o", tmp_path / "second")
    assert "0 of 2 agree" in said.out
    assert "without a known reason: h t 3.01 (ours 3)" in said.out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bias_test/t", "bias_test/tt", "the answer has no"),
        ('printed = "printed/t.csv"', 'printed = "printed/u.csv"', "does not exist"),
        ('line = "photocal', 'exit = 4\nline = "photocal', "ended with exit code 0, the study states 4"),
    ],
)
def test_what_does_not_fit(
    own: Path, old: str, new: str, message: str, photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    (own / "study.toml").write_text(OWN.replace(old, new, 1), encoding="utf-8")
    said = photocal("study", own, "-o", tmp_path / "out")
    assert said.code != 0
    assert message in said.err


def test_an_unknown_study(photocal: Callable[..., Answer]) -> None:
    assert "there are canon-elph" in photocal("study", "nothing").err
