"""Writing the results of an adjustment as a run folder."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from photocal.adjustment.mounting import BORESIGHT, COMMON, STRIPS
from photocal.adjustment.solution import Solution, global_test
from photocal.block.model import ROLES, Block, FiducialFit
from photocal.block.network import NetworkOfBlock, plane_per_unit
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.frames import nearest_rotation
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle

Floats = NDArray[np.float64]

SCHEMA = "photocal.adjustment/1"
# Residual tables longer than this are written as Parquet.
LONG_TABLE = 500_000


def summary(
    block: Block, assembly: NetworkOfBlock, solution: Solution, timing_s: dict[str, float]
) -> dict[str, Any]:
    """Make the content of `result.json`.

    Parameters
    ----------
    timing_s : dict
        Seconds by stage.

    Returns
    -------
    dict
        Plain values, ready for JSON.
    """
    test = global_test(solution.chi_squared, solution.degrees_of_freedom)
    factor = solution.variance_factor
    return {
        "schema": SCHEMA,
        "software": {"name": "photocal", "version": importlib.metadata.version("photocal")},
        "block": {
            "name": block.name,
            "frame": block.frame,
            "height": block.height,
            "datum": block.datum,
            "observation_unit": block.observations.unit,
            "observation_axes": block.observations.axes,
        },
        "inputs": [{"path": f.path, "sha256": f.sha256, "bytes": f.size} for f in block.inputs],
        "converged": True,
        "iterations": len(solution.iterations),
        "observations": solution.observations,
        "unknowns": solution.unknowns,
        "degrees_of_freedom": solution.degrees_of_freedom,
        "chi_squared": solution.chi_squared,
        "sigma0_squared": factor if np.isfinite(factor) else None,
        "global_test": None if test is None else dict(vars(test)),
        "groups": [dict(vars(group)) for group in solution.groups],
        "cameras": _cameras(block, solution),
        "images": _image_residuals(block, assembly, solution),
        "fiducials": [_fiducials(fit) for fit in block.fiducial_fits],
        "mounting": _mounting(block, solution),
        "checks": _checks(block, assembly, solution),
        "rejected": _rejected(block, assembly),
        "unobserved": [block.points.names[j] for j in np.flatnonzero(_unobserved(block))],
        "timing_s": timing_s,
    }


def _unobserved(block: Block) -> NDArray[np.bool_]:
    return np.asarray(np.bincount(block.observations.point, minlength=len(block.points.names)) == 0)


def write_run(
    folder: Path, block: Block, assembly: NetworkOfBlock, solution: Solution, result: dict[str, Any]
) -> None:
    """Write `result.json` and the tables beside it.

    Parameters
    ----------
    folder : Path
        Where to write; exists.
    block, assembly, solution
        What was adjusted.
    result : dict
        From `summary`.
    """
    _write(folder / "images.csv", _images(block, assembly, solution))
    _write(folder / "points.csv", _points(block, assembly, solution))
    residuals = _residuals(block, assembly, solution)
    if residuals.num_rows > LONG_TABLE:
        pyarrow.parquet.write_table(residuals, folder / "residuals.parquet")
    else:
        _write(folder / "residuals.csv", residuals)
    pyarrow.parquet.write_table(_covariances(block, assembly, solution), folder / "covariance.parquet")
    (folder / "result.json").write_text(
        json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )


def _write(path: Path, table: Any) -> None:
    options = pyarrow.csv.WriteOptions(quoting_style="needed")
    pyarrow.csv.write_csv(table, path, options)


def _cameras(block: Block, solution: Solution) -> dict[str, Any]:
    cameras = {}
    for camera, values, covariance in zip(
        block.cameras, solution.cameras, solution.camera_covariance, strict=True
    ):
        sigma = np.sqrt(np.diag(covariance))
        active = np.flatnonzero(camera.estimated)
        correlation = covariance[np.ix_(active, active)] / np.outer(sigma[active], sigma[active])
        cameras[camera.id] = {
            "model": camera.model,
            "unit": camera.unit,
            "size_px": list(camera.size_px),
            "pitch_mm": list(camera.pitch) if camera.unit == "mm" else None,
            "reference_radius": camera.reference_radius,
            "affinity": camera.affinity,
            "affinity_form": camera.affinity_form,
            "focus_m": camera.focus_m or None,
            "c_is_a_guess": camera.guessed and not camera.estimated[0],
            "photo_variant": [PARAMETERS[n] for n in np.flatnonzero(camera.deviation_sigma > 0)],
            "parameters": {
                name: {
                    "value": float(values[k]),
                    "given": float(camera.values[k]),
                    "sigma": float(sigma[k]),
                    "estimated": bool(camera.estimated[k]),
                    "prior_sigma": float(camera.prior_sigma[k])
                    if np.isfinite(camera.prior_sigma[k])
                    else None,
                }
                for k, name in enumerate(PARAMETERS)
            },
            "correlation": {"names": [PARAMETERS[k] for k in active], "matrix": correlation.tolist()},
        }
    return cameras


def _mounting(block: Block, solution: Solution) -> dict[str, Any] | None:
    """Lever arm (m, body axes), boresight (deg), time offset (s) and the strips' shifts and drifts."""
    if not len(block.positions.image) and not len(block.attitudes.image):
        return None
    strips = (len(solution.state.common) - STRIPS) // 6
    names = list(COMMON) + [
        f"{what}_{axis}[{strip}]" for strip in range(strips) for what in ("shift", "drift") for axis in "xyz"
    ]
    scale = np.ones(len(names))
    scale[BORESIGHT] = np.degrees(1.0)
    values = solution.state.common * scale
    sigma = np.sqrt(np.diag(solution.common_covariance)) * scale
    return {
        name: {
            "value": float(values[k]),
            "sigma": float(sigma[k]),
            "estimated": bool(block.mounting.sigma[k] != 0),
        }
        for k, name in enumerate(names)
    }


