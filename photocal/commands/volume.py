"""`photocal volume`: volume of a round tank from its sections or its mean radius."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, cast

from acquire.console import answer
from drivers.errors import ConfigurationError
from photocal.commands.options import AsJson, argument, option


def volume(
    sections: Annotated[
        Path | None,
        argument(
            "CSV of the points on the shell: section, point, X, Y, Z in metres, optional standard "
            "deviations sX, sY, sZ and correlations rXY, rXZ, rYZ."
        ),
    ] = None,
    radius: Annotated[float | None, option("Mean radius, m, in place of sections.")] = None,
    radius_sigma: Annotated[float | None, option("Its standard deviation, m.")] = None,
    height: Annotated[
        float | None, option("Measured height, m; with sections: volume by their mean radius too.")
    ] = None,
    height_sigma: Annotated[float | None, option("Its standard deviation, m.")] = None,
    sigma: Annotated[
        float | None, option("Standard deviation of all coordinates of a table without, m.")
    ] = None,
    vertical: Annotated[str, option("Axis of the table that points up: X, Y or Z.")] = "Z",
    wall_thickness: Annotated[
        float, option("Taken from the measured radii, m, where the points lie outside.")
    ] = 0.0,
    plot: Annotated[Path | None, option("Residual ring plot to write: .pdf, .svg, .png.")] = None,
    as_json: AsJson = False,
) -> None:
    """Volume of a round tank with its standard deviation.

    A circle is fitted to every section with the covariance of its points, a cylinder to all of them.

    Example: `photocal volume sections.csv --sigma 0.014 --height 9.5 --height-sigma 0.004 --plot rings.pdf`
    or `photocal volume --radius 6.479 --radius-sigma 0.003 --height 9.5 --height-sigma 0.004`
    """
    from photocal.products.sections import (
        SCHEMA,
        cylinder_volume,
        tank_json,
        tank_text,
        volume_json,
        volume_text,
    )

    _require_pairs(sections, radius, radius_sigma, height, height_sigma)
    figures: dict[str, Any] = {"schema": SCHEMA}
    lines: list[str] = []
    if sections is not None:
        from photocal.products.sections import draw_rings, measure_tank, read_ring_points

        if vertical not in ("X", "Y", "Z"):
            raise ConfigurationError(f"--vertical {vertical} is no axis", remedy="use X, Y or Z")
        points = read_ring_points(sections, cast("Literal['X', 'Y', 'Z']", vertical), sigma)
        tank = measure_tank(points, wall_thickness)
        figures |= tank_json(tank, points.axes, wall_thickness)
        lines.append(tank_text(tank, points.axes, wall_thickness))
        radius, radius_sigma = tank.radius, tank.radius_sigma
        if plot is not None:
            draw_rings(tank, points.axes, plot)
    elif sigma is not None or plot is not None or wall_thickness != 0.0:
        raise ConfigurationError("--sigma, --plot and --wall-thickness need a table of sections")
    if height is not None:
        # The pairs were checked: with a height there are all four.
        whole = cylinder_volume(radius or 0.0, radius_sigma or 0.0, height, height_sigma or 0.0)
        figures["by_mean_radius"] = volume_json(whole)
        lines.append(f"by mean radius and height: {volume_text(whole)}")
    answer(as_json, lambda: figures, lambda: "\n".join(lines))


def _require_pairs(
    sections: Path | None,
    radius: float | None,
    radius_sigma: float | None,
    height: float | None,
    height_sigma: float | None,
) -> None:
    """Refuse what is given twice, by half, or not at all."""
    if (radius is None) != (radius_sigma is None) or (height is None) != (height_sigma is None):
        raise ConfigurationError(
            "a length stands without its standard deviation, or the other way round",
            remedy="give --radius with --radius-sigma and --height with --height-sigma",
        )
    if sections is not None and radius is not None:
        raise ConfigurationError("both a table of sections and --radius are given", remedy="give one of them")
    if sections is None and (radius is None or height is None):
        raise ConfigurationError(
            "there is nothing to compute from",
            remedy="name a table of sections, or give --radius and --height with their sigmas",
        )
