"""Tables as spreadsheets write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.base.text_tables import read_table

ROWS = (("point", "X", "Y"), ("P1", "674123.45", "7458000.5"), ("Água", "-1.5", "2"))


def written(path: Path, separator: str, comma: bool, encoding: str) -> Path:
    """Write the table as a spreadsheet of some country does."""
    rows = [ROWS[0], *((row[0], *(c.replace(".", ",") if comma else c for c in row[1:])) for row in ROWS[1:])]
    path.write_bytes("".join(separator.join(row) + "\r\n" for row in rows).encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize(("separator", "comma"), [(",", False), (";", False), (";", True), ("\t", True)])
def test_separators_commas_and_encodings(tmp_path: Path, separator: str, comma: bool, encoding: str) -> None:
    table = read_table(written(tmp_path / "t.csv", separator, comma, encoding), ("point", "X", "Y"))
    assert table.names("point")[1] == ("P1", "Água")
    assert table.numbers("X").tolist() == [674123.45, -1.5]
    assert table.numbers("Y").tolist() == [7458000.5, 2.0]


def test_points_before_thousands(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("point;X\nP1;7.458.123,25\nP2;100,5\n")
    assert read_table(path, ("point", "X")).numbers("X").tolist() == [7458123.25, 100.5]


def test_decimal_commas_between_commas_are_named(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("point,X\nP1,100,5\n")
    with pytest.raises(InputMalformedError, match="decimal commas"):
        read_table(path, ("point", "X"))
