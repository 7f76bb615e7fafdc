"""Control and lists of exposures beside pictures with positions: `photocal new` names contradictions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from pyproj import Transformer

from photocal.measurement.image_facts import read_facts
from photocal.measurement.position_files import read_positions
from photocal.run.new_project import new_project

Place = tuple[float, float, float]
# Around a village of Austria, deg and m; pictures 50 m above.
POINTS: tuple[Place, ...] = (
    (16.47592, 47.64350, 463.7),
    (16.47619, 47.64347, 461.7),
    (16.47599, 47.64330, 461.5),
    (16.47604, 47.64313, 460.2),
)
_UTM = Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True)


def utm(place: Place) -> Place:
    east, north = _UTM.transform(*place[:2])
    return east, north, place[2]


def write_picture(path: Path, place: Place) -> None:
    """Write a small picture that states a position 50 m above a point."""
    longitude, latitude, height = place
    exif = Image.Exif()
    exif[271], exif[272] = "Autel Robotics", "XT705"
    exif.get_ifd(0x8769).update({37386: IFDRational(1057, 100), 41989: 29})
    degrees = {2: latitude, 4: longitude}
    exif.get_ifd(0x8825).update(
        {1: "N", 3: "E", 5: b"\0", 6: IFDRational(round(10 * (height + 50)), 10)}
        | {key: (int(v), 0, IFDRational(round(v % 1 * 3.6e7), 10_000)) for key, v in degrees.items()}
    )
    Image.new("L", (64, 48), 120).save(path, exif=exif)


def folder_of(folder: Path, system: str, written: Callable[[Place], Place], table: str = "") -> Path:
    """Write pictures and a list; each point is marked in two of the pictures."""
    names = [f"MAX_{k:04d}.JPG" for k in range(len(POINTS))]
    for name, place in zip(names, POINTS, strict=True):
        write_picture(folder / name, place)
    rows = [
        "{:.8f}\t{:.8f}\t{:.8f}".format(*written(place)) + f"\t{20 + k}\t{10 + n}\t{names[n]}\tGCP {k}"
        for k, place in enumerate(POINTS)
        for n in (k, k - 1)
    ]
    (folder / "gcp_list.txt").write_text("\n".join([system, *rows] if system else rows) + "\n")
    if table:
        (folder / "coordinates.csv").write_text(table)
    return folder


def swapped(place: Place) -> Place:
    return place[1], place[0], place[2]


def in_feet(place: Place) -> Place:
    east, north, height = (value / 0.3048 for value in utm(place))
    return east, north, height


@pytest.mark.parametrize(
    ("system", "written"),
    [
        ("EPSG:32633", utm),
        ("", utm),
        ("EPSG:4326", lambda place: place),
        ("", lambda place: place),
        ("EPSG:4326", swapped),
        ("", swapped),
    ],
    ids=["map", "map without its system", "degrees", "degrees alone", "latitude first", "both"],
)
def test_what_leaves_no_doubt_is_settled(
    tmp_path: Path, system: str, written: Callable[[Place], Place]
) -> None:
    made = new_project(folder_of(tmp_path, system, written), height="ellipsoidal")
    assert not made.asked
    assert 'crs = "EPSG:32633"' in made.path.read_text()
    assert (made.rows, made.rows_used) == (8, 8)
    first = (tmp_path / "control.csv").read_text().splitlines()[1].split(",")
    assert first[0] == "GCP 0"
    assert [float(cell) for cell in first[1:4]] == pytest.approx(utm(POINTS[0]), abs=0.01)


@pytest.mark.parametrize(
    ("system", "written", "said"),
    [
        ("EPSG:32633", lambda place: swapped(utm(place)), "E and N of the control points are exchanged"),
        ("", lambda place: swapped(utm(place)), "E and N of the control points are exchanged"),
        ("EPSG:32633", in_feet, "the control points are in feet"),
        ("EPSG:32632", utm, "is not the zone of the control points: that is EPSG:32633"),
        ("EPSG:31982", utm, "is not the zone of the control points: that is EPSG:32633"),
        # Nobody knows which of the two is right.
        ("EPSG:4326", lambda place: (-place[0], *place[1:]), "positions or of the control points is wrong"),
    ],
    ids=["exchanged", "exchanged without a system", "feet", "zone", "country", "west"],
)
def test_a_slip_of_all_points_is_named_before_any_run(
    tmp_path: Path, system: str, written: Callable[[Place], Place], said: str
) -> None:
    made = new_project(folder_of(tmp_path, system, written), height="ellipsoidal")
    assert any(said in line for line in made.doubtful)


def test_a_table_of_control_is_no_list_of_positions(tmp_path: Path) -> None:
    """A surveyor's table beside the list, in metres and degrees: its points are no pictures."""
    rows = (f"{k};{utm(p)[0]:.2f};{utm(p)[1]:.2f};{p[2]};{p[0]};{p[1]}" for k, p in enumerate(POINTS))
    table = "\n".join(["\ufeffName;Easting;Northing;Elevation;Longitude;Latitude", *rows])
    made = new_project(folder_of(tmp_path, "EPSG:4326", lambda p: p, table), height="ellipsoidal")
    assert "coordinates.csv" not in made.path.read_text()
    assert not any("coordinates.csv" in line for line in made.missing)


