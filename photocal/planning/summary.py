"""A planned flight as text and as JSON."""

import math
from dataclasses import dataclass
from typing import Any

from photocal.accuracy.standard import ScaleStandard, Standard
from photocal.base.arrays import picked
from photocal.base.errors import ConfigurationError
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_json, finding_text
from photocal.geometry.smear import SMEAR_LIMIT_PX, smear_px
from photocal.planning.flight import LevelGeometry, PlannedFlight

SCHEMA = "photocal.plan/1"
STAGES = ("product", "triangulation", "control points")
# With a third, all earlier stages together add 5 % to the error of the last one.
EARLIER_SHARE = 1.0 / 3.0


@dataclass(frozen=True)
class Target:
    """A class that the product shall reach."""

    name: str
    component: str
    ep_m: float


def error_budget(product_m: float) -> dict[str, float]:
    """Divide the standard error of a product among the stages that lead to it, m."""
    if not product_m > 0.0:
        raise ConfigurationError("the standard error of a product must be positive")
    return {name: product_m * EARLIER_SHARE**back for back, name in enumerate(STAGES)}


def targets_of(standard: Standard, scale_denominator: float, class_name: str) -> tuple[Target, ...]:
    """Give what a class of a standard asks for at a scale.

    returns: planimetry, and heights where the standard lists a contour interval for the scale.
    raises ConfigurationError: when the standard has no such class.
    """
    tables = standard.tables if isinstance(standard, ScaleStandard) else ()
    targets = []
    for table in tables:
        size = scale_denominator if table.basis == "scale" else table.interval_at(scale_denominator)
        limits = () if size is None else table.limits_at(size)
        targets += [
            Target(
                f"{table.product}, class {limit.name}, 1:{scale_denominator:g}", table.component, limit.ep_m
            )
            for limit in limits
            if limit.name == class_name
        ]
    if not targets:
        raise ConfigurationError(
            f"{standard.id} has no class {class_name!r}", remedy="take pec-pcd with class A, B, C or D"
        )
    return tuple(targets)


def to_json(
    flight: PlannedFlight, targets: tuple[Target, ...], findings: tuple[Finding, ...]
) -> dict[str, Any]:
    """Give a planned flight as a JSON value."""
    return {
        "schema": SCHEMA,
        "area_ha": flight.area_m2 / 1e4,
        "azimuth_deg": math.degrees(flight.azimuth_rad) % 180.0,
        "levels": [_level(level) for level in flight.levels],
        "along": flight.request.along,
        "strips": len(flight.strips),
        **picked(flight, "exposures", "distance_m", "duration_s"),
        "error_budget_m": {target.name: error_budget(target.ep_m) for target in targets},
        "findings": [finding_json(finding, catalogue("en")) for finding in findings],
    }


def remarks(
    flight: PlannedFlight,
    targets: tuple[Target, ...],
    exposure_time_s: float | None,
    shortest_interval_s: float | None,
) -> tuple[Finding, ...]:
    """Say what stands against a plan.

    shortest_interval_s: shortest time between two photos that the camera manages, s.
    """
    listed = []
    speed = flight.request.speed_m_s
    for level in flight.levels:
        height = f"{level.height_m:.0f} m"
        if shortest_interval_s is not None and level.exposure_interval_s < shortest_interval_s:
            figures = {
                "due_s": level.exposure_interval_s,
                "needed_s": shortest_interval_s,
                "speed_m_s": level.base_m / shortest_interval_s,
            }
            listed.append(Finding("interval-too-short", "doubtful", height, figures))
        smear = 0.0 if exposure_time_s is None else smear_px(exposure_time_s, speed, level.gsd_m)
        if smear > SMEAR_LIMIT_PX:
            longest_ms = SMEAR_LIMIT_PX * level.gsd_m / speed * 1e3
            figures = {"speed_m_s": speed, "smear_px": smear, "longest_ms": longest_ms}
            listed.append(Finding("smear", "doubtful", height, figures))
    precision = flight.levels[0].precision
    for target in targets:
        sigma = precision.plane_m if target.component == "planimetry" else precision.z_m
        if sigma > target.ep_m:
            figures = {"sigma_m": sigma, "allowed_m": target.ep_m}
            listed.append(Finding("precision-above-target", "doubtful", target.name, figures))
    if len(flight.levels) == 1:
        listed.append(Finding("one-height", "note"))
    return tuple(listed)


def to_text(flight: PlannedFlight, targets: tuple[Target, ...], findings: tuple[Finding, ...]) -> str:
    """Write a planned flight for people."""
    area = (
        f"area {flight.area_m2 / 1e4:.2f} ha, {len(flight.strips)} strips, azimuth "
        f"{math.degrees(flight.azimuth_rad) % 180.0:.1f} deg, {flight.exposures} photos, "
        f"{flight.distance_m / 1e3:.2f} km, {flight.duration_s / 60.0:.1f} min at "
        f"{flight.request.speed_m_s:g} m/s without take-off and return"
    )
    lines = [area]
    for level in flight.levels:
        width, height = level.footprint_m
        sigma = level.precision
        lines.append(
            f"height {level.height_m:.2f} m above ground: scale 1:{level.scale_denominator:.0f}, "
            f"GSD {level.gsd_m * 100.0:.2f} cm\n"
            f"  footprint {width:.1f} x {height:.1f} m ({width * height / 1e4:.2f} ha), "
            f"base {level.base_m:.2f} m, strips {level.strip_spacing_m:.2f} m apart, "
            f"a photo every {level.exposure_interval_s:.2f} s\n"
            f"  expected from one pair, at 95 % of the image sides, 0.5 px: sigma X {sigma.x_m:.3f}, "
            f"Y {sigma.y_m:.3f}, Z {sigma.z_m:.3f}, plane {sigma.plane_m:.3f} m\n"
            f"  limit dz of the ministry's form: {level.dz_m * 100.0:.2f} cm\n"
            f"  with c held and no control, each micrometre of c is {height_by_c(level):.3f} m of all heights"
        )
    for target in targets:
        stages = ", ".join(f"{name} {allowed:.3f} m" for name, allowed in error_budget(target.ep_m).items())
        lines.append(f"error budget, {target.name}: {stages}")
    return "\n".join([*lines, *(f"* {finding_text(finding, catalogue('en'))}" for finding in findings)])


def _level(level: LevelGeometry) -> dict[str, Any]:
    keys = ("height_m", "scale_denominator", "gsd_m", "footprint_m", "base_m", "strip_spacing_m", "dz_m")
    sigma = {axis: f"{axis}_m" for axis in ("x", "y", "z", "plane")}
    made = picked(level, *keys, "exposure_interval_s") | {"sigma_m": picked(level.precision, **sigma)}
    return made | {"height_by_c_m_um": height_by_c(level)}


def height_by_c(level: LevelGeometry) -> float:
    """Give the error of all heights for each micrometre that a held c is wrong, m.

    H / c, where positions and straight-down pictures of this height alone tell the heights.
    """
    # The scale denominator is H / c.
    return level.scale_denominator * 1e-6
