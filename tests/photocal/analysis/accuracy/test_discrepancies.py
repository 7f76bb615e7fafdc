from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.analysis.accuracy.discrepancies import Discrepancies, read_discrepancies
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Discrepancies]:
    path = tmp_path_factory.mktemp("tables") / "x.csv"

    def written(text: str) -> Discrepancies:
        path.write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
        return read_discrepancies(path)

    return written


def test_metres_without_unit(read: Callable[[str], Discrepancies]) -> None:
    found = read("point,dE,dN,dh\nA,0.1,-0.2,0.3\nB,0,0,\n")
    assert found.points == ("A", "B")
    assert found.correction_m[0] == pytest.approx([0.1, -0.2, 0.3])
    assert found.d_m[0] == pytest.approx([-0.1, 0.2, -0.3])
    assert np.isnan(found.d_m[1, 2])
    assert found.positions_m is None
    assert found.component("h")[0] == ("A",)
    assert found.planimetric()[0] == ("A", "B")
    assert found.spatial()[0] == ("A",)


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("dE_m", 1.0),
        ("dE_cm", 0.01),
        ("dE [mm]", 0.001),
        ("de(ft)", 0.3048),
        ("DE dm", 0.1),
        ("dE_usft", 0.3048006096),
    ],
)
def test_units_in_the_header(read: Callable[[str], Discrepancies], header: str, factor: float) -> None:
    found = read(f"point,{header},dN_m\nA,2.5,1\n")
    assert found.correction_m[0, 0] == pytest.approx(2.5 * factor, rel=1e-9)
    assert found.correction_m[0, 1] == 1.0


def test_decimal_commas_with_semicolons_and_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "pontos.csv"
    path.write_text("\ufeffpoint;dE;dN;dh\nA;0,12;-1,5;2\n", encoding="utf-8")
    assert read_discrepancies(path).correction_m[0] == pytest.approx([0.12, -1.5, 2.0])


def test_positions_for_the_map_in_any_order(read: Callable[[str], Discrepancies]) -> None:
    found = read("N,E,dh,point\n20,10,0.5,A\n")
    assert found.positions_m is not None
    assert found.positions_m[0, :2] == pytest.approx([10.0, 20.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("point,dE,dN\n", "no rows"),
        ("point,dE,dN\nA,,\n", "no discrepancy"),
        ("dE,dN\n1,2\n", "no column point"),
        ("point,dE\nA,1\n", "no column dn"),
        ("point,E,N\nA,1,2\n", "no column dE"),
        ("point,dE,dN,dX\nA,1,2,3\n", "line 1: unknown column 'dX'"),
        ("point,dE,dE,dN\nA,1,2,3\n", "appears twice"),
        ("point,dE_inch,dN\nA,1,2\n", "unknown unit 'inch'"),
        ("point,dE,dN\nA,1,2\nA,1,2\n", "line 3: point A is listed twice"),
        ("point,dE,dN\n,1,2\n", "line 2: point is empty"),
        ("point,dE,dN\nA,1\n", "row 2: has 2 cells"),
        ("point,dE,dN\nA,1,x\n", "line 2: dN is 'x'"),
        ("point,dE,dN\nA,1,nan\n", "not finite"),
        ("point,dE,dN\nA,1,1e999\n", "not finite"),
        ("point,dE,dN\nA,1,1_0\n", "not a number"),
        ("point,dE,dN\nA,\0,1\n", "not a number"),
    ],
)
def test_a_wrong_table_is_refused_with_its_place(
    read: Callable[[str], Discrepancies], text: str, message: str
) -> None:
    with pytest.raises(InputMalformedError, match=re.escape(message)) as failure:
        read(text)
    assert "x.csv" in str(failure.value)
    assert "\n" not in str(failure.value)


def test_a_missing_file_and_a_binary_file(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError, match="does not exist"):
        read_discrepancies(tmp_path / "none.csv")
    binary = tmp_path / "photo.jpg"
    binary.write_bytes(b"\xff\xd8\xff\xe0" + bytes(range(256)))
    with pytest.raises(InputMalformedError, match="UTF-8"):
        read_discrepancies(binary)


@given(st.text(max_size=300))
def test_any_text_is_read_or_refused(read: Callable[[str], Discrepancies], text: str) -> None:
    try:
        found = read(text)
    except PhotocalError:
        return
    assert np.isfinite(found.d_m).any()


@given(
    st.lists(
        st.sampled_from(
            ["point", "dE", "dN", "dh", ",", ";", "\t", "\n", '"', "1", "-0.5", "nan", "dE_cm", " "]
        ),
        max_size=40,
    ).map("".join)
)
def test_any_text_that_looks_like_a_table_is_read_or_refused(
    read: Callable[[str], Discrepancies], text: str
) -> None:
    try:
        found = read("point,dE,dN,dh\n" + text)
    except PhotocalError:
        return
    assert len(found.points) == len(found.d_m)
