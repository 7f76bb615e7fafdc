"""Volumes between sections of any closed shape, by quadrature: areas of outlines, and over the heights."""

from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.products.sections import RingPoints

Shape = Literal["curve", "polygon"]
_ROW = (
    "{section:<8} {points:>6} {height_m:>10.3f} {height_sigma_m:>8.4f} {area_m2:>12.4f} {area_sigma_m2:>8.4f}"
)


def outline_form(points: Floats, shape: Shape) -> Floats:
    """Give G (n, n) with which a closed outline through points (n, 2) encloses the area x' G y.

    By Green's theorem over straight sides, or over the periodic cubic spline on the lengths of the chords.
    """
    n = len(points)
    following = np.roll(np.eye(n), 1, axis=1)
    if shape == "polygon":
        return np.asarray((following - following.T) / 2.0)
    chords = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    along = np.concatenate([[0.0], np.cumsum(chords)])
    basis = CubicSpline(along, np.vstack([np.eye(n), np.eye(n)[:1]]), bc_type="periodic")
    # Gauss-Legendre nodes that integrate the products of cubics and their slopes exactly.
    nodes = 3
    node, weight = np.polynomial.legendre.leggauss(nodes)
    at = (along[:-1, None] + chords[:, None] * (node + 1.0) / 2.0).ravel()
    weights = (chords[:, None] * weight / 2.0).ravel()
    value, slope = basis(at), basis(at, 1)
    form = np.einsum("q,qi,qj->ij", weights, value, slope)
    return np.asarray((form - form.T) / 2.0)


def outline(points: RingPoints, name: str, shape: Shape) -> dict[str, Any]:
    """Measure a section whose points stand in their order around it; raises IllPosedError for too few."""
    rows = np.array([section == name for section in points.section])
    values, covariance = points.values[rows], points.covariance[rows]
    count, least = len(values), 3 if shape == "polygon" else 4
    if count < least:
        raise IllPosedError(
            f"{count} points are no outline", f"measure {least} or more", where=f"section {name}"
        )
    # About the middle, so that large coordinates keep their digits.
    plane = values[:, :2] - values[:, :2].mean(axis=0)
    form = outline_form(plane, shape)
    gradient = np.column_stack([form @ plane[:, 1], form.T @ plane[:, 0]])
    variance = np.einsum("ni,nij,nj->", gradient, covariance[:, :2, :2], gradient)
    return {
        "section": name,
        "points": count,
        "height_m": float(values[:, 2].mean()),
        "height_sigma_m": float(np.sqrt(covariance[:, 2, 2].sum()) / count),
        "area_m2": abs(float(plane[:, 0] @ form @ plane[:, 1])),
        "area_sigma_m2": float(np.sqrt(variance)),
    }


def measure_closed(points: RingPoints, shape: Shape) -> tuple[dict[str, Any], str]:
    """Give the areas of all sections and the volume between them as plain values, and as text.

    Areas are integrated over heights by the spline of third degree, or the highest that the sections bear.
    raises IllPosedError: for a single section, or two of one height.
    """
    outlines = (outline(points, name, shape) for name in dict.fromkeys(points.section))
    sections = sorted(outlines, key=lambda section: float(section["height_m"]))
    of = {key: np.array([section[key] for section in sections]) for key in sections[0]}
    height, area = of["height_m"], of["area_m2"]
    if len(sections) < 2 or (np.diff(height) <= 0).any():
        raise IllPosedError(
            "a volume needs sections of different mean heights", "is the vertical axis right?"
        )

    def volume(at: Floats, areas: Floats) -> float:
        """Integral of a spline through the areas of the sections, cubic where there are enough."""
        spline: Any = make_interp_spline(at, areas, k=min(3, len(at) - 1))
        return float(spline.integrate(at[0], at[-1]))

    step, units = 1e-4 * float(np.diff(height).min()), np.eye(len(height))
    by_area = np.array([volume(height, unit) for unit in units])
    either = [[volume(height + side * step * unit, area) for side in (-1, 1)] for unit in units]
    by_height = np.diff(either)[:, 0] / (2.0 * step)
    parts = np.concatenate([by_area * of["area_sigma_m2"], by_height * of["height_sigma_m"]])
    value, sigma = volume(height, area), float(np.linalg.norm(parts))
    between = {"volume_m3": value, "sigma_m3": sigma, "sigma_percent": 100.0 * sigma / value}
    lines = [
        "section  points   height m       sd      area m2       sd",
        *(_ROW.format(**section) for section in sections),
        "between the lowest and the highest section, by quadrature: V = {volume_m3:.3f} m3, standard "
        "deviation {sigma_m3:.4f} m3 = {sigma_percent:.4f} %".format(**between),
    ]
    return {"shape": shape, "sections": sections, "between_sections": between}, "\n".join(lines)
