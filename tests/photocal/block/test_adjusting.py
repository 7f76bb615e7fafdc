"""The same block in other units, axes, places and orders gives the same adjustment."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.geometry.camera import plane_to_pixel
from tests.photocal.blocks import adjusted_json, dcs460, published, small, table

SIZE, PITCH = (3060, 2036), (27.6 / 3060, 18.4 / 2036)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as text:
        return list(csv.DictReader(text))


def column(path: Path, *names: str) -> Any:
    return np.array([[float(row[name]) for name in names] for row in rows_of(path)])


@pytest.mark.parametrize("axes", ["pixel", "photo"])
def test_pixels_and_millimetres(axes: str, tmp_path: Path) -> None:
    """DCS460 observed in pixels of 9.0196 x 9.0373 um: the published figures, by either way of counting."""
    folder = dcs460(tmp_path / "block")
    setup = (folder / "block.toml").read_text()
    # 3 um in x and y are not the same number of pixels.
    setup = setup.replace('unit = "mm"\naxes = "photo"\nsigma = 0.003', f'unit = "px"\naxes = "{axes}"')
    (folder / "block.toml").write_text(setup)
    plane = column(folder / "observations.csv", "x", "y")
    if axes == "pixel":
        values = plane_to_pixel(SIZE, PITCH, plane)
        # The middle of the image, and y against the rows.
        assert values[0] == pytest.approx([1529.5 + 1.317 / PITCH[0], 1017.5 - 8.985 / PITCH[1]])
    else:
        values = plane / PITCH
    names = [(row["image"], row["point"]) for row in rows_of(folder / "observations.csv")]
    sigma = [0.003 / PITCH[0], 0.003 / PITCH[1]]
    table(
        folder / "observations.csv",
        "image,point,x,y,sx,sy",
        ([*name, repr(x), repr(y), *sigma] for name, (x, y) in zip(names, values.tolist(), strict=True)),
    )
    result = adjusted_json(folder, tmp_path / "run")
    assert result["chi_squared"] == pytest.approx(764.07, abs=0.01)
    parameters = result["cameras"]["dcs460"]["parameters"]
    stated = next(r for r in published("verification_adjustments.csv") if r["case"] == "A_11photos")
    for ours, theirs in (("c", "F"), ("x0", "CX"), ("y0", "CY"), ("K1", "K1"), ("P2", "P2")):
        tolerance = 1e-3 * float(stated[f"sd_{theirs}"])
        assert parameters[ours]["value"] == pytest.approx(float(stated[theirs]), abs=tolerance)
    # Residuals are in the unit and the axes of the observations.
    mm = dcs460(tmp_path / "mm")
    adjusted_json(mm, tmp_path / "mm-run")
    expected = column(tmp_path / "mm-run" / "residuals.csv", "vx", "vy") / PITCH
    expected *= [1, -1 if axes == "pixel" else 1]
    found = tmp_path / "run" / "residuals.csv"
    assert column(found, "vx", "vy") == pytest.approx(expected, abs=1e-4)
    assert column(found, "x", "y") == pytest.approx(values, rel=1e-12)
    w = column(tmp_path / "mm-run" / "residuals.csv", "wx", "wy") * np.sign(
        expected / column(found, "vx", "vy")
    )
    assert np.abs(column(found, "wx", "wy")) == pytest.approx(np.abs(w), abs=1e-3)


def test_a_camera_in_pixels(tmp_path: Path) -> None:
    """unit = "px" scales c, x0, y0 by the pitch and Kn by its powers; nothing else changes."""
    pitch, folder = 0.009, small(tmp_path / "mm")
    setup = (folder / "block.toml").read_text().replace('estimate = ["c"]', 'estimate = ["c", "x0", "K1"]')
    (folder / "block.toml").write_text(setup)
    mm = adjusted_json(folder, tmp_path / "mm-run")
    px = small(tmp_path / "px")
    setup = setup.replace('unit = "mm"\nsize', 'unit = "px"\nsize').replace("pitch_mm = 0.009\n", "")
    setup = setup.replace('unit = "mm"', 'unit = "px"').replace("sigma = 0.003", f"sigma = {0.003 / pitch}")
    (px / "block.toml").write_text(setup.replace("c = 20.0", f"c = {20 / pitch}"))
    table(
        px / "observations.csv",
        "image,point,x,y",
        (
            [row["image"], row["point"], float(row["x"]) / pitch, float(row["y"]) / pitch]
            for row in rows_of(folder / "observations.csv")
        ),
    )
    result = adjusted_json(px, tmp_path / "px-run")
    assert result["chi_squared"] == pytest.approx(mm["chi_squared"], rel=1e-6)
    one, other = (r["cameras"]["main"]["parameters"] for r in (mm, result))
    for name, scale in (("c", 1 / pitch), ("x0", 1 / pitch), ("K1", pitch**2)):
        assert other[name]["sigma"] == pytest.approx(one[name]["sigma"] * scale, rel=1e-5)
        error = other[name]["value"] - one[name]["value"] * scale
        assert abs(error) < 1e-3 * other[name]["sigma"]
    assert result["cameras"]["main"]["pitch_mm"] is None


def test_shift_of_the_origin_by_a_thousand_kilometres(tmp_path: Path) -> None:
    shift = np.array([1e6, -1e6, 1e5])
    near, far = dcs460(tmp_path / "near"), dcs460(tmp_path / "far")
    for name in ("images.csv", "points.csv"):
        rows = rows_of(far / name)
        for row in rows:
            for axis, by in zip("XYZ", shift, strict=True):
                # In decimal: no digit may be lost before the program sees it.
                whole, _, digits = row[axis].partition(".")
                sign = -1 if whole.startswith("-") else 1
                units = sign * int(whole.lstrip("-") + digits) + int(by) * 10 ** len(digits)
                row[axis] = f"{'-' if units < 0 else ''}{abs(units) // 10 ** len(digits)}."
                row[axis] += f"{abs(units) % 10 ** len(digits):0{len(digits)}d}"
        table(far / name, ",".join(rows[0]), (row.values() for row in rows))
    one, other = adjusted_json(near, tmp_path / "one"), adjusted_json(far, tmp_path / "other")
    assert other["chi_squared"] == pytest.approx(one["chi_squared"], abs=1e-5)
    for name, figures in one["cameras"]["dcs460"]["parameters"].items():
        found = other["cameras"]["dcs460"]["parameters"][name]
        assert found["value"] == pytest.approx(figures["value"], abs=1e-4 * figures["sigma"])
        assert found["sigma"] == pytest.approx(figures["sigma"], rel=1e-6)
    for name in ("images.csv", "points.csv"):
        ours = column(tmp_path / "other" / name, "X", "Y", "Z") - shift
        assert ours == pytest.approx(column(tmp_path / "one" / name, "X", "Y", "Z"), abs=2e-7)
        sigma = column(tmp_path / "other" / name, "sX", "sY", "sZ")
        assert sigma == pytest.approx(column(tmp_path / "one" / name, "sX", "sY", "sZ"), rel=1e-5)


def test_order_of_the_rows(tmp_path: Path) -> None:
    plain, mixed = dcs460(tmp_path / "plain"), dcs460(tmp_path / "mixed")
    rng = np.random.default_rng(3)
    for name in ("images.csv", "points.csv", "observations.csv"):
        header, *lines = (mixed / name).read_text().splitlines()
        (mixed / name).write_text("\n".join([header, *rng.permutation(lines)]) + "\n")
    one, other = adjusted_json(plain, tmp_path / "one"), adjusted_json(mixed, tmp_path / "other")
    assert other["chi_squared"] == pytest.approx(one["chi_squared"], rel=1e-8)
    found = {(r["image"], r["point"]): r for r in rows_of(tmp_path / "other" / "residuals.csv")}
    for row in rows_of(tmp_path / "one" / "residuals.csv"):
        for name in ("vx", "vy", "rx", "ry"):
            assert float(found[row["image"], row["point"]][name]) == pytest.approx(float(row[name]), abs=1e-6)
    # Tables come back in the order they were given in.
    for name, keys in (("images.csv", ["image"]), ("points.csv", ["point"])):
        given = [row[keys[0]] for row in rows_of(mixed / name)]
        assert [row[keys[0]] for row in rows_of(tmp_path / "other" / name)] == given
    given_pairs = [(row["image"], row["point"]) for row in rows_of(mixed / "observations.csv")]
    assert list(found) == given_pairs


def test_check_points_do_not_pull(tmp_path: Path) -> None:
    """A wrong check point changes its own difference and nothing else."""
    right, wrong = small(tmp_path / "right"), small(tmp_path / "wrong")
    text = (wrong / "points.csv").read_text()
    (wrong / "points.csv").write_text(text.replace("-2.1957", "-2.0957"))
    one, other = adjusted_json(right, tmp_path / "one"), adjusted_json(wrong, tmp_path / "other")
    assert other["cameras"]["main"]["parameters"]["c"]["value"] == pytest.approx(
        one["cameras"]["main"]["parameters"]["c"]["value"], abs=1e-6
    )
    before, after = one["checks"]["points"][0], other["checks"]["points"][0]
    assert after["dy"] - before["dy"] == pytest.approx(-0.1, abs=1e-5)
    assert after["dx"] == pytest.approx(before["dx"], abs=1e-5)
    assert other["checks"]["rmse_m"]["y"] == pytest.approx(abs(after["dy"]))
    assert other["checks"]["n"] == 1


def test_tie_points_without_start_values(tmp_path: Path) -> None:
    given, empty = small(tmp_path / "given"), small(tmp_path / "empty")
    text = (empty / "points.csv").read_text()
    (empty / "points.csv").write_text(text.replace("p6,-2.3724,-1.4261,0.5007", "p6,,,"))
    adjusted_json(given, tmp_path / "one")
    adjusted_json(empty, tmp_path / "other")
    places = [column(tmp_path / run / "points.csv", "X", "Y", "Z") for run in ("one", "other")]
    assert places[1] == pytest.approx(places[0], abs=1e-6)


def test_points_without_rays_are_named(tmp_path: Path) -> None:
    block = small(tmp_path / "block")
    with (block / "points.csv").open("a") as text:
        text.write("spare,1,1,1,0.01,0.01,0.01,control\n")
    result = adjusted_json(block, tmp_path / "run")
    assert result["unobserved"] == ["spare"]
    assert "spare" not in (tmp_path / "run" / "points.csv").read_text()


def test_control_with_one_ray(tmp_path: Path) -> None:
    block = small(tmp_path / "block")
    text = (block / "observations.csv").read_text()
    kept = [line for line in text.splitlines() if not line.startswith(("b,p4", "c,p4"))]
    (block / "observations.csv").write_text("\n".join(kept) + "\n")
    adjusted_json(block, tmp_path / "run")
    rows = {row["point"]: row for row in rows_of(tmp_path / "run" / "points.csv")}
    assert rows["p4"]["rays"] == "1"


def test_run_folder_as_agreed(tmp_path: Path) -> None:
    result = adjusted_json(small(tmp_path / "block"), tmp_path / "run")
    run = tmp_path / "run"
    assert {p.name for p in run.iterdir()} >= {
        "result.json", "images.csv", "points.csv", "residuals.csv", "covariance.parquet",
    }  # fmt: skip
    assert json.loads((run / "result.json").read_text()) == json.loads(json.dumps(result))
    assert result["schema"] == "photocal.adjustment/1"
    assert result["converged"] is True
    # 21 rays of 7 points and 15 control coordinates; 3 exposures, 7 points, c.
    assert result["observations"] == 42 + 15
    assert result["unknowns"] == 18 + 21 + 1
    assert result["degrees_of_freedom"] == 17
    heads = {
        name: (run / name).read_text().splitlines()[0].replace('"', "")
        for name in ("images.csv", "points.csv")
    }
    assert heads["images.csv"] == "image,camera,X,Y,Z,omega,phi,kappa,sX,sY,sZ,so,sp,sk"
    assert heads["points.csv"] == "point,role,X,Y,Z,sX,sY,sZ,rays"
    sigma = column(run / "points.csv", "sX", "sY", "sZ")
    assert (sigma > 0).all()


@pytest.mark.parametrize("what", ["c", "x0"])
def test_prior_sigma_zero_holds(what: str, tmp_path: Path) -> None:
    block = small(tmp_path / "block")
    text = (block / "block.toml").read_text().replace('["c"]', '["c", "x0"]')
    (block / "block.toml").write_text(text + f"prior_sigma = {{ {what} = 0.0 }}\n")
    figures = adjusted_json(block, tmp_path / "run")["cameras"]["main"]["parameters"][what]
    assert figures["value"] == (20.0 if what == "c" else 0.0)
    assert figures["sigma"] == 0.0
    assert not figures["estimated"]
