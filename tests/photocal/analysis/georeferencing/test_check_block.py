"""`photocal check BLOCK`: figures, files, and mistakes of the input said in words."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]
SMALL = Plan(tie=50)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return fly(tmp_path / "flight", np.random.default_rng(31), plan=SMALL)


def changed(folder: Path, name: str, change: Callable[[dict[str, str]], None]) -> None:
    """Rewrite a table row by row."""
    path = folder / name
    with path.open(encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    for row in rows:
        change(row)
    with path.open("w", encoding="utf-8", newline="") as text:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def checked(photocal: Photocal, folder: Path) -> dict[str, Any]:
    said = photocal("check", folder, "--json")
    assert said.code == 0, said.err
    return dict(json.loads(said.out))


def codes(content: dict[str, Any]) -> set[str]:
    return {finding["code"] for finding in content["findings"]}


def test_three_methods_side_by_side_and_the_files(photocal: Photocal, folder: Path, tmp_path: Path) -> None:
    said = photocal("check", folder, "-o", tmp_path / "out", "--scale", "1:1000", "--json")
    assert said.code == 0, said.err
    content = json.loads(said.out)
    assert content["schema"] == "photocal.block-check/2"
    assert list(content["methods"]) == ["direct", "integrated", "indirect"]
    for method, result in content["methods"].items():
        assert result["check"]["n"] == 20
        assert 0.5 < result["check"]["errors_over_prediction"] < 1.6, method
        point = result["check"]["points"][0]
        assert point["ellipse"]["semi_major_m"] >= point["ellipse"]["semi_minor_m"] > 0
        assert result["assessment"]["standards"][0]["accuracy_class"] is not None
        assert sum(image["rays"] for image in result["images"]) > 100
    # The direct method sees all errors of exposures: worst in height, and it knows.
    direct, indirect = (content["methods"][m]["check"]["predicted_m"] for m in ("direct", "indirect"))
    assert direct["Z"] > indirect["Z"]
    out = tmp_path / "out"
    names = {path.name for path in out.iterdir()}
    assert {"check.json", "ground_points.csv", "images.csv", "report.md", "systematic_errors.csv"} <= names
    for method in content["methods"]:
        assert (out / f"{method}_residual_map.pdf").read_bytes().startswith(b"%PDF")
        with closing(sqlite3.connect(out / f"{method}.gpkg")) as database:
            roles = dict(database.execute("SELECT role, COUNT(*) FROM ground_points GROUP BY role"))
        database.close()
        assert roles == {"control": 9, "check": 20}
    assert json.loads((out / "check.json").read_text()) == content
    assert len((out / "ground_points.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3 * 29


def test_text_has_methods_and_classes_side_by_side(photocal: Photocal, folder: Path, tmp_path: Path) -> None:
    said = photocal("check", folder, "-o", tmp_path / "out", "--scale", "1:1000", "--standard", "pec-pcd")
    assert said.code == 0, said.err
    line = next(row for row in said.out.splitlines() if row.startswith("pec-pcd planimetry at 1:1 000"))
    assert line.count("precision A, accuracy A") == 3
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "| pec-pcd planimetry at 1:1 000, 20 check points |" in report
    assert "cannot separate vertical lever arm and height datum" in report


def test_heights_of_zero(photocal: Photocal, folder: Path) -> None:
    def flat(row: dict[str, str]) -> None:
        if row["role"] == "control":
            row["Z"] = "0"

    changed(folder, "points.csv", flat)
    content = checked(photocal, folder)
    assert "heights-equal" in codes(content)
    assert any("Control points: all 9 have Z = 0" in f["text"] for f in content["findings"])


def test_check_points_that_are_control(photocal: Photocal, folder: Path) -> None:
    place: dict[str, str] = {}

    def same(row: dict[str, str]) -> None:
        if row["point"] == "p4":
            place.update({axis: row[axis] for axis in "XYZ"})
        if row["point"] == "p9":
            row.update(place)

    changed(folder, "points.csv", same)
    content = checked(photocal, folder)
    assert any("Check point p9 lies where control point p4 lies" in f["text"] for f in content["findings"])


def test_heights_in_feet(photocal: Photocal, folder: Path) -> None:
    def feet(row: dict[str, str]) -> None:
        if row["Z"]:
            row["Z"] = repr(float(row["Z"]) / 0.3048)

    changed(folder, "points.csv", feet)
    content = checked(photocal, folder)
    assert "feet-for-metres-height" in codes(content)
    assert "feet-for-metres-plane" not in codes(content)


def test_coordinates_in_feet(photocal: Photocal, folder: Path) -> None:
    def feet(row: dict[str, str]) -> None:
        for axis in "XYZ":
            if row[axis]:
                row[axis] = repr(float(row[axis]) / 0.3048)

    changed(folder, "points.csv", feet)
    said = photocal("check", folder, "--json")
    # Whether or not an adjustment survives it, the cause is said.
    assert "in feet where metres are expected" in (said.out or said.err)


def test_points_in_one_image(photocal: Photocal, folder: Path) -> None:
    seen: set[str] = set()
    with (folder / "observations.csv").open(encoding="utf-8") as text:
        lines = text.read().splitlines()
    kept = [lines[0]]
    for line in lines[1:]:
        point = line.split(",")[1]
        if point in ("p3", "p12"):
            if point in seen:
                continue
            seen.add(point)
        kept.append(line)
    (folder / "observations.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    content = checked(photocal, folder)
    said = [f["text"] for f in content["findings"] if f["code"] == "one-image-only"]
    assert any("Control point p3" in text and "blunder" in text for text in said)
    assert any("Check point p12" in text and "checks nothing" in text for text in said)
    assert content["methods"]["indirect"]["check"]["n"] == 19


@pytest.mark.parametrize(
    ("frame", "code", "words"),
    [("EPSG:4326", "latitude", "swapped"), ("EPSG:32722", "zone", "zone 23 S")],
)
def test_a_wrong_frame_of_the_points_is_said(
    photocal: Photocal, folder: Path, frame: str, code: str, words: str
) -> None:
    """Latitude for longitude, and control computed in the neighbouring UTM zone."""
    longitude, latitude = -51.41, -22.12
    if frame == "EPSG:4326":
        flown, surveyed = (longitude, latitude), (latitude, longitude)
        scale = 1e-5
    else:
        scale = 1.0
        utm = [Transformer.from_crs("EPSG:4326", f"EPSG:327{n}", always_xy=True) for n in (22, 23)]
        flown, surveyed = (zone.transform(longitude, latitude) for zone in utm)

    def moved(to: tuple[float, float]) -> Callable[[dict[str, str]], None]:
        def change(row: dict[str, str]) -> None:
            for axis, middle in zip("XY", to, strict=True):
                row[axis] = repr(middle + scale * float(row[axis])) if row[axis] else ""

        return change

    for table, to in (("images.csv", flown), ("positions.csv", flown), ("points.csv", surveyed)):
        changed(folder, table, moved(to))
    toml = (folder / "block.toml").read_text(encoding="utf-8")
    toml = toml.replace('frame = "local"', f'frame = "{frame}"\nheight = "ellipsoidal"')
    (folder / "block.toml").write_text(toml, encoding="utf-8")
    said = photocal("check", folder, "--json")
    # Whether or not anything can be computed, the reason is said.
    assert words in said.out + said.err, (code, said.err)
    assert "Traceback" not in said.err


@pytest.mark.parametrize("called", ["project.toml", "."], ids=["file", "folder"])
def test_a_project_is_checked_as_it_asks(photocal: Photocal, folder: Path, called: str) -> None:
    project = folder.parent / "project.toml"
    project.write_text(
        '[project]\nname = "p"\ncrs = "local"\nheight = "local"\noutput = "work"\n'
        '[measurements]\nblock = "flight"\n[judgement]\nscale = "1:2000"\nstandards = ["pec-pcd"]\n',
        encoding="utf-8",
    )
    said = photocal("flown", folder.parent / called, "-o", folder.parent / "flown")
    assert said.code == 3
    assert "has no block yet; run `photocal run` first" in said.err
    said = photocal("check", folder.parent / called, "--json")
    assert said.code == 0, said.err
    content = json.loads(said.out)
    assert list(content["methods"]) == ["direct", "integrated", "indirect"]
    standards = content["methods"]["indirect"]["assessment"]["standards"]
    assert {one["standard"] for one in standards} == {"pec-pcd"}


def test_no_georeference_leaves_the_indirect_method(photocal: Photocal, folder: Path) -> None:
    (folder / "positions.csv").unlink()
    (folder / "attitudes.csv").unlink()
    content = checked(photocal, folder)
    assert list(content["methods"]) == ["indirect"]
    assert [one["method"] for one in content["refused"]] == ["direct", "integrated"]


def test_no_control_leaves_the_others(photocal: Photocal, folder: Path) -> None:
    def none(row: dict[str, str]) -> None:
        if row["role"] == "control":
            row["role"] = "check"

    changed(folder, "points.csv", none)
    content = checked(photocal, folder)
    assert list(content["methods"]) == ["direct", "integrated"]
    assert "nothing fixes the datum" in content["refused"][0]["reason"]
    codes = [finding["code"] for finding in content["findings"]]
    assert "no-control" in codes
    assert "method-refused" not in codes


def test_no_check_points_are_missed_once(photocal: Photocal, folder: Path) -> None:
    def held(row: dict[str, str]) -> None:
        if row["role"] == "check":
            row.update(role="control", sX="0.01", sY="0.01", sZ="0.01")

    changed(folder, "points.csv", held)
    codes = [finding["code"] for finding in checked(photocal, folder)["findings"]]
    assert codes.count("no-check-points") == 1


def test_simulated_direct_is_labelled(photocal: Photocal, folder: Path) -> None:
    (folder / "positions.csv").unlink()
    (folder / "attitudes.csv").unlink()
    said = photocal("check", folder, "--simulate-direct", "0.08,0.02", "--seed", "4", "--json")
    content = json.loads(said.out)
    assert "SIMULATED" in content["methods"]["direct"]["label"]
    assert "0.08 m and 0.02 deg" in content["methods"]["direct"]["label"]
    rmse = content["exposures_direct_less_indirect"]["rmse"]
    assert rmse["X_m"] == pytest.approx(0.08, rel=0.4)
    assert rmse["omega_deg"] == pytest.approx(0.02, rel=0.4)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ((), 5, "one thing to check"),
        (("nowhere",), 3, "does not exist"),
        (("BLOCK", "--discrepancies", "x.csv"), 5, "one thing to check"),
        (("BLOCK", "--simulate-direct", "much"), 5, "0.08,0.02"),
        (("BLOCK", "--simulate-direct", "0,0.1"), 5, "positive"),
        (("BLOCK", "--crs", "EPSG:4326"), 5, "map projection"),
    ],
)
def test_wrong_commands(
    photocal: Photocal, folder: Path, arguments: tuple[str, ...], code: int, words: str
) -> None:
    said = photocal("check", *(str(folder) if a == "BLOCK" else a for a in arguments))
    assert said.code == code
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
