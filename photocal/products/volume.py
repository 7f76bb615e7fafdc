"""The step `volume`: of a tank, by sections of its shell or by its mean radius and height.

Partial volumes between neighbouring sections of a tank, and its filling table, with sigmas.

Volumes between sections of any closed shape, by quadrature: areas of outlines, and over the heights.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.findings.document import Paragraph, Piece, Section, TablePart, table, text
from photocal.findings.texts import Catalogue, catalogue
from photocal.products import sections as tanks
from photocal.products.options import VolumeOptions
from photocal.products.sections import RingPoints, Tank, volume_between_sections

Shape = Literal["curve", "polygon"]
# No tank is so wide: its coordinates may be millimetres or feet.
_WIDE_M = 1000.0


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
            f"{count} points do not make an outline", f"measure {least} or more", where=f"section {name}"
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


def measure_closed(points: RingPoints, shape: Shape) -> dict[str, Any]:
    """Give the areas of all sections and the volume between them as plain values.

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
    return {"shape": shape, "sections": sections, "between_sections": between}


def partial_volumes(tank: Tank, wall_thickness: float = 0.0) -> list[dict[str, float]]:
    """Volumes between neighbouring sections, by the end areas; levels above the lowest section."""
    radius, height, covariance = tanks.shells(tank.sections, wall_thickness)
    parts = []
    for k in range(len(radius) - 1):
        made = volume_between_sections(radius[k : k + 2], height[k : k + 2], covariance[k : k + 2])
        levels = height[k : k + 2] - height[0]
        parts.append(_part(levels[0], levels[1], made["volume_m3"], made["sigma_m3"]))
    return parts


def _part(from_m: float, to_m: float, volume_m3: float, sigma_m3: float) -> dict[str, float]:
    return {"from_m": from_m, "to_m": to_m, "volume_m3": volume_m3, "sigma_m3": sigma_m3}


def filling_table(tank: Tank, step_m: float, wall_thickness: float = 0.0) -> list[dict[str, float]]:
    """Volumes from the lowest section to levels that far apart; areas change evenly between sections.

    raises ConfigurationError: for a step that cannot be, or a single section.
    """
    radius, height, covariance = tanks.shells(tank.sections, wall_thickness)
    if len(radius) < 2:
        raise ConfigurationError("a filling table needs two sections", "measure another ring")
    whole = float(height[-1] - height[0])
    most_levels = 10_000
    if not whole / most_levels < step_m <= whole:
        raise ConfigurationError(
            f"levels every {step_m:g} m do not make a table", f"the sections span {whole:g} m"
        )
    levels = np.append(np.arange(step_m, whole * (1 - 1e-9), step_m), whole)
    return [_part(0.0, float(at), *_filled(radius, height, covariance, float(at))) for at in levels]


def _filled(radius: Floats, height: Floats, covariance: Floats, level: float) -> tuple[float, float]:
    """Volume up to a level above the lowest section, and its standard deviation."""
    steps = 1e-6 * np.stack([radius, np.full_like(radius, height[-1] - height[0])], axis=1)
    gradient = np.zeros((len(radius), 2))
    for k in range(len(radius)):
        for axis in (0, 1):
            moved = [np.stack([radius, height], axis=1) for _ in "+-"]
            moved[0][k, axis] += steps[k, axis]
            moved[1][k, axis] -= steps[k, axis]
            above, below = (_volume(one[:, 0], one[:, 1], one[0, 1] + level) for one in moved)
            gradient[k, axis] = (above - below) / (2 * steps[k, axis])
    variance = float(np.einsum("mi,mij,mj->", gradient, covariance, gradient))
    return _volume(radius, height, height[0] + level), float(np.sqrt(variance))


def _volume(radius: Floats, height: Floats, top: float) -> float:
    """Integral of the area, even between sections, up to a height; beyond the last it goes on as there."""
    area, total = np.pi * radius**2, 0.0
    for k in range(len(radius) - 1):
        last = k == len(radius) - 2
        rise = float(height[k + 1] - height[k])
        up = max(top - height[k], 0.0) if last else min(max(top - height[k], 0.0), rise)
        total += area[k] * up + (area[k + 1] - area[k]) * up**2 / (2 * rise)
    return float(total)


