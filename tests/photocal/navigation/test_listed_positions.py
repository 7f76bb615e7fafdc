"""Event lists with one fault each: named by their lines, or refused; recorded lists say nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from photocal.base.errors import InputMalformedError
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.listed_positions import ListedPositions, judge_listed, judge_marks, judge_order
from photocal.measurement.picture_tests import judge_pictures
from photocal.measurement.position_files import read_positions
from photocal.navigation.events import CameraEventList, read_mrk
from photocal.navigation.exposure_checks import Evidence, check_exposures
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime, UtcTime
from tests.photocal.conftest import Answer
from tests.photocal.navigation.test_exposure_checks import shots, trajectory

WEEK, START_S = 2211, 296288.242869
LATITUDE, LONGITUDE, HEIGHT_M = 47.64368732, 16.47592717, 512.998
METRES_OF_DEGREE = 111_200.0
# Irregular, so that only one alignment with pictures fits.
TIMES_S = np.cumsum([0.0, 1.53, 1.47, 1.72, 1.5, 1.91, 1.44, 1.6, 1.55, 1.83, 1.49, 1.66])
Floats = NDArray[np.float64]
Photocal = Callable[..., Answer]
Change = Callable[[list[str]], Sequence[str]]


def lines(count: int = 12) -> list[str]:
    """A strip at 10 m/s northwards with fixed ambiguities, as a Phantom 4 RTK writes it."""
    return [
        f"{k + 1}\t{START_S + TIMES_S[k]:.6f}\t[{WEEK}]\t     3,N\t     0,E\t    75,V\t"
        f"{LATITUDE + 10 * TIMES_S[k] / METRES_OF_DEGREE:.10f},Lat\t{LONGITUDE:.10f},Lon\t"
        f"{HEIGHT_M:.3f},Ellh\t0.014391, 0.013698, 0.029694\t50,Q"
        for k in range(count)
    ]


def cells(line: str, **changed: str) -> str:
    """A line with other cells, by their place."""
    places = {"time": 1, "lat": 6, "lon": 7, "height": 8, "sigma": 9}
    own = line.split("\t")
    for name, text in changed.items():
        own[places[name]] = text
    return "\t".join(own)


def listed(folder: Path, rows: Sequence[str]) -> CameraEventList:
    path = folder / "flight_Timestamp.MRK"
    path.write_text("\n".join(rows) + "\n")
    return read_mrk(path)


def with_line(number: int, **changed: str) -> Change:
    return lambda rows: [cells(r, **changed) if k == number else r for k, r in enumerate(rows, 1)]


NOWHERE = {"lat": "0.0000000000,Lat", "lon": "0.0000000000,Lon", "height": "0.000,Ellh"}
FAR = {"lat": f"{LATITUDE + 5000 / METRES_OF_DEGREE:.10f},Lat"}
FAULTS: dict[str, tuple[Change, str, tuple[str, ...]]] = {
    "zeros": (with_line(5, **NOWHERE), "events-without-position", ("line 5",)),
    "outside the globe": (with_line(3, lat="147.6,Lat"), "events-without-position", ("line 3",)),
    "sigma of zero": (with_line(7, sigma="0.000, 0.000, 0.000"), "events-without-sigma", ("line 7",)),
    "5 km within 2 s": (with_line(6, **FAR), "events-jump", ("line 6",)),
    "5 km at the end": (with_line(12, **FAR), "events-jump", ("line 12",)),
    "twice": (lambda rows: [*rows[:4], rows[3], *rows[4:]], "events-twice", ("line 5",)),
    "order": (
        lambda rows: [*rows[:3], rows[4], rows[3], *rows[5:]], "events-out-of-order", ("line 5",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_by_its_line(tmp_path: Path, name: str) -> None:
    change, code, named = FAULTS[name]
    found = listed(tmp_path, change(lines()))
    assert [(one.code, one.figures["lines"], one.severity) for one in found.findings] == [
        (code, named, "doubtful")
    ]
    # What is named is not used; all else is, in the order of time.
    assert (np.diff(found.events.time.ns) > 0).all()
    assert len(found.events) == 12
    lost = {"events-without-position", "events-jump"}
    assert int(found.placed.placed.sum()) == (11 if code in lost else 12)
    unknown = np.isnan(found.placed.covariance_m2[:, 0, 0]).sum()
    assert unknown == (code == "events-without-sigma")


def test_a_list_of_zeros_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputMalformedError, match=r"12 of 12 positions .* are impossible") as refusal:
        listed(tmp_path, [cells(row, **NOWHERE) for row in lines()])
    assert "flight_Timestamp.MRK" in str(refusal.value)


def test_the_longer_part_of_two_places_is_believed() -> None:
    """Two flights in one list, 40 km apart and minutes after each other."""
    n, first = 30, 20
    time = np.asarray(np.arange(n) * 2.0, dtype=float)
    place = np.column_stack([LATITUDE + 1e-4 * np.arange(n), np.full(n, LONGITUDE), np.full(n, 500.0)])
    place[first:, 1] += 0.5
    rows = ListedPositions(
        tuple(f"line {k}" for k in range(n)), time, place, np.full((n, 3), 0.02), np.arange(n)
    )
    judged = judge_listed(rows)
    assert judged.placed.tolist() == [True] * first + [False] * (n - first)
    assert [one.code for one in judged.findings] == ["events-jump"]


@pytest.mark.parametrize("seed", range(20))
def test_aircraft_in_a_hurry_are_believed(seed: int) -> None:
    """Speeds up to 40 m/s in all directions, pauses, code positions of 3 m beside fixed ones."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([0.7, 2.0, 60.0], 200, p=[0.6, 0.38, 0.02]))
    step = rng.normal(0, 20.0, (200, 3)).clip(-23, 23) * np.diff(time, prepend=0.0)[:, None]
    sigma = np.where(rng.random((200, 1)) < 0.2, 3.0, 0.02) * np.ones(3)
    track = np.cumsum(step, axis=0) + rng.normal(0, 1.0, (200, 3)) * sigma
    place = np.array([LATITUDE, LONGITUDE, 500.0]) + track / [METRES_OF_DEGREE, 75e3, 1.0]
    judged = judge_listed(ListedPositions(("x",) * 200, time, place, sigma, np.arange(200)))
    assert judged.findings == ()


