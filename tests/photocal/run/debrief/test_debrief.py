"""Faults injected into a simulated flight with pictures: each is named, and nothing else."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.progress_bars import progress
from photocal.block.project import read_project
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.findings.texts import catalogue, finding_text
from photocal.geometry.camera import Camera
from photocal.measurement import match_images
from photocal.run.debrief import pictures
from photocal.run.debrief.verdict import Debrief, debrief, debrief_json
from tests.conftest import needs_engine
from tests.photocal.run.debrief.conftest import (
    BOTH,
    FOCAL,
    FOCAL_MM,
    SERIAL,
    SIZE,
    TAKEN,
    edited,
    fly,
    names,
    smeared,
)
from tests.simulated import import_log


@pytest.fixture
def site(flown: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(flown, tmp_path / "site"))


def last(c: float = FOCAL) -> Camera:
    """Camera of the last certificate: the true one, or another."""
    true = from_pinhole(
        Pinhole(SIZE, c, c, 321.4, 238.1, -0.0412, 0.0236, -0.0061, 0.00042, -0.00031), "sim-0", "truth"
    )
    return replace(true, sigma=np.where(true.values == c, 0.02, 0.0))


def judged(site: Path, camera: Camera | None = None) -> Debrief:
    return debrief(read_project(site / "project.toml"), 1, progress, () if camera is None else (camera,))


def codes(made: Debrief) -> set[str]:
    return {one.code for one in made.findings if not one.small}


@pytest.mark.slow
def test_a_clean_flight_is_complete(flown: Path) -> None:
    needs_engine()
    made = judged(flown, last())
    assert codes(made) == set()
    assert made.verdict.code == "flight-complete"
    content = json.loads((flown / "work" / "debrief.json").read_text(encoding="utf-8"))
    assert content == json.loads(json.dumps(debrief_json(made)))
    assert content["said"]["en"]["verdict"] == content["verdict"]["text"]
    assert content["said"]["pt-BR"]["verdict"].startswith("O voo está completo")
    assert len(content["exposures"]) == len(content["pictures"]) == 10
    assert {one["state"] for one in content["exposures"]} == {"fixed"}
    assert {one["strip"] for one in content["exposures"]} == {1, 2}


@pytest.mark.slow
def test_a_picture_that_comes_in_costs_that_picture(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The card is still being read: what was looked at, and the pairs that were matched, are kept."""
    needs_engine()
    done: list[str] = []

    def counted(name: str, module: Any) -> None:
        function = getattr(module, name)

        def call(*given: Any) -> Any:
            done.append(name)
            return function(*given)

        monkeypatch.setattr(module, name, call)

    monkeypatch.setenv("XDG_CACHE_HOME", str(site / "cache"))
    path = names(site)[-1]
    late = path.rename(site / path.name)
    codes(judged(site))
    counted("detect", pictures)
    counted("match", match_images)
    late.rename(path)
    assert codes(judged(site)) == set()
    assert done.count("detect") == 1
    assert 1 <= done.count("match") <= len(names(site)) - 1
    done.clear()
    judged(site)
    assert not done


def test_bad_pictures_are_named(site: Path) -> None:
    paths = names(site)
    edited(paths[0], smeared)
    edited(paths[4], lambda image: image.point(lambda grey: min(255, 3 * grey)))
    edited(paths[5], lambda image: image.point(lambda grey: grey // 6))
    paths[9].write_bytes(paths[9].read_bytes()[:3000])
    made = judged(site)
    found = {one.code: one.figures.get("images") for one in made.findings if not one.small}
    assert found["pictures-blurred"] == (paths[0].name,)
    assert found["pictures-too-bright"] == (paths[4].name,)
    assert found["pictures-too-dark"] == (paths[5].name,)
    assert found["pictures-unreadable"] == (paths[9].name,)
    assert made.verdict.code != "flight-complete"


def test_another_camera_and_another_zoom_are_named(site: Path) -> None:
    paths = names(site)
    edited(paths[0], lambda image: image, {SERIAL: "9999"})
    edited(paths[9], lambda image: image, {FOCAL_MM: 12.3})
    found = {one.code: one.figures.get("images") for one in judged(site).findings if not one.small}
    assert found["pictures-of-other-camera"] == (paths[0].name,)
    assert found["lens-changed"] == (paths[9].name,)


def test_missing_pictures_name_the_strip_to_fly_again(site: Path) -> None:
    needs_engine()
    for path in names(site)[6:8]:
        path.unlink()
    made = judged(site)
    assert {"events-without-image", "strip-gap"} <= codes(made)
    assert [one.subject for one in made.findings if one.code == "strip-gap"] == ["2"]
    assert made.verdict.code == "fly-again"


def test_the_card_of_another_flight_is_named(site: Path) -> None:
    for path in names(site):
        day = {TAKEN: "2025:06:12 08:00:00", BOTH: "2025:06:12 08:00:00"}
        edited(path, lambda image: image, day)
    assert codes(judged(site)) & {"wrong-card", "exposures-unknown"}


def test_a_lens_that_has_changed_is_named(flown: Path) -> None:
    """By 3 %: beside a free principal point ten pictures of almost flat ground tell c to 0.4 % only."""
    needs_engine()
    made = judged(flown, last(FOCAL * 1.03))
    assert codes(made) == {"c-changed"}
    (found,) = [one for one in made.findings if one.code == "c-changed"]
    assert found.figures["percent"] == pytest.approx(-100.0 * 0.03 / 1.03, abs=1.2)


@pytest.mark.parametrize(
    ("language", "said"),
    [
        ("en", "471.44 ± 0.23 px, the last certificate states 476.200 ± 0.020 px"),
        ("pt-BR", "471,44 ± 0,23 px, onde o último certificado tem 476,200 ± 0,020 px"),
    ],
)
def test_no_principal_distance_has_more_digits_than_its_sigma(language: str, said: str) -> None:
    released = {"c": 471.437812, "sigma": 0.234567, "credible": True, "change": -0.01}
    found = pictures.since_certificate({"camera": "sim-0", "unit": "px", "released": released}, [last(476.2)])
    assert said in finding_text(found, catalogue(language))


def test_a_base_that_did_not_run_and_telemetry_that_ended_are_named(site: Path) -> None:
    needs_engine()
    log = next(site.glob("vehicle.*"))
    log.write_bytes(log.read_bytes()[: int(0.6 * log.stat().st_size)])
    import_log(site, ("vehicle", "rover"))
    found = codes(judged(site))
    assert "no-ppk" in found
    assert found & {"telemetry-gap", "exposure-not-placed"}


@pytest.mark.slow
def test_float_positions_are_named(tmp_path: Path) -> None:
    """Cycle slips every few seconds leave ambiguities that are not fixed."""
    needs_engine()
    made = judged(fly(tmp_path, faults=["cycle_slips"], fault_sizes={"slips_per_hour": 720.0}))
    (found,) = [one for one in made.findings if one.code == "positions-not-fixed"]
    assert found.figures["float"] + found.figures["single"] > 0.33 * found.figures["all"]
    assert made.verdict.code == "fly-again"
