"""`photocal localise`: a local system tied to a map system, and the report of the site calibration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.errors import ConfigurationError
from photocal.base.files import write_json, write_rows
from photocal.base.text_tables import read_wider_table
from photocal.findings.document import KeyValues, Paragraph, Piece, Remarks, Section, markdown, table, text
from photocal.findings.texts import Catalogue
from photocal.geometry.frames import GroundScale, ground_scale
from photocal.geometry.localisation import CommonPoints, FittedPart, Localisation, localise
from photocal.navigation.options import SiteOptions

COLUMNS = ("point", "X", "Y", "Z", "sX", "sY", "sZ", "role")
REPORT, FIGURES = "localisation.md", "localisation.json"


@dataclass(frozen=True)
class PointTable:
    """Points of one system; NaN where a coordinate or a sigma is not given."""

    names: tuple[str, ...]
    values: Floats
    sigma: Floats
    role: tuple[str, ...]


@dataclass(frozen=True)
class SiteCalibration:
    """A local system, the map system, and what ties them.

    fit: over the common points without those left out.
    scale: of the map at the common points' middle.
    """

    crs: str
    local: PointTable
    mapped: PointTable
    common: CommonPoints
    left_out: tuple[str, ...]
    fit: Localisation
    scale: GroundScale

    @property
    def combined(self) -> float:
        """Length in the map of a metre on the ground."""
        return float(self.scale.combined[0])


def read_point_table(path: Path) -> PointTable:
    """Read a table point, X, Y, Z with optional sX, sY, sZ, role; empty cells are not known.

    raises InputMalformedError, InputNotFoundError: as of `read_wider_table`.
    """
    given = read_wider_table(path, COLUMNS[:4])
    places, sigma = given.matrix("XYZ", empty=np.nan), given.matrix(("sX", "sY", "sZ"), empty=np.nan)
    role = given.texts("role") if given.has("role") else ("control",) * len(given)
    return PointTable(given.unique_names("point"), places, sigma, role)


def calibrate(local: PointTable, mapped: PointTable, options: SiteOptions) -> SiteCalibration:
    """Fit a local system to the points that both tables name.

    Common points that are left out are not used, and are shown all the same.
    raises ConfigurationError: for points that are not common, or a scale that is none of these.
    raises IllPosedError: for too few common points.
    """
    left_out, scale = options.left_out, options.scale
    names = tuple(name for name in local.names if name in mapped.names)
    strangers = sorted(set(left_out) - set(names))
    if strangers:
        raise ConfigurationError(
            f"{', '.join(strangers)} cannot be left out: no common point has this name",
            f"common are {', '.join(names) or 'none'}",
            where="--without",
        )
    used = tuple(name for name in names if name not in left_out)
    common = _common(local, mapped, used)
    known = np.isfinite(common.map_m).all(axis=1)
    middle = (common.map_m[known] if known.any() else np.nan_to_num(common.map_m)).mean(axis=0)
    factors = ground_scale(options.crs, middle[None])
    held = {"free": None, "ground": 1.0 / float(factors.combined[0])}
    try:
        value = held[scale] if scale in held else float(scale)
    except ValueError as refusal:
        raise ConfigurationError(
            f"{scale!r} is not a scale", 'give "free", "ground" or a number such as 1.0', where="--scale"
        ) from refusal
    fit = localise(common, value, tilt=not options.level)
    return SiteCalibration(options.crs, local, mapped, common, left_out, fit, factors)


def _common(local: PointTable, mapped: PointTable, names: tuple[str, ...]) -> CommonPoints:
    here, there = ([one.names.index(name) for name in names] for one in (local, mapped))
    sigma = np.sqrt(np.nan_to_num(local.sigma[here]) ** 2 + np.nan_to_num(mapped.sigma[there]) ** 2)
    # One coordinate without any sigma would count as known: then the residuals tell for all.
    stated = sigma if len(names) and bool((sigma > 0).all()) else None
    return CommonPoints(names, mapped.values[there], local.values[here], stated)


def write_calibration(folder: Path, made: SiteCalibration, say: Catalogue) -> dict[str, Any]:
    """Write the report, its figures, and the points of each table in the other system; give the figures."""
    figures = calibration_figures(made)
    write_json(folder / FIGURES, figures, 2)
    (folder / REPORT).write_text(markdown(say("site.title"), sections(made, say)), encoding="utf-8")
    fit = made.fit
    mapped = fit.to_map(made.local.values)
    _write_points(folder / "points.csv", made.local, mapped, fit.sigma_m(mapped))
    local = fit.to_local(made.mapped.values)
    _write_points(folder / "local.csv", made.mapped, local, fit.sigma_m(made.mapped.values))
    return figures


def _write_points(path: Path, given: PointTable, places: Floats, spread: Floats) -> None:
    sigma = np.hypot(given.sigma, spread)
    numbers = np.hstack([places, sigma])
    forms = [".5f"] * 3 + [".6f"] * 3
    rows = [
        [name, *("" if np.isnan(v) else format(v, form) for v, form in zip(row, forms, strict=True)), role]
        for name, row, role in zip(given.names, numbers.tolist(), given.role, strict=True)
    ]
    write_rows(path, COLUMNS, rows)


def calibration_figures(made: SiteCalibration) -> dict[str, Any]:
    """Return the figures of a site calibration, ready for JSON."""
    fit = made.fit
    figures: dict[str, Any] = as_plain(
        {
            "schema": "photocal.localisation/1",
            "crs": made.crs,
            "points": [
                {
                    "point": name,
                    "residual_m": [*fit.plan.residual_m[k], *fit.height.residual_m[k]],
                    "miss_by_the_others_m": [*fit.plan.miss_m[k], *fit.height.miss_m[k]],
                    "probability": {"plan": fit.plan.probability[k], "height": fit.height.probability[k]},
                    "doubtful": {"plan": k in fit.plan.doubtful, "height": k in fit.height.doubtful},
                }
                for k, name in enumerate(made.common.names)
            ],
            "left_out": made.left_out,
            "middle_map_m": fit.middle_m,
            "middle_local_m": fit.plan.parameters[:2],
            "rotation_deg": np.degrees(fit.plan.parameters[2]),
            "scale": fit.plan.parameters[3],
            "scale_free": fit.scale_free,
            "height_shift_m": fit.height.parameters[0],
            "slope_east": fit.height.parameters[1],
            "slope_north": fit.height.parameters[2],
            "tilted": fit.tilted,
            "plan": _part(fit.plan),
            "height": _part(fit.height),
            "ground_to_map": {
                "point_scale_factor": made.scale.point_factor[0],
                "elevation_factor": made.scale.elevation_factor[0],
                "combined_factor": made.combined,
            },
            "metre_of_the_local_system": whose_metre(made),
        }
    )
    return figures


def _part(part: FittedPart) -> dict[str, Any]:
    return {**picked(part, "covariance", "redundancy", sigma0="factor"), "rms_m": _rms(part)}


def _rms(part: FittedPart) -> float:
    return float(
        np.sqrt(np.nanmean(np.nansum(part.residual_m**2, axis=1)[np.isfinite(part.residual_m[:, 0])]))
    )


def whose_metre(made: SiteCalibration) -> str:
    """Whether a metre of the local system is one on the ground, one of the map, either or neither.

    returns: "ground", "map", "either", "neither"; "held" where the scale was not estimated or its
        standard deviation is unknown.
    """
    scale, sigma = made.fit.plan.parameters[3], float(np.sqrt(made.fit.plan.covariance[3, 3]))
    if not made.fit.scale_free or np.isnan(sigma):
        return "held"
    # A scale is that of the ground, or of the map, within so many standard deviations.
    agrees = 3.0
    ground, grid = (abs(scale - wanted) <= agrees * sigma for wanted in (1.0 / made.combined, 1.0))
    return "either" if ground and grid else "ground" if ground else "map" if grid else "neither"


def sections(made: SiteCalibration, say: Catalogue) -> list[Section]:
    """Write the report: parameters, points with residuals and tests, what to look at."""
    fit, combined = made.fit, made.combined
    east, north, angle, scale = fit.plan.parameters.tolist()
    sigma_plan, sigma_height = (np.sqrt(np.diag(part.covariance)) for part in (fit.plan, fit.height))
    middle = dict(zip(("east", "north"), fit.middle_m.tolist(), strict=True))
    turned = _sure(np.degrees(sigma_plan[2:3]), "deg", say, 6)
    plan_ppm = _sure(1e6 * sigma_plan[3:], "ppm", say, 1) if fit.scale_free else f", {say('site.held')}"
    values = (
        say.told("site.place", crs=made.crs, **middle),
        say.told("site.local_place", east=east, north=north) + _sure(sigma_plan[:2], "m", say),
        f"{say.row([np.degrees(angle)], '.6f')} deg{turned}",
        f"{say.row([scale], '.8f')} ({_ppm(scale, say)} ppm{plan_ppm})",
        f"{say.row([fit.height.parameters[0]], '+.4f')} m{_sure(sigma_height[:1], 'm', say)}",
        _slope(fit, sigma_height, say),
        say.row(made.scale.point_factor[:1], ".8f"),
        say.row(made.scale.elevation_factor[:1], ".8f"),
        say("site.to_map", factor=say.row([combined], ".8f"), ppm=_ppm(combined, say)),
        say(f"site.metre_{whose_metre(made)}"),
    )
    rows = tuple(zip(say("site.rows").split("|"), values, strict=True))
    pieces: list[Piece] = [KeyValues(rows), _point_table(made, say), Paragraph(_quality(fit, say))]
    return [Section("", tuple(pieces)), Section(say("site.check"), (Remarks(tuple(_remarks(made, say))),))]


def _sure(sigma: Floats, unit: str, say: Catalogue, decimals: int = 4) -> str:
    known = bool(np.isfinite(sigma).all())
    return f", {say('site.sd')} {say.row(sigma, f'.{decimals}f')} {unit}" if known else ""


def _ppm(factor: float, say: Catalogue) -> str:
    return say.row([1e6 * (factor - 1.0)], "+.1f")


def _slope(fit: Localisation, sigma: Floats, say: Catalogue) -> str:
    if not fit.tilted:
        return say("site.no_slope")
    east, north = (1e6 * fit.height.parameters[1:]).tolist()
    return say.told("site.slope", east=east, north=north) + _sure(1e6 * sigma[1:], "ppm", say, 1)


def _point_table(made: SiteCalibration, say: Catalogue) -> Piece:
    plan, height = made.fit.plan, made.fit.height
    rows = []
    for k, name in enumerate(made.common.names):
        cells = [(value, "+.4f") for value in plan.residual_m[k]]
        cells += [(float(np.hypot(*plan.residual_m[k])), ".4f"), (height.residual_m[k, 0], "+.4f")]
        cells += [(value, "+.4f") for value in (*plan.miss_m[k], *height.miss_m[k])]
        cells += [(part.probability[k], ".4f") for part in (plan, height)]
        rows.append([name, *("" if np.isnan(value) else say.row([value], form) for value, form in cells)])
    return table(say("site.points"), say("site.heads").split("|"), rows, say("site.note"))


def _quality(fit: Localisation, say: Catalogue) -> str:
    parts = []
    for name, part in (("plan", fit.plan), ("height", fit.height)):
        factor = "" if np.isnan(part.factor) else f", sigma0 {say.row([part.factor], '.3g')}"
        sizes = {"rms": _rms(part), "redundancy": part.redundancy}
        parts.append(say.told("site.quality", part=say(f"site.{name}"), **sizes) + factor)
    return "; ".join(parts) + "."


def _remarks(made: SiteCalibration, say: Catalogue) -> list[str]:
    fit, found = made.fit, list[str]()
    for part, name in ((fit.plan, "plan"), (fit.height, "height")):
        if part.redundancy < 1:
            found.append(say(f"site.unchecked_{name}"))
        for k, (size, p) in part.doubtful.items():
            found.append(say.told(f"site.doubtful_{name}", point=made.common.names[k], size=size, p=p))
    if made.common.sigma_m is None:
        found.append(say("site.no_sigmas"))
    if made.left_out:
        found.append(say("site.left_out", names=", ".join(made.left_out)))
    return found or [say("site.nothing")]


def calibration_text(made: SiteCalibration, say: Catalogue) -> str:
    """Write the report for a terminal, in a language."""
    return text(sections(made, say))
