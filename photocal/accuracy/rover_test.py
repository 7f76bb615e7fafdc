"""Field test of a GNSS rover after ISO 17123-8 (RTK): as good as its maker says, and as last year.

Two rover points some metres apart whose horizontal distance and height difference are known to 3 mm are
measured in sets, at least five minutes from each other. The simplified test looks at the five sets of one
series; the full test estimates standard deviations from three series, 90 minutes apart, so that satellites
differ. The procedure is written from the teaching of the standard, whose own text was not at hand.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from photocal.base.arrays import Floats, as_plain
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.table import read_table

SCHEMA = "photocal.rover-test/1"
SERIES, SETS, POINTS = 3, 5, 2
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Sets:
    """Coordinates of both rover points by set, shape (m, 2, 3): E, N, h, m; the series of each set (m,)."""

    series: tuple[str, ...]
    names: tuple[str, ...]
    xyz: Floats


@dataclass(frozen=True)
class Deviation:
    """Deviation of one set from the known horizontal distance and height difference, m."""

    series: str
    set: str
    distance_m: float
    height_m: float
    within: bool


@dataclass(frozen=True)
class SampleTest:
    """A standard deviation compared with one stated, or against an earlier one.

    least, most: between which s lies when it is no worse, or the same, with 95 %; least is 0 for one side.
    """

    what: str
    s_m: float
    against_m: float
    least_m: float
    most_m: float

    @property
    def passed(self) -> bool:
        """Whether it lies between them."""
        return self.least_m <= self.s_m <= self.most_m


@dataclass(frozen=True)
class RoverTest:
    """What the test says.

    s_e_m, s_n_m, s_xy_m, s_h_m: standard deviations of a position; None of the simplified test.
    """

    full: bool
    deviations: tuple[Deviation, ...]
    limit_distance_m: float
    limit_height_m: float
    s_e_m: float | None
    s_n_m: float | None
    s_xy_m: float | None
    s_h_m: float | None
    degrees_of_freedom: int
    tests: tuple[SampleTest, ...]

    @property
    def passed(self) -> bool:
        """Whether no set is gross and every test passes."""
        return all(one.within for one in self.deviations) and all(test.passed for test in self.tests)


def read_sets(path: Path) -> Sets:
    """Read the measured sets: series, set, point, E, N, h (m); two points, each once in every set.

    raises InputNotFoundError, InputMalformedError: when it is not such a table.
    """
    table = read_table(path, ("series", "set", "point", "E", "N", "h"))
    which, points = table.names("point")
    wrong = InputMalformedError.at(path)
    if len(points) != POINTS:
        raise wrong(f"has {len(points)} rover points", "the test is of two")
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
    return Sets(tuple(series for series, _ in sets), tuple(name for _, name in sets), made)


def rover_test(
    sets: Sets,
    distance_m: float,
    height_m: float,
    sigma_xy_m: float,
    sigma_h_m: float,
    earlier_m: tuple[float, float] | None = None,
) -> RoverTest:
    """Test a rover: fully where there are three series of five sets, else the simplified test of one series.

    distance_m, height_m: known horizontal distance, and height of the second point over the first.
    sigma_xy_m, sigma_h_m: standard deviations that the rover is said to have, in plane and height.
    earlier_m: those of an earlier full test.
    raises ConfigurationError: for sets that are no test, or sigmas that cannot be.
    """
    # Bounds of a deviation from the known figure, in standard deviations of a difference of two points.
    limit_factor = 2.5
    if not (sigma_xy_m > 0.0 and sigma_h_m > 0.0 and distance_m > 0.0):
        raise ConfigurationError("distance and standard deviations must be positive", "give them in metres")
    counts = [sets.series.count(name) for name in dict.fromkeys(sets.series)]
    full = counts == [SETS] * SERIES
    if not full and counts != [SETS]:
        raise ConfigurationError(
            f"the sets are {', '.join(map(str, counts))} by series",
            f"measure {SERIES} series of {SETS} sets, or one series of {SETS} for the simplified test",
        )
    if earlier_m is not None and not full:
        raise ConfigurationError("an earlier test is compared with a full one", "measure three series")
    mean = sets.xyz.mean(axis=0)
    s, freedom = np.full(3, np.nan), 0
    if full:
        freedom = (SERIES * SETS - 1) * POINTS
        s = np.sqrt(((sets.xyz - mean) ** 2).sum(axis=(0, 1)) / freedom)
    s_xy, s_h = float(np.hypot(s[0], s[1])), float(s[2])
    limits = limit_factor * math.sqrt(2.0) * sigma_xy_m, limit_factor * math.sqrt(2.0) * sigma_h_m
    apart = sets.xyz[:, 1] - sets.xyz[:, 0]
    deviations = tuple(
        Deviation(series, name, far, high, abs(far) <= limits[0] and abs(high) <= limits[1])
        for series, name, far, high in zip(
            sets.series,
            sets.names,
            (np.hypot(apart[:, 0], apart[:, 1]) - distance_m).tolist(),
            (apart[:, 2] - height_m).tolist(),
            strict=True,
        )
    )
    if not full:
        return RoverTest(False, deviations, *limits, None, None, None, None, 0, ())
    tests = _tests((s_xy, s_h), freedom, (sigma_xy_m, sigma_h_m), earlier_m)
    return RoverTest(True, deviations, *limits, float(s[0]), float(s[1]), s_xy, s_h, freedom, tests)


def _tests(
    s: tuple[float, float], freedom: int, stated: tuple[float, float], earlier: tuple[float, float] | None
) -> tuple[SampleTest, ...]:
    """Chi-squared against what is stated, one-sided; F against an earlier test, two-sided."""
    made = []
    for what, value, sigma, f in zip(("plane", "height"), s, stated, (2 * freedom, freedom), strict=True):
        most = sigma * math.sqrt(float(stats.chi2.ppf(_CONFIDENCE, f)) / f)
        made.append(SampleTest(f"{what}, stated", value, sigma, 0.0, most))
    for what, value, before, f in zip(
        ("plane", "height"), s, earlier or (), (2 * freedom, freedom), strict=False
    ):
        ratio = float(stats.f.ppf(0.5 + _CONFIDENCE / 2.0, f, f))
        bounds = before / math.sqrt(ratio), before * math.sqrt(ratio)
        made.append(SampleTest(f"{what}, earlier test", value, before, *bounds))
    return tuple(made)


def as_record(test: RoverTest) -> dict[str, Any]:
    """Give a test as plain values, ready for JSON."""
    tests = [{**vars(one), "passed": one.passed} for one in test.tests]
    return {"schema": SCHEMA, **as_plain(test), "tests": tests, "passed": test.passed}


def as_text(test: RoverTest) -> str:
    """Write a test for people, mm."""
    from photocal.findings.document import Paragraph, Section, table, text

    kind = "full" if test.full else "simplified"
    rows = [
        (
            one.series,
            one.set,
            f"{1e3 * one.distance_m:+.1f}",
            f"{1e3 * one.height_m:+.1f}",
            "" if one.within else "gross",
        )
        for one in test.deviations
    ]
    limit = f"limits {1e3 * test.limit_distance_m:.1f} and {1e3 * test.limit_height_m:.1f} mm"
    pieces = [
        table(f"{kind} test after ISO 17123-8, mm", ("series", "set", "distance", "height", ""), rows, limit)
    ]
    if test.full:
        figures = zip(
            ["E", "N", "plane", "h"], (test.s_e_m, test.s_n_m, test.s_xy_m, test.s_h_m), strict=True
        )
        said = ", ".join(f"s({name}) {1e3 * (value or 0.0):.1f}" for name, value in figures)
        pieces.append(
            table(
                f"{said} mm with {test.degrees_of_freedom} degrees of freedom for each coordinate",
                ("", "s, mm", "against", "from", "to", ""),
                [
                    (
                        one.what,
                        *(f"{1e3 * v:.1f}" for v in (one.s_m, one.against_m, one.least_m, one.most_m)),
                        "passed" if one.passed else "NOT passed",
                    )
                    for one in test.tests
                ],
            )
        )
    verdict = (
        "the rover passes" if test.passed else "the rover does not pass: look at base, mounting and antenna"
    )
    return text([Section("", (*pieces, Paragraph(verdict)))])
