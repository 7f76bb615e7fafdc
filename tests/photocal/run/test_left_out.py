"""What a person leaves out: of the block, in the project file, and among the findings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.project import LeaveOutKeys, read_project
from photocal.findings.finding import Finding
from photocal.run.left_out import leave_out, left_out, settled, take_back
from tests.photocal.analysis.georeferencing.flights import Plan, fly

PROJECT = """# of the field
[project]
name = "a"   # short
crs = "local"
height = "local"
output = "work"

[measurements]
block = "block"
"""


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Block:
    folder = tmp_path_factory.mktemp("left") / "block"
    return read_block(fly(folder, np.random.default_rng(1), plan=Plan(tie=20)))


def rays(block: Block) -> set[tuple[str, str]]:
    seen, images, points = block.observations, block.images.names, block.points.names
    return {(images[i], points[p]) for i, p in zip(seen.image, seen.point, strict=True)}


def test_one_observation_goes_and_nothing_else(block: Block) -> None:
    image, point = sorted(rays(block))[7]
    entry = LeaveOutKeys(image=image, point=point, reason="wrong corner")
    left, (told,) = left_out(block, [entry])
    assert rays(block) - rays(left) == {(image, point)}
    assert left.images.names == block.images.names
    assert told.figures["rays"] == 1
    assert told.figures["reason"] == "wrong corner"


def test_an_image_goes_with_what_was_observed_at_its_exposure(block: Block, tmp_path: Path) -> None:
    gone = block.images.names[3]
    left, _ = left_out(block, [LeaveOutKeys(image=gone, reason="blurred")])
    assert {image for image, _ in rays(left)} == {image for image, _ in rays(block)} - {gone}
    # Positions belong to the same images by name, before and after, and in the folder.
    left.write(tmp_path / "block")
    for some in (left, read_block(tmp_path / "block")):
        where = dict(
            zip((some.images.names[k] for k in some.positions.image), some.positions.values, strict=True)
        )
        assert gone not in where
        for k, values in zip(block.positions.image, block.positions.values, strict=True):
            if block.images.names[k] != gone:
                assert where[block.images.names[k]] == pytest.approx(values)


def test_a_point_goes_and_ties_seen_once_go_with_it(block: Block) -> None:
    point = next(name for name, role in zip(block.points.names, block.points.role, strict=True) if role == 2)
    images = sorted(image for image, name in rays(block) if name == point)
    chosen = [LeaveOutKeys(image=image, point=point, reason="r") for image in images[1:]]
    for entries in ([LeaveOutKeys(point=point, reason="r")], chosen):
        left, _ = left_out(block, entries)
        assert point not in left.points.names
        assert rays(left) == {ray for ray in rays(block) if ray[1] != point}


def test_what_the_block_does_not_have_is_said(block: Block) -> None:
    left, (told,) = left_out(block, [LeaveOutKeys(image="none.jpg", reason="r")])
    assert rays(left) == rays(block)
    assert told.clauses == ("takes-no-part",)


def test_the_project_file_keeps_its_comments(tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_text(PROJECT, encoding="utf-8")
    first = LeaveOutKeys(image="a.jpg", point='"P5"', reason="it's ' \" \\ odd")
    second = LeaveOutKeys(point="P6", reason="moved")
    leave_out(path, first)
    leave_out(path, second)
    leave_out(path, second.model_copy(update={"reason": "stolen"}))
    assert path.read_text(encoding="utf-8").startswith(PROJECT)
    assert [entry.reason for entry in read_project(path).contents.leave_out] == [first.reason, "stolen"]
    take_back(path, first)
    take_back(path, second)
    assert path.read_text(encoding="utf-8").strip() == PROJECT.strip()
    with pytest.raises(ConfigurationError, match="not in the list of data left out"):
        take_back(path, second)


def test_findings_on_what_was_left_out_are_settled() -> None:
    by_hand = Finding("left-out-by-hand", "note", figures={"point": "P5", "image": "a.jpg"})
    off = Finding("mark-off", "doubtful", "P5 (a.jpg)", {"point": "P5", "image": "a.jpg"})
    other = Finding("mark-off", "doubtful", "P5 (b.jpg)", {"point": "P5", "image": "b.jpg"})
    apart = Finding("marks-apart", "doubtful", "P5", {"images": ("a.jpg", "b.jpg")})
    assert settled([off, other, apart, by_hand]) == (other, apart, by_hand)
    assert settled([off, other, apart]) == (off, other, apart)
