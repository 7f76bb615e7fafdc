"""What one picture or one point shows: observations with residual vectors, and where a point is seen."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputNotFoundError
from photocal.block.network import observed_pixels
from photocal.desk.views.shown import Shown, numbers


def picture(shown: Shown, name: str) -> dict[str, Any]:
    """Observations of a picture and where surveyed points that nobody marked would be.

    raises InputNotFoundError: for an image that is not in the result.
    """
    k = shown.image_rows.get(name)
    if k is None:
        raise InputNotFoundError("is not used in the adjustment", "choose another", where=name)
    order, first = shown.of_image
    rows = order[first[k] : first[k + 1]]
    images = shown.result.images
    camera = shown.result.cameras[images.cameras[images.camera[k]].id]
    return {
        "name": name,
        "size_px": list(camera.size_px),
        "station": numbers(shown.on_map(images.station[[k]])[0], 3),
        "station_sigma_m": numbers(images.sigma[k, 3:], 4),
        "angles_deg": numbers(images.angles_deg[k], 4),
        **_rays(shown, rows),
        "points": [shown.result.residuals.point_names[p] for p in shown.result.residuals.point[rows]],
        "predicted": _predicted(shown, k, rows),
    }


def point(shown: Shown, name: str) -> dict[str, Any]:
    """Observations of a point in all pictures, the worst first, and its place.

    raises InputNotFoundError: for a point that is not in the result.
    """
    residuals = shown.result.residuals
    known = {each: k for k, each in enumerate(residuals.point_names)}
    if name not in known:
        raise InputNotFoundError("is not used in the adjustment", "choose another", where=name)
    order, first = shown.of_point
    rows = order[first[known[name]] : first[known[name] + 1]]
    worst = np.nan_to_num(np.abs(residuals.standardised[rows]).max(axis=1), nan=-1.0)
    rows = rows[np.argsort(-worst, kind="stable")]
    k = shown.point_rows.get(name)
    points = shown.result.points
    return {
        "name": name,
        "of_role": None if k is None else points.role[k],
        "at": None if k is None else numbers(shown.on_map(points.values[[k]])[0], 4),
        "sigma_m": None if k is None else numbers(points.sigma[k], 5),
        **_rays(shown, rows),
        "images": [residuals.image_names[i] for i in residuals.image[rows]],
    }


def _rays(shown: Shown, rows: Integers) -> dict[str, Any]:
    """Places (column, row) and residuals, px, of observations; how sure they are, and the role of each."""
    residuals, role = shown.result.residuals, shown.result.points.role
    places, per_px = _pixels(shown)
    vector = residuals.residual[rows] / per_px[rows]
    if shown.result.block.observation_axes == "photo":
        vector = vector * [1.0, -1.0]
    names = (residuals.point_names[p] for p in residuals.point[rows])
    found = (shown.point_rows.get(name) for name in names)
    return {
        "place": numbers(places[rows], 2),
        "residual_px": numbers(vector, 3),
        "in_sigmas": numbers(np.abs(residuals.standardised[rows]).max(axis=1), 2),
        "redundancy": numbers(residuals.redundancy[rows].min(axis=1), 3),
        "role": ["" if k is None else role[k] for k in found],
    }


@lru_cache(maxsize=1)
def _pixels(shown: Shown) -> tuple[Floats, Floats]:
    """Columns and rows of all observations, and units of the observations per pixel."""
    block = shown.block
    mm = block.observations.unit == "mm"
    pitch = np.array([c.pitch if mm else (1.0, 1.0) for c in block.cameras])
    return observed_pixels(block), pitch[block.images.camera[block.observations.image]]


def _predicted(shown: Shown, image: int, rows: Integers) -> list[dict[str, Any]]:
    """Surveyed points that the picture shows by its orientation, but that have no mark in it."""
    residuals, points = shown.result.residuals, shown.block.points
    marked = {residuals.point_names[p] for p in residuals.point[rows]}
    open_ = [
        k
        for k in np.flatnonzero(~points.of_role("tie"))
        if points.names[k] not in marked and np.isfinite(points.values[k]).all()
    ]
    if not open_:
        return []
    local = shown.frame.to_local(points.values[open_])
    place = shown.images.project(np.full(len(open_), image), local)
    size = shown.images.sizes()[image]
    # Predicted places of surveyed points are shown within the picture and so much beyond its edge, px.
    beyond_px = 0.5
    with np.errstate(invalid="ignore"):
        inside = ((place >= -beyond_px) & (place <= size - beyond_px)).all(axis=1)
    return [{"point": points.names[open_[k]], "place": numbers(place[k], 1)} for k in np.flatnonzero(inside)]
