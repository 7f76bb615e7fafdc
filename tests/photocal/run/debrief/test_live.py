"""The debrief in flight: pictures come one by one, half of one first, and the card is pulled out."""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from photocal.base.arrays import Bytes
from photocal.block.project import read_project
from photocal.measurement.features import Features, FeatureSettings, detect
from photocal.run.debrief import live, pictures, verdict
from photocal.run.debrief.pictures import PictureQuality
from photocal.run.debrief.verdict import Debrief, Together

PATIENCE_S = 120.0


@dataclass
class Followed:
    """A debrief in flight: its verdicts, and the file that the monitor reads."""

    file: Path
    told: list[Debrief] = field(default_factory=list)

    @property
    def written(self) -> dict[str, Any]:
        return dict(json.loads(self.file.read_text(encoding="utf-8")))

    def until(self, seen: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while not (self.file.exists() and seen(self.written)):
            assert time.monotonic() < end, self.file.exists() and self.written
            time.sleep(0.02)
        return self.written


@pytest.fixture
def site(flown: Path, tmp_path: Path) -> Path:
    """The flight with an empty folder of pictures."""
    site = tmp_path / "site"
    shutil.copytree(flown, site, ignore=shutil.ignore_patterns("work"))
    (site / "images").rename(tmp_path / "sent")
    (site / "images").mkdir()
    return site


@contextmanager
def following(site: Path) -> Iterator[Followed]:
    stop, followed = threading.Event(), Followed(site / "work" / "debrief.json")
    project = read_project(site / "project.toml")
    thread = threading.Thread(target=live.follow, args=(project, 2, stop, followed.told.append))
    thread.start()
    try:
        yield followed
    finally:
        stop.set()
        thread.join()


@pytest.fixture(autouse=True)
def _quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_POLL_S", 0.05)
    # A process that has stepped back cannot come forward again.
    monkeypatch.setattr(os, "nice", lambda _: 0)


def names(content: dict[str, Any]) -> list[str]:
    return [one["image"] for one in content["pictures"]]


def _holds(name: str, content: dict[str, Any]) -> bool:
    return name in names(content)


def test_pictures_are_judged_as_they_come(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is looked at once, also after a new start; all together give overlap and c with its sigma."""
    monkeypatch.setattr(live, "_QUIET_S", 0.5)
    detected: list[int] = []

    def counted(grey: Bytes, settings: FeatureSettings) -> Features:
        detected.append(1)
        return detect(grey, settings)

    monkeypatch.setattr(pictures, "detect", counted)
    monkeypatch.setenv("XDG_CACHE_HOME", str(site / "cache"))
    sent = sorted((site.parent / "sent").iterdir())
    with following(site) as followed:
        assert followed.until(lambda _: True)["pictures"] == []
        for path in sent[:7]:
            shutil.copyfile(path, site / "images" / path.name)
            followed.until(partial(_holds, path.name))
        # The verdict of all comes after that of the last picture.
        followed.until(lambda content: content["quick"] and content["coverage"])
    assert len(detected) == 7
    with following(site) as followed:
        for path in sent[7:]:
            shutil.copyfile(path, site / "images" / path.name)
        made = followed.until(
            lambda content: (
                len(names(content)) == 10 and content["quick"] and content["quick"]["joined"] == 10
            )
        )
    assert len(detected) == 10
    assert made["verdict"]["code"] == "flight-so-far"
    assert made["live"]["waiting"] == 0
    (camera,) = made["quick"]["cameras"]
    assert camera["released"]["c"] == pytest.approx(471.4, abs=4 * camera["released"]["sigma"])
    # Planned are at least 70 % (small.toml).
    assert 0.7 < made["coverage"]["overlap_median"] < 0.8
    assert [one["code"] for one in made["findings"] if one["severity"] in ("grave", "doubtful")] == []
    assert any("c 47" in line for line in made["summary"])


def test_the_last_verdict_is_of_all_pictures(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of one that comes just before the end; meanwhile they are oriented when many have come."""
    oriented: list[int] = []
    together = verdict.judged_together

    def counted(looks: Sequence[PictureQuality], *others: Any) -> Together:
        oriented.append(len(looks))
        return together(looks, *others)

    monkeypatch.setattr(verdict, "judged_together", counted)
    sent = sorted((site.parent / "sent").iterdir())
    with following(site) as followed:
        for path in sent[:6]:
            shutil.copyfile(path, site / "images" / path.name)
        followed.until(lambda content: content["quick"])
        for path in sent[6:9]:
            shutil.copyfile(path, site / "images" / path.name)
            followed.until(partial(_holds, path.name))
        shutil.copyfile(sent[9], site / "images" / sent[9].name)
    assert followed.written["quick"]["joined"] == len(names(followed.written)) == 10
    assert followed.written["live"]["waiting"] == 0
    assert len(oriented) <= 4
    assert oriented[-1] == 10
    assert followed.written["said"]["pt-BR"]["calibration"]


def test_half_a_picture_waits_for_its_end_and_what_was_judged_stays(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = sorted((site.parent / "sent").iterdir())[:2]
    folder = site / "images"
    with following(site) as followed:
        (folder / second.name).write_bytes(second.read_bytes()[:9000])
        shutil.copyfile(first, folder / first.name)
        waiting = followed.until(lambda content: names(content) == [first.name])
        assert waiting["live"]["waiting"] == 1
        assert waiting["findings"] == []
        shutil.copyfile(second, folder / second.name)
        followed.until(lambda content: names(content) == [first.name, second.name])
        # Nobody goes on writing: then it is broken.
        monkeypatch.setattr(live, "_PATIENCE_S", 0.0)
        (folder / "late.JPG").write_bytes(second.read_bytes()[:9000])
        told = followed.until(lambda content: "late.JPG" in names(content))
        assert [one["code"] for one in told["findings"]] == ["pictures-unreadable"]
        # The card is pulled out, and comes back under the same name.
        shutil.rmtree(folder)
        time.sleep(0.3)
        folder.mkdir()
        shutil.copyfile(second, folder / "later.JPG")
        followed.until(lambda content: len(names(content)) == 4)
