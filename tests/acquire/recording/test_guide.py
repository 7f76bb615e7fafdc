"""docs/recording.md: its keys, addresses and alarms are those of the program, its commands run."""

from __future__ import annotations

import glob
import json
import re
import shlex
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from acquire.recording.alarms import ALARM
from acquire.recording.configuration import RecordingConfiguration, Site, read_configuration
from acquire.recording.recorder import source_of_link
from photocal.base.checked_toml import Table
from tests.acquire.live import Process, free_port, is_bound, until

GUIDE = Path(__file__).parents[3] / "docs" / "recording.md"
TEXT = GUIDE.read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def keys(section: type[BaseModel], seen: set[str]) -> set[str]:
    """Return the keys of a table and of the tables within."""
    for name, field in section.model_fields.items():
        seen.add(name)
        for part in _types(field.annotation):
            if isinstance(part, type) and issubclass(part, Table):
                keys(part, seen)
    return seen


def _types(annotation: object) -> list[object]:
    inner = [part for argument in get_args(annotation) for part in _types(argument)]
    return [annotation, *inner]


def test_the_whole_configuration_is_one_and_has_every_key(tmp_path: Path) -> None:
    first, whole = blocks("toml")
    for number, content in enumerate((first, whole)):
        path = tmp_path / f"{number}.toml"
        path.write_text(content)
        chosen = read_configuration(path)
        for link in chosen.link:
            source_of_link(link, {"CASTER": "secret"})
    words = set(re.findall(r"\w+", whole))
    assert keys(RecordingConfiguration, set()) - words == set()
    assert set(Site.model_validate(chosen.site).model_extra or {}) == {"place", "operator"}


def test_defaults_that_are_told_are_the_defaults(tmp_path: Path) -> None:
    first, whole = blocks("toml")
    for name, content in (("first", first), ("whole", whole)):
        (tmp_path / name).write_text(content)
    default = read_configuration(tmp_path / "first")
    shown = read_configuration(tmp_path / "whole")
    for key in ("flush_s", "rotate_mb", "rotate_min", "least_free_mb"):
        assert getattr(default.recording, key) == getattr(shown.recording, key), key
    assert default.link[0].silent_s == shown.link[0].silent_s
    assert f"({default.link[0].baud})" in whole
    assert shown.link[0].vehicle is not None
    assert type(shown.link[0].vehicle)().timesync_s == shown.link[0].vehicle.timesync_s


def test_every_alarm_is_explained() -> None:
    kinds = set(re.findall(r"\w+", ALARM.members["kind"]["description"])) - {"or"}
    explained = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE))
    assert explained == kinds


@pytest.fixture
def port() -> int:
    return free_port()


def test_the_commands_run(tmp_path: Path, port: int) -> None:
    """As they stand, with a port that is free and little waiting between the frames."""
    (tmp_path / "first.toml").write_text(blocks("toml")[0].replace("14550", str(port)))
    answers: dict[str, str] = {}
    with ExitStack() as running:
        recorder: Process | None = None
        for line in blocks("sh")[0].splitlines():
            command = shlex.split(
                line.replace("14550", str(port)).replace("--speed 10", "--speed 20"), comments=True
            )
            program, *arguments = [
                w
                for word in command
                for w in (glob.glob(str(tmp_path / word)) or [word])  # noqa: PTH207
            ]
            assert program == "acquire"
            words = [sys.executable, "-m", "acquire", *arguments]
            if arguments[0] == "record":
                recorder = running.enter_context(Process(words, tmp_path))
                recorder.line("recording to ")
                until(lambda: is_bound(port), "the port of the vehicle")
                continue
            if arguments[0] == "info":
                assert recorder is not None
                recorder.end(signal.SIGINT)
                assert recorder.process.returncode == 0
            done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{line}: {done.stderr}"
            answers[arguments[0]] = done.stdout
    assert "differential" in answers["monitor"].lower(), answers["monitor"]
    assert re.search(r"vehicle: 25[12]\d frames", answers["info"])
    assert answers["recover"].rstrip().endswith("messages")


def test_the_preflight_that_is_named_exists(tmp_path: Path, port: int) -> None:
    (tmp_path / "first.toml").write_text(blocks("toml")[0].replace("14550", str(port)))
    words = [
        sys.executable,
        "-m",
        "acquire",
        "check",
        "first.toml",
        "--seconds",
        "0.3",
        "--json",
    ]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 10
    subjects = {finding["subject"] for finding in json.loads(done.stdout)["findings"]}
    assert {"vehicle: frames", "vehicle: heartbeat", "vehicle: fix", "disk logs"} <= subjects
