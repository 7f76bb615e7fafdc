"""Metashape's reference tables."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.exchange.parts import PointEntry
from photocal.exchange.reference_table import read_references, write_references


def test_reference_round_trip(tmp_path: Path) -> None:
    nan = math.nan
    rows = (
        PointEntry('a, "quoted".jpg', "tie", (999660.44, 112368.17, 1916.55), (0.05, 0.05, 0.1)),
        PointEntry("b", "tie", (1.0, 2.0, 3.0), (nan, nan, nan)),
    )
    write_references(tmp_path / "r.csv", 'LOCAL_CS["m"]', rows)
    crs, again = read_references(tmp_path / "r.csv")
    assert crs == 'LOCAL_CS["m"]'
    assert repr(again) == repr(rows)


@pytest.mark.shared
def test_recorded_references(shared: Path) -> None:
    _, rows = read_references(shared / "data" / "dbat-sxb" / "ref" / "fake-camera-positions.txt")
    assert [row.name for row in rows] == ["8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg"]
    assert rows[0].xyz == (999660.44, 112368.17, 1916.55)
    assert rows[0].sigma == (0.05, 0.05, 0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,1,2,3\n", "no header"),
        ("#Label,X,Y\na,1,2\n", "no column Z"),
        ("#Label,X,Y,Z\na,1,2\n", "3 cells where the header has 4"),
        ("#Label,X,Y,Z\na,1,2,inf\n", "not finite"),
        ("#Label,X,Y,Z\na,1,2,3\na,1,2,3\n", "listed twice"),
        ('#Label,X,Y,Z\n"a,1,2,3\n', "not a row of a table|cells where"),
    ],
)
def test_bad_references(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_references(tmp_path / "r.csv")