@dataclass(frozen=True)
class Volume:
    """The volume of a tank: its figures as a JSON value (m, m^3)."""

    figures: dict[str, Any]

    def __repr__(self) -> str:
        """Say it for people."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        of = self.figures
        pieces: list[Piece] = [_section_table(of["sections"], say)] if "sections" in of else []
        if lines := tuple(_lines(of, say)):
            pieces.append(Paragraph("\n".join(lines)))
        if levels := of.get("filling"):
            keys = {"to_m": ".3f", "volume_m3": ".3f", "sigma_m3": ".3f"}
            rows = [[say.row([level[key]], form) for key, form in keys.items()] for level in levels]
            pieces.append(table(say("volume.filling"), say("volume.levels").split("|"), rows))
        return text([Section("", tuple(pieces))])


# Figures of a section in the order of its row; those of circles have two coordinates of their centre.
_AREAS = {"height_m": ".3f", "height_sigma_m": ".4f", "area_m2": ".4f", "area_sigma_m2": ".4f"}
_CIRCLES = {"radius_m": ".4f", "radius_sigma_m": ".4f", "variance_factor": ".3f", "largest_residual_m": ".4f"}


def _section_table(sections: list[dict[str, Any]], say: Catalogue) -> TablePart:
    rows = []
    for one in sections:
        row = [one["section"], str(one["points"])]
        if "area_sigma_m2" in one:
            row += [say.row([one[key]], form) for key, form in _AREAS.items()]
        else:
            row.append(say.row([one["height_m"]], ".3f"))
            for centre, sigma in zip(one["center_m"].values(), one["center_sigma_m"].values(), strict=True):
                row += [say.row([centre], ".4f"), say.row([sigma], ".4f")]
            # A ring of three points has no variance factor.
            row += ["" if one[key] is None else say.row([one[key]], form) for key, form in _CIRCLES.items()]
        rows.append(row)
    if "center_m" not in sections[0]:
        return table("", say("volume.areas").split("|"), rows)
    first, second = sections[0]["center_m"]
    return table("", say("volume.circles", first=first, second=second).split("|"), rows)


def _lines(of: dict[str, Any], say: Catalogue) -> Iterator[str]:
    """Write what is computed from all sections, a line each."""
    wide = 2.0 * np.sqrt(max((one["area_m2"] for one in of.get("sections", ())), default=0.0) / np.pi)
    if wide > _WIDE_M:
        yield say.told("volume.wide", wide=wide)
    if "mean_radius_m" in of:
        rejected = [
            one for one in of["sections"] if one["global_test"] and not one["global_test"]["accepted"]
        ]
        rough = [one["section"] for one in rejected if one["variance_factor"] > 1.0]
        smooth = [one["section"] for one in rejected if one["variance_factor"] < 1.0]
        if rough:
            yield say("volume.no_circle", names=", ".join(rough))
        if smooth:
            yield say("volume.too_good", names=", ".join(smooth))
        wall = 1e3 * of["wall_thickness_m"]
        inside = say.told("volume.inside", wall=wall) if wall else ""
        sizes = {"radius": of["mean_radius_m"], "sigma": of["mean_radius_sigma_m"]}
        yield say.told("volume.mean_radius", inside=inside, **sizes)
        if (cylinder := of["cylinder"]) is not None:
            # Without redundancy there is no variance factor.
            factor = np.nan if cylinder["variance_factor"] is None else cylinder["variance_factor"]
            yield say.told(
                "volume.cylinder", up=of["vertical_axis"], **{**cylinder, "variance_factor": factor}
            )
    if (between := of.get("between_sections")) is not None:
        # Circles are joined by their end areas, outlines by a spline through their areas.
        rule = "volume.quadrature" if "shape" in of else "volume.end_areas"
        yield say("volume.between", rule=say(rule), volume=_told(between, say))
    parts = of.get("partial_volumes", ())
    if len(parts) > 1:
        yield from (say.told("volume.part", **part) for part in parts)
    if "by_mean_radius" in of:
        yield say("volume.by_radius", volume=_told(of["by_mean_radius"], say))


def _told(volume: dict[str, float], say: Catalogue) -> str:
    shares = say.told("volume.shares", **volume) if "variance_m6" in volume else ""
    return say.told("volume.volume", shares=shares, **volume)


def volume(sections: str | Path | None, options: VolumeOptions) -> Volume:
    """Measure the volume of a tank, round or of any closed shape, with its standard deviation.

    A circle is fitted to every section with the covariance of its points, a cylinder to all of them.

    Parameters
    ----------
    sections
        CSV of points on the shell: section, point, X, Y, Z (m), optional sigmas and correlations;
        None for a volume by mean radius and height only.
    options
        Radius, height and their sigmas (m), shape and wall thickness (m).

    Returns
    -------
    Volume
        Figures, and their text in either language.

    Raises
    ------
    ConfigurationError
        For options that contradict each other, or when there is nothing to compute from.
    InputNotFoundError, InputMalformedError
        For a table that cannot be read.

    Examples
    --------
    >>> import photocal
    >>> tank = photocal.VolumeOptions(radius=6.479, radius_sigma=0.003, height=9.5, height_sigma=0.004)
    >>> round(photocal.volume(None, tank).figures["by_mean_radius"]["volume_m3"], 1)
    1252.8
    """
    radius, radius_sigma, height = options.radius, options.radius_sigma, options.height
    if sections is not None and radius is not None:
        raise ConfigurationError("both a table of sections and --radius are given", "give one of them")
    if sections is None and (radius is None or height is None):
        raise ConfigurationError(
            "there is nothing to compute from",
            "name a table of sections, or give --radius and --height with their sigmas",
        )
    figures: dict[str, Any] = {"schema": tanks.SCHEMA}
    if sections is not None:
        points = tanks.read_ring_points(Path(sections), options.vertical, options.sigma)
        if options.shape != "circle":
            return Volume(figures | _closed(points, options))
        wall = options.wall_thickness
        tank = tanks.measure_tank(points, wall)
        figures |= tanks.tank_json(tank, points.axes, wall)
        radius, radius_sigma = tank.radius, tank.radius_sigma
        figures["partial_volumes"] = partial_volumes(tank, wall)
        if options.filling is not None:
            figures["filling"] = filling_table(tank, options.filling, wall)
        if options.plot is not None:
            tanks.draw_rings(tank, points.axes, options.plot)
    elif (options.sigma, options.plot, options.filling) != (None,) * 3 or options.wall_thickness != 0.0:
        raise ConfigurationError("--sigma, --plot, --filling and --wall-thickness need a table of sections")
    if height is not None:
        # The pairs were checked: with a height there are all four.
        lengths = (radius or 0.0, radius_sigma or 0.0, height, options.height_sigma or 0.0)
        figures["by_mean_radius"] = tanks.cylinder_volume(*lengths)
    return Volume(figures)


def _closed(points: RingPoints, options: VolumeOptions) -> dict[str, Any]:
    round_only = options.plot or options.height or options.wall_thickness or options.filling
    if options.shape not in ("curve", "polygon") or round_only:
        raise ConfigurationError(
            f"--shape {options.shape} with --plot, --height, --filling or --wall-thickness is not possible",
            "use circle, or curve or polygon without them",
        )
    return measure_closed(points, cast("Shape", options.shape))
