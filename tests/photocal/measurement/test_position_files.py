"""Positions in tables beside the pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.position_files import read_positions

# Two lines of a recorded list (Phantom 4 RTK).
MRK = """\
2\t296288.242869\t[2211]\t     3,N\t     0,E\t    75,V\t47.6436873208,Lat\t16.4759271684,Lon\t512.998,Ellh\
\t0.014391, 0.013698, 0.029694\t50,Q
3\t296289.777625\t[2211]\t     5,N\t     1,E\t    75,V\t47.6436479170,Lat\t16.4758945272,Lon\t512.996,Ellh\
\t0.014268, 0.013609, 0.029783\t50,Q
"""


def _fact(name: str) -> ImageFacts:
    return ImageFacts(name, (4000, 3000))


def test_events_go_to_the_pictures_of_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "Timestamp.MRK"
    path.write_text(MRK)
    given = read_positions(path, ["DJI_0003.JPG", "DJI_0009.JPG"])
    placed, other = given(_fact("DJI_0003.JPG")), given(_fact("DJI_0009.JPG"))
    assert (placed.latitude_deg, placed.longitude_deg) == (47.6436479170, 16.4758945272)
    assert placed.altitude_m == 512.996
    # The list has north before east.
    assert placed.position_sigma_m == (0.013609, 0.014268, 0.029783)
    assert not other.has_position


def test_events_go_in_order_where_names_carry_no_numbers(tmp_path: Path) -> None:
    path = tmp_path / "Timestamp.MRK"
    path.write_text(MRK)
    given = read_positions(path, ["b.jpg", "a.jpg"])
    assert given(_fact("a.jpg")).latitude_deg == 47.6436873208
    assert given(_fact("b.jpg")).latitude_deg == 47.6436479170


def test_tables_in_map_coordinates(tmp_path: Path) -> None:
    """geo.txt in UTM, names without their suffix; 500 000 m east is the central meridian."""
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:32633\na 500000 5276000 300.5 0 0 0 0.02 0.04\n")
    placed = read_positions(path, ["a.JPG"])(_fact("a.JPG"))
    assert placed.longitude_deg == pytest.approx(15.0, abs=1e-9)
    assert placed.altitude_m == 300.5
    assert placed.position_sigma_m == (0.02, 0.02, 0.04)


def test_a_table_of_other_pictures_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:4326\nother.jpg 16.4 47.6 300\n")
    with pytest.raises(InputMalformedError, match="none of the 1 pictures"):
        read_positions(path, ["a.jpg"])


def test_a_spreadsheet_of_positions(tmp_path: Path) -> None:
    """Semicolons, decimal commas and heads in Portuguese; a table that states no sigma gives none."""
    path = tmp_path / "posicoes.csv"
    path.write_bytes("Imagem;Latitude;Longitude;Altitude (m)\na;-22,9;-43,25;61,5\n".encode("cp1252"))
    placed = read_positions(path, ["a.JPG"])(_fact("a.JPG"))
    assert (placed.latitude_deg, placed.longitude_deg, placed.altitude_m) == (-22.9, -43.25, 61.5)
    assert all(sigma != sigma for sigma in placed.position_sigma_m)
    path.write_text("image,E,N,Z\na,500000,7000000,61.5\n")
    with pytest.raises(InputMalformedError, match="does not state its system"):
        read_positions(path, ["a.JPG"])
