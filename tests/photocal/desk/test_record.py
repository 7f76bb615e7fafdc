"""The step Record: the recording beneath the folder on the monitor's own page, framed by the window alone."""

from __future__ import annotations

import http.client
import json
from pathlib import Path
from urllib.parse import urlsplit

from acquire.log.chunk import MAGIC
from tests.photocal.desk.client import Client, opened

MISSION = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.5\t8.5\t30\t1\n" + "".join(
    f"{k}\t0\t3\t16\t0\t0\t0\t0\t47.50{k}\t8.50{k}\t60\t1\n" for k in (1, 2, 3)
)


def events(window: Client, count: int) -> dict[str, object]:
    """The first events of the monitor's feed, by their names."""
    connection = http.client.HTTPConnection(urlsplit(window.url).netloc, timeout=60)
    connection.request("GET", "/monitor/feed")
    answer = connection.getresponse()
    found: dict[str, object] = {}
    while len(found) < count:
        name = answer.readline().decode().removeprefix("event: ").strip()
        found[name] = json.loads(answer.readline().decode().removeprefix("data: "))
        answer.readline()
    connection.close()
    return found


def test_without_a_recording_it_says_what_begins_one(tmp_path: Path) -> None:
    (tmp_path / "flight.toml").write_text('[recording]\noutput = "logs"\n')
    (tmp_path / "other.toml").write_text("not = [toml\n")
    with opened(tmp_path, tmp_path / "cache") as window:
        told = window.get("/api/record").json
    assert told["file"] is None
    assert told["configurations"] == ["flight.toml"]
    assert [line.split()[:2] for line in told["begin"]] == [["acquire", "check"], ["acquire", "record"]]


def test_the_newest_recording_is_shown_over_the_planned_line(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("flight-20260101T100000Z.mcap", "flight-20260102T100000Z.mcap"):
        (logs / name).write_bytes(MAGIC)
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan" / "flight.waypoints").write_text(MISSION)
    with opened(tmp_path, tmp_path / "cache") as window:
        told = window.get("/api/record").json
        assert told["file"] == "logs/flight-20260102T100000Z.mcap"
        assert told["plan"] == "plan/flight.waypoints"
        assert "--plan" in told["line"]
        page = window.get("/monitor/")
        assert page.status == 200
        assert "frame-ancestors 'self'" in page.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in window.get("/").headers["content-security-policy"]
        for path in ("/monitor/monitor.css", "/monitor/map.js", "/monitor/alarms.js"):
            assert window.get(path).status == 200
        chart = events(window, 2)["chart"]
    assert isinstance(chart, list)
    assert [(layer["kind"], layer["points"]) for layer in chart] == [
        ("plan", [[47.501, 8.501], [47.502, 8.502], [47.503, 8.503]])
    ]


def test_what_a_flight_determines_is_told_without_a_recording(tmp_path: Path) -> None:
    """In the language of the window, while the debrief follows the flight."""
    file = tmp_path / "work" / "debrief.json"
    file.parent.mkdir()
    told: dict[str, object] = {
        "live": {"waiting": 0},
        "determined": [{"lacks": ""}, {"lacks": "height"}],
        "said": {"en": {"calibration": ["a is determined", "b is not"]}},
    }
    with opened(tmp_path, tmp_path / "cache") as window:
        assert window.get("/api/record").json["calibration"] == []
        file.write_text(json.dumps(told))
        lines = window.get("/api/record").json["calibration"]
        assert lines == [["a is determined", True], ["b is not", False]]
        file.write_text(json.dumps({**told, "live": None, "said": {}}))
        assert window.get("/api/record").json["calibration"] == []


def test_a_mission_that_cannot_be_read_keeps_nobody_from_the_recording(tmp_path: Path) -> None:
    (tmp_path / "flight-20260102T100000Z.mcap").write_bytes(MAGIC)
    (tmp_path / "flight.waypoints").write_text("nothing of the kind")
    with opened(tmp_path, tmp_path / "cache") as window:
        assert window.get("/api/record").status == 200
        assert window.get("/monitor/").status == 200
