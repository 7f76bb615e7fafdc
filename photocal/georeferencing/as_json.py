"""A block's check as a JSON value (schema `photocal.block-check/2`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drivers.arrays import Floats
from photocal.accuracy.as_json import finite
from photocal.accuracy.as_json import to_json as assessment_json
from photocal.accuracy.discrepancies import SIGN
from photocal.findings.catalogue import Catalogue, catalogue
from photocal.findings.finding import verdict
from photocal.findings.texts import finding_json
from photocal.georeferencing.comparison import BlockCheck, Judged
from photocal.georeferencing.differences import CRITICAL_W, ELLIPSE_PROBABILITY, Differences, JointTest
from photocal.georeferencing.findings import block_findings
from photocal.georeferencing.freed_groups import Estimate
from photocal.georeferencing.separation import Separation
from photocal.georeferencing.systematic import Hypothesis, SystematicErrors

SCHEMA = "photocal.block-check/2"
_AXES = ("X", "Y", "Z")
_POSE = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")


def to_json(check: BlockCheck, say: Catalogue | None = None) -> dict[str, Any]:
    """Give a block's check as a JSON value, its findings in a language (English when none is given).

    returns: lengths in m; null where a figure does not exist.
    """
    exposures, found = check.exposures, block_findings(check)
    scale = np.array([*np.degrees(np.ones(3)), 1.0, 1.0, 1.0])
    return {
        "schema": SCHEMA,
        "block": check.block.name,
        "sign": SIGN,
        "methods": {one.found.method: _method(check, one) for one in check.judged},
        "refused": [{"method": method, "reason": reason} for method, reason in check.refused],
        "exposures_direct_less_indirect": None
        if exposures is None
        else {
            "images": exposures.images,
            "mean": dict(zip(_POSE, (exposures.mean * scale).tolist(), strict=True)),
            "rmse": dict(zip(_POSE, (exposures.rmse * scale).tolist(), strict=True)),
        },
        "systematic_errors": None if check.systematic is None else _systematic(check.systematic),
        "separation": None if check.separation is None else _separation(check.separation),
        "mistyped": [
            {
                "point": one.point,
                "d_m": one.d.tolist(),
                "sigma_m": one.sigma.tolist(),
                "slips": list(one.slips),
            }
            for one in check.mistyped
        ],
        "verdict": finding_json(verdict(found), say or catalogue("en")),
        "findings": [finding_json(one, say or catalogue("en")) for one in found],
    }


def _method(check: BlockCheck, judged: Judged) -> dict[str, Any]:
    found = judged.found
    return {
        "label": found.label,
        "chi_squared": found.chi_squared,
        "degrees_of_freedom": found.degrees_of_freedom,
        "global_test": None if found.test is None else dict(vars(found.test)),
        "control": _differences(judged.control),
        "check": _differences(judged.check),
        "images": [
            {"image": name, "rays": n, "rms_x_px": x, "rms_y_px": y, "largest_w": w}
            for name, n, (x, y), w in zip(
                check.block.images.names,
                found.images.rays.tolist(),
                found.images.rms.tolist(),
                found.images.largest.tolist(),
                strict=True,
            )
        ],
        "assessment": None if judged.assessment is None else assessment_json(judged.assessment),
    }


def _differences(found: Differences) -> dict[str, Any]:
    return {
        "n": len(found.names),
        "rmse_m": _by_axis(found.rmse),
        "predicted_m": _by_axis(found.predicted),
        "errors_over_prediction": finite(found.ratio),
        "critical_w": CRITICAL_W,
        "ellipse_probability": ELLIPSE_PROBABILITY,
        "joint": None if found.joint is None else _joint(found.joint),
        "points": [_point(found, k) for k in range(len(found.names))],
    }


def _by_axis(values: Floats) -> dict[str, float | None]:
    return {axis: finite(value) for axis, value in zip(_AXES, values.tolist(), strict=True)}


def _joint(one: JointTest) -> dict[str, Any]:
    return {
        **vars(one),
        "mean": _by_axis(one.mean),
        "mean_sigma": _by_axis(one.mean_sigma),
    }


def _point(found: Differences, k: int) -> dict[str, Any]:
    keyed: dict[str, Any] = {"point": found.names[k]}
    for a, axis in enumerate(_AXES):
        keyed[f"d{axis}_m"] = float(found.d[k, a])
        keyed[f"s{axis}_m"] = float(found.product_sigma[k, a])
        keyed[f"w{axis}"] = finite(float(found.w[k, a]))
    keyed["chi_squared"] = finite(float(found.distance[k]))
    keyed["covariance_m2"] = found.covariance[k][np.tril_indices(3)].tolist()
    keyed["ellipse"] = {
        "semi_major_m": float(found.ellipses.semi_axes[k, 0]),
        "semi_minor_m": float(found.ellipses.semi_axes[k, 1]),
        "azimuth_deg": math.degrees(found.ellipses.azimuth[k]),
    }
    return keyed


def _systematic(errors: SystematicErrors) -> dict[str, Any]:
    return {
        "tested": [_hypothesis(one) for one in errors.tested],
        "found": [
            {**_hypothesis(one.found), "not_separated_from": [_name(code) for code in one.same]}
            for one in errors.errors
        ],
        "together": [_estimate(one) for one in errors.estimates],
        "untested": list(errors.untested),
        "stated_sigmas": [vars(one) for one in errors.sigmas],
        "free_in_block": [_estimate(one) for one in errors.own],
    }


def _name(code: str) -> str:
    """What schema 1 calls a fault."""
    return code.replace("-", " ")


def _hypothesis(one: Hypothesis) -> dict[str, Any]:
    return {
        "name": _name(one.name),
        "gain": one.gain,
        "factor": one.factor,
        "unknowns": one.unknowns,
        "f": one.f,
        "critical": one.critical,
        "significant": one.significant,
        "estimates": [_estimate(e) for e in one.estimates],
    }


def _estimate(one: Estimate) -> dict[str, Any]:
    return {key: (bool(v) if key == "significant" else v) for key, v in vars(one).items()}


def _separation(found: Separation) -> dict[str, Any]:
    return {
        "names": list(found.names),
        "sigma": found.sigma.tolist(),
        "correlation": found.correlation.tolist(),
        "not_separated": [list(group) for group in found.groups],
    }
