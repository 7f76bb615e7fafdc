"""What `photocal volume` answers, as JSON values and as text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from acquire.outputs import output_file
from drivers.errors import ConfigurationError
from photocal.adjustment.solution import global_test
from photocal.products.sections import Section, Tank, Volume

SCHEMA = "photocal.volume/1"


def volume_json(volume: Volume) -> dict[str, float]:
    """Give a volume as plain values."""
    return {
        "volume_m3": volume.value,
        "variance_m6": volume.variance,
        "radius_variance_m6": volume.radius_variance,
        "height_variance_m6": volume.height_variance,
        "sigma_m3": volume.sigma,
        "sigma_percent": volume.percent,
    }


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
            "variance_factor": _number(cylinder.adjusted.variance_factor),
        },
        "between_sections": None if tank.between is None else volume_json(tank.between),
    }


def _section_json(ring: Section, axes: tuple[str, str, str]) -> dict[str, Any]:
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
        "variance_factor": _number(circle.adjusted.variance_factor),
        "degrees_of_freedom": circle.adjusted.degrees_of_freedom,
        "global_test": None if test is None else dict(vars(test)),
        "largest_residual_m": float(np.abs(circle.radial).max()),
        "radial_m": dict(zip(ring.points, circle.radial.tolist(), strict=True)),
    }


def volume_text(volume: Volume) -> str:
    """Give a volume in one line."""
    return (
        f"V = {volume.value:.3f} m3, variance {volume.variance:.4f} m6 "
        f"(radius {volume.radius_variance:.4f}, height {volume.height_variance:.4f}), "
        f"standard deviation {volume.sigma:.4f} m3 = {volume.percent:.4f} %"
    )


def tank_text(tank: Tank, axes: tuple[str, str, str], wall_thickness: float) -> str:
    """Give a tank as lines of text; parameters as in `tank_json`."""
    first, second, up = axes
    centre = f"centre {first} m     sd   centre {second} m     sd"
    lines = [f"section  points   height m  {centre}   radius m     sd   factor  largest mm"]
    doubtful = []
    for ring in tank.sections:
        circle = ring.circle
        sx, sy, sr = np.sqrt(np.diag(circle.covariance))
        adjusted = circle.adjusted
        test = global_test(adjusted.chi_squared, adjusted.degrees_of_freedom)
        if test is not None and not test.accepted:
            doubtful.append(ring.name)
        lines.append(
            f"{ring.name:<8} {len(ring.points):>6} {ring.height:>10.3f} {circle.center[0]:>12.4f} {sx:.4f} "
            f"{circle.center[1]:>12.4f} {sy:.4f} {circle.radius:>10.4f} {sr:.4f} "
            f"{adjusted.variance_factor:>8.3f} {1e3 * np.abs(circle.radial).max():>11.1f}"
        )
    if doubtful:
        lines.append(
            f"the variance factor of section {', '.join(doubtful)} lies outside its 95 % interval: the "
            "ring is no circle within the stated sigmas (too large), or they are too large (too small)"
        )
    inside = f" inside a wall of {1e3 * wall_thickness:g} mm" if wall_thickness else ""
    lines.append(f"mean radius {tank.radius:.5f} m{inside}, sd {tank.radius_sigma:.5f} m (a priori)")
    if tank.cylinder is not None:
        lines.append(
            f"cylinder: radius {tank.cylinder.radius:.4f} m, axis tilted {np.degrees(tank.tilt):.4f} deg "
            f"(sd {np.degrees(tank.tilt_sigma):.4f}) against {up}, variance factor "
            f"{tank.cylinder.adjusted.variance_factor:.3f}"
        )
    if tank.between is not None:
        lines.append(f"between the lowest and the highest section, end areas: {volume_text(tank.between)}")
    return "\n".join(lines)


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


_INK, _RULE = "#1a1a1a", "#8a8f94"
# The largest residual is drawn as this share of the radius.
_LARGEST = 0.25


def draw_rings(tank: Tank, axes: tuple[str, str, str], path: Path) -> None:
    """Draw the rings of a tank.

    axes: names of the two horizontal axes and the vertical one.
    raises ConfigurationError: for another ending.
    raises OutputError: when it cannot be written.
    """
    if path.suffix.lower() not in (".pdf", ".svg", ".png"):
        raise ConfigurationError(f"{path} has no known ending", remedy="use .pdf, .svg or .png")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    columns = min(3, len(tank.sections))
    rows = -(-len(tank.sections) // columns)
    largest = max(float(np.abs(ring.circle.radial).max()) for ring in tank.sections)
    with mpl.rc_context({"svg.hashsalt": "photocal", "svg.fonttype": "path", "font.size": 8}):
        figure = Figure(figsize=(2.6 * columns, 2.9 * rows), layout="constrained")
        for number, ring in enumerate(tank.sections):
            ax = figure.add_subplot(rows, columns, number + 1)
            circle = ring.circle
            enlarged = _LARGEST * circle.radius / largest if largest > 0 else 1.0
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
        with output_file(path) as aside:
            kind = path.suffix.lower()[1:]
            stamp = {"png": None, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
            figure.savefig(aside, format=kind, metadata=stamp, dpi=200)