def test_metres_beside_degrees_are_control_in_the_zone(tmp_path: Path) -> None:
    rows = (f"{k};{utm(p)[0]:.2f};{utm(p)[1]:.2f};{p[2]};{p[0]};{p[1]}" for k, p in enumerate(POINTS))
    table = "\n".join(["Name;Easting;Northing;Elevation;Longitude;Latitude", *rows])
    folder = folder_of(tmp_path, "", utm, table)
    (folder / "gcp_list.txt").unlink()
    made = new_project(folder, height="ellipsoidal")
    assert 'crs = "EPSG:32633"' in made.path.read_text()
    first = (tmp_path / "control.csv").read_text().splitlines()[1].split(",")
    assert [float(cell) for cell in first[1:4]] == pytest.approx(utm(POINTS[0]), abs=0.01)


def event(number: int, place: Place) -> str:
    """A line of a Timestamp.MRK list."""
    longitude, latitude, height = place
    return (
        f"{number}\t{296288.2 + 2 * number:.6f}\t[2211]\t     3,N\t     0,E\t    75,V\t{latitude:.10f},Lat\t"
        f"{longitude:.10f},Lon\t{height + 50:.3f},Ellh\t0.014, 0.013, 0.029\t50,Q\n"
    )


@pytest.mark.parametrize(
    ("places", "used", "said"),
    [
        (POINTS, True, ""),
        (POINTS[:3], True, "has 3 of the 4 pictures: stated positions are kept for DJI_0003.JPG"),
        ([(lon, lat + 0.06, h) for lon, lat, h in POINTS], False, "is it the table of another flight?"),
        ([(0.0, 0.0, 0.0)] * 4, False, "4 of 4 positions of the list are impossible"),
        ([*POINTS[:3], (0.0, 0.0, 0.0)], False, "(line 4)"),
        ([*POINTS[:3], (16.47, 47.69, 460.0)], False, "(line 4)"),
    ],
    ids=["own", "one is lost", "another flight", "zeros", "one zero", "a jump"],
)
def test_lists_of_exposures_are_opened_before_they_are_written_down(
    tmp_path: Path, places: Sequence[Place], used: bool, said: str
) -> None:
    for k, place in enumerate(POINTS):
        write_picture(tmp_path / f"DJI_{k:04d}.JPG", place)
    (tmp_path / "DJI_202605181012_001_Timestamp.MRK").write_text("".join(map(event, range(4), places)))
    made = new_project(tmp_path)
    assert ("positions = " in made.path.read_text()) == used
    lists = [line for line in made.missing if "Timestamp.MRK" in line]
    assert any(said in line for line in lists) if said else not lists
    assert all(line.startswith("not used: ") for line in lists) or used


