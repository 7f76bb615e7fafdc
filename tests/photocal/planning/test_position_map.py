"""Observed minus adjusted camera positions: the formula, and files and words of `photocal flown`."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from photocal.adjustment.mounting import TIME, Positions
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.mounting import make_mounting
from photocal.block.results.adjusted import adjust_block
from photocal.block.setup import MountingKeys
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.rotation import angles_from_matrix
from photocal.planning.position_map import position_differences
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.conftest import Answer


def test_differences_are_what_was_put_in() -> None:
    """Antennas on a mast above cameras that look down, turned by their headings, moving at 10 m/s."""
    random = np.random.default_rng(2)
    heading = random.uniform(0, 360, 8)
    # Camera axes of a nadir picture: x right, y forward, z up; object axes east, north, up.
    rotation = Rotation.from_euler("z", -heading[:, None], degrees=True).as_matrix()
    station, error = random.normal(0, 100, (8, 3)), random.normal(0, 0.05, (8, 3))
    forward = np.swapaxes(rotation, 1, 2) @ np.array([0.0, 1.0, 0.0])
    velocity = 10.0 * forward
    # 0.2 m forward and 0.3 m above the camera (body axes forward, right, down); events 0.01 s early.
    antenna = station + 0.2 * forward + [0.0, 0.0, 0.3] - velocity * 0.01 + error
    positions = Positions(
        np.arange(8),
        antenna,
        np.tile(1e-4 * np.eye(3), (8, 1, 1)),
        velocity,
        np.zeros(8, np.int64),
        np.zeros(8),
        np.zeros(8),
    )
    given = make_mounting(MountingKeys(lever_arm_m=(0.2, 0.0, -0.3)), 1)
    names = tuple(f"{k}" for k in range(8))
    common = given.values.copy()
    common[TIME] = 0.01
    images = OrientedImages(
        names, (), np.zeros(8, np.int64), np.hstack([angles_from_matrix(rotation), station])
    )
    found = position_differences(images, positions, given, common)
    assert found is not None
    assert found.d_m == pytest.approx(error, abs=1e-9)
    assert found.figures()["mean_m"] == pytest.approx(error.mean(axis=0))


def test_the_command_maps_them_and_names_strips_without_control(
    photocal: Callable[..., Answer], tmp_path: Path
) -> None:
    errors = Errors(datum_m=(0.0, 0.0, 0.4))
    folder = fly(tmp_path / "block", np.random.default_rng(5), errors, Plan())
    block = read_block(folder)
    strip = {name: int(k) for name, k in zip(block.images.names, _strips(block), strict=True)}
    # Of the control points that which the fewest strips see stays; the others become check points.
    seen: dict[str, set[int]] = {}
    for i, j in zip(block.observations.image, block.observations.point, strict=True):
        if block.points.of_role("control")[j]:
            seen.setdefault(block.points.names[j], set()).add(strip[block.images.names[i]])
    kept = min(seen, key=lambda name: len(seen[name]))
    lines = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    others = [line if line.startswith(f"{kept},") else line.replace("control", "check") for line in lines]
    (folder / "points.csv").write_text("\n".join(others) + "\n", encoding="utf-8")
    adjust_block(folder, tmp_path / "run")
    said = photocal("flown", folder, "--run", tmp_path / "run", "-o", tmp_path / "flown")
    assert said.code == 0, said.err
    figures = json.loads((tmp_path / "flown" / "flown.json").read_text(encoding="utf-8"))
    with (tmp_path / "flown" / "positions.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == figures["positions"]["exposures"] == len(block.images.names)
    with closing(sqlite3.connect(tmp_path / "flown" / "positions.gpkg")) as database:
        assert database.execute("select count(*) from positions").fetchone() == (len(rows),)
    assert (tmp_path / "flown" / "positions.svg").read_text(encoding="utf-8").startswith("<?xml")
    assert "observed minus adjusted" in said.out
    counts = figures["control_by_strip"]
    assert sum(row["images"] for row in counts) == len(block.images.names)
    bare = [row["strip"] for row in counts if not row["control_points"]]
    assert len(bare) == len(counts) - len(seen[kept])
    # Positions of 3 cm hold strips without control.
    assert bare
    assert figures["held_by_positions"]
    assert "strips without control" not in said.out


def test_strips_that_nothing_holds_are_named(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    """Positions of 3 m, those of a camera's own receiver, hold no strip."""
    folder = fly(tmp_path / "block", np.random.default_rng(5), Errors(), Plan(position_sigma_m=3.0))
    lines = (folder / "points.csv").read_text(encoding="utf-8").splitlines()
    # Control of the southern row is left.
    moved = [
        line.replace("control", "check")
        if line.endswith("control") and float(line.split(",")[2]) > -40
        else line
        for line in lines
    ]
    (folder / "points.csv").write_text("\n".join(moved) + "\n", encoding="utf-8")
    said = photocal("flown", folder, "-o", tmp_path / "flown")
    assert said.code == 0, said.err
    figures = json.loads((tmp_path / "flown" / "flown.json").read_text(encoding="utf-8"))
    assert not figures["held_by_positions"]
    counts = figures["control_by_strip"]
    bare = [row for row in counts if not row["control_points"]]
    assert 0 < len(bare) < len(counts)
    # The fourth strip of the simulation is the northern one.
    assert any((row["strip"], row["first"]) == (4, "s3_0") for row in bare)
    named = ", ".join(f"{row['strip']} (from {row['first']}, {row['images']} images)" for row in bare)
    assert f"strips without control: {named}" in said.out


