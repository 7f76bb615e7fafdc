"""Strips without control are named by a check where nothing else holds them."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer

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


def southern(folder: Path, control: int, north_m: float) -> Path:
    """Make a flight whose control lies in the south only."""
    made = fly(folder, np.random.default_rng(8), plan=Plan(control=control, tie=120))
    rows = (made / "points.csv").read_text().splitlines()
    kept = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        northern = cells[-1] == "control" and float(cells[2]) > north_m
        kept.append(row.replace("control", "check") if northern else row)
    (made / "points.csv").write_text("\n".join(kept) + "\n")
    return made


@pytest.fixture
def block(tmp_path: Path) -> Path:
    return southern(tmp_path / "flight", 9, -40.0)


def test_strips_that_hang_on_their_neighbours(photocal: Photocal, block: Path) -> None:
    assert finding(photocal, block) == []
    own, seen = strips_of_table(block), seen_control(block)
    bare = {strip for strip, points in seen.items() if not points}
    assert bare
    assert bare != set(seen)
    (block / "positions.csv").unlink()
    (block / "attitudes.csv").unlink()
    (one,) = finding(photocal, block)
    images = sum(strip in bare for strip in own.values())
    assert f"({images} of {len(own)} images)" in str(one["text"])
    firsts = sorted(next(name for name, strip in own.items() if strip == wanted) for wanted in bare)
    # Strips are counted from 1 in the order of the flight; names begin with s and a number from 0.
    strips = [str(int(name[1]) + 1) for name in firsts]
    assert f"Strips {', '.join(strips)} (first images {', '.join(firsts)}) show" in str(one["text"])
    (told,) = finding(photocal, block, "--lang", "pt-BR")
    assert f"As faixas {', '.join(strips)} (primeiras imagens {', '.join(firsts)})" in str(told["text"])


def without_crossing_strips(block: Path) -> None:
    """Keep the four parallel strips, and the points that two of their images show."""
    tables = {
        name: (block / name).read_text().splitlines()
        for name in ("images.csv", "observations.csv", "points.csv")
    }
    kept = {
        name: [head, *(row for row in rows if row[:2] in ("s0", "s1", "s2", "s3") or name == "points.csv")]
        for name, (head, *rows) in tables.items()
    }
    rays = Counter(row.split(",")[1] for row in kept["observations.csv"][1:])
    shown = {name for name, count in rays.items() if count > 1}
    head, *rows = kept["points.csv"]
    kept["points.csv"] = [head, *(row for row in rows if row.split(",")[0] in shown)]
    head, *rows = kept["observations.csv"]
    kept["observations.csv"] = [head, *(row for row in rows if row.split(",")[1] in shown)]
    for name, lines in kept.items():
        (block / name).write_text("\n".join(lines) + "\n")


def test_heights_there_and_elsewhere(photocal: Photocal, tmp_path: Path) -> None:
    """The sigmas of an adjustment, the points chosen by the tables; images listed in any order."""
    block = southern(tmp_path / "flight", 16, 0.0)
    own = strips_of_table(block)
    without_crossing_strips(block)
    seen = seen_control(block)
    bare = {strip for strip in set(own.values()) if not seen[strip] and strip in ("0.0", "1.0", "2.0", "3.0")}
    assert 0 < len(bare) < 4
    (block / "positions.csv").unlink()
    (block / "attitudes.csv").unlink()
    head, *rows = (block / "images.csv").read_text().splitlines()
    np.random.default_rng(1).shuffle(rows)
    (block / "images.csv").write_text("\n".join([head, *rows]) + "\n")
    (one,) = finding(photocal, block)
    assert photocal("adjust", block, "-o", tmp_path / "run").code == 0
    strips: dict[str, set[str]] = {}
    for row in (block / "observations.csv").read_text().splitlines()[1:]:
        image, point = row.split(",")[:2]
        strips.setdefault(point, set()).add(own[image])
    outside: list[float] = []
    inside: list[float] = []
    with (tmp_path / "run" / "points.csv").open(encoding="utf-8") as stream:
        for seen_point in csv.DictReader(stream):
            (outside if strips[seen_point["point"]] <= bare else inside).append(float(seen_point["sZ"]))
    there, elsewhere = (float(np.sqrt(np.mean(np.square(sigmas)))) for sigmas in (outside, inside))
    figures = one["figures"]
    assert isinstance(figures, dict)
    assert (figures["there_m"], figures["elsewhere_m"]) == pytest.approx((there, elsewhere), rel=0.01)
    # Nothing was asked for: a pixel on the ground, 4.5 um of 12 mm at 90 m, is the measure.
    assert there > 1.5 * elsewhere
    assert (one["severity"] == "doubtful") == (there > 0.0045 / 12.0 * 90.0)
    images = sum(own[row.split(",")[0]] in bare for row in rows)
    assert f"({images} of {len(rows)} images)" in str(one["text"])
    assert "Heights there have a standard deviation of" in str(one["text"])


def test_control_everywhere(photocal: Photocal, tmp_path: Path) -> None:
    made = fly(tmp_path / "flight", np.random.default_rng(8), plan=Plan(control=16))
    (made / "positions.csv").unlink()
    (made / "attitudes.csv").unlink()
    assert finding(photocal, made) == []