@pytest.mark.shared
def test_a_recorded_list_says_nothing(shared: Path) -> None:
    found = read_mrk(shared / "data/rtk-mrk-gcp-helenenschacht/101FTASK_Timestamp.mrk")
    assert found.findings == ()
    assert found.placed.placed.all()


def pictures(
    folder: Path, *, beside_m: float = 0.0, late_s: float = 0.0, utc: bool = True, count: int = 12
) -> Path:
    """Pictures of these exposures with the positions of a receiver, and their time as M4E writes it."""
    folder.mkdir()
    utc_ns = GpsTime.from_week([WEEK] * count, (START_S + TIMES_S[:count]).tolist()).to_utc()
    for k, stamp in enumerate(UtcTime(utc_ns.ns + round(late_s * 1e9)).iso()):
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "DJI", "M4E"
        # The camera's own clock is eight hours and twenty seconds beside it.
        exif.get_ifd(0x8769)[0x9003] = f"2022:05:25 {(18 + k // 60) % 24:02}:{k:02}:40"
        gps = exif.get_ifd(0x8825)
        latitude = LATITUDE + (10 * TIMES_S[k] + beside_m) / METRES_OF_DEGREE
        for tag, value in ((2, latitude), (4, LONGITUDE)):
            gps[tag] = (IFDRational(int(value)), IFDRational(0), IFDRational(round(value % 1 * 36e8), 10**6))
        gps[1], gps[3], gps[6] = "N", "E", IFDRational(513)
        exact = f'drone-dji:UTCAtExposure="{stamp[:26].replace("Z", "")}"' if utc else ""
        packet = f"<x:xmpmeta><rdf:Description {exact} drone-dji:RelativeAltitude='+60.0'/></x:xmpmeta>"
        Image.new("L", (64, 48), 8 * k).save(folder / f"DJI_{k + 1:04}.JPG", exif=exif, xmp=packet.encode())
    return folder