def test_events_of_pictures_that_were_deleted_are_named(tmp_path: Path) -> None:
    for k in (0, 1, 3):
        write_picture(tmp_path / f"DJI_{k:04d}.JPG", POINTS[k])
    (tmp_path / "DJI_1_001_Timestamp.MRK").write_text("".join(map(event, range(4), POINTS)))
    made = new_project(tmp_path)
    assert any("1 event without a picture (line 3)" in line for line in made.missing)


def test_pictures_that_a_table_of_positions_does_not_have_are_named(tmp_path: Path) -> None:
    for k, place in enumerate(POINTS):
        write_picture(tmp_path / f"MAX_{k}.JPG", place)
    rows = (f"MAX_{k}.JPG,{lat},{lon},{h + 50}" for k, (lon, lat, h) in enumerate(POINTS[:3]))
    (tmp_path / "positions.csv").write_text("\n".join(["image,lat,lon,alt", *rows]) + "\n")
    made = new_project(tmp_path)
    said = "positions.csv has 3 of the 4 pictures: stated positions are kept for MAX_3.JPG"
    assert any(said in line for line in made.missing)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lat, lon: (lat, -lon), "the sign of the longitudes is wrong"),
        (lambda lat, lon: (-lat, lon), "the sign of the latitudes is wrong"),
        (lambda lat, lon: (lon, lat), "latitude and longitude are exchanged"),
        (lambda lat, lon: (lat + 1, lon), "far from those that the pictures state"),
    ],
    ids=["west", "south", "exchanged", "elsewhere"],
)
def test_a_table_of_positions_far_from_the_pictures_is_not_used(
    tmp_path: Path, change: Callable[[float, float], tuple[float, float]], said: str
) -> None:
    for k, place in enumerate(POINTS):
        write_picture(tmp_path / f"MAX_{k}.JPG", place)
    rows = ("MAX_{},{},{},510".format(k, *change(lat, lon)) for k, (lon, lat, _) in enumerate(POINTS))
    (tmp_path / "positions.csv").write_text("\n".join(["image,lat,lon,alt", *rows]) + "\n")
    made = new_project(tmp_path)
    assert any("not used" in line and said in line for line in made.missing)
    text = made.path.read_text()
    assert "positions = " not in text
    assert 'crs = "EPSG:32633"' in text


GEODETIC = (
    "%  GPST                   latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
)
CARTESIAN = (
    "%  GPST                        x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   sdy(m)\n"
)


def solution(number: int, place: Place) -> str:
    """A line of RTKLIB's list of events (2.4.2 Manual, appendix B.1)."""
    longitude, latitude, height = place
    return (
        f"2026/05/18 10:18:{8.2 + 2 * number:06.3f} {latitude:14.9f} {longitude:14.9f} {height + 50:10.4f}"
        "   1  11   0.0130   0.0140   0.0290   0.0021  -0.0012   0.0004   0.20   18.2\n"
    )


def by_week(number: int, place: Place) -> str:
    """The same with week and second, between semicolons, without what stands behind the sigmas."""
    _, _, *cells = solution(number, place).split()
    return ";".join(["2419", f"{123500.2 + 2 * number:.3f}", *cells[:8]]) + "\n"


