"""Folders as `photocal adjust` writes them, made from published figures and from invented ones."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

NAMES = ("c", "x0", "y0", "K1", "K2", "K3", "K4", "P1", "P2", "P3", "P4", "B1", "B2")
PUBLISHED = {"F": "c", "CX": "x0", "CY": "y0"}


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def dcs460(reference: Path, folder: Path) -> Path:
    """Write the published DCS460 calibration as a run; redundancy numbers are the mean one."""
    folder.mkdir(parents=True, exist_ok=True)
    parameters, correlation = _published_camera(reference)
    residuals = _published_residuals(reference)
    write_table(folder / "residuals.csv", residuals)
    images = [
        {
            "image": row["photo"],
            "camera": "dcs460",
            **{axis: row[f"{axis}C_m"] for axis in "XYZ"},
            **{angle: row[f"{angle}_deg"] for angle in ("omega", "phi", "kappa")},
            **{f"s{axis}": row[f"sd_{axis}C_m"] for axis in "XYZ"},
            **{
                short: row[f"sd_{angle}_deg"]
                for short, angle in (("so", "omega"), ("sp", "phi"), ("sk", "kappa"))
            },
        }
        for row in table(reference / "eo_adjusted.csv")
    ]
    write_table(folder / "images.csv", images)
    points = [
        {
            "point": row["point"],
            "role": "control",
            **{axis: row[f"{axis}G_m"] for axis in "XYZ"},
            **{f"s{axis}": row[f"sd_{axis}G_m"] for axis in "XYZ"},
            "rays": sum(r["point"] == row["point"] for r in residuals),
        }
        for row in table(reference / "control_adjusted.csv")
    ]
    write_table(folder / "points.csv", points)
    camera = {
        "model": "brown-observed",
        "unit": "mm",
        "size_px": [3060, 2036],
        "pitch_mm": [0.009019607843, 0.009037328094],
        "reference_radius": 0.0,
        "affinity": "additive",
        "affinity_form": "fraser",
        "parameters": parameters,
        "correlation": correlation,
    }
    result = _result("dcs460", camera, residuals, len(images))
    result["groups"] = [
        {"name": "image", "observations": 2 * len(residuals), "chi_squared": 809.93, "redundancy": 755.7},
        {"name": "control", "observations": 120, "chi_squared": 78.12, "redundancy": 78.5},
        {"name": "camera", "observations": 8, "chi_squared": 0.303, "redundancy": 7.8},
    ]
    (folder / "result.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    return folder


def _published_camera(reference: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    rows = {
        PUBLISHED.get(row["parameter"], row["parameter"]): row
        for row in table(reference / "iop_adjusted.csv")
    }
    parameters = {
        name: {
            "value": float(rows[name]["adjusted_full"]) if name in rows else 0.0,
            "sigma": float(rows[name]["sd_from_covariance"]) if name in rows else 0.0,
            "estimated": name in rows,
        }
        for name in NAMES
    }
    names = list(rows)
    matrix = np.eye(len(names))
    for row in table(reference / "iop_covariance.csv"):
        i, j = (names.index(PUBLISHED.get(row[k], row[k])) for k in ("row", "col"))
        scale = parameters[names[i]]["sigma"] * parameters[names[j]]["sigma"]
        if i != j:
            matrix[i, j] = matrix[j, i] = float(row["value"]) / scale
    return parameters, {"names": names, "matrix": matrix.tolist()}


def _published_residuals(reference: Path) -> list[dict[str, Any]]:
    measured = {
        (row["photo"], row["point"]): (row["x_mm"], row["y_mm"])
        for name in ("image_observations.csv", "image_observations_photo02_reconstructed.csv")
        for row in table(reference / name)
    }
    redundancy = 0.827
    scale = 1.0 / (0.003 * np.sqrt(redundancy))
    return [
        {
            "image": row["photo"],
            "point": row["point"],
            "x": measured[row["photo"], row["point"]][0],
            "y": measured[row["photo"], row["point"]][1],
            "vx": row["vx_mm"],
            "vy": row["vy_mm"],
            "rx": redundancy,
            "ry": redundancy,
            "wx": float(row["vx_mm"]) * scale,
            "wy": float(row["vy_mm"]) * scale,
        }
        for row in table(reference / "image_residuals.csv")
    ]


def _result(
    name: str, camera: dict[str, Any], residuals: list[dict[str, Any]], images: int
) -> dict[str, Any]:
    return {
        "schema": "photocal.adjustment/1",
        "software": {"name": "photocal", "version": "0.1.0"},
        "block": {
            "name": name,
            "frame": "local",
            "height": "",
            "datum": "control",
            "observation_unit": "mm",
            "observation_axes": "photo",
        },
        "inputs": [
            {"path": path, "sha256": f"{i:064x}", "bytes": 1000 + i}
            for i, path in enumerate(("block.toml", "images.csv", "points.csv", "observations.csv"), start=1)
        ],
        "converged": True,
        "iterations": 6,
        "observations": 2 * len(residuals) + 128,
        "unknowns": 200,
        "degrees_of_freedom": 842,
        "chi_squared": 888.36,
        "sigma0_squared": 1.0551,
        "global_test": {
            "probability": 0.95,
            "lower": 763.5,
            "upper": 924.3,
            "accepted": True,
            "p_value": 0.13,
        },
        "groups": [
            {"name": "image", "observations": 2 * len(residuals), "chi_squared": 800.0, "redundancy": 750.0}
        ],
        "cameras": {name: camera},
        "images": {"n": images, "rms": _rms(residuals)},
        "checks": {"n": 0, "rmse_m": {"x": 0.0, "y": 0.0, "z": 0.0}, "points": []},
    }


def _rms(residuals: list[dict[str, Any]]) -> list[dict[str, Any]]:
    rows = []
    for image in dict.fromkeys(row["image"] for row in residuals):
        v = np.array([[float(r["vx"]), float(r["vy"])] for r in residuals if r["image"] == image])
        x, y = np.sqrt(np.mean(v**2, axis=0))
        rows.append({"image": image, "rays": len(v), "rms_x": float(x), "rms_y": float(y)})
    return rows


def invented(folder: Path, *, images: int = 4, rays: int = 25, checks: int = 3, seed: int = 1) -> Path:
    """Write a run in pixels with check points and a camera that estimates five parameters."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    residuals = [
        {
            "image": f"IMG_{i:04d}.JPG",
            "point": f"P{j}",
            "x": round(rng.uniform(0, 3999), 3),
            "y": round(rng.uniform(0, 2999), 3),
            **{v: round(rng.normal(0, 0.3), 4) for v in ("vx", "vy")},
            **dict.fromkeys(("rx", "ry"), 0.8),
            **{w: round(rng.normal(0, 1), 3) for w in ("wx", "wy")},
        }
        for i in range(images)
        for j in range(rays)
    ]
    write_table(folder / "residuals.csv", residuals)
    exposures = [
        {
            "image": f"IMG_{i:04d}.JPG",
            "camera": "l1",
            "X": -120.5 + 30 * i,
            "Y": 12.25,
            "Z": 101.0 + 0.1 * i,
            "omega": 0.5,
            "phi": -0.25,
            "kappa": 179.0,
            **dict.fromkeys(("sX", "sY", "sZ"), 0.012),
            **dict.fromkeys(("so", "sp", "sk"), 0.0021),
        }
        for i in range(images)
    ]
    write_table(folder / "images.csv", exposures)
    roles = ["control"] * 4 + ["check"] * checks + ["tie"] * (rays - 4 - checks)
    points = [
        {
            "point": f"P{j}",
            "role": role,
            **{axis: round(rng.uniform(-90, 90), 3) for axis in "XYZ"},
            **dict.fromkeys(("sX", "sY", "sZ"), 0.01),
            "rays": images,
        }
        for j, role in enumerate(roles)
    ]
    write_table(folder / "points.csv", points)
    names = ["c", "x0", "y0", "K1", "K2"]
    values = {
        "c": (3412.5, 0.42),
        "x0": (12.3, 0.21),
        "y0": (-7.9, 0.25),
        "K1": (1.2e-9, 2e-10),
        "K2": (3e-17, 6e-17),
    }
    camera = {
        "model": "brown-ideal",
        "unit": "px",
        "size_px": [4000, 3000],
        "pitch_mm": None,
        "parameters": {
            name: {
                "value": values.get(name, (0.0, 0.0))[0],
                "sigma": values.get(name, (0.0, 0.0))[1],
                "estimated": name in names,
            }
            for name in NAMES
        },
        "correlation": {"names": names, "matrix": (0.1 * np.ones((5, 5)) + 0.9 * np.eye(5)).tolist()},
    }
    result = _result("l1", camera, residuals, images)
    result["block"] |= {
        "observation_unit": "px",
        "observation_axes": "pixel",
        "frame": "EPSG:31982",
        "height": "ellipsoidal",
    }
    d = [
        {"point": f"P{4 + k}", **dict(zip(("dx", "dy", "dz"), rng.normal(0, 0.02, 3), strict=True))}
        for k in range(checks)
    ]
    result["checks"] = {
        "n": checks,
        "rmse_m": {a: float(np.sqrt(np.mean([p[f"d{a}"] ** 2 for p in d]))) if d else 0.0 for a in "xyz"},
        "points": [{**p, "sx": 0.011, "sy": 0.012, "sz": 0.031} for p in d],
    }
    (folder / "result.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    return folder
