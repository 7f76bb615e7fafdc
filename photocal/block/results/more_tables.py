"""Tables of a run folder that are made when they are asked for."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from photocal.adjustment.factored import factored
from photocal.adjustment.joint import joint_covariance
from photocal.adjustment.reliability import reliability
from photocal.adjustment.solution import Solution
from photocal.base.arrays import Floats
from photocal.base.ellipses import (
    azimuth_and_elevation,
    ellipses,
    ellipsoids,
    hottier_factor,
    mean_precision,
    spheres,
)
from photocal.base.policy import policy
from photocal.base.text_tables import write_table
from photocal.block.model import Block
from photocal.block.network import NetworkOfBlock, plane_per_unit
from photocal.block.options import Wanted
from photocal.block.results.result import AdjustedPoints
from photocal.geometry.camera import OWN


def more_figures(
    block: Block, assembly: NetworkOfBlock, points: AdjustedPoints, wanted: Wanted
) -> dict[str, Any]:
    """Figures of the result that go with them."""
    free = ~assembly.network.points.held.any(axis=1)
    mean = vars(mean_precision(points.covariance[free], points.values[free])) if free.any() else {}
    return {
        "mean_precision_m": {
            name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in mean.items()
        },
        "control_residuals": _control_residuals(block, assembly, points),
        "reliability": {"significance": policy.significance, "power": policy.power}
        if wanted.reliability
        else None,
        "ellipses": None if wanted.ellipses is None else {"probability": wanted.ellipses},
    }


def _control_residuals(
    block: Block, assembly: NetworkOfBlock, points: AdjustedPoints
) -> dict[str, float | None] | None:
    """Root mean square length of the residuals of control points in space, and what Hottier makes of it."""
    control = np.array([role == "control" for role in points.role]) & ~assembly.network.points.held.any(
        axis=1
    )
    apart = (points.values - block.points.values[assembly.points])[control]
    apart = apart[np.isfinite(block.points.sigma[assembly.points][control]).all(axis=1)]
    if not len(apart):
        return None
    rms = float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))
    parameters = sum(len(camera.free) for camera in assembly.network.cameras)
    factor = hottier_factor(2 * int(points.rays[control].sum()), parameters)
    return {
        "n": float(len(apart)),
        "rmse_m": rms,
        "hottier_factor": factor,
        "expected_at_check_points_m": None if factor is None else factor * rms,
    }


def write_more(
    folder: Path,
    block: Block,
    assembly: NetworkOfBlock,
    solution: Solution,
    covariance: Floats,
    wanted: Wanted,
) -> None:
    """Write the tables that are asked for."""
    if len(solution.photo_variant.image):
        _write(folder / "photo_variant.csv", _photo_variant(block, solution))
    if wanted.ellipses is not None:
        _write(folder / "ellipses.csv", _ellipses(block, assembly, covariance, wanted.ellipses))
    if wanted.reliability:
        for name, table in _reliability(block, assembly, solution).items():
            _write(folder / name, table)
    if wanted.joint:
        unknowns, covariance = joint_covariance(factored(assembly.network, solution.state), wanted.unknowns)
        scale = np.array([unknown.scale for unknown in unknowns])
        names = [f"{unknown.name} ({unknown.unit})" if unknown.unit else unknown.name for unknown in unknowns]
        matrix = covariance * np.outer(scale, scale)
        columns = {"unknown": names} | {name: matrix[:, k] for k, name in enumerate(names)}
        _write(folder / "joint_covariance.csv", columns)


def _write(path: Path, columns: dict[str, Any]) -> None:
    arrays = {
        name: pa.array(values, from_pandas=True) if isinstance(values, np.ndarray) else values
        for name, values in columns.items()
    }
    write_table(path, pa.table(arrays))


def _photo_variant(block: Block, solution: Solution) -> dict[str, Any]:
    variant = solution.photo_variant
    return {
        "image": [block.images.names[i] for i in variant.image],
        "camera": [block.cameras[k].id for k in block.images.camera[variant.image]],
        "parameter": [OWN[n] for n in variant.parameter],
        "value": variant.values,
        "sigma": variant.sigma,
        "deviation": variant.deviations,
        "sdeviation": variant.deviation_sigma,
    }


def _ellipses(
    block: Block, assembly: NetworkOfBlock, covariance: Floats, probability: float
) -> dict[str, Any]:
    plane, azimuth = ellipses(covariance, probability)
    space, directions = ellipsoids(covariance, probability)
    azimuths, elevations = azimuth_and_elevation(directions)
    columns: dict[str, Any] = {
        "point": [block.points.names[j] for j in assembly.points],
        "a": plane[:, 0],
        "b": plane[:, 1],
        "azimuth": np.degrees(azimuth),
    }
    for k, axis in enumerate("123"):
        columns["A" + axis] = space[:, k]
        columns["azimuth" + axis] = np.degrees(azimuths[:, k])
        columns["elevation" + axis] = np.degrees(elevations[:, k])
    quadratic = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    return {**columns, "sphere": spheres(space), "quadratic_sigma": quadratic}


def _reliability(block: Block, assembly: NetworkOfBlock, solution: Solution) -> dict[str, dict[str, Any]]:
    """Tables of the rays and of the control coordinates; an infinite figure is an empty cell."""
    figures = reliability(assembly.network, solution)
    network = assembly.network
    per_unit = plane_per_unit(block)[network.exposures.camera[network.rays.image]]
    rays: dict[str, Any] = {
        "image": [network.image_names[i] for i in network.rays.image],
        "point": [network.point_names[j] for j in network.rays.point],
    }
    control = np.flatnonzero(np.isfinite(figures.control_bias).any(axis=1))
    marks: dict[str, Any] = {"point": [network.point_names[j] for j in control]}
    for k, axis in enumerate("xy"):
        rays["mdb_" + axis] = _finite(figures.ray_bias[:, k] / per_unit[:, k])
        rays["external_" + axis] = _finite(figures.ray_external[:, k])
        rays["on_c_" + axis] = _finite(figures.ray_on_c[:, k])
        rays["on_point_m_" + axis] = _finite(figures.ray_on_point[:, k])
    for k, axis in enumerate("XYZ"):
        marks["mdb_" + axis] = _finite(figures.control_bias[control, k])
        marks["external_" + axis] = _finite(figures.control_external[control, k])
        marks["on_c_" + axis] = _finite(figures.control_on_c[control, k])
    return {"reliability.csv": rays, "control_reliability.csv": marks}


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, np.nan)
