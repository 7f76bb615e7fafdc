"""Mutilated control lists through `new` and the checks of `run`: nothing is lost without a word.

`PHOTOCAL_LISTS=2000` tries so many.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
from PIL import Image

from photocal.base.errors import PhotocalError
from photocal.project import ASKED, read_project
from photocal.run.project_checks import check_project

COUNT = int(os.environ.get("PHOTOCAL_LISTS", "40"))
PICTURES = tuple(f"a{k}.jpg" for k in range(4))
SYSTEMS = (
    "EPSG:2180", "PUWG1992", "WGS84 UTM 22S", "EPSG:4326", "EPSG:999999", "local", "Poland", "",
    "Gauss-Boaga", "+proj=utm +zone=34 +datum=WGS84", "\x00\xff", "EPSG:2180+5773", "EPSG:4978", "UTM",
)  # fmt: skip
CELLS = ("nan", "inf", "1e400", "-1e300", "", "x", "1,5", "0", "99999999", "-3", "a0.jpg", "½", "P 1")


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def _rows(rng: np.random.Generator) -> list[list[str]]:
    """A list as it should be."""
    rows = []
    for k in range(int(rng.integers(1, 7))):
        east, north, height = rng.uniform([634500, 485200, 100], [634700, 485400, 120])
        for image in rng.choice(PICTURES, int(rng.integers(1, 5)), replace=False):
            x, y = rng.uniform(0, [160, 120])
            rows.append(
                [f"{east:.3f}", f"{north:.3f}", f"{height:.3f}", f"{x:.1f}", f"{y:.1f}", image, f"P{k}"]
            )
    return rows


def _mutilated(rows: list[list[str]], rng: np.random.Generator) -> list[list[str]]:
    """The same after some accidents."""
    for _ in range(int(rng.integers(0, 6))):
        k = int(rng.integers(len(rows)))
        row, cell = list(rows[k]), int(rng.integers(len(rows[k]) or 1))
        kind = int(rng.integers(9))
        if kind == 0 and row:
            row[cell % len(row)] = str(rng.choice(CELLS))
        elif kind == 1:
            row = row[:cell]
        elif kind == 2 and len(row) > 1:
            row[0], row[1] = row[1], row[0]
        elif kind == 3 and len(row) > 5:
            row[5] = str(rng.choice(["gone.jpg", "A0.JPG", "img/a1.jpg", "a2", "7"]))
        elif kind == 4 and len(row) > 6:
            row[6] = str(rng.choice(["P0", "P1", "", "point2"]))
        elif kind == 5:
            rows.insert(k, list(row))
        elif kind == 6 and len(row) > 4:
            row[3], row[4] = row[4], f"{float(rng.uniform(-500, 9000)):.0f}"
        elif kind == 7 and row:
            row[0] = row[0].replace(".", ",")
        else:
            row = [*row, "more"]
        rows[k] = row
    return rows


def _write(folder: Path, rng: np.random.Generator) -> int | None:
    """Write a list of one of many forms; give how many rows it has, None for one that is cut."""
    rows = [row for row in _mutilated(_rows(rng), rng) if "".join(row).strip()]
    between = str(rng.choice([" ", "\t", "  "]))
    lines = [between.join(row) for row in rows]
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    system = str(rng.choice(SYSTEMS))
    content = "\n".join([system, *lines]) + str(rng.choice(["\n", "", "\n\n# end\n"]))
    data = content.encode(str(rng.choice(["utf-8", "utf-8", "utf-8", "utf-16", "cp1252"])), "replace")
    if rng.random() < 0.1:
        data = data.replace(b"\n", b"\r\n")
    cut = rng.random() < 0.05
    (folder / "gcp_list.txt").write_bytes(data[: int(rng.integers(len(data)))] if cut else data)
    return None if cut or not system else len(lines)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four small pictures that no mark is looked up in."""
    folder = tmp_path_factory.mktemp("lists")
    for name in PICTURES:
        Image.new("L", (160, 120)).save(folder / name)
    return folder


@pytest.mark.timeout(300 + 3 * COUNT)
def test_no_row_is_lost_silently(folder: Path, photocal: Callable[..., Answer]) -> None:
    """Each list is read, and every row used or named; what is asked or refused is one line."""
    for seed in range(COUNT):
        rng = np.random.default_rng(seed)
        for name in ("project.toml", "control.csv", "marks.csv"):
            (folder / name).unlink(missing_ok=True)
        count = _write(folder, rng)
        said = photocal("new", folder, "--json", *(("--height", "ellipsoidal") if seed % 2 else ()))
        assert said.code == 0, (seed, said.err)
        found = json.loads(said.out)
        rows = found["rows"]
        assert rows["read"] == rows["used"] + len(rows["not_used"]), seed
        assert count is None or rows["read"] in (0, count), seed
        marks = folder / "marks.csv"
        if rows["read"]:
            assert rows["used"] == (len(marks.read_text().splitlines()) - 1 if marks.exists() else 0), seed
        else:
            # Nothing of it is a list: it is named as a whole.
            assert any("gcp_list.txt" in line for line in found["missing"]), seed
        text = (folder / "project.toml").read_text(encoding="utf-8")
        if f'"{ASKED}"' in text:
            assert found["asked"], seed
            (folder / "project.toml").write_text(text.replace(f'"{ASKED}"', '"local"'), encoding="utf-8")
        # As `run` looks at it before any work: right, or refused as what a person can mend.
        with suppress(PhotocalError):
            check_project(read_project(folder / "project.toml"))