@pytest.mark.parametrize(
    ("head", "line", "places", "said"),
    [
        (GEODETIC, solution, POINTS, ""),
        ("", by_week, POINTS, ""),
        (GEODETIC, solution, POINTS[:3], "lists 3 events for 4 pictures"),
        (
            GEODETIC,
            solution,
            [(lon, lat + 0.06, h) for lon, lat, h in POINTS],
            "the table of another flight?",
        ),
        (GEODETIC, solution, [*POINTS[:3], (16.47, 97.69, 460.0)], "line 5: is not a position"),
        (CARTESIAN, solution, POINTS, "line 1: has other coordinates"),
    ],
    ids=["own", "week and second", "one is lost", "another flight", "beyond the pole", "geocentric"],
)
def test_events_of_rtklib_are_positions_of_the_pictures(
    tmp_path: Path, head: str, line: Callable[[int, Place], str], places: Sequence[Place], said: str
) -> None:
    for k, place in enumerate(POINTS):
        write_picture(tmp_path / f"P{k}.JPG", place)
    text = head + "".join(map(line, range(4), places))
    (tmp_path / "reach_raw_events.pos").write_text(text)
    made = new_project(tmp_path)
    assert ('positions = "reach_raw_events.pos"' in made.path.read_text()) == (not said)
    lists = [one for one in made.missing if "_events.pos" in one]
    # These pictures have no time.
    assert any((said or "in their order") in one for one in lists)
    if not said:
        pictures = [read_facts(tmp_path / f"P{k}.JPG") for k in range(4)]
        places_of = read_positions(tmp_path / "reach_raw_events.pos", pictures)
        facts = places_of(read_facts(tmp_path / "P2.JPG"))
        longitude, latitude, height = POINTS[2]
        assert (facts.latitude_deg, facts.longitude_deg) == pytest.approx((latitude, longitude), abs=1e-9)
        assert facts.altitude_m == pytest.approx(height + 50, abs=1e-4)
        assert facts.position_sigma_m == pytest.approx((0.014, 0.013, 0.029))


def test_a_sigma_of_zero_in_a_solution_is_none(tmp_path: Path) -> None:
    """Four decimals are printed: a position without an error would hold the block."""
    write_picture(tmp_path / "P0.JPG", POINTS[0])
    (tmp_path / "x_events.pos").write_text(solution(0, POINTS[0]).replace("0.0130", "0.0000"))
    picture = read_facts(tmp_path / "P0.JPG")
    facts = read_positions(tmp_path / "x_events.pos", [picture])(picture)
    assert np.isnan(facts.position_sigma_m[1])
    assert (facts.position_sigma_m[0], facts.position_sigma_m[2]) == (0.014, 0.029)


def test_heights_are_asked_where_a_list_of_exposures_alone_places_the_pictures(tmp_path: Path) -> None:
    """Positions of a receiver are compared with the heights of control, whoever has written them."""
    for k in range(len(POINTS)):
        Image.new("L", (160, 120)).save(tmp_path / f"MAX_{k:04d}.JPG")
    (tmp_path / "101FTASK_Timestamp.mrk").write_text("".join(map(event, range(4), POINTS)))
    rows = [f"P{k},{x:.3f},{y:.3f},{z:.3f}" for k, (x, y, z) in enumerate(map(utm, POINTS))]
    (tmp_path / "control.csv").write_text("\n".join(["name,E,N,Z", *rows]) + "\n")
    made = new_project(tmp_path)
    assert made.asked == ["height: whether the control points' heights are ellipsoidal or orthometric"]
    text = made.path.read_text()
    assert 'positions = "101FTASK_Timestamp.mrk"' in text
    assert 'crs = "EPSG:32633"' in text


def test_lenses_of_one_gimbal_are_no_rig_where_the_card_was_copied_flat(tmp_path: Path) -> None:
    for k, place in enumerate(POINTS):
        for lens in "WT":
            write_picture(tmp_path / f"DJI_20260518101200_{k:04d}_{lens}.JPG", place)
    made = new_project(tmp_path)
    text = made.path.read_text()
    assert "[[head]]" not in text
    assert 'folder = "DJI_20260518101200_*_W.JPG"' in text
    assert any(line.startswith("lens T (thermal): 4 pictures") for line in made.known)