def _fiducials(fit: FiducialFit) -> dict[str, Any]:
    """How an image's fiducial marks fit, in the unit of its camera."""
    return {
        "image": fit.image,
        "sigma0": fit.sigma0 if fit.redundancy else None,
        "residuals": [
            {"fiducial": name, "vx": vx, "vy": vy}
            for name, (vx, vy) in zip(fit.fiducials, fit.residuals.tolist(), strict=True)
        ],
    }


def _rejected(block: Block, assembly: NetworkOfBlock) -> list[dict[str, str]]:
    """Observations that take no part because data snooping found them wrong."""
    part = np.zeros(len(block.observations.image), dtype=np.bool_)
    part[assembly.rays] = True
    return [
        {
            "image": block.images.names[block.observations.image[row]],
            "point": block.points.names[block.observations.point[row]],
        }
        for row in np.flatnonzero(~part)
    ]


def _image_residuals(block: Block, assembly: NetworkOfBlock, solution: Solution) -> dict[str, Any]:
    v = observed_residuals(block, assembly, solution)
    image = assembly.network.rays.image
    count = np.bincount(image, minlength=len(block.images.names))
    squares = [np.bincount(image, v[:, a] ** 2, len(count)) for a in range(2)]
    rms = np.sqrt(np.column_stack(squares) / np.maximum(count, 1)[:, None])
    rows = zip(block.images.names, count.tolist(), rms.tolist(), strict=True)
    return {
        "n": len(count),
        "rms": [{"image": name, "rays": n, "rms_x": x, "rms_y": y} for name, n, (x, y) in rows],
    }


def _checks(block: Block, assembly: NetworkOfBlock, solution: Solution) -> dict[str, Any]:
    """Differences adjusted minus surveyed at the check points."""
    check = block.points.of_role("check")[assembly.points]
    index = assembly.points[check]
    values, covariance = given_points(assembly, solution)
    d = values[check] - block.points.values[index]
    sigma = np.sqrt(np.diagonal(covariance[check], axis1=1, axis2=2))
    rmse = np.sqrt(np.mean(d**2, axis=0)).tolist() if len(d) else [None] * 3
    points = [
        dict(
            zip(("point", "dx", "dy", "dz", "sx", "sy", "sz"), (block.points.names[j], *dj, *sj), strict=True)
        )
        for j, dj, sj in zip(index, d.tolist(), sigma.tolist(), strict=True)
    ]
    return {"n": len(d), "rmse_m": dict(zip("xyz", rmse, strict=True)), "points": points}


