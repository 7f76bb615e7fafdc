"""What `acquire info` says of a log before packing up."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from acquire.channels.summary import verdict_lines, verdict_on
from acquire.commands.texts import texts
from tests.acquire.conftest import Acquire


def kind(name: str, longest_gap_s: float = 0.2, rate_hz: float = 5.0) -> dict[str, Any]:
    return {"type": name, "frames": 100, "longest_gap_s": longest_gap_s, "rate_hz": rate_hz}


def link(name: str, *kinds: dict[str, Any], damage: int = 0) -> dict[str, Any]:
    return {"link": name, "types": list(kinds), "damage_bytes": damage, "frame_bytes": 10_000}


ENGLISH = texts("en")
ROVER = link("rover", kind("RXM-RAWX"), kind("RXM-SFRBX"), kind("TIM-TM2", 30.0))
BASE = link("base", kind("1077", 1.0, 1.0), kind("1005", 10.0, 0.1))
SEEN = {"trigger": 10, "feedback": 10, "rising": 10, "falling": 9}


def figures(*links: dict[str, Any], complete: bool = True) -> dict[str, Any]:
    return {"links": list(links), "complete": complete}


def test_a_whole_flight_is_complete() -> None:
    said = verdict_on(figures(ROVER, BASE), SEEN)
    assert said["complete"]
    assert verdict_lines(said, ENGLISH) == [
        "verdict: complete",
        "  pictures: 10 triggered, 10 reported by the autopilot, 10 time marks",
        "  rover: raw observations at 5 Hz without gaps",
        "  base: raw observations at 1 Hz without gaps",
        "  can be processed: PPK yes; exposures yes",
    ]


@pytest.mark.parametrize(
    ("links", "seen", "words"),
    [
        (
            (ROVER, BASE),
            {**SEEN, "feedback": 9},
            "only 9 of 10 pictures were reported by the autopilot",
        ),
        (
            (ROVER, link("base", kind("1077", 7.5))),
            SEEN,
            "base: raw observations at 5 Hz with gaps, the longest 7.5 s",
        ),
        ((ROVER, link("base", kind("1077"), damage=4_000)), SEEN, "4000 bytes belong to no valid frame"),
        ((ROVER,), SEEN, "PPK no (raw observations of rover only"),
        ((link("rover", kind("RXM-RAWX")), BASE), SEEN, "no satellite orbits"),
        ((ROVER, link("base", kind("1077", 7.5), kind("1087", 9.0))), SEEN, "longest 7.5 s"),
        ((ROVER, BASE), {}, "exposures no (no time mark and no camera feedback)"),
    ],
)
def test_what_lacks_is_named(links: tuple[dict[str, Any], ...], seen: dict[str, int], words: str) -> None:
    assert words in "\n".join(verdict_lines(verdict_on(figures(*links), seen), ENGLISH))


def test_a_flight_with_gaps_is_not_complete() -> None:
    assert not verdict_on(figures(ROVER, link("base", kind("1077", 7.5))), SEEN)["complete"]


def test_a_cut_log_is_not_complete() -> None:
    said = verdict_on(figures(ROVER, BASE, complete=False), SEEN)
    assert not said["complete"]
    assert "acquire recover" in "\n".join(verdict_lines(said, ENGLISH))


def test_links_of_two_days_are_named() -> None:
    """Base and rover of two flights are no flight; a vehicle's clock beside theirs is worth a look."""
    rover, base = {**ROVER, "span_ns": [0, 10]}, {**BASE, "span_ns": [11, 20]}
    said = verdict_on(figures(rover, base), SEEN)
    assert not said["complete"]
    assert "PPK no (rover and base do not overlap in time)" in "\n".join(verdict_lines(said, ENGLISH))
    vehicle = {**link("vehicle"), "span_ns": [11, 20]}
    said = verdict_on(figures(rover, {**BASE, "span_ns": [5, 20]}, vehicle), SEEN)
    assert (said["complete"], said["ppk"]["possible"]) == (False, True)
    assert said["remarks"] == ["rover and vehicle do not overlap in time"]


def test_a_packed_recording_that_was_cut_is_not_complete() -> None:
    cut = {"metadata": {"import rover": {"packing_cut": "True"}}}
    said = verdict_on(figures(ROVER, BASE) | cut, SEEN)
    assert not said["complete"]
    assert "  rover: the imported file ends early" in verdict_lines(said, ENGLISH)


def test_a_base_that_stops_before_the_last_picture_is_named(acquire: Acquire, tmp_path: Path) -> None:
    """No gap shows it, for what lacks is the end; the exposures tell from when on it is missed."""
    made = acquire("simulate", "flight", "small", "--level", "observations", "-o", tmp_path)
    assert made.returncode == 0, made.stderr
    site, log = tmp_path / "site", tmp_path / "flight.mcap"
    base = (site / "base.ubx").read_bytes()
    (site / "base.ubx").write_bytes(base[: len(base) // 2])
    done = acquire("import", *(site / name for name in ("vehicle.tlog", "rover.ubx", "base.ubx")), "-o", log)
    assert done.returncode == 0, done.stderr
    figures = json.loads(acquire("info", log, "--json").stdout)
    ends_s = next(link["span_ns"][1] for link in figures["links"] if link["link"] == "base") / 1e9
    with closing(mavutil.mavlink_connection(str(site / "vehicle.tlog"))) as flight:
        reported = iter(lambda: flight.recv_match(type="CAMERA_FEEDBACK"), None)
        late = sum(picture._timestamp > ends_s for picture in reported)
    assert 0 < late < 10
    assert not figures["verdict"]["complete"]
    assert f"base: no raw observations at {late} of 10 exposures" in acquire("info", log).stdout