def exposures(photocal: Photocal, folder: Path, **more: float) -> dict[str, object]:
    """Findings of `photocal exposures` that are no small ones, by code, of the list and such pictures."""
    mrk = folder / "x_Timestamp.MRK"
    mrk.write_text("\n".join(lines()) + "\n")
    images = pictures(folder / "pictures", **more)  # type: ignore[arg-type]
    answer = photocal("exposures", "--mrk", mrk, "--images", images, "-o", folder / "out", "--json")
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    return {one["code"]: one for one in figures["findings"]} | {"": figures}


def test_pictures_with_their_utc_need_no_offset(photocal: Photocal, tmp_path: Path) -> None:
    found = exposures(photocal, tmp_path)
    assert set(found) == {""}
    camera = found[""]["cameras"][0]  # type: ignore[index]
    assert camera["matched"] == 12
    assert camera["clock_offset_s"] == pytest.approx(0.0, abs=1e-3)


def test_a_list_that_is_beside_its_pictures_is_named(photocal: Photocal, tmp_path: Path) -> None:
    found = exposures(photocal, tmp_path, beside_m=60.0)
    one = found["list-of-another-flight"]
    assert one["severity"] == "grave"  # type: ignore[index]
    assert one["figures"]["apart_m"] == pytest.approx(60.0, abs=0.5)  # type: ignore[index]
    assert one["figures"]["lines"][0] == "line 1"  # type: ignore[index]


def test_a_list_in_utc_is_named(photocal: Photocal, tmp_path: Path) -> None:
    """The events lie as much later as GPS time was ahead of UTC in 2022."""
    found = exposures(photocal, tmp_path, late_s=-18.0)
    one = found["events-beside-time"]
    assert (one["severity"], one["cause"]) == ("grave", "leap-seconds-list")  # type: ignore[index]
    assert one["figures"]["late_s"] == pytest.approx(18.0, abs=0.01)  # type: ignore[index]


def test_a_list_of_another_zone_is_refused_with_the_best_alignment(
    photocal: Photocal, tmp_path: Path
) -> None:
    mrk = tmp_path / "x_Timestamp.MRK"
    mrk.write_text("\n".join(lines()) + "\n")
    images = pictures(tmp_path / "pictures", late_s=8 * 3600.0)
    answer = photocal("exposures", "--mrk", mrk, "--images", images, "-o", tmp_path / "out")
    assert answer.code != 0
    assert "12 of 12 images fit if their clock is +28800 s off" in answer.err.replace("\n", " ")


def test_fewer_pictures_than_events_are_aligned(photocal: Photocal, tmp_path: Path) -> None:
    found = exposures(photocal, tmp_path, count=10)
    assert found["events-without-image"]["figures"]["events"] == ["11", "12"]  # type: ignore[index]


def test_tables_of_positions_are_judged_too(tmp_path: Path) -> None:
    path = tmp_path / "positions.csv"
    for row, wrong in (
        ("b.jpg,0,0,0,0.02,0.02,0.03", "are impossible"),
        ("b.jpg,47.6,16.4,500,0,0,0", "sigma"),
    ):
        path.write_text(
            f"image,latitude,longitude,height,sx,sy,sz\na.jpg,47.6,16.4,500,0.02,0.02,0.03\n{row}\n"
        )
        with pytest.raises(InputMalformedError, match=rf"{wrong}.*picture b.jpg"):
            read_positions(path, [ImageFacts(n, (64, 48)) for n in ("a.jpg", "b.jpg")])
    mrk = tmp_path / "x.MRK"
    mrk.write_text("\n".join(FAULTS["5 km within 2 s"][0](lines())))
    with pytest.raises(InputMalformedError, match=r"80 m/s allow \(line 6\)"):
        read_positions(mrk, [ImageFacts(f"DJI_{k:04}.JPG", (64, 48)) for k in range(1, 13)])


def renumbered(rows: Sequence[str]) -> list[str]:
    """The lines counted from 1."""
    return ["\t".join([str(k), *row.split("\t")[1:]]) for k, row in enumerate(rows, 1)]


def later(row: str) -> str:
    """A line of another flight over the same site, an hour later."""
    return cells(row, time=f"{float(row.split()[1]) + 3600:.6f}")


def in_week(row: str, seconds: float) -> str:
    """A line at a time around the end of the week, whose number did not go on."""
    return cells(row, time=f"{seconds % 604800:.6f}")