def _strips(block: Block) -> list[int]:
    pairs = zip(block.positions.image.tolist(), block.positions.strip.tolist(), strict=True)
    of_image = dict(pairs)
    return [of_image[k] for k in range(len(block.images.names))]


def test_a_camera_that_is_turned_against_the_body(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    """Differences by the true rig and the adjusted orientations, with rotations of scipy."""
    lever, turn = np.array([0.30, 0.05, -0.25]), (2.0, -1.5, 3.0)
    stated = (
        f"lever_arm_m = {lever.tolist()}\nboresight_deg = {list(turn)}\n"
        "boresight_sigma_deg = [1.0, 1.0, 1.0]\n"
    )
    errors = Errors(lever_arm_m=tuple(lever.tolist()), boresight_deg=turn)
    folder = fly(tmp_path / "block", np.random.default_rng(3), errors, Plan(mounting=stated))
    adjust_block(folder, tmp_path / "run")
    said = photocal("flown", folder, "--run", tmp_path / "run", "-o", tmp_path / "flown")
    assert said.code == 0, said.err
    found, observed, adjusted = (
        _by_image(path)
        for path in (
            tmp_path / "flown" / "positions.csv",
            folder / "positions.csv",
            tmp_path / "run" / "images.csv",
        )
    )
    # Body axes forward, right, down; photo axes right, forward, up of a camera that looks down.
    nadir = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    arm = Rotation.from_rotvec(np.radians(turn)).as_matrix() @ nadir @ lever
    assert len(found) == len(observed) == len(adjusted)
    for image, row in found.items():
        angles = [float(adjusted[image][name]) for name in ("omega", "phi", "kappa")]
        to_object = Rotation.from_euler("XYZ", angles, degrees=True)
        place, antenna = (
            np.array([float(one[axis]) for axis in "XYZ"]) for one in (adjusted[image], observed[image])
        )
        difference = [float(row[f"d{axis}_m"]) for axis in "XYZ"]
        # The adjusted boresight is known to some thousandths of a degree.
        assert difference == pytest.approx(antenna - to_object.apply(arm) - place, abs=5e-4)


def _by_image(path: Path) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return {row["image"]: row for row in csv.DictReader(stream)}
