"""`photocal adjust` on the Kodak DCS460 study: the published figures and an independent adjustment's."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from typer.testing import CliRunner

from photocal.commands.cli import app
from tests.photocal.blocks import SQUARE, adjusted_json, dcs460, published

# Names of the study, in the order of its tables.
NAMES = {"c": "F", "x0": "CX", "y0": "CY", "K1": "K1", "K2": "K2", "K3": "K3", "P1": "P1", "P2": "P2"}
ANGLES = ("omega", "phi", "kappa")
# How the cases of the independent adjustment differ: arguments of `dcs460`.
CASES: dict[str, dict[str, Any]] = {
    "A_11photos": {},
    "B_12photos_tuned": {"photo2": True},
    "C_12photos_untuned": {"photo2": True, "tuned": False},
    "D_12photos_square_pixel": {"photo2": True, "y_scale": SQUARE},
    "E_12photos_square_pixel_459pts": {"photo2": True, "y_scale": SQUARE, "unused_too": True},
    "F_11photos_square_pixel": {"y_scale": SQUARE},
    "G_11photos_square_pixel_420pts": {"y_scale": SQUARE, "unused_too": True},
    "H_11photos_420pts_published_pixel": {"unused_too": True},
}


class Run:
    """A run folder, read by nothing but the standard tools."""

    def __init__(self, folder: Path) -> None:
        self.result: dict[str, Any] = json.loads((folder / "result.json").read_text())
        self.images = {row["image"]: row for row in self._rows(folder / "images.csv")}
        self.points = {row["point"]: row for row in self._rows(folder / "points.csv")}
        self.residuals = {(row["image"], row["point"]): row for row in self._rows(folder / "residuals.csv")}
        self.covariance = {
            (row["kind"], row["id"]): (row["names"], row["lower"])
            for row in pyarrow.parquet.read_table(folder / "covariance.parquet").to_pylist()
        }

    @staticmethod
    def _rows(path: Path) -> list[dict[str, str]]:
        with path.open(encoding="utf-8", newline="") as text:
            return list(csv.DictReader(text))

    def parameter(self, name: str) -> dict[str, Any]:
        parameters: dict[str, dict[str, Any]] = self.result["cameras"]["dcs460"]["parameters"]
        return parameters[name]

    def block(self, kind: str, name: str) -> dict[tuple[str, str], float]:
        """Covariances by the names of their rows and columns."""
        names, lower = self.covariance[kind, name]
        pairs = [(a, b) for i, a in enumerate(names) for b in names[: i + 1]]
        found = dict(zip(pairs, lower, strict=True))
        return found | {(b, a): value for (a, b), value in found.items()}


def adjusted(folder: Path, **case: Any) -> Run:
    block = dcs460(folder / "block", **case)
    said = CliRunner().invoke(app, ["adjust", str(block), "-o", str(folder / "run")])
    assert said.exit_code == 0, said.output
    return Run(folder / "run")


@pytest.fixture(scope="module")
def case_a(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return adjusted(tmp_path_factory.mktemp("a"))


@pytest.fixture(scope="module")
def case_b(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return adjusted(tmp_path_factory.mktemp("b"), photo2=True)


def test_eleven_photos_as_stated(case_a: Run) -> None:
    stated = {
        "c": (20.50047, 0.00945), "x0": (-0.21972, 0.00653), "y0": (0.18379, 0.00607),
        "K1": (-2.75074e-4, 4.825e-6), "K2": (2.6779e-7, 4.967e-8), "K3": (9.137e-10, 1.550e-10),
        "P1": (1.0725e-5, 4.796e-6), "P2": (5.323e-6, 4.447e-6),
    }  # fmt: skip
    for name, (value, sigma) in stated.items():
        found = case_a.parameter(name)
        assert found["value"] == pytest.approx(value, abs=1e-3 * sigma), name
        assert found["sigma"] == pytest.approx(sigma, rel=1e-3), name
    assert case_a.result["chi_squared"] == pytest.approx(764.07, abs=0.01)
    assert case_a.result["degrees_of_freedom"] == 770
    assert case_a.result["sigma0_squared"] == pytest.approx(0.9923, abs=1e-4)
    assert case_a.result["observations"] == 836 + 120 + 8


@pytest.mark.parametrize("case", CASES)
def test_independent_adjustments(case: str, tmp_path: Path) -> None:
    row = next(r for r in published("verification_adjustments.csv") if r["case"] == case)
    result = adjusted_json(dcs460(tmp_path / "block", **CASES[case]), tmp_path / "run")
    assert result["degrees_of_freedom"] == int(row["dof"])
    assert result["chi_squared"] == pytest.approx(float(row["chi2"]), abs=0.0051)
    groups = {group["name"]: group for group in result["groups"]}
    assert groups["image"]["observations"] == int(row["n_image_obs"])
    for ours, theirs in (("image", "chi2_image"), ("control", "chi2_control"), ("camera", "chi2_iop")):
        assert groups[ours]["chi_squared"] == pytest.approx(float(row[theirs]), abs=0.0051)
    for ours, theirs in NAMES.items():
        found, sigma = result["cameras"]["dcs460"]["parameters"][ours], float(row[f"sd_{theirs}"])
        assert found["value"] == pytest.approx(float(row[theirs]), abs=1e-3 * sigma), ours
        assert found["sigma"] == pytest.approx(sigma, rel=1e-3), ours


@pytest.mark.parametrize("photo", [str(n) for n in range(1, 13)])
@pytest.mark.parametrize("pixel", ["published_pixel", "square_pixel"])
def test_leaving_one_photo_out(pixel: str, photo: str, tmp_path: Path) -> None:
    rows = published("verification_leave_one_out.csv")
    row = next(r for r in rows if (r["pixel_model"], r["photo_removed"]) == (pixel, photo))
    scale = SQUARE if pixel == "square_pixel" else 1.0
    block = dcs460(tmp_path / "block", photo2=True, y_scale=scale, without=photo)
    result = adjusted_json(block, tmp_path / "run")
    assert result["degrees_of_freedom"] == int(row["dof"])
    assert result["chi_squared"] == pytest.approx(float(row["chi2"]), abs=0.0051)
    for ours, theirs in NAMES.items():
        found = result["cameras"]["dcs460"]["parameters"][ours]
        assert found["value"] == pytest.approx(float(row[theirs]), abs=2e-3 * found["sigma"]), ours


def test_published_interior_orientation(case_b: Run) -> None:
    for row in published("iop_adjusted.csv"):
        ours = next(name for name, theirs in NAMES.items() if theirs == row["parameter"])
        found, sigma = case_b.parameter(ours), float(row["sd_from_covariance"])
        assert found["value"] == pytest.approx(float(row["adjusted_full"]), abs=0.01 * sigma), ours
        assert found["sigma"] == pytest.approx(sigma, rel=1e-3), ours
    assert case_b.result["chi_squared"] == pytest.approx(888.36, abs=0.05)
    assert case_b.result["chi_squared"] == pytest.approx(887.6, rel=2e-3)
    assert case_b.result["degrees_of_freedom"] == 842
    test = case_b.result["global_test"]
    assert (round(test["lower"], 1), round(test["upper"], 1)) == (763.5, 924.3)
    assert test["accepted"]


def test_published_covariance_of_the_interior_orientation(case_b: Run) -> None:
    ours = {theirs: name for name, theirs in NAMES.items()}
    block = case_b.block("camera", "dcs460")
    rows = published("iop_covariance.csv")
    assert len(rows) == 36
    for row in rows:
        a, b = ours[row["row"]], ours[row["col"]]
        product = np.sqrt(block[a, a] * block[b, b])
        assert block[a, b] == pytest.approx(float(row["value"]), abs=5e-4 * product), (a, b)


def test_published_covariances_of_the_exterior_orientations(case_b: Run) -> None:
    ours = {"OMEGA": "omega", "PHI": "phi", "KAPPA": "kappa", "XC": "X", "YC": "Y", "ZC": "Z"}
    rows = published("eo_covariance.csv")
    assert len(rows) == 12 * 21
    for row in rows:
        a, b = ours[row["row"]], ours[row["col"]]
        block = case_b.block("image", row["photo"])
        product = np.sqrt(block[a, a] * block[b, b])
        assert block[a, b] == pytest.approx(float(row["value"]), abs=5e-4 * product), (row["photo"], a, b)


def test_published_covariances_of_the_points(case_b: Run) -> None:
    rows = published("points_covariance.csv")
    assert len(rows) == 40 * 6
    for row in rows:
        a, b = row["row"][0], row["col"][0]
        block = case_b.block("point", row["point"])
        product = np.sqrt(block[a, a] * block[b, b])
        assert block[a, b] == pytest.approx(float(row["value_m2"]), abs=5e-4 * product), (row["point"], a, b)


def test_published_exterior_orientations(case_b: Run) -> None:
    rows = published("eo_adjusted.csv")
    assert len(rows) == 12
    for row in rows:
        found = case_b.images[row["photo"]]
        for angle in ANGLES:
            difference = float(found[angle]) - float(row[f"{angle}_deg"])
            assert (difference + 180) % 360 - 180 == pytest.approx(0, abs=0.0015)
        for axis in "XYZ":
            assert float(found[axis]) == pytest.approx(float(row[f"{axis}C_m"]), abs=0.0007)
        for ours, theirs in (("so", "omega_deg"), ("sp", "phi_deg"), ("sk", "kappa_deg"), ("sX", "XC_m")):
            assert float(found[ours]) == pytest.approx(float(row[f"sd_{theirs}"]), rel=2e-3)


def test_published_points_and_their_corrections(case_b: Run) -> None:
    surveyed = {row["point"]: row for row in published("control_points.csv")}
    rows = published("control_adjusted.csv")
    assert len(rows) == 40
    for row in rows:
        found = case_b.points[row["point"]]
        for axis in "XYZ":
            value = float(found[axis])
            assert value == pytest.approx(float(row[f"{axis}G_m"]), abs=0.0006)
            correction = value - float(surveyed[row["point"]][f"{axis}_m"])
            assert correction == pytest.approx(float(row[f"v{axis}_m"]), abs=0.0006)


def test_published_residuals(case_b: Run) -> None:
    rows = published("image_residuals.csv")
    assert len(rows) == 457 == len(case_b.residuals)
    for row in rows:
        found = case_b.residuals[row["photo"], row["point"]]
        for axis in "xy":
            assert float(found[f"v{axis}"]) == pytest.approx(float(row[f"v{axis}_mm"]), abs=0.0007)


def test_redundancy_numbers_add_up(case_b: Run) -> None:
    groups = {group["name"]: group for group in case_b.result["groups"]}
    of_rays = sum(float(row["rx"]) + float(row["ry"]) for row in case_b.residuals.values())
    assert of_rays == pytest.approx(groups["image"]["redundancy"])
    assert sum(group["redundancy"] for group in groups.values()) == pytest.approx(842, abs=1e-6)
    # The priors of the camera (1 mm and the like) carry next to nothing.
    assert groups["camera"]["redundancy"] == pytest.approx(8, abs=1e-3)


def test_residual_rms_with_square_pixels(tmp_path: Path) -> None:
    """The finding of the study's check: 1.20 um instead of 2.82 um, 0.96 to 1.79 um per photo."""
    rms = {}
    for name, scale in (("published", 1.0), ("square", SQUARE)):
        block = dcs460(tmp_path / name, photo2=True, y_scale=scale)
        images = adjusted_json(block, tmp_path / f"{name}-run")["images"]["rms"]
        rms[name] = {i["image"]: np.hypot(i["rms_x"], i["rms_y"]) / np.sqrt(2) * 1000 for i in images}
        rays = np.array([i["rays"] for i in images])
        squares = np.array(list(rms[name].values())) ** 2
        rms[name]["all"] = np.sqrt(rays @ squares / rays.sum())
    assert rms["published"].pop("all") == pytest.approx(2.82, abs=0.005)
    assert rms["square"].pop("all") == pytest.approx(1.20, abs=0.005)
    assert min(rms["published"].values()) == pytest.approx(1.3, abs=0.05)
    assert max(rms["published"].values()) == pytest.approx(4.5, abs=0.05)
    assert min(rms["square"].values()) == pytest.approx(0.96, abs=0.005)
    assert max(rms["square"].values()) == pytest.approx(1.79, abs=0.005)
