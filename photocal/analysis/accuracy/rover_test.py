"""Field test of a GNSS rover after ISO 17123-8 (RTK): as good as its maker says, and as last year.

Two rover points some metres apart whose horizontal distance and height difference are known to 3 mm are
measured in sets, at least five minutes from each other. The simplified test looks at the five sets of one
series; the full test estimates standard deviations from three series, 90 minutes apart, so that satellites
differ. The procedure is written from the teaching of the standard, whose own text was not at hand.
"""

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.text_tables import read_table
from photocal.findings.texts import Catalogue

SCHEMA = "photocal.rover-test/1"
SERIES, SETS, POINTS = 3, 5, 2
_CONFIDENCE = 0.95


# Series and name of each set (m,), and coordinates of both rover points in it, (m, 2, 3): E, N, h, m.
Sets = tuple[tuple[tuple[str, str], ...], Floats]


def read_sets(path: Path) -> Sets:
    """Read the measured sets: series, set, point, E, N, h (m); two points, each once in every set.

    raises InputNotFoundError, InputMalformedError: when it is not such a table.
    """
    table = read_table(path, ("series", "set", "point", "E", "N", "h"))
    which, points = table.names("point")
    wrong = InputMalformedError.at(path)
    if len(points) != POINTS:
        raise wrong(f"has {len(points)} rover points", "the test needs two")
    xyz = table.matrix(("E", "N", "h"))
    keys = list(zip(table.texts("series"), table.texts("set"), strict=True))
    sets = tuple(dict.fromkeys(keys))
    made = np.full((len(sets), POINTS, 3), np.nan)
    for row, (key, point) in enumerate(zip(keys, which.tolist(), strict=True)):
        at = sets.index(key)
        if np.isfinite(made[at, point]).any():
            raise wrong(f"point {points[point]} comes twice in series {key[0]}, set {key[1]}", "keep one")
        made[at, point] = xyz[row]
    lacking = np.argwhere(~np.isfinite(made).all(axis=2))
    if len(lacking):
        series, name = sets[int(lacking[0, 0])]
        raise wrong(f"series {series}, set {name} lacks point {points[int(lacking[0, 1])]}", "measure both")
    return sets, made


