"""The analysis for a program."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from photocal.analysis.camera_analysis import CameraAnalysis
from photocal.analysis.hidden.residual_map import ResidualMap
from photocal.analysis.hidden.search import Search
from photocal.analysis.outcome import Outcome
from photocal.geometry.camera import PARAMETERS

SCHEMA = "photocal.analysis/1"


def as_figures(outcome: Outcome) -> dict[str, Any]:
    """Turn an analysis into plain values, ready for JSON.

    Parameters
    ----------
    outcome : Outcome
        The analysis.

    Returns
    -------
    dict
        "findings" first, worst first; what is not determined is null.
    """
    search = outcome.search
    names = [camera.id for camera in search.first.network.cameras]
    return {
        "schema": SCHEMA,
        "findings": [_plain(asdict(one)) for one in outcome.findings],
        "variance_factor": _plain(search.first.solution.variance_factor),
        "alpha": outcome.alpha,
        "correlation_threshold": outcome.threshold,
        "cameras": {
            name: None if one is None else _camera(one)
            for name, one in zip(names, outcome.cameras, strict=True)
        },
        "observation_sigma": _plain(asdict(search.sigma)),
        "variance_components": {
            "images": [_plain(asdict(one)) for one in search.images],
            "axes": [_plain(asdict(one)) for one in search.axes],
            "cameras": [_plain(asdict(one)) for one in search.cameras],
        },
        "image_shifts": [_plain(asdict(one)) for one in search.shifts],
        "residual_maps": {
            name: None if cells is None else _map(cells)
            for name, cells in zip(names, search.maps, strict=True)
        },
        "jackknife": _jackknife(search, names),
        "network": _plain(asdict(outcome.shape)),
        "methods": [_plain(asdict(one)) for one in outcome.methods],
    }


def _camera(one: CameraAnalysis) -> dict[str, Any]:
    return {
        "variance_factor_of_tests": one.variance_factor,
        "significance": [_plain(asdict(test)) for test in one.tests],
        "effects": [_plain(asdict(effect)) for effect in one.effects],
        "correlations": [_plain(asdict(pair)) for pair in one.correlations],
        "correlations_with_exterior": [_plain(asdict(pair)) for pair in one.exterior],
        "components": {
            "steps": [_plain(asdict(step)) for step in one.proposal.steps],
            "final": _plain(asdict(one.proposal.final)),
            "removed": list(one.proposal.removed),
            "kept": list(one.proposal.kept),
            "proposal": list(one.proposal.sentences),
        },
        "left_out": [_plain(asdict(outcome)) for outcome in one.left_out],
    }


def _map(cells: ResidualMap) -> dict[str, Any]:
    figures: dict[str, Any] = _plain(asdict(cells))
    return figures


def _jackknife(search: Search, names: list[str]) -> dict[str, Any]:
    before, after = search.jackknife_first, search.jackknife_last

    def by_parameter(values: Any, camera: int) -> dict[str, Any]:
        estimated = search.first.network.cameras[camera].estimated
        return {PARAMETERS[i]: _plain(values[camera][i]) for i in np.flatnonzero(estimated)}

    return {
        name: {
            "standard_error": by_parameter(before.standard_error, k),
            "standard_error_corrected": by_parameter(after.standard_error, k),
            "left_out": [
                {"images": list(images), "parameters": by_parameter(values, k)}
                for images, values in zip(before.left_out, before.cameras, strict=True)
            ],
            "not_possible": list(before.not_possible),
        }
        for k, name in enumerate(names)
    }


def _plain(value: Any) -> Any:
    """Replace arrays by lists and what is not a finite number by null."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
