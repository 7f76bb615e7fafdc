"""A field of coded targets, one corner of some covered, some at the border: 12 rendered pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from photocal.block.results.folder import read_result
from photocal.geometry.distortion import projected
from tests.photocal.conftest import Answer
from tests.photocal.measurement.laboratory import (
    LENS,
    SIZE,
    TAPE_SIGMA_M,
    Laboratory,
    laboratory,
    picture,
    tapes,
)

TARGETS, PICTURES = 30, 12
WHOLE = laboratory(TARGETS)
LAB = replace(WHOLE, rotation=WHOLE.rotation[:PICTURES], centre=WHOLE.centre[:PICTURES])
# Over which targets a plate lies, in every third picture: 12 of some 250 views.
COVERED = {0: (3, 8, 14), 3: (5, 11, 22), 6: (2, 16, 25), 9: (7, 12, 19)}
# Sheets breathe: between two pictures three corners move by so much, the fourth with them, and no grey value
# knows it.
UNSTEADY_M = 4e-5


def moved(k: int) -> Laboratory:
    aside = np.random.default_rng(100 + k).normal(0, UNSTEADY_M, LAB.corners.shape)
    aside[:, 2] = aside[:, 1] + aside[:, 3] - aside[:, 0]
    return replace(LAB, corners=LAB.corners + aside)


@dataclass(frozen=True)
class Field:
    common_sigma: float
    corner_sigma: float
    c: float
    sigma_c: float
    rejected: set[tuple[str, str]]
    said: str
    seen: set[tuple[str, str]]


def measured(
    folder: Path, covered: Mapping[int, tuple[int, ...]], cache: Path, photocal: Callable[..., Answer]
) -> Field:
    (folder / "pictures").mkdir(parents=True)
    for k in range(PICTURES):
        # The same noise with plates and without.
        grey = picture(moved(k), k, np.random.default_rng(k), covered=covered.get(k, ()), margin=0.05)
        cv2.imwrite(str(folder / "pictures" / f"lab{k:02d}.png"), grey)
    rows = [f"{a},{b},{v:.5f},{TAPE_SIGMA_M}" for a, b, v in tapes(LAB, np.random.default_rng(3))]
    (folder / "tape.csv").write_text("\n".join(["from,to,value,sigma", *rows]) + "\n", encoding="utf-8")
    given = ("--images", folder / "pictures", "--field", "4x4_100", "--distances", folder / "tape.csv")
    said = photocal("measure", *given, "-o", folder / "block", "--run", folder / "run", "--cache", cache)
    assert said.code == 0, said.err
    record = json.loads((folder / "block" / "measurement.json").read_text(encoding="utf-8"))
    own = read_result(folder / "run").cameras["camera"]
    under = {(f"lab{k:02d}.png", str(code)) for k, codes in COVERED.items() for code in codes}
    head, *rows = (folder / "block" / "observations.csv").read_text(encoding="utf-8").splitlines()
    assert head == "image,point,x,y,sx,sy"
    cells = [row.split(",") for row in rows]
    clear = [float(row[4]) for row in cells if (row[0], row[1].split(".")[0]) not in under]
    return Field(
        record["common_sigma_px"],
        # Of targets without a plate: what a plate covers in part is rightly less sure itself.
        float(np.sqrt(np.mean(np.square(clear)))),
        own.value("c"),
        own.sigma_of("c"),
        {(one["image"], one["point"]) for one in record["rejected"]},
        said.out,
        {(row.split(",")[0], row.split(",")[1]) for row in rows},
    )


@pytest.mark.slow
def test_covered_targets_change_no_sigma_and_border_targets_are_found(
    photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    clean = measured(tmp_path / "clean", {}, tmp_path / "cache", photocal)
    spoiled = measured(tmp_path / "spoiled", COVERED, tmp_path / "cache", photocal)
    assert spoiled.common_sigma == pytest.approx(clean.common_sigma, rel=0.10)
    assert spoiled.corner_sigma == pytest.approx(clean.corner_sigma, rel=0.10)
    # What moves the corners is some 0.02 px in the pictures.
    depth = [(LAB.corners.mean(axis=1) - LAB.centre[k]) @ -LAB.rotation[k][2] for k in range(PICTURES)]
    of_four = np.sqrt((1 + 1 + 3 + 1) / 4)
    expected = of_four * UNSTEADY_M * LENS["c"] * float(np.sqrt(np.mean(1 / np.square(depth))))
    assert clean.common_sigma == pytest.approx(expected, rel=0.10)
    assert spoiled.sigma_c == pytest.approx(clean.sigma_c, rel=0.10)
    assert abs(spoiled.c - LENS["c"]) < 3.5 * spoiled.sigma_c
    # Covered corners, wrong by 0.6 to 1.2 px, are rejected and named, and what their edges shift beside them.
    bad = {(f"lab{k:02d}.png", f"{code}.1") for k, codes in COVERED.items() for code in codes}
    assert bad & spoiled.seen == set()
    assert len(bad & spoiled.rejected) >= 8
    beside = {(image, f"{point[:-2]}.{k}") for image, point in bad for k in range(1, 5)}
    assert len(spoiled.rejected - beside) <= len(clean.rejected) + 3
    assert "gross corners rejected" in spoiled.said
    # Nearer to the border than a third of its side: where the disc about it leaves the picture.
    near, found = 0, 0
    for k in range(PICTURES):
        for code, corners in enumerate(LAB.corners):
            q = (corners - LAB.centre[k]) @ LAB.rotation[k].T
            seen = projected(LAB.lens, q) * [1, -1] + (np.array(SIZE) - 1) / 2
            side = np.linalg.norm(np.roll(seen, -1, axis=0) - seen, axis=1).max()
            gap = min(seen.min(), *(np.array(SIZE) - 1 - seen.max(axis=0)))
            if 0.06 * side + 2 < gap < 0.32 * side:
                near += 1
                found += (f"lab{k:02d}.png", f"{code}.2") in clean.seen
    assert near >= 3
    assert found >= 0.8 * near


def test_tapes_are_read_before_the_pictures(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    """A wrong name among the tapes costs no measuring: the pictures here could not even be opened."""
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(b"no picture")
    (tmp_path / "tape.csv").write_text("from,to,value,sigma\n3.1,3.9,1.0,0.001\n", encoding="utf-8")
    given = ("--images", tmp_path / "pictures", "--field", "4x4_100", "-o", tmp_path / "block")
    said = photocal("measure", *given, "--distances", tmp_path / "tape.csv")
    assert said.code != 0
    assert "3.9" in said.err
    assert "tape.csv" in said.err
