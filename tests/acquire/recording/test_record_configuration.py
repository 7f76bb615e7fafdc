"""Configurations of a recording: what cannot be meant, and what rides along with the log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from acquire.recording.configuration import RecordingConfiguration, read_configuration
from drivers import ubx
from photocal.base.errors import ConfigurationError
from tests.acquire.scripted import Script, configured, run


def test_site_antenna_and_control_file_ride_along(tmp_path: Path) -> None:
    (tmp_path / "control.csv").write_text("point,X,Y,Z\n1,0,0,0\n")
    site = {
        "operator": "A. Surveyor", "place": "runway", "antenna_height_m": 1.652,
        "antenna_height_kind": "slant", "control_file": "control.csv",
    }  # fmt: skip
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    source = Script([ubx.encode(0x0213, bytes(8))])
    done, _ = run(
        {**configured(rover), "site": site}, tmp_path, lambda told: bool(told), None, {"rover": source}
    )
    with done.paths[0].open("rb") as stream:
        reader = make_reader(stream)
        notes = {m.name: m.metadata for m in reader.iter_metadata()}
        attached = {a.name: a.data for a in reader.iter_attachments()}
    assert notes["site"] == {key: str(value) for key, value in site.items()}
    assert attached == {"control.csv": (tmp_path / "control.csv").read_bytes()}


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ({"vehicle": {}}, "mavlink"),
        ({"ublox": {"rate_ms": 200}}, "port"),
        ({"ublox": {"port": "usb"}}, "rate_ms"),
        ({"user": "me"}, "ntrip"),
        ({"position": [47.0, 8.0, 400.0]}, "ntrip"),
        ({"position_from": "rover", "url": "ntrip://127.0.0.1/M"}, "not another link"),
        ({"position": [95.0, 8.0, 400.0], "url": "ntrip://127.0.0.1/M"}, "90"),
        ({"corrections_to": ["nobody"]}, "nobody"),
    ],
)
def test_links_that_cannot_be_meant(link: dict[str, Any], words: str, tmp_path: Path) -> None:
    def toml(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
        return json.dumps(value)

    lines = {"name": "rover", "protocol": "ubx", "url": "udp://127.0.0.1:1", **link}
    text = '[recording]\noutput = "x"\n[[link]]\n' + "".join(f"{k} = {toml(v)}\n" for k, v in lines.items())
    path = tmp_path / "flight.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        read_configuration(path)


def test_an_antenna_height_says_its_kind(tmp_path: Path) -> None:
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    with pytest.raises(ValueError, match="slant"):
        RecordingConfiguration.model_validate({**configured(rover), "site": {"antenna_height_m": 1.6}})
