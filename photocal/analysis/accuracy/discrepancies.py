"""Discrepancies at check points and the table that they are read from.

Laser distances of pictures against the adjusted surface: a check of heights that no observation feeds.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Flags, Floats
from photocal.base.errors import InputMalformedError
from photocal.base.policy import policy
from photocal.base.text_tables import TextTable, read_columns
from photocal.findings.finding import Finding, untested

SIGN = "product minus reference"
COMPONENTS = ("E", "N", "h")
GROUND = "ground"

_METRES: dict[str, float] = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "usft": 1200.0 / 3937.0,
}
_COLUMN = re.compile(r"^(?P<name>point|(d|correction_)?[enh])(?:[\s_]*[\[(]?\s*(?P<unit>[a-z]+)\s*[\])]?)?$")
_EXPECTED = "point, correction_E, correction_N, correction_h (reference minus product; also as dE, dN, dh)"


@dataclass(frozen=True)
class Discrepancies:
    """Product minus reference at check points.

    Attributes
    ----------
    d_m : array, shape (n, 3)
        DE, dN, dh in m; NaN where a component was not measured.
    positions_m : array, shape (n, 3)
        E, N, h of the points, m, for maps; NaN where not given.
    vegetated : array, shape (n,)
        Which points lie in vegetated ground; None where it is not stated, which counts as none.
    """

    points: tuple[str, ...]
    d_m: Floats
    positions_m: Floats | None = None
    vegetated: Flags | None = None

    def of_ground(self, ground: Literal["open", "vegetated"]) -> "Discrepancies":
        """Give the points in open, or in vegetated ground."""
        grown = np.zeros(len(self.points), dtype=np.bool_) if self.vegetated is None else self.vegetated
        chosen = grown if ground == "vegetated" else ~grown
        names = tuple(name for name, has in zip(self.points, chosen.tolist(), strict=True) if has)
        return Discrepancies(names, self.d_m[chosen])

    @property
    def correction_m(self) -> Floats:
        """Reference minus product, as most studies print it: what is to be added to the product."""
        return 0.0 - self.d_m

    def component(self, name: str) -> tuple[tuple[str, ...], Floats]:
        """Give the values of one component with the names of their points."""
        return self._complete([COMPONENTS.index(name)], 0)

    def planimetric(self) -> tuple[tuple[str, ...], Floats]:
        """Give the plane vectors of the points that have both dE and dN."""
        return self._complete([0, 1], slice(None))

    def spatial(self) -> tuple[tuple[str, ...], Floats]:
        """Give the vectors of the points that have all three components."""
        return self._complete([0, 1, 2], slice(None))

    def _complete(self, columns: list[int], pick: int | slice) -> tuple[tuple[str, ...], Floats]:
        known: Flags = np.all(np.isfinite(self.d_m[:, columns]), axis=1)
        names = tuple(name for name, has in zip(self.points, known.tolist(), strict=True) if has)
        return names, self.d_m[known][:, columns][:, pick]


def read_discrepancies(path: Path) -> Discrepancies:
    """Read a table of corrections at check points.

    path: table with the columns point, correction_E, correction_N, correction_h (those of the plane, or of
        the height, may be missing), and optional E, N, h, and ground (open or vegetated). dE, dN, dh are
        other names of the corrections: as published studies print them, reference minus product. Metres,
        unless the header gives another unit (m, dm, cm, mm, ft, usft).
    raises InputNotFoundError, InputMalformedError: when it is not such a table; the message says the line.
    """
    table = read_columns(path)
    title, factor = _columns(table)
    points = table.unique_names(title["point"])

    def metres(names: str) -> Floats:
        """Columns by their names, in metres; NaN where a column is missing or a cell is empty."""
        given = (
            factor[name] * table.numbers(title[name], empty=np.nan)
            if name in title
            else np.full(len(points), np.nan)
            for name in names.split()
        )
        return np.column_stack(tuple(given))

    corrections = metres("de dn dh")
    if not np.isfinite(corrections).any():
        raise InputMalformedError("holds no discrepancy", "give at least one check point", where=path)
    positions = metres("e n h") if {"e", "n"} <= title.keys() else None
    return Discrepancies(points, 0.0 - corrections, positions, _vegetated(table))


def _vegetated(table: TextTable) -> Flags | None:
    """The column `ground`: open or vegetated."""
    if not table.has(GROUND):
        return None
    which, kinds = table.names(GROUND)
    wrong = [kind for kind in kinds if kind not in ("open", "vegetated")]
    if wrong:
        row = int(np.flatnonzero(which == kinds.index(wrong[0]))[0])
        raise InputMalformedError(
            f"ground {wrong[0]!r} is not known",
            "write open (bare, rock, short grass, paved) or vegetated",
            where=table.place(row),
        )
    return np.asarray([kind == "vegetated" for kind in kinds])[which]


def _columns(table: TextTable) -> tuple[dict[str, str], dict[str, float]]:
    """Titles of the columns by their short name, and how many metres their unit has."""
    titles: dict[str, str] = {}
    factors: dict[str, float] = {}
    place, remedy = f"{table.path}, line 1", f"the columns are {_EXPECTED}, and E, N, h"
    malformed = InputMalformedError.at(place)
    for title in table.columns.column_names:
        if title == GROUND:
            continue
        match = _COLUMN.match(title.lower())
        if match is None:
            raise malformed(f"unknown column {title!r}", remedy)
        name, unit = match["name"].replace("correction_", "d"), match["unit"]
        if name in titles:
            raise malformed(f"column {name} appears twice", "keep one")
        if unit is not None and (unit not in _METRES or name == "point"):
            raise malformed(f"unknown unit {unit!r} of column {title!r}", f"known are {', '.join(_METRES)}")
        titles[name], factors[name] = title, _METRES[unit or "m"]
    missing = [] if "point" in titles else ["point"]
    if ("de" in titles) != ("dn" in titles):
        missing.append("dn" if "de" in titles else "de")
    if missing or not {"de", "dh"} & titles.keys():
        lacking = " and ".join(missing) or "dE, dN or dh"
        raise malformed(f"has no column {lacking}", remedy)
    return titles, factors


CODE = "laser-heights"
# A rangefinder of DJI is good to 0.2 m and 0.15 % of the distance (Zenmuse H20 series, data sheet): taken for
# three sigmas, and as if all its distances had the error in common.
LASER_M, LASER_SHARE = 0.2 / 3, 0.0015 / 3
# A surface is fitted to this many points, the nearest of them within this share of the distance.
NEIGHBOURS, DENSE = 8, 0.05
# A surface of tie points is no better than this, m; with fewer shots nothing is said.
SMOOTH_M, FEWEST_SHOTS = 0.05, 8
# Weights fall from so many sigmas on (Huber); beyond the second a shot hit something else.
_HUBER, ELSEWHERE = 1.5, 4.0


def check_laser(target: Floats, distance_m: Floats, points: Floats, c_share: float = 0.0) -> Finding:
    """Hold laser targets against the surface of tie points (m, 3) there, as a check beside check points.

    target (n, 3), distance_m (n,): what each laser hit, in a frame whose third axis is up, and how far away.
    c_share: standard deviation of the principal distance over it: distances to the ground go with it.
    returns: untested with too few of them. Its figures: n shots, of which elsewhere hit something else (gaps
        of a canopy); lonely ones without tie points near enough; bias_m, the height of the surface less that
        of the laser; sigma_m, its standard deviation with what all distances have in common, the error of the
        laser and that of c; spread_m of single differences, robust; scale, the change of the difference with
        distance, and its scale_sigma: NaN where distances are alike.
    """
    counted = {"n": float(np.isfinite(distance_m).sum()), "needed": float(FEWEST_SHOTS)}
    few = untested(CODE, "few-laser-shots", counted)
    known = np.isfinite(target).all(axis=1)
    target, distance, ties = target[known], distance_m[known], points[np.isfinite(points).all(axis=1)]
    if len(target) < FEWEST_SHOTS or len(ties) < NEIGHBOURS:
        return few
    height, rough, dense = _surface(target[:, :2], ties, DENSE * distance)
    difference, sigma, distance = height[dense] - target[dense, 2], rough[dense], distance[dense]
    if len(difference) < FEWEST_SHOTS:
        return few
    design = np.ones((len(difference), 1))
    (bias,), (formal,), spread, far = _robust(design, difference, sigma)
    # What passes through a canopy is farther away, which would look like a scale.
    difference, sigma, distance = difference[~far], sigma[~far], distance[~far]
    middle = float(np.median(distance))
    common = float(np.hypot(LASER_M + LASER_SHARE * middle, c_share * middle))
    scale = scale_sigma = np.nan
    design = _with_scale(distance)
    if design.shape[1] > 1:
        (_, scale), (_, scale_sigma), _, _ = _robust(design, difference, sigma)
        scale_sigma = float(np.hypot(scale_sigma, np.hypot(LASER_SHARE, c_share)))
    figures = {
        "n": float(dense.sum()), "bias_m": float(bias), "sigma_m": float(np.hypot(formal, common)),
        "spread_m": spread, "elsewhere": float(far.sum()), "lonely": float((~dense).sum()),
        "scale": float(scale), "scale_sigma": float(scale_sigma),
    }  # fmt: skip
    clauses: tuple[str, ...] = ("laser-elsewhere",) if far.any() else ()
    clauses += ("laser-scale",) if np.isfinite(scale) else ()
    if abs(figures["bias_m"]) > policy.times_999 * figures["sigma_m"]:
        return Finding(CODE, "doubtful", figures=figures, clauses=("laser-beside", *clauses))
    return Finding(CODE, "note", figures=figures, clauses=clauses)


def _with_scale(distance: Floats) -> Floats:
    """Design of a bias and, where distances differ by enough for one, of a scale, shape (n, 1 or 2)."""
    # A scale wants distances that differ by this share.
    span, middle = 0.2, float(np.median(distance))
    columns = [np.ones(len(distance)), distance - middle]
    return np.column_stack(columns if np.ptp(distance) > span * middle else columns[:1])


def far_off(difference: Floats, sigma: Floats, distance: Floats) -> Flags:
    """Tell which shots hit something else: far from the bias, and the scale, of all others."""
    _, _, _, far = _robust(_with_scale(distance), difference, sigma)
    return far


def _surface(places: Floats, ties: Floats, reach: Floats) -> tuple[Floats, Floats, Flags]:
    """Height of planes through the nearest tie points, their roughness, and which places have them near."""
    from scipy.spatial import KDTree

    found, near = KDTree(ties[:, :2]).query(places, NEIGHBOURS)
    away = np.asarray(found)
    offset = ties[near] - np.column_stack([places, np.zeros(len(places))])[:, None]
    height, rough = np.empty(len(places)), np.empty(len(places))
    for k, (beside, distances) in enumerate(zip(offset, away, strict=True)):
        # Far ones count less: they are of another slope.
        weight = 1.0 / (distances + 1e-3 + 0.5 * distances[-1])
        design = np.column_stack([np.ones(NEIGHBOURS), beside[:, :2]])
        plane, *_ = np.linalg.lstsq(design * weight[:, None], beside[:, 2] * weight, rcond=None)
        rest = beside[:, 2] - design @ plane
        height[k] = plane[0]
        rough[k] = np.hypot(SMOOTH_M, np.sqrt(np.sum(rest**2) / (NEIGHBOURS - 3)))
    return height, rough, np.asarray(away[:, 2] <= reach)


def _robust(design: Floats, values: Floats, sigma: Floats) -> tuple[Floats, Floats, float, Flags]:
    """Estimates of Huber, their standard deviations, the robust spread of the values, and what is far off."""
    estimates = np.zeros(design.shape[1])
    estimates[0] = np.median(values)
    factor = 1.0
    for _ in range(50):
        share = (values - design @ estimates) / sigma
        factor = max(policy.mad_to_sigma * float(np.median(np.abs(share - np.median(share)))), 1e-6)
        weight = np.minimum(1.0, _HUBER * factor / np.maximum(np.abs(share), 1e-12)) / sigma**2
        normal = design.T @ (design * weight[:, None])
        step = np.linalg.solve(normal, design.T @ (weight * (values - design @ estimates)))
        estimates = estimates + step
        if np.abs(step).max() < 1e-9:
            break
    rest = values - design @ estimates
    spread = policy.mad_to_sigma * float(np.median(np.abs(rest)))
    # Efficiency of Huber's weights with normal errors.
    deviation = max(factor, 1.0) * np.sqrt(np.diag(np.linalg.inv(normal))) * 1.05
    return estimates, deviation, spread, np.abs(rest / sigma) > ELSEWHERE * max(factor, 1.0)