SPOILT: dict[str, tuple[Change, str]] = {
    "two flights that count from 1": (
        lambda rows: [*rows[:6], *renumbered([later(row) for row in rows[6:]])],
        "line 7: has another position for event 1 than line 1: two flights in one list",
    ),
    "a decimal comma": (with_line(6, height="512,998,Ellh"), "line 6: is not an event"),
    "a head": (lambda rows: ["Number\tTime", *rows], "line 1: is not an event"),
    "cut": (lambda rows: [*rows[:11], rows[11][:40]], "line 12: is not an event"),
    "a decimal point that slipped": (with_line(6, lat="4.7643687320,Lat"), "80 m/s allow (line 6)"),
    "sorted backwards": (lambda rows: rows[::-1], "11 of 12 events of the list are earlier"),
    "a week that did not go on": (
        lambda rows: [in_week(r, 604790 + s) for r, s in zip(rows, TIMES_S, strict=True)],
        "5 of 12 events of the list are earlier than a preceding one (line 8, line 9,",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_list_is_refused_with_its_line(photocal: Photocal, tmp_path: Path, name: str) -> None:
    """By `photocal new`, which goes on with the positions of the pictures."""
    change, said = SPOILT[name]
    pictures(tmp_path / "DJI_001")
    (tmp_path / "x_Timestamp.MRK").write_text("\n".join(change(lines())) + "\n")
    answer = photocal("new", tmp_path, "--json")
    assert answer.code == 0, answer.err
    (left,) = (line for line in json.loads(answer.out)["missing"] if "x_Timestamp.MRK" in line)
    assert said in left
    assert "positions =" not in (tmp_path / "project.toml").read_text()


def test_a_line_that_is_missing_is_told(photocal: Photocal, tmp_path: Path) -> None:
    pictures(tmp_path / "DJI_001")
    (tmp_path / "x_Timestamp.MRK").write_text("\n".join([*lines()[:5], *lines()[6:]]) + "\n")
    told = json.loads(photocal("new", tmp_path, "--json").out)["missing"]
    assert "x_Timestamp.MRK has 11 of the 12 pictures: stated positions are kept for DJI_0006.JPG" in told


def between(one: str, other: str) -> str:
    """An event of a picture that is there no more."""
    own, next_one = one.split("\t"), other.split("\t")
    second = (float(own[1]) + float(next_one[1])) / 2
    latitude = (float(own[6].split(",")[0]) + float(next_one[6].split(",")[0])) / 2
    return cells(one, time=f"{second:.6f}", lat=f"{latitude:.10f},Lat")


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        (
            [*lines()[:5], *lines()[6:]],
            "line 6: has the number of DJI_0006.JPG with the time of DJI_0007.JPG, and so it is with 6 of 11",
        ),
        (
            [*lines()[:5], between(*lines()[4:6]), *lines()[5:]],
            "line 7: has the number of DJI_0007.JPG with the time of DJI_0006.JPG, and so it is with 6 of 12",
        ),
    ],
    ids=["a line is missing", "a picture was deleted"],
)
def test_a_list_that_was_numbered_anew_is_not_used(
    photocal: Photocal, tmp_path: Path, kept: list[str], said: str
) -> None:
    pictures(tmp_path / "DJI_001")
    (tmp_path / "x_Timestamp.MRK").write_text("\n".join(renumbered(kept)) + "\n")
    answer = photocal("new", tmp_path, "--json")
    (left,) = (line for line in json.loads(answer.out)["missing"] if "x_Timestamp.MRK" in line)
    assert said in left
    assert "positions =" not in (tmp_path / "project.toml").read_text()


