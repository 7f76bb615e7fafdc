"""Exposures against their images: stored turns, gimbal angles of a recorded flight."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from photocal.measurement.features import FeatureSettings
from photocal.measurement.match_images import MatchingPlan
from photocal.navigation.exposure_run import ExposureChoices, place_exposures
from photocal.navigation.image_checks import PairRotation, stored_turns
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.rig import CameraOnBody
from tests.photocal.conftest import Answer
from tests.photocal.findings.english import english

Photocal = Callable[..., Answer]


@contextmanager
def silent(_title: str, _total: float | None) -> Iterator[Callable[[float], None]]:
    yield lambda _: None


def some_of(shared: Path, numbers: Iterable[int], folder: Path) -> Path:
    """A folder with some of the recorded images."""
    (folder / "images").mkdir()
    for number in numbers:
        source = shared / f"data/uav-brighton-beach/images/DJI_{number:04d}.JPG"
        (folder / "images" / source.name).symlink_to(source)
    return folder / "images"


def pairs(turns: list[int], along: list[float]) -> list[PairRotation]:
    """Pairs of images of which each is stored turned by so many quarters."""
    return [
        PairRotation(i, i + 1, 100, (turns[i + 1] - turns[i]) % 4, 0.5, along[i])
        for i in range(len(turns) - 1)
    ]


def test_positions_tell_which_images_are_turned() -> None:
    # Three of four images are upside down: the majority is wrong.
    assert stored_turns(pairs([0, 2, 2, 2], [0.9, -0.9, -0.9])) == {1: 2, 2: 2, 3: 2}
    # Without positions the majority counts.
    assert stored_turns(pairs([0, 2, 2, 2], [np.nan] * 3)) == {0: 2}
    assert stored_turns(pairs([0, 0, 1, 0], [1.0, 1.0, 0.0])) == {2: 1}
    assert stored_turns(pairs([0, 0, 0], [1.0, 1.0])) == {}


@pytest.mark.shared
def test_exposures_of_images_alone(photocal: Photocal, shared: Path, tmp_path: Path) -> None:
    images = shared / "data/uav-brighton-beach/images"
    out = tmp_path / "out"
    answer = photocal("exposures", "--images", images, "--attitude-sigma", "1,1,2", "-o", out, "--json")
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    assert (figures["events"], figures["placed"], figures["with_attitude"]) == (18, 18, 18)
    # README of the data: some 40 m above the take-off; Lake Superior lies at 183 m.
    spans = [tuple(span.values()) for span in figures["heights"].values()]
    assert [kind.split()[0] for kind in figures["heights"]] == ["as", "above"]
    assert spans[0] == pytest.approx((198.3, 198.7), abs=0.05)
    assert spans[1] == pytest.approx((39.8, 40.2), abs=0.05)
    rows = (out / "images.csv").read_text().splitlines()
    assert len(rows) == 19
    # Gimbal pitch -89.9, yaw 45: looks down, its upper edge to the north-east.
    first = [float(v) for v in rows[1].split(",")[5:8]]
    assert first == pytest.approx([0.07, -0.07, -45.0], abs=0.01)


@pytest.mark.shared
@pytest.mark.slow
def test_a_strip_stored_upside_down(shared: Path, tmp_path: Path) -> None:
    plan = MatchingPlan(tmp_path, 1, FeatureSettings(most=1500, longest_px=1000))
    # The strip and some images of both strips beside it.
    images = some_of(shared, range(20, 34), tmp_path)
    choices = ExposureChoices(
        Sources(),
        images,
        rig=CameraOnBody(angle_sigma=np.radians([1.0, 1.0, 2.0])),
        ties=(plan, silent),
    )
    checks = {own.code: own for own in place_exposures(choices, None, None).checks}
    check = checks["image-rotations"]
    assert check.severity == "grave"
    # README of the data.
    turned = check.figures["stored_turned"]
    assert [entry["image"] for entry in turned] == [f"DJI_{n:04d}.JPG" for n in range(24, 30)]
    assert {entry["degrees"] for entry in turned} == {180}
    assert "DJI_0024.JPG to DJI_0029.JPG" in english(check)
    # Gimbal angles are good to a degree from image to image, also where the strip changes.
    assert len(check.figures["pairs"]) == 13
    assert check.figures["median_deg"] < 1.0
    assert checks["boresight"].severity == "passed"


@pytest.mark.shared
def test_images_that_do_not_overlap_say_so(shared: Path, tmp_path: Path) -> None:
    folder = some_of(shared, (18, 35), tmp_path)
    ties = (MatchingPlan(tmp_path / "cache", 1, FeatureSettings(500, 600)), silent)
    run = place_exposures(ExposureChoices(Sources(), folder, ties=ties), None, None)
    check = {own.code: own for own in run.checks}["image-rotations"]
    assert check.severity == "untested"
    assert english(check)
