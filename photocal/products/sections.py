"""Sections of a tank: circles of points measured on rings, and what they enclose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain
from photocal.base.chi_square import global_test
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError, PhotocalError
from photocal.base.files import output_picture
from photocal.base.text_tables import read_table, refuse
from photocal.products.surfaces import Circle, Cylinder, fit_circle, fit_cylinder

# The two horizontal axes, such that they and the vertical one are right-handed.
HORIZONTAL: dict[str, tuple[int, int, int]] = {"X": (1, 2, 0), "Y": (2, 0, 1), "Z": (0, 1, 2)}
SIGMAS = ("sX", "sY", "sZ")
CORRELATIONS = ("rXY", "rXZ", "rYZ")
SCHEMA = "photocal.volume/1"
_INK, _RULE = "#1a1a1a", "#8a8f94"


def _propagated(volume: float, variance: float, by_radius: float, by_height: float) -> dict[str, float]:
    """Figures of a volume and of what its uncertainty is made of.

    by_radius, by_height: shares of the variance that come from the radii and from the heights, m6; they add
        up to the variance where radii and heights are uncorrelated.
    """
    sigma = float(np.sqrt(variance))
    shares = {"variance_m6": variance, "radius_variance_m6": by_radius, "height_variance_m6": by_height}
    return {"volume_m3": volume, **shares, "sigma_m3": sigma, "sigma_percent": 100 * sigma / volume}


def cylinder_volume(
    radius: float, radius_sigma: float, height: float, height_sigma: float
) -> dict[str, float]:
    """Give the figures of the volume of an upright cylinder from its mean radius and its height.

    radius, radius_sigma, height, height_sigma: m; radius and height uncorrelated.
    raises ConfigurationError: for a radius or height that is not positive, or a sigma that is negative.
    """
    for name, value in (("radius", radius), ("height", height)):
        if not (np.isfinite(value) and value > 0):
            raise ConfigurationError(f"the {name} is {value:g} m", "give a positive length in metres")
    for name, value in (("radius", radius_sigma), ("height", height_sigma)):
        if not (np.isfinite(value) and value >= 0):
            raise ConfigurationError(
                f"the standard deviation of the {name} is {value:g} m", "give metres, not negative"
            )
    by_radius = (2 * np.pi * radius * height * radius_sigma) ** 2
    by_height = (np.pi * radius**2 * height_sigma) ** 2
    return _propagated(np.pi * radius**2 * height, by_radius + by_height, by_radius, by_height)


def volume_between_sections(radius: Floats, height: Floats, covariance: Floats) -> dict[str, float]:
    """Give the figures of the volume from the lowest to the highest section by the end areas."""
    area, step = np.pi * radius**2, np.diff(height)
    around = np.concatenate([[0.0], step, [0.0]])
    by_radius = np.pi * radius * (around[:-1] + around[1:])
    means = (area[:-1] + area[1:]) / 2
    by_height = np.concatenate([[0.0], means]) - np.concatenate([means, [0.0]])
    gradient = np.column_stack([by_radius, by_height])
    return _propagated(
        float(means @ step),
        float(np.einsum("mi,mij,mj->", gradient, covariance, gradient)),
        float(by_radius**2 @ covariance[:, 0, 0]),
        float(by_height**2 @ covariance[:, 1, 1]),
    )


@dataclass(frozen=True)
class RingPoints:
    """Points on the shell of a tank.

    values (n, 3): two horizontal coordinates and the height, m.
    covariance (n, 3, 3): m2, in the same order.
    axes: names of the three coordinates.
    """

    section: tuple[str, ...]
    point: tuple[str, ...]
    values: Floats
    covariance: Floats
    axes: tuple[str, str, str]


@dataclass(frozen=True)
class TankRing:
    """One ring.

    covariance (2, 2): of radius and height, m2.
    """

    name: str
    points: tuple[str, ...]
    circle: Circle
    height: float
    covariance: Floats


@dataclass(frozen=True)
class Tank:
    """A tank as measured.

    cylinder: through all points: its axis shows the tilt; None where the points fix none.
    tilt, tilt_sigma: of that axis against the vertical, radians; NaN without cylinder.
    between: figures of the volume from the lowest to the highest section; None for a single one.
    """

    sections: tuple[TankRing, ...]
    cylinder: Cylinder | None
    tilt: float
    tilt_sigma: float
    radius: float
    radius_sigma: float
    between: dict[str, float] | None


def read_ring_points(path: Path, vertical: str, sigma_m: float | None) -> RingPoints:
    """Read the table of the points of all sections.

    path: columns section, point, X, Y, Z (m), optional sX, sY, sZ (m), rXY, rXZ, rYZ (correlations).
    sigma_m: standard deviation of all coordinates of a table without sX, sY, sZ.
    raises InputNotFoundError, InputMalformedError: when it is no such table.
    raises ConfigurationError: when no standard deviation is given, or twice, or for no axis.
    """
    if vertical not in HORIZONTAL:
        raise ConfigurationError(f"--vertical {vertical} is not an axis", "use X, Y or Z")
    table = read_table(path, ("section", "point", "X", "Y", "Z"), SIGMAS + CORRELATIONS)
    sigma_columns = [name for name in SIGMAS if table.has(name)]
    stated = ", ".join(sigma_columns)
    if stated and sigma_m is not None:
        raise ConfigurationError(f"{path} has {stated} and --sigma is given", "give one of them")
    if 0 < len(sigma_columns) < 3:
        raise InputMalformedError(f"has {stated} only", "give sX, sY and sZ", where=path)
    if not sigma_columns and sigma_m is None:
        raise ConfigurationError(
            f"{path} has no standard deviations", "add sX, sY, sZ, or give --sigma in metres"
        )
    if sigma_m is not None and not (np.isfinite(sigma_m) and sigma_m > 0):
        raise ConfigurationError(f"--sigma is {sigma_m:g}", "give a positive length in metres")
    values = table.matrix("XYZ")
    sigma = table.matrix(SIGMAS) if sigma_columns else np.full(values.shape, sigma_m, dtype=float)
    refuse(table, np.asarray((sigma <= 0).any(axis=1)), "a standard deviation is not positive", "correct it")
    xy, xz, yz = table.matrix(CORRELATIONS, empty=0.0).T
    ones = np.ones(len(sigma))
    correlation = np.moveaxis(np.array([[ones, xy, xz], [xy, ones, yz], [xz, yz, ones]]), -1, 0)
    covariance = np.asarray(correlation * sigma[:, :, None] * sigma[:, None, :])
    impossible = np.asarray(np.linalg.eigvalsh(covariance)[:, 0] <= 0)
    refuse(table, impossible, "the correlations are impossible", "correct rXY, rXZ, rYZ")
    section, names = table.names("section")
    point, points = table.names("point")
    pair = section * len(points) + point
    _, first = np.unique(pair, return_index=True)
    again = np.ones(len(pair), dtype=np.bool_)
    again[first] = False
    refuse(table, again, "the point appears twice in its section", "keep one of the rows")
    order = list(HORIZONTAL[vertical])
    axes = tuple("XYZ"[k] for k in order)
    return RingPoints(
        tuple(names[k] for k in section),
        tuple(points[k] for k in point),
        values[:, order],
        covariance[:, order][:, :, order],
        (axes[0], axes[1], axes[2]),
    )


def measure_tank(points: RingPoints, wall_thickness: float = 0.0) -> Tank:
    """Fit the circle of each section and add up what lies between them.

    wall_thickness: taken from every radius before a volume is computed, m; 0 where the points lie inside.
    raises IllPosedError: when a section does not determine its circle, or two sections have one height.
    raises ConfigurationError: for an impossible wall.
    """
    names = list(dict.fromkeys(points.section))
    rings = tuple(sorted((_section(points, name) for name in names), key=lambda ring: ring.height))
    radius, height, covariance = shells(rings, wall_thickness)
    if not 0 <= wall_thickness < radius.min() + wall_thickness:
        raise ConfigurationError(
            f"the wall is {wall_thickness:g} m thick", "give metres, less than the radius"
        )
    if (np.diff(height) <= 0).any():
        raise IllPosedError("two sections have the same mean height", "is the vertical axis right?")
    cylinder = _cylinder(points)
    tilt, tilt_sigma = _tilt(cylinder) if cylinder else (np.nan, np.nan)
    return Tank(
        rings,
        cylinder,
        tilt,
        tilt_sigma,
        float(radius.mean()),
        float(np.sqrt(covariance[:, 0, 0].sum()) / len(rings)),
        volume_between_sections(radius, height, covariance) if len(rings) > 1 else None,
    )


def shells(rings: Sequence[TankRing], wall_thickness: float) -> tuple[Floats, Floats, Floats]:
    """Give inner radii (n,), heights (n,) and their covariances (n, 2, 2) of rings."""
    radius = np.array([ring.circle.radius for ring in rings]) - wall_thickness
    height = np.array([ring.height for ring in rings])
    return radius, height, np.array([ring.covariance for ring in rings])


def _section(points: RingPoints, name: str) -> TankRing:
    rows = np.array([section == name for section in points.section])
    values, covariance = points.values[rows], points.covariance[rows]
    try:
        circle = fit_circle(values[:, :2], covariance[:, :2, :2])
    except PhotocalError as failure:
        raise type(failure)(failure.what, where=f"section {name}", remedy=failure.remedy) from failure
    count = len(values)
    # Radius and mean height are both linear in the corrections of the points.
    together = np.einsum("ni,ni->", circle.adjusted.influence[2], covariance[:, :2, 2]) / count
    of_height = covariance[:, 2, 2].sum() / count**2
    members = tuple(point for point, row in zip(points.point, rows, strict=True) if row)
    of_both = np.array([[circle.covariance[2, 2], together], [together, of_height]])
    return TankRing(name, members, circle, float(values[:, 2].mean()), of_both)


def _cylinder(points: RingPoints) -> Cylinder | None:
    try:
        cylinder = fit_cylinder(points.values, points.covariance)
    except PhotocalError:
        # A single ring, or rings close together, fix no axis: the circles are still good.
        return None
    return replace(cylinder, axis=cylinder.axis * np.sign(cylinder.axis[2] or 1.0))


def _tilt(cylinder: Cylinder) -> tuple[float, float]:
    sideways = cylinder.axis[:2]
    length = float(np.linalg.norm(sideways))
    covariance = cylinder.axis_covariance[:2, :2]
    # Upright within rounding there is no direction of the tilt: the mean of all of them then.
    toward = sideways / length if length > 1e-12 else None
    variance = np.trace(covariance) / 2 if toward is None else toward @ covariance @ toward
    return float(np.arctan2(length, cylinder.axis[2])), float(np.sqrt(variance))


def tank_json(tank: Tank, axes: tuple[str, str, str], wall_thickness: float) -> dict[str, Any]:
    """Give a tank as plain values; `wall_thickness`: m."""
    cylinder = tank.cylinder
    return {
        "vertical_axis": axes[2],
        "wall_thickness_m": wall_thickness,
        "sections": [_section_json(ring, axes) for ring in tank.sections],
        "mean_radius_m": tank.radius,
        "mean_radius_sigma_m": tank.radius_sigma,
        "cylinder": None
        if cylinder is None
        else {
            "axis": dict(zip(axes, cylinder.axis.tolist(), strict=True)),
            "point": dict(zip(axes, cylinder.point.tolist(), strict=True)),
            "radius_m": cylinder.radius,
            "radius_sigma_m": cylinder.radius_sigma,
            "tilt_deg": float(np.degrees(tank.tilt)),
            "tilt_sigma_deg": float(np.degrees(tank.tilt_sigma)),
            "variance_factor": as_plain(cylinder.adjusted.variance_factor),
        },
        "between_sections": tank.between,
    }


def _section_json(ring: TankRing, axes: tuple[str, str, str]) -> dict[str, Any]:
    circle = ring.circle
    sigma = np.sqrt(np.diag(circle.covariance))
    test = global_test(circle.adjusted.chi_squared, circle.adjusted.degrees_of_freedom)
    return {
        "section": ring.name,
        "points": len(ring.points),
        "height_m": ring.height,
        "height_sigma_m": float(np.sqrt(ring.covariance[1, 1])),
        "center_m": dict(zip(axes[:2], circle.center.tolist(), strict=True)),
        "center_sigma_m": dict(zip(axes[:2], sigma[:2].tolist(), strict=True)),
        "radius_m": circle.radius,
        "radius_sigma_m": float(sigma[2]),
        "area_m2": float(np.pi * circle.radius**2),
        "variance_factor": as_plain(circle.adjusted.variance_factor),
        "degrees_of_freedom": circle.adjusted.degrees_of_freedom,
        "global_test": None if test is None else dict(vars(test)),
        "largest_residual_m": float(np.abs(circle.radial).max()),
        "radial_m": dict(zip(ring.points, circle.radial.tolist(), strict=True)),
    }


def draw_rings(tank: Tank, axes: tuple[str, str, str], path: Path) -> None:
    """Draw the rings of a tank.

    axes: names of the two horizontal axes and the vertical one.
    raises ConfigurationError, OutputError: as `output_picture` does.
    """
    columns = min(3, len(tank.sections))
    rows = -(-len(tank.sections) // columns)
    largest = max(float(np.abs(ring.circle.radial).max()) for ring in tank.sections)
    # The largest residual is drawn as this share of the radius.
    largest_drawn = 0.25
    with output_picture(path, (2.6 * columns, 2.9 * rows)) as figure:
        for number, ring in enumerate(tank.sections):
            ax = figure.add_subplot(rows, columns, number + 1)
            circle = ring.circle
            enlarged = largest_drawn * circle.radius / largest if largest > 0 else 1.0
            turn = circle.direction
            drawn = circle.radius + enlarged * circle.radial
            around = np.linspace(0, 2 * np.pi, 361)
            ax.plot(circle.radius * np.cos(around), circle.radius * np.sin(around), color=_RULE, lw=0.8)
            order = np.append(np.argsort(turn), np.argmin(turn))
            ax.plot((drawn * np.cos(turn))[order], (drawn * np.sin(turn))[order], color=_INK, lw=0.8)
            ax.plot(drawn * np.cos(turn), drawn * np.sin(turn), ".", color=_INK, ms=3)
            for point, angle, length in zip(ring.points, turn, drawn, strict=True):
                outside = max(float(length), circle.radius) + 0.12 * circle.radius
                ax.text(outside * np.cos(angle), outside * np.sin(angle), point, ha="center", va="center",
                        fontsize=5)  # fmt: skip
            worst = 1e3 * float(np.abs(circle.radial).max())
            ax.set_title(
                f"section {ring.name}, {axes[2]} {ring.height:.3f} m\nR {circle.radius:.4f} m, "
                f"largest {worst:.1f} mm, residuals x {enlarged:.0f}",
                fontsize=7,
            )
            ax.set_aspect("equal")
            ax.set_axis_off()