def observed_residuals(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Floats:
    """Residuals (computed minus measured) in the unit and axes of the observations, shape (rays, 2)."""
    camera = block.images.camera[assembly.network.rays.image]
    sign = np.array([1.0, -1.0 if block.observations.axes == "pixel" else 1.0])
    return np.asarray(solution.residuals / plane_per_unit(block)[camera] * sign)


def given_points(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Adjusted points in the block's coordinates, shape (n, 3), and their covariance, (n, 3, 3)."""
    values = assembly.frame.to_given(solution.points)
    back = np.linalg.inv(assembly.frame.derivative(values))
    return values, np.asarray(back @ solution.point_covariance @ np.swapaxes(back, 1, 2))


def given_exposures(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Adjusted exterior orientation in the block's coordinates, shape (n, 6), and covariance, (n, 6, 6).

    The angles refer to the axes of the given coordinates at each image.
    """
    values = solution.exposures.copy()
    values[:, 3:] = assembly.frame.to_given(values[:, 3:])
    derivative = assembly.frame.derivative(values[:, 3:])
    turn = nearest_rotation(derivative)
    jacobian = np.broadcast_to(np.eye(6), solution.exposure_covariance.shape).copy()
    if not np.array_equal(turn, np.broadcast_to(np.eye(3), turn.shape)):
        matrix = solution.state.rotation @ turn
        values[:, :3] = angles_from_matrix(matrix)
        local = turn_per_angle(solution.exposures[:, :3])
        jacobian[:, :3, :3] = np.linalg.solve(turn_per_angle(values[:, :3]), local)
        jacobian[:, 3:, 3:] = np.linalg.inv(derivative)
    covariance = jacobian @ solution.exposure_covariance @ np.swapaxes(jacobian, 1, 2)
    return values, np.asarray(covariance)


def _images(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Any:
    values, covariance = given_exposures(assembly, solution)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    columns: dict[str, Any] = {
        "image": list(block.images.names),
        "camera": [block.cameras[k].id for k in block.images.camera],
    }
    for k, name in enumerate("XYZ"):
        columns[name] = values[:, 3 + k]
    for k, name in enumerate(("omega", "phi", "kappa")):
        columns[name] = np.degrees(values[:, k])
    for k, name in enumerate(("sX", "sY", "sZ")):
        columns[name] = sigma[:, 3 + k]
    for k, name in enumerate(("so", "sp", "sk")):
        columns[name] = np.degrees(sigma[:, k])
    return pa.table(columns)


def _points(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Any:
    values, covariance = given_points(assembly, solution)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    columns: dict[str, Any] = {
        "point": [block.points.names[j] for j in assembly.points],
        "role": [ROLES[r] for r in block.points.role[assembly.points]],
    }
    for k, name in enumerate("XYZ"):
        columns[name] = values[:, k]
        columns["s" + name] = sigma[:, k]
    columns["rays"] = np.bincount(assembly.network.rays.point, minlength=len(values))
    order = ["point", "role", "X", "Y", "Z", "sX", "sY", "sZ", "rays"]
    return pa.table({name: columns[name] for name in order})


def _residuals(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Any:
    """One row for each observation, in the order of the block's table."""
    observations = block.observations
    sign = np.array([1.0, -1.0 if observations.axes == "pixel" else 1.0])
    # Observations that take no part have empty cells.
    v, r, w = np.full((3, len(observations.image), 2), np.nan)
    v[assembly.rays] = observed_residuals(block, assembly, solution)
    r[assembly.rays] = solution.redundancy
    w[assembly.rays] = solution.standardised(assembly.network.rays.sigma) * sign
    images = pa.DictionaryArray.from_arrays(observations.image, list(block.images.names))
    points = pa.DictionaryArray.from_arrays(observations.point, list(block.points.names))
    columns: dict[str, Any] = {
        "image": images.dictionary_decode(),
        "point": points.dictionary_decode(),
        "x": observations.values[:, 0],
        "y": observations.values[:, 1],
    }
    for name, pair in (("v", v), ("r", r), ("w", w)):
        for k, axis in enumerate("xy"):
            # An observation that no other checks has no standardised residual: an empty cell.
            columns[name + axis] = pa.array(pair[:, k], from_pandas=True)
    return pa.table(columns)


def _covariances(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Any:
    """One row for each image (deg, m), point (m) and camera: its unknowns and the lower triangle by rows."""
    scale = np.array([*np.degrees(np.ones(3)), 1.0, 1.0, 1.0])
    pose, xyz = ["omega", "phi", "kappa", "X", "Y", "Z"], ["X", "Y", "Z"]
    points = [block.points.names[j] for j in assembly.points]
    of_images = given_exposures(assembly, solution)[1] * np.outer(scale, scale)
    rows = [("image", block.images.names, pose, of_images)]
    rows.append(("point", tuple(points), xyz, given_points(assembly, solution)[1]))
    for camera, covariance in zip(block.cameras, solution.camera_covariance, strict=True):
        active = np.flatnonzero(camera.estimated)
        own = covariance[np.ix_(active, active)][None]
        rows.append(("camera", (camera.id,), [PARAMETERS[k] for k in active], own))
    lower = [m[:, *np.tril_indices(m.shape[1])] for _, _, _, m in rows]
    return pa.table(
        {
            "kind": [kind for kind, ids, _, _ in rows for _ in ids],
            "id": [name for _, ids, _, _ in rows for name in ids],
            "names": [names for _, ids, names, _ in rows for _ in ids],
            "lower": pa.concat_arrays([_lists(part) for part in lower]),
        }
    )


def _lists(rows: Floats) -> Any:
    """Arrow list array of equally long rows."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * rows.shape[1]
    return pa.ListArray.from_arrays(offsets, np.ascontiguousarray(rows).ravel())
