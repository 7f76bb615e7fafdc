"""Analysis of variance: which factor of an experiment moves its errors, and which of them only together."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from photocal.analysis.accuracy.output import told_table
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.policy import policy
from photocal.base.text_tables import read_wider_table
from photocal.findings.document import Section, TablePart, text
from photocal.findings.texts import Catalogue

SCHEMA = "photocal.variance-analysis/1"
RESIDUAL = "residual"


@dataclass(frozen=True)
class VarianceEffect:
    """What a factor, or two of them together, explains.

    sum_of_squares: in the square of the unit of the values.
    share: of the whole sum of squares, 0 to 1.
    f, p_value: against the residual; NaN for the residual itself.
    """

    name: str
    degrees_of_freedom: int
    sum_of_squares: float
    share: float
    f: float = np.nan
    p_value: float = np.nan

    @property
    def significant(self) -> bool:
        """Whether chance makes so large an effect in less than one of twenty cases."""
        return self.p_value < 1.0 - policy.confidence


def analyse_variance(factors: Mapping[str, Sequence[str]], values: Floats) -> tuple[VarianceEffect, ...]:
    """Part the variance of values by the factors that were varied (Fisher 1925).

    Each combination of levels must occur equally often; a single factor may have groups of any size. Factors
    act together in pairs where enough is left over to judge that; what is left is the residual, the last one.

    factors: level of each value by the name of the factor.
    raises ConfigurationError: where no factor or value varies, values or combinations are missing, or nothing
        is repeated.
    """
    levels = {name: np.unique(given, return_inverse=True)[1] for name, given in factors.items()}
    levels = {name: level for name, level in levels.items() if level.max(initial=0) > 0}
    if not levels:
        raise ConfigurationError("no factor varies", "give at least two levels of one factor")
    if not np.isfinite(values).all():
        raise ConfigurationError("values are missing", "give a number in each row, or take the row out")
    if not np.ptp(values):
        raise ConfigurationError("all values are equal", "give values that differ")
    count = len(values)
    cells = _joined(list(levels.values()))
    number = np.bincount(cells)
    whole = int(np.prod([level.max() + 1 for level in levels.values()]))
    if len(levels) > 1 and (len(number) != whole or np.ptp(number)):
        raise ConfigurationError(
            f"{len(number)} of {whole} combinations of {', '.join(levels)} occur, "
            f"{number.min()} to {number.max()} times",
            "give each combination equally often",
        )
    d = values - values.mean()
    total = float(d @ d)
    mains = {name: (int(level.max()), _between(level, d)) for name, level in levels.items()}
    pairs = {}
    for a, b in combinations(levels, 2):
        own = _between(_joined([levels[a], levels[b]]), d) - mains[a][1] - mains[b][1]
        pairs[f"{a} x {b}"] = mains[a][0] * mains[b][0], own
    used = mains | pairs
    # Pairs are the residual where nothing else is left of it.
    if count - 1 - sum(df for df, _ in used.values()) < 1:
        used = mains
    left = count - 1 - sum(df for df, _ in used.values())
    if left < 1:
        raise ConfigurationError("nothing is repeated", "give more values, or another factor")
    rest = max(total - sum(squares for _, squares in used.values()), 0.0)
    effects = []
    for name, (df, squares) in used.items():
        f = np.inf if rest == 0.0 else squares / df / (rest / left)
        effects.append(
            VarianceEffect(name, df, squares, squares / total, f, float(special.fdtrc(df, left, f)))
        )
    return (*effects, VarianceEffect(RESIDUAL, left, rest, rest / total))


def _joined(levels: list[Integers]) -> Integers:
    """Number the combinations that occur, from 0."""
    return np.unique(np.column_stack(levels), axis=0, return_inverse=True)[1].reshape(-1)


def _between(group: Integers, d: Floats) -> float:
    """Sum of squares of the means of groups, about the common mean 0."""
    return float(np.sum(np.bincount(group, d) ** 2 / np.bincount(group)))


def read_variance_table(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, Floats]]:
    """Read levels of factors and values: columns that end in `_m` are values, the others factors.

    Beside x_m and y_m, or E_m and N_m, the plane is a value, too.
    raises InputNotFoundError, InputMalformedError: when it is no such table.
    """
    with_heads = read_wider_table(path, ())
    heads = with_heads.columns.column_names
    values = {name.removesuffix("_m"): with_heads.numbers(name) for name in heads if name.endswith("_m")}
    factors = {name: with_heads.texts(name) for name in heads if not name.endswith("_m")}
    if not values or not factors:
        raise InputMalformedError(
            "has no factor or no value", "name columns of values with their unit, such as rmse_m", where=path
        )
    for x, y in (("x", "y"), ("E", "N")):
        if x in values and y in values:
            values["plane"] = np.hypot(values[x], values[y])
    return factors, values


def analyse_table(path: Path) -> dict[str, tuple[VarianceEffect, ...]]:
    """Analyse each value of a table of an experiment; errors as of its parts."""
    factors, values = read_variance_table(path)
    return {name: analyse_variance(factors, column) for name, column in values.items()}


def analyse_rmse(
    factors: Mapping[str, Sequence[str]], rmse_m: Floats
) -> dict[str, tuple[VarianceEffect, ...]]:
    """Analyse the errors of runs in plane and in height; what cannot be analysed is left out.

    rmse_m (n, 3): of the runs, X, Y, Z.
    """
    found = {}
    for name, values in (("plane", np.hypot(rmse_m[:, 0], rmse_m[:, 1])), ("Z", rmse_m[:, 2])):
        # Runs that failed leave combinations out.
        with suppress(ConfigurationError):
            found[name] = analyse_variance(factors, values)
    return found


def variance_tables(analysed: Mapping[str, tuple[VarianceEffect, ...]], say: Catalogue) -> list[TablePart]:
    """Write each analysis as people know it."""
    parts = []
    for value, effects in analysed.items():
        rows = []
        for one in effects:
            name = say("assessed.residual") if one.name == RESIDUAL else one.name
            row = (name, str(one.degrees_of_freedom), f"{one.sum_of_squares:.4g}", f"{one.share:.1%}")
            tested = one.name != RESIDUAL
            ends = (
                (f"{one.f:.3g}", f"{one.p_value:.2g}", "*" if one.significant else "") if tested else [""] * 3
            )
            rows.append((*row, *ends))
        caption = say("assessed.variance", value=value)
        parts.append(told_table("assessed.variance", rows, say, caption=caption))
    return parts


def variance_record(analysed: Mapping[str, tuple[VarianceEffect, ...]]) -> dict[str, Any]:
    """Give the analyses as a JSON value."""
    return {
        value: [
            {**vars(one), "f": None, "p_value": None} if one.name == RESIDUAL else dict(vars(one))
            for one in effects
        ]
        for value, effects in analysed.items()
    }


def variance_text(analysed: Mapping[str, tuple[VarianceEffect, ...]], say: Catalogue) -> str:
    """Write all of them for people."""
    return text([Section("", tuple(variance_tables(analysed, say)))])
