"""Strips without control are named by a check where nothing else holds them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.photocal.conftest import Answer
from tests.photocal.georeferencing.flights import Plan, fly

Photocal = Callable[..., Answer]


def finding(photocal: Photocal, block: Path, *words: str) -> list[dict[str, object]]:
    said = photocal("check", block, "--json", *words)
    assert said.code == 0, said.err
    return [one for one in json.loads(said.out)["findings"] if one["code"] == "strips-without-control"]


def strips_of_table(block: Path) -> dict[str, str]:
    """Strip of each image, as the flight was simulated."""
    head, *rows = (block / "positions.csv").read_text().splitlines()
    image, strip = head.split(",").index("image"), head.split(",").index("strip")
    return {row.split(",")[image]: row.split(",")[strip] for row in rows}


def seen_control(block: Path) -> dict[str, set[str]]:
    """Control points by the strip that shows them, counted in the tables."""
    own = strips_of_table(block)
    control = {
        row.split(",")[0]
        for row in (block / "points.csv").read_text().splitlines()
        if row.endswith(",control")
    }
    seen: dict[str, set[str]] = {strip: set() for strip in own.values()}
    for row in (block / "observations.csv").read_text().splitlines()[1:]:
        image, point = row.split(",")[:2]
        if point in control:
            seen[own[image]].add(point)
    return seen


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A flight whose control lies in the south only: 14 points in three rows."""
    made = fly(tmp_path / "flight", np.random.default_rng(8), plan=Plan(control=9))
    rows = (made / "points.csv").read_text().splitlines()
    kept = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        northern = cells[-1] == "control" and float(cells[2]) > -40.0
        kept.append(row.replace("control", "check") if northern else row)
    (made / "points.csv").write_text("\n".join(kept) + "\n")
    return made


def test_strips_that_hang_on_their_neighbours(photocal: Photocal, block: Path) -> None:
    assert finding(photocal, block) == []
    own, seen = strips_of_table(block), seen_control(block)
    bare = {strip for strip, points in seen.items() if not points}
    assert bare
    assert bare != set(seen)
    (block / "positions.csv").unlink()
    (block / "attitudes.csv").unlink()
    (one,) = finding(photocal, block)
    assert one["severity"] == "note"
    images = sum(strip in bare for strip in own.values())
    assert f"({images} of {len(own)} images)" in str(one["text"])
    firsts = {next(name for name, strip in own.items() if strip == wanted) for wanted in bare}
    assert all(f"from {name}" in str(one["text"]) for name in firsts)


def test_control_everywhere(photocal: Photocal, tmp_path: Path) -> None:
    made = fly(tmp_path / "flight", np.random.default_rng(8), plan=Plan(control=16))
    (made / "positions.csv").unlink()
    (made / "attitudes.csv").unlink()
    assert finding(photocal, made) == []