def flown(seed: int) -> tuple[Floats, Floats]:
    """A list, and what pictures state of strips there and back, degrees.

    Pictures are off by an offset, by 1.5 m with a memory of a minute, and up to a second late.
    """
    rng = np.random.default_rng(seed)
    spacing, speed = rng.uniform(8, 40), rng.uniform(5, 18)
    strips, each = int(rng.integers(1, 7)), int(rng.integers(12, 25))
    along = np.arange(each) * spacing
    north = np.concatenate([along if k % 2 == 0 else along[::-1] for k in range(strips)])
    east = np.repeat(np.arange(strips) * 1.5 * spacing, each)
    heading = np.repeat(np.where(np.arange(strips) % 2, -1.0, 1.0), each)
    place = np.column_stack([north, east]) + rng.normal(0, 0.3, (len(north), 2))
    memory = np.exp(-spacing / speed / 60.0)
    error = np.zeros_like(place)
    error[0] = rng.normal(0, 1.5, 2)
    for k in range(1, len(error)):
        error[k] = memory * error[k - 1] + rng.normal(0, 1.5 * np.sqrt(1 - memory**2), 2)
    late = np.column_stack([rng.uniform(0, 1) * speed * heading, np.zeros(len(north))])
    told = place + error - late + rng.normal(0, 3, 2)

    def degrees(metres: Floats) -> Floats:
        scale = METRES_OF_DEGREE * np.array([1.0, np.cos(np.radians(LATITUDE))])
        return np.column_stack([metres / scale + (LATITUDE, LONGITUDE), np.full(len(metres), HEIGHT_M)])

    return degrees(place), degrees(told)


def test_a_lost_line_is_found_and_a_whole_list_says_nothing() -> None:
    """At random places; at the ends of strips, and where few rows are left, none can be told."""
    found = []
    for seed in range(200):
        listed, told = flown(seed)
        names = [f"picture {k}" for k in range(len(listed))]
        assert judge_order(names, listed, told) == []
        lost = int(np.random.default_rng(1000 + seed).integers(4, len(listed) - 5))
        judged = judge_order(names[:-1], np.delete(listed, lost, axis=0), told[:-1])
        found += [(one.cause, names.index(one.subject) - lost) for one in judged]
    assert len(found) > 0.8 * 200
    assert {cause for cause, _ in found} == {"lines-missing"}
    assert np.mean([abs(beside) <= 1 for _, beside in found]) > 0.9


def test_a_table_of_another_flight_is_named(tmp_path: Path) -> None:
    path = tmp_path / "positions.csv"
    path.write_text("image,latitude,longitude,height\na.jpg,47.6005,16.4,500\nb.jpg,47.6,16.4,500\n")
    place = read_positions(path, [ImageFacts(n, (64, 48)) for n in ("a.jpg", "b.jpg")])
    own = [
        ImageFacts(n, (64, 48), latitude_deg=47.6, longitude_deg=16.4, altitude_m=500.0)
        for n in ("a.jpg", "b.jpg")
    ]
    (found,) = judge_pictures([place(one) for one in own])
    assert (found.code, found.figures["images"]) == ("table-beside-pictures", ("a.jpg",))
    assert found.figures["apart_m"] == pytest.approx(55.6, abs=0.2)


def test_marks_of_a_receiver_are_judged_too() -> None:
    """A bouncing contact, and a receiver without fixes; others say nothing."""
    time, accuracy = np.array([0.0, 2.0, 2.0004, 4.0, 6.0]), np.full(5, 2e-8)
    names = [f"mark {k}" for k in range(5)]
    assert judge_marks(names, time * [1, 1, 1.01, 1, 1], accuracy) == []
    (twice,) = judge_marks(names, time, accuracy)
    assert (twice.code, twice.figures["lines"]) == ("events-twice", ("mark 2",))
    accuracy[3] = 0.4
    (_, unsure) = judge_marks(names, time, accuracy)
    assert (unsure.code, unsure.figures["lines"]) == ("marks-unsure", ("mark 3",))
    assert unsure.figures["accuracy_ms"] == pytest.approx(400.0)


def test_positions_that_an_autopilot_tells_are_judged_too() -> None:
    """CAM records: one before the receiver had a position."""
    path = trajectory()
    antenna, events = shots(path)
    claimed = np.full((len(events), 6), np.nan)
    claimed[:, :3] = antenna.placed.place

    def codes(told: Floats) -> list[tuple[str, tuple[str, ...]]]:
        given = replace(events, source="CAM", claimed=told)
        evidence = Evidence(CameraOnBody(), given, antenna, path, None, None, None, [], None)
        return [
            (f.code, f.figures["lines"]) for f in check_exposures(evidence) if f.code.startswith("events-")
        ]

    assert codes(claimed) == []
    wrong = claimed.copy()
    wrong[4, :3] = 0.0
    wrong[9, 0] += 0.05
    assert codes(wrong) == [("events-without-position", ("event 4",)), ("events-jump", ("event 9",))]
