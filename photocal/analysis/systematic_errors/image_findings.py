"""Findings about groups of observations: image axes, cameras, images, places on the sensor."""

from __future__ import annotations

import numpy as np

from photocal.analysis.systematic_errors.refit import SMALL_PX
from photocal.analysis.systematic_errors.search import LEVEL, WRONG_SIGMA, Search
from photocal.analysis.systematic_errors.variance_components import VarianceComponent
from photocal.findings.finding import Figure, Finding, Severity, Size

# An image's own scale or principal point is listed when it moves a ray beyond the noise of single ones.
VISIBLE_SIGMAS = 2.5
# Scatter against that of all together: from here on an axis or camera is listed, and no longer called small.
WORTH_A_LINE = 1.05
SMALL_RATIO = 1.25


def of_stated(search: Search) -> list[Finding]:
    """Name groups whose stated standard deviations are wrong by a factor."""
    listed = []
    for one in search.groups:
        if one.p_value >= LEVEL / len(search.groups) or abs(one.factor - 1.0) < WRONG_SIGMA:
            continue
        # What is known beforehand is stated with caution: no error of measurement says otherwise.
        if one.factor < 1.0 and one.name in ("camera", "mounting", "head", "rig"):
            continue
        figures: dict[str, Figure] = {
            "group": one.name,
            "factor": one.factor,
            "lower": one.lower,
            "upper": one.upper,
            "camera": one.of,
        }
        size = Size(one.factor, "1")
        if one.factor > 1.0:
            severity: Severity = "doubtful" if one.factor > SMALL_RATIO else "note"
            listed.append(Finding("sigmas-too-small", severity, one.name, figures, size=size))
        else:
            listed.append(Finding("sigmas-too-large", "note", one.name, figures, size=size))
    return listed


def of_groups(search: Search) -> list[Finding]:
    """Describe image axes and cameras that scatter differently."""
    overall = search.sigma.found / search.sigma.assumed
    return [
        _scatter(code, one, search)
        for code, components in (("axis-scatter", search.axes), ("camera-scatter", search.cameras))
        for one in components
        if one.p_value < LEVEL and one.ratio > WORTH_A_LINE * overall
    ]


def of_images(search: Search) -> list[Finding]:
    """Describe images that scatter more, or have a scale or principal point of their own."""
    components = {one.name: one for one in search.images}
    sigma_px = search.sigma.found / min(search.last.network.cameras[0].pitch)
    overall = search.sigma.found / search.sigma.assumed
    listed = []
    shifts = {one.image: one for one in search.shifts}
    for name, component in components.items():
        shift = shifts.get(name)
        shifted = shift is not None and shift.p_value < LEVEL and shift.effect_px > VISIBLE_SIGMAS * sigma_px
        # One bad image makes the good ones look better than all together: only the bad one is named.
        scattered = component.p_value < LEVEL and component.ratio > overall
        if not (scattered or shifted):
            continue
        found = _scatter("image", component, search)
        if shift is None or not shifted:
            listed.append(found)
            continue
        small = shift.effect_px < SMALL_PX
        figures = {**found.figures, "moved_px": shift.effect_px}
        clauses = ("own_geometry", "small") if small else ("own_geometry",)
        size = Size(_relative(component, search), "1", px=shift.effect_px)
        listed.append(Finding("image", _severity(small=small), name, figures, clauses, size))
    return sorted(listed, key=lambda one: -one.size.figure if one.size else 0.0)


def _severity(*, small: bool) -> Severity:
    return "note" if small else "doubtful"


def _relative(one: VarianceComponent, search: Search) -> float:
    """Scatter of a group over that of all together."""
    return one.ratio / (search.sigma.found / search.sigma.assumed)


def _scatter(code: str, one: VarianceComponent, search: Search) -> Finding:
    relative = _relative(one, search)
    effect = one.ratio * search.sigma.assumed / min(search.last.network.cameras[0].pitch)
    small = effect < SMALL_PX or relative < SMALL_RATIO
    figures: dict[str, Figure] = {"name": one.name, "relative": relative, "px": effect}
    clauses = ("amount", "small") if small else ("amount",)
    return Finding(code, _severity(small=small), one.name, figures, clauses, Size(relative, "1", px=effect))


def of_maps(search: Search) -> list[Finding]:
    """Describe patterns of the residuals on the sensor."""
    listed = []
    for camera, cells in zip(search.last.network.cameras, search.maps, strict=True):
        if cells is None or (cells.global_p_value >= LEVEL and not cells.significant.any()):
            continue
        length = np.linalg.norm(cells.mean_px, axis=-1)
        length[cells.count == 0] = 0.0
        if cells.significant.any():
            length[~cells.significant] = 0.0
        row, column = np.unravel_index(int(np.argmax(length)), length.shape)
        effect = float(length[row, column])
        small = effect < SMALL_PX
        figures: dict[str, Figure] = {
            "camera": camera.id,
            "significant": float(cells.significant.sum()),
            "cells": float(cells.cells),
            "px": effect,
            "column": float(cells.columns_px[column] + cells.columns_px[column + 1]) / 2,
            "row": float(cells.rows_px[row] + cells.rows_px[row + 1]) / 2,
        }
        clauses = ("small",) if small else ()
        size = Size(effect, "px", px=effect)
        listed.append(Finding("residual-map", _severity(small=small), camera.id, figures, clauses, size))
    return listed
