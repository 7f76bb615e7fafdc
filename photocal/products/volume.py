"""The step `volume`: of a tank, by sections of its shell or by its mean radius and height."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from photocal.base.errors import ConfigurationError
from photocal.products import sections as tanks
from photocal.products.closed_sections import measure_closed
from photocal.products.filling import Filled, filling_table, partial_volumes
from photocal.products.options import VolumeOptions


@dataclass(frozen=True)
class Volume:
    """The volume of a tank: its figures as a JSON value (m, m^3), and a text for people."""

    figures: dict[str, Any]
    text: str

    def __str__(self) -> str:
        """Say it for people."""
        return self.text


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
        Figures and text.

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
    lines: list[str] = []
    if sections is not None:
        if options.shape != "circle":
            return _closed(Path(sections), options)
        points, wall = _points(Path(sections), options), options.wall_thickness
        tank = tanks.measure_tank(points, wall)
        figures |= tanks.tank_json(tank, points.axes, wall)
        lines.append(tanks.tank_text(tank, points.axes, wall))
        radius, radius_sigma = tank.radius, tank.radius_sigma
        parts = partial_volumes(tank, wall)
        figures["partial_volumes"] = [vars(part) for part in parts]
        if len(parts) > 1:
            lines += [f"between {p.from_m:.3f} and {p.to_m:.3f} m: {_told(p)}" for p in parts]
        if options.filling is not None:
            filled = filling_table(tank, options.filling, wall)
            figures["filling"] = [vars(level) for level in filled]
            lines.append("filling table, m above the lowest section:")
            lines += [f"  {level.to_m:.3f}  {_told(level)}" for level in filled]
        if options.plot is not None:
            tanks.draw_rings(tank, points.axes, options.plot)
    elif (options.sigma, options.plot, options.filling) != (None,) * 3 or options.wall_thickness != 0.0:
        raise ConfigurationError("--sigma, --plot, --filling and --wall-thickness need a table of sections")
    if height is not None:
        # The pairs were checked: with a height there are all four.
        whole = tanks.cylinder_volume(radius or 0.0, radius_sigma or 0.0, height, options.height_sigma or 0.0)
        figures["by_mean_radius"] = tanks.volume_json(whole)
        lines.append(f"by mean radius and height: {tanks.volume_text(whole)}")
    return Volume(figures, "\n".join(lines))


def _told(part: Filled) -> str:
    return f"{part.volume_m3:.3f} m3, sigma {part.sigma_m3:.3f} m3"


def _points(sections: Path, options: VolumeOptions) -> tanks.RingPoints:
    if options.vertical not in ("X", "Y", "Z"):
        raise ConfigurationError(f"--vertical {options.vertical} is no axis", "use X, Y or Z")
    return tanks.read_ring_points(sections, cast("Literal['X', 'Y', 'Z']", options.vertical), options.sigma)


def _closed(sections: Path, options: VolumeOptions) -> Volume:
    points = _points(sections, options)
    round_only = options.plot or options.height or options.wall_thickness or options.filling
    if options.shape not in ("curve", "polygon") or round_only:
        raise ConfigurationError(
            f"--shape {options.shape} with --plot, --height, --filling or --wall-thickness makes no sense",
            "use circle, or curve or polygon without them",
        )
    closed, text = measure_closed(points, cast("Literal['curve', 'polygon']", options.shape))
    return Volume({"schema": tanks.SCHEMA} | closed, text)