def rover_test(
    sets: Sets,
    distance_m: float,
    height_m: float,
    sigma_xy_m: float,
    sigma_h_m: float,
    earlier_m: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Test a rover: fully where there are three series of five sets, else the simplified test of one series.

    distance_m, height_m: known horizontal distance, and height of the second point over the first.
    sigma_xy_m, sigma_h_m: standard deviations that the rover is said to have, in plane and height.
    earlier_m: those of an earlier full test.
    returns: what goes to JSON: deviation of every set from the known figures, standard deviations of a
        position (None of the simplified test), and whether no set is gross and every test passes.
    raises ConfigurationError: for sets that are no test, or sigmas that cannot be.
    """
    # Bounds of a deviation from the known figure, in standard deviations of a difference of two points.
    limit_factor = 2.5
    if not (sigma_xy_m > 0.0 and sigma_h_m > 0.0 and distance_m > 0.0):
        raise ConfigurationError("distance and standard deviations must be positive", "give them in metres")
    keys, xyz = sets
    counts = list(Counter(series for series, _ in keys).values())
    full = counts == [SETS] * SERIES
    if not full and counts != [SETS]:
        raise ConfigurationError(
            f"the sets are {', '.join(map(str, counts))} by series",
            f"measure {SERIES} series of {SETS} sets, or one series of {SETS} for the simplified test",
        )
    if earlier_m is not None and not full:
        raise ConfigurationError("an earlier test is compared with a full one", "measure three series")
    mean = xyz.mean(axis=0)
    s, freedom = np.full(3, np.nan), 0
    if full:
        freedom = (SERIES * SETS - 1) * POINTS
        s = np.sqrt(((xyz - mean) ** 2).sum(axis=(0, 1)) / freedom)
    s_xy, s_h = float(np.hypot(s[0], s[1])), float(s[2])
    limits = limit_factor * math.sqrt(2.0) * sigma_xy_m, limit_factor * math.sqrt(2.0) * sigma_h_m
    apart = xyz[:, 1] - xyz[:, 0]
    deviations = [
        {
            "series": series,
            "set": name,
            "distance_m": far,
            "height_m": high,
            "within": abs(far) <= limits[0] and abs(high) <= limits[1],
        }
        for (series, name), far, high in zip(
            keys,
            (np.hypot(apart[:, 0], apart[:, 1]) - distance_m).tolist(),
            (apart[:, 2] - height_m).tolist(),
            strict=True,
        )
    ]
    tests = _tests((s_xy, s_h), freedom, (sigma_xy_m, sigma_h_m), earlier_m) if full else []
    return {
        "schema": SCHEMA,
        "full": full,
        "deviations": deviations,
        "limit_distance_m": limits[0],
        "limit_height_m": limits[1],
        "s_e_m": float(s[0]) if full else None,
        "s_n_m": float(s[1]) if full else None,
        "s_xy_m": s_xy if full else None,
        "s_h_m": s_h if full else None,
        "degrees_of_freedom": freedom,
        "tests": tests,
        "passed": all(one["within"] for one in deviations) and all(test["passed"] for test in tests),
    }


def _tests(
    s: tuple[float, float], freedom: int, stated: tuple[float, float], earlier: tuple[float, float] | None
) -> list[dict[str, Any]]:
    """Chi-squared against what is stated, one-sided; F against an earlier test, two-sided."""
    made = []
    for what, value, sigma, f in zip(("plane", "height"), s, stated, (2 * freedom, freedom), strict=True):
        most = sigma * math.sqrt(float(stats.chi2.ppf(_CONFIDENCE, f)) / f)
        made.append(_compared(f"{what}, stated", value, sigma, 0.0, most))
    for what, value, before, f in zip(
        ("plane", "height"), s, earlier or (), (2 * freedom, freedom), strict=False
    ):
        ratio = float(stats.f.ppf(0.5 + _CONFIDENCE / 2.0, f, f))
        bounds = before / math.sqrt(ratio), before * math.sqrt(ratio)
        made.append(_compared(f"{what}, earlier test", value, before, *bounds))
    return made


def _compared(what: str, s_m: float, against_m: float, least_m: float, most_m: float) -> dict[str, Any]:
    """A standard deviation beside another; the bounds of one that is no worse, or the same, with 95 %."""
    bounds = {"least_m": least_m, "most_m": most_m, "passed": least_m <= s_m <= most_m}
    return {"what": what, "s_m": s_m, "against_m": against_m, **bounds}


def as_text(test: dict[str, Any], say: Catalogue) -> str:
    """Write a test for people, mm."""
    from photocal.findings.document import Paragraph, Section, table, text

    kind = say("rover.full" if test["full"] else "rover.simplified")
    rows = [
        (
            one["series"],
            one["set"],
            *say.row((1e3 * one["distance_m"], 1e3 * one["height_m"]), "+.1f").split(" "),
            "" if one["within"] else say("rover.gross"),
        )
        for one in test["deviations"]
    ]
    limits = {"distance": 1e3 * test["limit_distance_m"], "height": 1e3 * test["limit_height_m"]}
    heads, note = say("rover.heads").split("|"), say.told("rover.limits", **limits)
    pieces = [table(say("rover.title", kind=kind), heads, rows, note)]
    if test["full"]:
        figures = {"E": "s_e_m", "N": "s_n_m", "plane": "s_xy_m", "h": "s_h_m"}
        said = say("join.figures").join(
            f"s({say.stored(name)}) {say.row([1e3 * test[key]], '.1f')}" for name, key in figures.items()
        )
        sizes = ("s_m", "against_m", "least_m", "most_m")
        tests = [
            (
                say.stored(one["what"]),
                *say.row((1e3 * one[key] for key in sizes), ".1f").split(" "),
                say("rover.within" if one["passed"] else "rover.beyond"),
            )
            for one in test["tests"]
        ]
        title = say("rover.sigmas", figures=said, freedom=test["degrees_of_freedom"])
        pieces.append(table(title, say("rover.tests_heads").split("|"), tests))
    verdict = say("rover.passes" if test["passed"] else "rover.fails")
    return text([Section("", (*pieces, Paragraph(verdict)))])
