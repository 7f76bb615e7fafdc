"""The analysis of a run for programs: `analysis.json`, written by `photocal analyse`."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from photocal.analysis.camera_analysis import CameraAnalysis
from photocal.analysis.method import MethodCheck
from photocal.analysis.outcome import Outcome
from photocal.analysis.robust import Robust
from photocal.analysis.systematic_errors.search import Search
from photocal.findings.catalogue import Catalogue
from photocal.findings.finding import Finding
from photocal.findings.texts import finding_json, finding_text, need_words, plain
from photocal.geometry.camera import PARAMETERS
from photocal.report.stored_analysis import SCHEMA


def analysis_record(outcome: Outcome, say: Catalogue) -> dict[str, Any]:
    """Turn an analysis into plain values, ready for JSON."""
    search = outcome.search
    names = [camera.id for camera in search.first.network.cameras]
    return {
        "schema": SCHEMA,
        "findings": [finding_record(one, say) for one in outcome.findings],
        "variance_factor": as_plain(search.first.solution.variance_factor),
        "alpha": outcome.alpha,
        "correlation_threshold": outcome.threshold,
        "cameras": {
            name: None if one is None else _camera(one, say)
            for name, one in zip(names, outcome.cameras, strict=True)
        },
        "lens_models": {
            name: [as_plain(asdict(one)) for one in fits]
            for name, fits in zip(names, outcome.lenses, strict=True)
        },
        "observation_sigma": as_plain(asdict(search.sigma)),
        "groups": [as_plain(asdict(one)) for one in search.groups],
        "variance_components": {
            "images": [as_plain(asdict(one)) for one in search.images],
            "axes": [as_plain(asdict(one)) for one in search.axes],
            "cameras": [as_plain(asdict(one)) for one in search.cameras],
        },
        "image_shifts": [as_plain(asdict(one)) for one in search.shifts],
        "residual_maps": {
            name: None if cells is None else as_plain(asdict(cells))
            for name, cells in zip(names, search.maps, strict=True)
        },
        "jackknife": _jackknife(search, outcome.robust, names),
        "bootstrap_draws": outcome.robust.draws,
        "network": as_plain(asdict(outcome.shape)),
        "methods": [_method(one, say) for one in outcome.methods],
    }


def finding_record(finding: Finding, say: Catalogue) -> dict[str, Any]:
    """A finding as JSON value, with what schema 1 calls its figures beside."""
    size = {} if finding.size is None else asdict(finding.size)
    return {
        **finding_json(finding, say),
        "kind": finding.code,
        "sentence": finding_text(finding, say, plain),
        "small": finding.small,
        **{key: as_plain(size.get(key)) for key in ("figure", "sigma", "unit")},
        **{f"effect_{key}": as_plain(size.get(key)) for key in ("c", "ground_m", "px")},
    }


def _camera(one: CameraAnalysis, say: Catalogue) -> dict[str, Any]:
    proposal = one.proposal
    return {
        "variance_factor_of_tests": one.variance_factor,
        "significance": [as_plain(asdict(test)) for test in one.tests],
        "effects": [as_plain(asdict(effect)) for effect in one.effects],
        "correlations": [
            {**as_plain(asdict(pair)), "words": say(f"cause.{pair.cause}")} for pair in one.correlations
        ],
        "correlations_with_exterior": [
            {**as_plain(asdict(pair)), "words": say(f"cause.{pair.cause}")} for pair in one.exterior
        ],
        "components": {
            "steps": [as_plain(asdict(step)) for step in proposal.steps],
            "final": as_plain(asdict(proposal.final)),
            "removed": list(proposal.removed),
            "kept": list(proposal.kept),
            "recommended": list(proposal.recommended),
            "proposal": [finding_text(remark, say, plain) for remark in proposal.findings],
            "remarks": [finding_record(remark, say) for remark in proposal.findings],
        },
        "left_out": [as_plain(asdict(outcome)) for outcome in one.left_out],
        "within_flight": [as_plain(asdict(parameter)) for parameter in one.within],
    }


def _method(one: MethodCheck, say: Catalogue) -> dict[str, Any]:
    """A method with its requirements, in codes and in words."""
    return {
        "method": one.method,
        "met": one.met,
        "requirements": [
            {
                "code": need.code,
                "severity": need.severity,
                "met": need.severity == "passed",
                "figures": dict(need.figures),
                **need_words(need.code, need.figures, say),
            }
            for need in one.requirements
        ],
    }


def _jackknife(search: Search, robust: Robust, names: list[str]) -> dict[str, Any]:
    before, after = search.jackknife_first, search.jackknife_last

    def by_parameter(values: Any, camera: int) -> dict[str, Any]:
        estimated = search.first.network.cameras[camera].estimated
        return {PARAMETERS[i]: as_plain(values[camera][i]) for i in np.flatnonzero(estimated)}

    return {
        name: {
            "standard_error": by_parameter(before.standard_error, k),
            "sandwich": by_parameter(robust.sandwich, k),
            "bootstrap": None if robust.bootstrap is None else by_parameter(robust.bootstrap, k),
            "standard_error_corrected": by_parameter(after.standard_error, k),
            "left_out": [
                {"images": list(images), "parameters": by_parameter(values, k)}
                for images, values in zip(before.left_out, before.cameras, strict=True)
            ],
            "not_possible": list(before.not_possible),
        }
        for k, name in enumerate(names)
    }


def as_plain(value: Any) -> Any:
    """Replace arrays by lists and what is not a finite number by null."""
    if isinstance(value, np.ndarray):
        return as_plain(value.tolist())
    if isinstance(value, np.generic):
        return as_plain(value.item())
    if isinstance(value, dict):
        return {key: as_plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
