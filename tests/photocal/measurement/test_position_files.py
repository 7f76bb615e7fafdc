"""Positions in tables beside the pictures."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.position_files import is_event_table, read_positions

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
    given = read_positions(path, [_fact("DJI_0003.JPG"), _fact("DJI_0009.JPG")])
    placed, other = given(_fact("DJI_0003.JPG")), given(_fact("DJI_0009.JPG"))
    assert (placed.latitude_deg, placed.longitude_deg) == (47.6436479170, 16.4758945272)
    assert placed.altitude_m == 512.996
    # The list has north before east.
    assert placed.position_sigma_m == (0.013609, 0.014268, 0.029783)
    assert not other.has_position


def test_events_go_in_order_where_names_carry_no_numbers(tmp_path: Path) -> None:
    path = tmp_path / "Timestamp.MRK"
    path.write_text(MRK)
    given = read_positions(path, [_fact("b.jpg"), _fact("a.jpg")])
    assert given(_fact("a.jpg")).latitude_deg == 47.6436873208
    assert given(_fact("b.jpg")).latitude_deg == 47.6436479170


def test_tables_in_map_coordinates(tmp_path: Path) -> None:
    """geo.txt in UTM, names without their suffix; 500 000 m east is the central meridian."""
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:32633\na 500000 5276000 300.5 0 0 0 0.02 0.04\n")
    placed = read_positions(path, [_fact("a.JPG")])(_fact("a.JPG"))
    assert placed.longitude_deg == pytest.approx(15.0, abs=1e-9)
    assert placed.altitude_m == 300.5
    assert placed.position_sigma_m == (0.02, 0.02, 0.04)


def test_a_table_of_other_pictures_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:4326\nother.jpg 16.4 47.6 300\n")
    with pytest.raises(InputMalformedError, match="none of the 1 pictures"):
        read_positions(path, [_fact("a.jpg")])


def test_a_spreadsheet_of_positions(tmp_path: Path) -> None:
    """Semicolons, decimal commas and heads in Portuguese; a table that states no sigma gives none."""
    path = tmp_path / "posicoes.csv"
    path.write_bytes("Imagem;Latitude;Longitude;Altitude (m)\na;-22,9;-43,25;61,5\n".encode("cp1252"))
    placed = read_positions(path, [_fact("a.JPG")])(_fact("a.JPG"))
    assert (placed.latitude_deg, placed.longitude_deg, placed.altitude_m) == (-22.9, -43.25, 61.5)
    assert all(sigma != sigma for sigma in placed.position_sigma_m)
    path.write_text("image,E,N,Z\na,500000,7000000,61.5\n")
    with pytest.raises(InputMalformedError, match="does not state its system"):
        read_positions(path, [_fact("a.JPG")])


# Seconds of exposures: two strips at equal intervals with a turn between.
SECONDS = [2.0 * k + 13.4 * (k > 11) for k in range(24)]
HEADS = ("time,latitude,longitude,height", "Week;TOW;Lat;Lon;Alt", "id,Date,UTC time,lat,lon,h,sx,sy,sz")


def taken(*seconds: float, first: int = 1) -> list[ImageFacts]:
    """Pictures of a camera with another clock that tells whole seconds, named without numbers of events."""
    began = dt.datetime(2024, 1, 1, 3, 0, 7)
    return [
        ImageFacts(
            f"P{k:05}.JPG",
            (64, 48),
            taken=(began + dt.timedelta(seconds=int(one))).isoformat(timespec="seconds"),
        )
        for k, one in enumerate(seconds, first)
    ]


def place_of(k: int) -> tuple[float, float, float]:
    return 47.6 + 1e-4 * k, 16.4, 500.0 + k


def event_table(path: Path, head: str, rows: Sequence[int]) -> Path:
    """A table of events under such heads, without the names of pictures."""
    cut = ";" if ";" in head else ","
    lines = [head]
    for k in rows:
        moment = dt.datetime(2026, 5, 14, 8, 0, 18) + dt.timedelta(seconds=SECONDS[k])
        stamp = moment.isoformat(sep=" ", timespec="milliseconds")
        times = [stamp] if head.startswith("time") else ["2418", f"{374418.0 + SECONDS[k]:.3f}"]
        times = [str(k), *stamp.split()] if head.startswith("id") else times
        sigmas = ["0.02", "0.02", "0.03"] if head.startswith("id") else []
        lines.append(cut.join([*times, *map(repr, place_of(k)), *sigmas]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_one_line_with_a_number_is_no_event_list(tmp_path: Path) -> None:
    """Of a single row nobody sees how fast they follow each other."""
    path = tmp_path / "table.csv"
    path.write_text("id,time,lat,lon,h\n1,10.5,47.6,16.4,500\n")
    assert not is_event_table(path)


def test_a_line_of_events_without_a_week_is_named(tmp_path: Path) -> None:
    path = tmp_path / "events.csv"
    path.write_text("week,tow,lat,lon,h\n2418,374418,47.6,16.4,500\n,374420,47.6,16.4,500\n")
    with pytest.raises(InputMalformedError, match=r"events\.csv, line 3: week is empty"):
        read_positions(path, taken(*SECONDS[:2]))


@pytest.mark.parametrize("time", ["inf", "1e999", "-inf", "nan", "25:61", "9" * 400])
def test_a_time_that_is_none_is_refused(tmp_path: Path, time: str) -> None:
    path = event_table(tmp_path / "events.csv", HEADS[1], range(5))
    path.write_text(path.read_text().replace("374418.000", time))
    with pytest.raises(InputMalformedError):
        read_positions(path, taken(*SECONDS[:5]))


@pytest.mark.parametrize("head", HEADS)
def test_a_table_of_times_and_places_goes_to_the_pictures_of_these_times(tmp_path: Path, head: str) -> None:
    """One event was lost, and a picture: neither numbers nor the order tell."""
    path = event_table(tmp_path / "events.csv", head, [k for k in range(24) if k != 5])
    pictures = taken(*SECONDS[:15], *SECONDS[16:])
    assert is_event_table(path)
    given = read_positions(path, pictures)
    assert (given.by, given.left) == ("time", ("line 16",))
    assert [one.name for one in pictures if not given.has(one.name)] == ["P00006.JPG"]
    for k, name in ((0, "P00001.JPG"), (14, "P00015.JPG"), (16, "P00016.JPG"), (23, "P00023.JPG")):
        placed = given(_fact(name))
        assert (placed.latitude_deg, placed.longitude_deg, placed.altitude_m) == place_of(k)


def test_tables_of_points_and_of_pictures_are_no_events(tmp_path: Path) -> None:
    """Surveyed points have names, or numbers and some minutes between them; tables of pictures name these."""
    for head, row in (
        ("name,time,lat,lon,h", "P{k},2026-05-14 08:{k:02}:00,47.{k:02},16.4,500"),
        ("id,time,lat,lon,h", "{k},2026-05-14 08:{k:02}:00,47.{k:02},16.4,500"),
        ("image,time,lat,lon,h", "a{k}.jpg,2026-05-14 08:00:{k:02},47.{k:02},16.4,500"),
        ("time,E,N,h", "2026-05-14 08:00:{k:02},5000{k:02},7000000,500"),
    ):
        path = tmp_path / "table.csv"
        path.write_text("\n".join([head, *(row.format(k=k) for k in range(10, 16))]) + "\n")
        assert not is_event_table(path)


def test_an_order_that_times_contradict_is_refused(tmp_path: Path) -> None:
    """As many events as pictures, but the first of one and the last of the other are missing."""
    path = event_table(tmp_path / "events.csv", HEADS[0], range(1, 14))
    with pytest.raises(InputMalformedError, match=r"in their order their times differ by up to 13\.4 s"):
        read_positions(path, taken(*SECONDS[:13]))
    path = event_table(tmp_path / "events.csv", HEADS[0], range(10))
    with pytest.raises(InputMalformedError, match=r"10 events for 9 pictures, the match is ambiguous"):
        read_positions(path, taken(*SECONDS[:9]))
    assert read_positions(path, taken(*SECONDS[:10])).by == "order"
