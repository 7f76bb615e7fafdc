"""Volumes between sections of any closed shape, by quadrature: areas of outlines, and over the heights."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from drivers.arrays import Floats
from drivers.errors import IllPosedError
from photocal.products.sections import RingPoints

Shape = Literal["curve", "polygon"]
# Gauss-Legendre nodes that integrate the products of cubics and their slopes exactly.
_NODES = 3


@dataclass(frozen=True)
class Outline:
    """The area within one section; height and area with their standard deviations, m and m2."""

    name: str
    points: int
    height: float
    height_sigma: float
    area: float
    area_sigma: float


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
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    at = (along[:-1, None] + chords[:, None] * (node + 1.0) / 2.0).ravel()
    weights = (chords[:, None] * weight / 2.0).ravel()
    value, slope = basis(at), basis(at, 1)
    form = np.einsum("q,qi,qj->ij", weights, value, slope)
    return np.asarray((form - form.T) / 2.0)


def outline(points: RingPoints, name: str, shape: Shape) -> Outline:
    """Measure a section whose points stand in their order around it; raises IllPosedError for too few."""
    rows = np.array([section == name for section in points.section])
    values, covariance = points.values[rows], points.covariance[rows]
    least = 3 if shape == "polygon" else 4
    if len(values) < least:
        raise IllPosedError(
            f"{len(values)} points are no outline", where=f"section {name}", remedy=f"measure {least} or more"
        )
    # About the middle, so that large coordinates keep their digits.
    plane = values[:, :2] - values[:, :2].mean(axis=0)
    form = outline_form(plane, shape)
    area = float(plane[:, 0] @ form @ plane[:, 1])
    gradient = np.column_stack([form @ plane[:, 1], form.T @ plane[:, 0]])
    variance = np.einsum("ni,nij,nj->", gradient, covariance[:, :2, :2], gradient)
    height_sigma = float(np.sqrt(covariance[:, 2, 2].sum()) / len(values))
    return Outline(
        name, len(values), float(values[:, 2].mean()), height_sigma, abs(area), float(np.sqrt(variance))
    )


def volume_between(outlines: list[Outline]) -> tuple[float, float]:
    """Integrate areas over heights by the spline of third degree, or the highest that so many sections bear.

    returns: volume from the lowest to the highest section, m3, and its standard deviation.
    raises IllPosedError: for a single section, or two of one height.
    """
    height, area = (np.array([getattr(one, name) for one in outlines]) for name in ("height", "area"))
    if len(outlines) < 2 or (np.diff(height) <= 0).any():
        raise IllPosedError(
            "a volume needs sections of different mean heights", remedy="is the vertical axis right?"
        )

    def volume(at: Floats, areas: Floats) -> float:
        spline: Any = make_interp_spline(at, areas, k=min(3, len(at) - 1))
        return float(spline.integrate(at[0], at[-1]))

    step = 1e-4 * float(np.diff(height).min())
    shifts = step * np.eye(len(height))
    by_height = [(volume(height + h, area) - volume(height - h, area)) / (2 * step) for h in shifts]
    by_area = [volume(height, unit) for unit in np.eye(len(area))]
    variance = sum(
        (da * one.area_sigma) ** 2 + (dh * one.height_sigma) ** 2
        for one, da, dh in zip(outlines, by_area, by_height, strict=True)
    )
    return volume(height, area), float(np.sqrt(variance))


def measure_closed(points: RingPoints, shape: Shape) -> tuple[dict[str, Any], str]:
    """Give the areas of all sections and the volume between them as plain values, and as text."""
    names = dict.fromkeys(points.section)
    outlines = sorted((outline(points, name, shape) for name in names), key=lambda one: one.height)
    value, sigma = volume_between(outlines)
    figures = {
        "shape": shape,
        "sections": [vars(one) for one in outlines],
        "between_sections": {"volume_m3": value, "sigma_m3": sigma, "sigma_percent": 100.0 * sigma / value},
    }
    lines = ["section  points   height m       sd      area m2       sd"]
    lines += [
        f"{o.name:<8} {o.points:>6} {o.height:>10.3f} {o.height_sigma:>8.4f} "
        f"{o.area:>12.4f} {o.area_sigma:>8.4f}"
        for o in outlines
    ]
    percent = 100.0 * sigma / value
    lines.append(
        f"between the lowest and the highest section, by quadrature: V = {value:.3f} m3, "
        f"standard deviation {sigma:.4f} m3 = {percent:.4f} %"
    )
    return figures, "\n".join(lines)
