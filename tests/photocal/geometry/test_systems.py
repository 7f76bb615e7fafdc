"""Coordinate systems as people call them; codes by the register's own pages (epsg.org)."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.geometry.systems import at_place, called, heights_at, is_meant

# Warsaw in 2180, Curitiba in 31982, near Milan in 3003.
WARSAW = np.array([[634676.0, 485344.0], [634604.0, 485234.0], [634544.0, 485363.0]])
CURITIBA = np.array([[677864.0, 7184231.0], [677870.0, 7184240.0]])
MILAN = np.array([[1514000.0, 5034000.0], [1514100.0, 5034100.0]])


@pytest.mark.parametrize(
    ("text", "places", "code"),
    [
        ("PUWG1992", WARSAW, "EPSG:2180"),
        ("PUWG 1992", WARSAW[:, ::-1], "EPSG:2180"),
        ("CS92", None, "EPSG:2180"),
        ("Układ PL-1992", WARSAW, "EPSG:2180"),
        ("SIRGAS 2000 / UTM 22S", CURITIBA, "EPSG:31982"),
        ("SIRGAS2000 UTM zona 22S", None, "EPSG:31982"),
        ("Gauss-Boaga", MILAN, "EPSG:3003"),
        ("rdnew", None, "EPSG:28992"),
    ],
)
def test_a_name_that_leaves_no_doubt(text: str, places: np.ndarray | None, code: str) -> None:
    (found,) = called(text, places)
    assert found.code == code
    assert is_meant(text, found)


def test_a_name_of_several_is_not_decided() -> None:
    """Both zones of Italy bear it; of Poland there are many systems, and what is offered covers the place."""
    assert [system.code for system in called("Gauss-Boaga")][:2] == ["EPSG:3003", "EPSG:3004"]
    offered = called("Poland", WARSAW)
    assert offered[0].code == "EPSG:2180"
    assert 2 <= len(offered) <= 5
    assert called("no such thing", WARSAW) == ()
    assert called("Gauss-Boaga", WARSAW) == ()


def test_systems_near_a_place_that_is_known() -> None:
    assert [system.code for system in at_place(52.2228, 20.9706, WARSAW)] == ["EPSG:2180"]
    assert at_place(-52.2228, 20.9706, WARSAW) == ()


def test_heights_of_a_place_end_with_those_of_the_world() -> None:
    found = heights_at(52.2, 20.97)
    assert [code for code, _ in found][-2:] == ["3855", "5773"]
    assert "9651" in dict(found)