@pytest.mark.parametrize(("between", "comma"), [(",", False), (";", True), ("\t", False), (" ", False)])
@pytest.mark.parametrize("name", ["control.csv", "points.txt"])
def test_points_without_a_head_are_control(tmp_path: Path, name: str, between: str, comma: bool) -> None:
    """Name, east, north, height: what other programs export, and no table of marks."""
    folder = folder_of(tmp_path, "", utm)
    (folder / "gcp_list.txt").unlink()
    rows = [
        between.join([f"GCP{k}", *(f"{value:.3f}" for value in utm(place))]) for k, place in enumerate(POINTS)
    ]
    (folder / name).write_text("\n".join(rows).replace(".", "," if comma else "."))
    made = new_project(folder, height="ellipsoidal")
    assert 'crs = "EPSG:32633"' in made.path.read_text()
    assert any(line.startswith(f"control: 4 points of {name}") for line in made.known)
    (table,) = (path for path in folder.glob("*control.csv") if "point,X,Y,Z" in path.read_text())
    first = table.read_text().splitlines()[1].split(",")
    assert first[0] == "GCP0"
    assert [float(cell) for cell in first[1:4]] == pytest.approx(utm(POINTS[0]), abs=0.002)


def test_marks_without_a_head_stay_marks(tmp_path: Path) -> None:
    """Pix4D's table of marks: image, point, x, y; the points have numbers."""
    folder = folder_of(tmp_path, "", utm)
    (folder / "gcp_list.txt").unlink()
    (folder / "control.csv").write_text(
        "\n".join(f"{k},{','.join(map(str, utm(p)))}" for k, p in enumerate(POINTS))
    )
    (folder / "marks.txt").write_text(
        "\n".join(f"MAX_{n:04d}.JPG,{k},20,10" for k in range(4) for n in (0, 1))
    )
    made = new_project(folder, height="ellipsoidal")
    assert any(line == "control: 4 points of control.csv, 8 marks in 2 images" for line in made.known)


@pytest.mark.parametrize("name", ["DJI_0001.JPG", "677000.25", "12:01:02"])
def test_places_of_pictures_clouds_and_tracks_are_no_control(tmp_path: Path, name: str) -> None:
    folder = folder_of(tmp_path, "", utm)
    (folder / "gcp_list.txt").unlink()
    (folder / "places.txt").write_text(f"{name},677001.5,5277001.5,463.5\n")
    new_project(folder, height="ellipsoidal")
    assert not (folder / "control.csv").exists()


@pytest.mark.parametrize(
    ("head", "order"),
    [
        ("point,E,N,Z,image,x,y", (0, 1, 2, 3, 4, 5, 6)),
        ("point,X,Y,Z,image,u,v", (0, 1, 2, 3, 4, 5, 6)),
        ("image;x;y;gcp;easting;northing;height", (4, 5, 6, 0, 1, 2, 3)),
    ],
)
def test_points_and_marks_may_stand_in_one_table(tmp_path: Path, head: str, order: tuple[int, ...]) -> None:
    """A row for each mark, with the place of its point: one place each, and what contradicts it is named."""
    folder = folder_of(tmp_path, "", utm)
    (folder / "gcp_list.txt").unlink()
    rows = [
        [f"GCP{k}", *(f"{value:.3f}" for value in utm(place)), f"MAX_{n:04d}.JPG", "20.5", "10.5"]
        for k, place in enumerate(POINTS)
        for n in (0, 1)
    ]
    rows[-1][2] = "5276999.000"
    between = ";" if ";" in head else ","
    lines = [head, *(between.join(row[k] for k in order) for row in rows)]
    (folder / "gcp.csv").write_text("\n".join(lines))
    made = new_project(folder, height="ellipsoidal")
    assert any(line == "control: 4 points of gcp.csv, 7 marks in 2 images" for line in made.known)
    assert any("line 9: GCP3 has other coordinates than before" in line for line in made.doubtful)
    (marks,) = (path for path in folder.glob("*marks.csv") if "image,point" in path.read_text())
    # Other programs count from the corner of a pixel, our tables from its centre.
    assert marks.read_text().splitlines()[1].split(",")[:4] == ["MAX_0000.JPG", "GCP0", "20.000", "10.000"]
