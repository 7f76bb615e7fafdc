"""Blocks without exterior orientation reach the minimum of the same block with it."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import photocal
from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.results.adjusted import adjust_network
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.blocks import adjusted_json

DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"


def without_orientation(folder: Path, images: frozenset[str], extra: str = "") -> Path:
    """Copy the demonstration block, the orientation of some images left empty."""
    shutil.copytree(DEMO, folder)
    with (folder / "images.csv").open(encoding="utf-8") as text:
        rows = list(csv.reader(text))
    head = ",".join(rows[0]) + (",sX" if extra else "")
    lines = [head]
    for row in rows[1:]:
        cells = row[:2] + [""] * 6 if row[0] in images else row
        lines.append(",".join(cells) + (f",{extra}" if extra else ""))
    (folder / "images.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


ALL = frozenset({"1", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12"})


@pytest.mark.parametrize("images", [ALL, frozenset({"8"})], ids=["none given", "one missing"])
def test_same_minimum_without_orientation(images: frozenset[str], tmp_path: Path) -> None:
    result = adjusted_json(without_orientation(tmp_path / "block", images), tmp_path / "run")
    # Case A of the study, computed by others.
    assert result["chi_squared"] == pytest.approx(764.07, abs=0.01)
    assert result["cameras"]["dcs460"]["parameters"]["c"]["value"] == pytest.approx(20.5004666, abs=1e-5)


def test_an_adjusted_block_needs_no_start_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Analysed with its result, a block without orientation is what it is with one."""
    block = read_block(without_orientation(tmp_path / "block", ALL))
    result = photocal.adjust(block)

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("start values were sought")

    monkeypatch.setattr("photocal.adjustment.start.values.start_values", refused)
    (found,) = photocal.analyse(block, result).cameras.values()
    (given,) = photocal.analyse(read_block(DEMO)).cameras.values()
    assert found is not None
    assert given is not None
    for one, other in zip(found.significance, given.significance, strict=True):
        assert (one.kind, one.parameters) == (other.kind, other.parameters)
        assert one.statistic == pytest.approx(other.statistic, rel=1e-6)


def test_control_that_is_known_in_some_coordinates_only(tmp_path: Path) -> None:
    """A third of the control has no surveyed height, and a nonsense in its place."""
    results = []
    for name, images, height in (("given", frozenset[str](), None), ("none", ALL, "99.0")):
        folder = without_orientation(tmp_path / name, images)
        with (folder / "points.csv").open(encoding="utf-8") as text:
            rows = list(csv.DictReader(text))
        for row in rows[::3]:
            row["sZ"] = ""
            row["Z"] = height or row["Z"]
        lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
        (folder / "points.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        results.append(adjusted_json(folder, tmp_path / f"run-{name}"))
    assert results[1]["chi_squared"] == pytest.approx(results[0]["chi_squared"], rel=1e-7)


def test_slips_in_check_points_change_nothing(tmp_path: Path) -> None:
    """The surveyed coordinates of check points take no part, however wrong they are."""
    results = []
    for name, slip in (("right", 0.0), ("wrong", 180.0)):
        folder = without_orientation(tmp_path / name, frozenset())
        with (folder / "points.csv").open(encoding="utf-8") as text:
            rows = list(csv.DictReader(text))
        for k, row in enumerate(rows[5:45:10]):
            row["role"], row["XYZ"[k % 3]] = "check", f"{float(row['XYZ'[k % 3]]) + slip}"
        lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
        (folder / "points.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        results.append(adjusted_json(folder, tmp_path / f"run-{name}"))
    assert results[1]["chi_squared"] == pytest.approx(results[0]["chi_squared"], rel=1e-7)
    assert results[1]["checks"]["rmse_m"]["x"] > 100.0


def test_an_image_that_nothing_connects(tmp_path: Path) -> None:
    folder = without_orientation(tmp_path / "block", frozenset({"8"}))
    rows = (folder / "observations.csv").read_text(encoding="utf-8").splitlines()
    few = [row for row in rows if not row.startswith("8,")] + [row for row in rows if row.startswith("8,")][
        :3
    ]
    (folder / "observations.csv").write_text("\n".join(few) + "\n", encoding="utf-8")
    with pytest.raises(IllPosedError, match=r"1 image\(s\) \(8\)"):
        adjusted_json(folder, tmp_path / "run")


def test_a_sigma_needs_its_value(tmp_path: Path) -> None:
    folder = without_orientation(tmp_path / "block", frozenset({"8"}), extra="0.05")
    with pytest.raises(InputMalformedError, match="a value with a sigma is empty"):
        adjusted_json(folder, tmp_path / "run")


def test_tie_points_that_start_behind_their_cameras_are_placed_again_or_counted(tmp_path: Path) -> None:
    """Other people's blocks have them: an adjustment of the others must not hang on them."""
    block = read_block(fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(tie=40)))
    expected = adjust_network(block)
    row = {name: k for k, name in enumerate(expected.points.names)}
    values, tie = block.points.values.copy(), np.flatnonzero(block.points.of_role("tie"))
    values[tie] = expected.points.values[[row[block.points.names[k]] for k in tie]]
    values[tie[:5], 2] += 1000.0
    moved = replace(block, points=replace(block.points, values=values))
    found = adjust_network(moved)
    assert found.chi_squared == pytest.approx(expected.chi_squared, rel=1e-9)
    assert not found.rejected
    # Rays that part in front of their cameras meet behind them: those of a point in the sky.
    seen, point, camera = block.observations, tie[0], block.cameras[0]
    mine = np.flatnonzero(seen.point == point)
    pose = block.images.values[seen.image[mine]]
    away = values[point] + np.array([0.0, 0.0, 1000.0]) - pose[:, 3:]
    q = np.einsum("nab,nb->na", matrix_from_angles(pose[:, :3]), away)
    measured = seen.values.copy()
    plane = -camera.value("c") * q[:, :2] / q[:, 2:]
    measured[mine] = plane_to_pixel(camera.size_px, camera.pitch, plane)
    parted = replace(moved, observations=replace(seen, values=measured))
    left = adjust_network(parted)
    assert {ray.point for ray in left.rejected} == {block.points.names[point]}
    assert len(left.rejected) == len(mine)
    assert left.chi_squared < expected.chi_squared


def test_heights_of_positions_may_put_the_cameras_below_the_ground() -> None:
    """Of another surface and known as badly as that, they change what they weigh: next to nothing."""
    block = read_block(DEMO)
    images = block.images

    def positions(below_m: float, sigma_m: float) -> Block:
        sigma = np.hstack([np.full((len(images.names), 3), np.inf), np.tile([1.5, 1.5, sigma_m], (11, 1))])
        values = images.values - [0.0, 0.0, 0.0, 0.0, 0.0, below_m]
        return replace(block, images=replace(images, values=values, sigma=sigma))

    expected, found = adjust_network(positions(0.0, np.inf)), adjust_network(positions(3000.0, 1e5))
    assert found.cameras["dcs460"].value("c") == pytest.approx(
        expected.cameras["dcs460"].value("c"), abs=1e-5
    )
    assert found.images.values[:, 3:] == pytest.approx(expected.images.values[:, 3:], abs=1e-2)
