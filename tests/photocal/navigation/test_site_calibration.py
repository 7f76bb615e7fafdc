"""`photocal localise` as a surveyor uses it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.geometry.frames import reference_frame
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]
CRS = "EPSG:31982"
MIDDLE = np.array([677_000.0, 7_184_000.0, 925.0])
# On the ground, metres in a horizontal plane of the site, as a total station measures them.
GROUND = np.array([
    [-600.0, -500.0, 2.0], [620.0, -450.0, -3.0], [550.0, 520.0, 8.0], [-580.0, 480.0, 4.0],
    [40.0, 30.0, 1.0], [300.0, -100.0, 0.5],
])  # fmt: skip


def write(path: Path, names: str, values: np.ndarray, sigma: str) -> Path:
    """Write a table of points."""
    rows = [f"{n},{','.join(f'{v:.4f}' for v in row)}{sigma}" for n, row in zip(names, values, strict=True)]
    path.write_text("point,X,Y,Z,sX,sY,sZ\n" + "\n".join(rows) + "\n")
    return path


def site(folder: Path, seed: int = 0) -> tuple[Path, Path, np.ndarray]:
    """Tables of a site whose local system is the tangent plane, turned by 12 degrees; points in the map."""
    rng = np.random.default_rng(seed)
    on_map = reference_frame(CRS, "ellipsoidal", MIDDLE).to_given(GROUND)
    c, s = np.cos(np.radians(12.0)), np.sin(np.radians(12.0))
    local = GROUND @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [5000.0, 2000.0, 100.0]
    # The plane leaves the earth by 4 cm at 700 m: levelled heights do not.
    local[:, 2] = on_map[:, 2] - 825.0
    local += rng.normal(0, 0.003, local.shape)
    measured = on_map + rng.normal(0, 0.005, local.shape)
    one = write(folder / "site.csv", "ABCDEF", local, ",0.003,0.003,0.003")
    other = write(folder / "survey.csv", "ABCDE", measured[:5], ",0.005,0.005,0.005")
    return one, other, on_map


def test_the_report_has_what_a_surveyor_looks_for(photocal: Photocal, tmp_path: Path) -> None:
    local, mapped, on_map = site(tmp_path)
    answer = photocal("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    figures = json.loads(answer.out)
    # A metre on the ground is 0.99984 of the map there: point scale 0.99999, 925 m above the ellipsoid.
    assert 1 / figures["scale"] == pytest.approx(figures["ground_to_map"]["combined_factor"], abs=1.2e-5)
    assert figures["metre_of_the_local_system"] == "ground"
    # The turn of the site and the convergence of the meridians.
    assert figures["height_shift_m"] == pytest.approx(-825.0, abs=0.02)
    assert not any(any(p["doubtful"].values()) for p in figures["points"])
    report = (tmp_path / "out" / "localisation.md").read_text()
    assert "combined factor" in report
    assert "metres on the ground" in report
    with (tmp_path / "out" / "points.csv").open() as stream:
        rows = {row["point"]: row for row in csv.DictReader(stream)}
    # F was not measured in the map: the site takes it there.
    found = np.array([float(rows["F"][axis]) for axis in "XYZ"])
    sigma = np.array([float(rows["F"][f"s{axis}"]) for axis in "XYZ"])
    assert (np.abs(found - on_map[5]) < 4 * sigma).all()
    assert (sigma < 0.012).all()


def test_a_point_that_does_not_fit_is_named_and_stays_until_it_is_left_out(
    photocal: Photocal, tmp_path: Path
) -> None:
    local, mapped, _ = site(tmp_path)
    text = mapped.read_text().splitlines()
    cells = text[3].split(",")
    cells[1] = f"{float(cells[1]) + 0.10:.4f}"
    text[3] = ",".join(cells)
    mapped.write_text("\n".join(text) + "\n")
    said = photocal("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "a")
    assert "C does not fit in plan" in said.out
    # One gross error makes its neighbours look wrong; tested without it, they are good.
    assert said.out.count("does not fit in plan") == 1
    assert "does not fit in height" not in said.out
    again = photocal("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "b", "--without", "C")
    assert "does not fit" not in again.out
    assert "Left out: C" in again.out


def test_two_points_that_do_not_fit_are_named_and_no_others(photocal: Photocal, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    places = np.column_stack([rng.uniform(0, 500, (9, 2)), rng.uniform(0, 20, 9)])
    given = places + rng.normal(0, 0.004, places.shape)
    given[2, 0] += 0.30
    given[5, 1] -= 0.12
    given[7, 2] += 0.09
    frame = reference_frame(CRS, "ellipsoidal", MIDDLE)
    middle = frame.to_given(GROUND)[:1]
    mapped = write(tmp_path / "map.csv", "ABCDEFGHI", middle + places, ",0.003,0.003,0.003")
    local = write(tmp_path / "local.csv", "ABCDEFGHI", given, ",0.003,0.003,0.003")
    figures = json.loads(
        photocal("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "out", "--json").out
    )
    wrong = {
        part: {p["point"] for p in figures["points"] if p["doubtful"][part]} for part in ("plan", "height")
    }
    assert wrong == {"plan": {"C", "F"}, "height": {"H"}}


def test_the_report_speaks_portuguese(photocal: Photocal, tmp_path: Path) -> None:
    local, mapped, _ = site(tmp_path)
    said = photocal("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "out", "--lang", "pt-BR").out
    assert said.count("o sistema local mede em metros do terreno") == 1
    assert "fator combinado" in (tmp_path / "out" / "localisation.md").read_text(encoding="utf-8")
    # Decimals have the mark of the language.
    assert "0,9998" in said
    assert "0.9998" not in said


def test_a_scale_that_is_held_and_wrong_inputs(photocal: Photocal, tmp_path: Path) -> None:
    local, mapped, _ = site(tmp_path)
    given = ("localise", local, mapped, "--crs", CRS, "-o", tmp_path / "out")
    grid = json.loads(photocal(*given, "--scale", "1", "--json").out)
    ground = json.loads(photocal(*given, "--scale", "ground", "--json").out)
    # 150 ppm over 700 m: ten centimetres that a grid scale leaves in the residuals.
    assert grid["plan"]["rms_m"] > 0.08 > 0.01 > ground["plan"]["rms_m"]
    assert "--scale" in photocal(*given, "--scale", "x").err
    assert "--without" in photocal(*given, "--without", "Q").err
    assert "common points" in photocal(*given, "--without", "A,B,C,D").err
    assert (
        "not a map system"
        in photocal("localise", local, mapped, "--crs", "EPSG:4674", "-o", tmp_path / "o").err
    )
