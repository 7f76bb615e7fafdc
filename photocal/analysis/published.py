"""Parameters as a publication or another program prints them: tested, and their components analysed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.analysis.components import Components, principal_components
from photocal.analysis.correlation import StrongCorrelation, strong_correlations
from photocal.analysis.estimates import GROUPS, Estimates, FTest, f_test, from_sigmas
from photocal.base.arrays import as_plain
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.table import read_columns, read_table, read_wider_table

SCHEMA = "photocal.published/1"
# What the studies call the parameters of ours.
_ALSO = {"f": "c", "xo": "x0", "yo": "y0", "A": "B1", "B": "B2"}
_SIGMAS = ("std_dev", "sigma")
_OPTIONAL = ("set", "unit", "degrees_of_freedom", *_SIGMAS)


@dataclass(frozen=True)
class PublishedSet:
    """What follows from one printed set of parameters.

    tests: none where no values are known; of groups only where their correlations are.
    components: none without a matrix.
    """

    name: str
    estimates: Estimates
    degrees_of_freedom: float
    tests: tuple[FTest, ...]
    correlations: tuple[StrongCorrelation, ...]
    components: Components | None


def analyse_published(
    table: Path,
    matrix: Path | None = None,
    set_name: str | None = None,
    degrees_of_freedom: float = np.inf,
    alpha: float = 0.10,
    threshold: float = 0.8,
) -> tuple[PublishedSet, ...]:
    """Analyse a printed table of parameters, a printed matrix, or both.

    table: CSV. Either parameter, value and std_dev (or sigma), perhaps set and degrees_of_freedom: each set
        is analysed alone. Or a square matrix of correlations, or a covariance, with the names in its head and
        its first column.
    raises InputNotFoundError, InputMalformedError, ConfigurationError, IllPosedError: for what cannot be
        read, does not fit together, or is no covariance.
    """
    wrong = ConfigurationError.at(table)
    if not read_columns(table).has("value"):
        if matrix is not None or set_name is not None:
            raise wrong("is itself a matrix", "leave out --matrix and --set")
        estimates = _matrix(table)
        strong, components = strong_correlations(estimates, threshold), principal_components(estimates)
        return (PublishedSet("", estimates, np.inf, (), strong, components),)
    sets = _sets(table, degrees_of_freedom)
    if set_name is not None and set_name not in sets:
        raise wrong(f"has no set {set_name}", f"it has {', '.join(sets)}")
    chosen = sets if set_name is None else {set_name: sets[set_name]}
    if matrix is None:
        return tuple(
            PublishedSet(name, parameters, freedom, tuple(_tests(parameters, freedom, alpha, ())), (), None)
            for name, (parameters, freedom) in chosen.items()
        )
    if len(chosen) > 1:
        raise wrong(f"holds {len(chosen)} sets, but the matrix is of one", "name it with --set")
    ((name, (single, freedom)),) = chosen.items()
    correlation = _matrix(matrix)
    if correlation.names != single.names:
        raise ConfigurationError(
            f"the matrix is of {' '.join(correlation.names)}, the table of {' '.join(single.names)}",
            "name the same parameters in the same order in both",
            where=matrix,
        )
    values, sigmas = single.values.tolist(), single.sigmas.tolist()
    together = from_sigmas(single.names, values, sigmas, correlation.correlation)
    tests = tuple(_tests(together, freedom, alpha, GROUPS))
    strong = strong_correlations(together, threshold)
    return (PublishedSet(name, together, freedom, tests, strong, principal_components(together)),)


def _tests(
    estimates: Estimates, freedom: float, alpha: float, groups: tuple[tuple[str, ...], ...]
) -> list[FTest]:
    """Test each parameter, and the groups of which two or more are there, by the names that the table has."""
    known_as = {_ALSO.get(name, name): name for name in estimates.names}
    tests = [f_test(estimates, (name,), freedom, alpha, "single") for name in estimates.names]
    for group in groups:
        members = tuple(known_as[name] for name in group if name in known_as)
        if len(members) > 1:
            tests.append(f_test(estimates, members, freedom, alpha))
    return tests


def _sets(path: Path, degrees_of_freedom: float) -> dict[str, tuple[Estimates, float]]:
    """Read parameters with their standard deviations, set by set, and the redundancy of each."""
    table = read_table(path, ("parameter", "value"), _OPTIONAL)
    column = next((name for name in _SIGMAS if table.has(name)), None)
    malformed = InputMalformedError.at(path)
    if column is None:
        raise malformed("has no standard deviations", "add a column std_dev beside value")
    which, names = table.names("parameter")
    of_set, sets = table.names("set") if table.has("set") else (np.zeros(len(table), dtype=np.int64), ("",))
    values, sigmas = table.numbers("value"), table.numbers(column)
    freedom = table.numbers("degrees_of_freedom", empty=degrees_of_freedom)
    answer = {}
    for k, name in enumerate(sets):
        rows = np.flatnonzero(of_set == k)
        parameters = tuple(names[j] for j in which[rows])
        if len(set(parameters)) < len(parameters):
            raise malformed(
                f"a parameter comes twice{f' in set {name}' if name else ''}", "give a column set"
            )
        estimates = from_sigmas(parameters, values[rows].tolist(), sigmas[rows].tolist())
        answer[name] = (estimates, float(freedom[rows[0]]))
    return answer


def _matrix(path: Path) -> Estimates:
    """Read a square matrix of correlations or a covariance, named in its head and its first column.

    returns: with values of zero.
    """
    table = read_wider_table(path, ())
    head = tuple(table.columns.column_names)
    names = table.unique_names(head[0])
    matrix = table.matrix(head[1:])
    malformed = InputMalformedError.at(path)
    if names != head[1:] or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
        raise malformed(
            "is no symmetric matrix with the same names in its head and its first column",
            "give every row in full",
        )
    if not (np.diag(matrix) > 0.0).all():
        raise malformed("has a variance that is not positive", "leave out what was held fixed")
    sigma = np.sqrt(np.diag(matrix))
    return from_sigmas(names, [0.0] * len(names), sigma.tolist(), matrix / np.outer(sigma, sigma))


def published_record(sets: tuple[PublishedSet, ...]) -> dict[str, Any]:
    """Give sets as plain values, ready for JSON; what is not known is null."""
    return {"schema": SCHEMA, "sets": [_record(published) for published in sets]}


def _record(published: PublishedSet) -> dict[str, Any]:
    shown = ("eigenvalues", "percent", "cumulative_percent", "loadings")
    return {
        "set": published.name or None,
        "parameters": list(published.estimates.names),
        **{key: as_plain(getattr(published, key)) for key in ("degrees_of_freedom", "tests", "correlations")},
        "components": published.components
        and {key: as_plain(getattr(published.components, key)) for key in shown},
    }
