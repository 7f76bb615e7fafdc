"""Parameters as a publication or another program prints them: tested, and their components analysed."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from photocal.analysis.correlation import StrongCorrelation, strong_correlations
from photocal.analysis.estimates import (
    GROUPS,
    Components,
    Estimates,
    FTest,
    Proposal,
    f_test,
    from_sigmas,
    principal_components,
    propose_removal,
)
from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.policy import policy
from photocal.base.text_tables import read_columns, read_table, read_wider_table
from photocal.findings.finding import Figure, Finding
from photocal.geometry.camera import PARAMETERS

SCHEMA = "photocal.published/1"
# What the studies call the parameters of ours.
_ALSO = {"f": "c", "xo": "x0", "yo": "y0", "A": "B1", "B": "B2"}
_SIGMAS = ("std_dev", "sigma")
_OPTIONAL = ("set", "unit", "degrees_of_freedom", "sigma0", *_SIGMAS)


@dataclass(frozen=True)
class PrintedSigmaTest:
    """One-sided test of a printed standard deviation of unit weight against 1."""

    sigma0: float
    chi_squared: float
    critical: float

    @property
    def accepted(self) -> bool:
        """Whether the observations are as good as assumed."""
        return self.chi_squared <= self.critical


@dataclass(frozen=True)
class PublishedSet:
    """What follows from one printed set of parameters.

    tests: none where no values are known; of groups only where their correlations are.
    components: none without a matrix.
    component_values (p,): Y = C' x of parameters over their standard deviations; the variance of each is its
        eigenvalue. None without values.
    removal: the removal rule of the tank study; None without correlations of a camera.
    global_test: none without a standard deviation of unit weight.
    one_angle: omega and kappa that are one angle; None where they can be separated.
    """

    name: str
    estimates: Estimates
    degrees_of_freedom: float
    tests: tuple[FTest, ...] = ()
    correlations: tuple[StrongCorrelation, ...] = ()
    components: Components | None = None
    component_values: Floats | None = None
    removal: Proposal | None = None
    global_test: PrintedSigmaTest | None = None
    one_angle: Finding | None = None


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
        return (_correlated("", estimates, np.inf, (), threshold),)
    sets = _sets(table, degrees_of_freedom, alpha)
    if set_name is not None and set_name not in sets:
        raise wrong(f"has no set {set_name}", f"it has {', '.join(sets)}")
    chosen = sets if set_name is None else {set_name: sets[set_name]}
    if matrix is None:
        return tuple(
            replace(one, tests=tuple(_tests(one.estimates, one.degrees_of_freedom, alpha, ())))
            for one in chosen.values()
        )
    if len(chosen) > 1:
        raise wrong(f"holds {len(chosen)} sets, but the matrix is of one", "name it with --set")
    (single,) = chosen.values()
    correlation = _matrix(matrix)
    of_table = single.estimates.names
    if correlation.names != of_table:
        raise ConfigurationError(
            f"the matrix is of {' '.join(correlation.names)}, the table of {' '.join(of_table)}",
            "name the same parameters in the same order in both",
            where=matrix,
        )
    values, sigmas = single.estimates.values.tolist(), single.estimates.sigmas.tolist()
    together = from_sigmas(single.estimates.names, values, sigmas, correlation.correlation)
    freedom = single.degrees_of_freedom
    tests = tuple(_tests(together, freedom, alpha, GROUPS))
    judged = _correlated(single.name, together, freedom, tests, threshold)
    return (replace(judged, global_test=single.global_test),)


def _correlated(
    name: str, estimates: Estimates, freedom: float, tests: tuple[FTest, ...], threshold: float
) -> PublishedSet:
    """Say what follows from the correlations of a set."""
    components = principal_components(estimates)
    known = bool(np.any(estimates.values))
    ours = replace(estimates, names=tuple(_ALSO.get(one, one) for one in estimates.names))
    of_camera = sum(one in PARAMETERS for one in ours.names) > len(ours.names) / 2
    return PublishedSet(
        name,
        estimates,
        freedom,
        tests,
        strong_correlations(estimates, threshold),
        components,
        components.vectors.T @ (estimates.values / estimates.sigmas) if known else None,
        propose_removal(ours) if of_camera else None,
        one_angle=one_angle(estimates),
    )


def one_angle(estimates: Estimates) -> Finding | None:
    """Say that omega and kappa are one angle, where phi is near 90 degrees.

    Of turns that are equally sure about all axes, omega and kappa have the variance 1 / cos^2 phi and the
    covariance sin phi / cos^2 phi: their correlation is the sine of phi (tank study, Table 1).
    """
    angles = ("omega", "kappa")
    if not set(angles) <= set(estimates.names):
        return None
    both = estimates.select(angles)
    r = float(both.correlation[0, 1])
    if abs(r) < policy.one_angle:
        return None
    figures: dict[str, Figure] = {"r": r, "phi_deg": math.degrees(math.asin(min(abs(r), 1.0)))}
    return Finding("one-angle", "note", "omega-kappa", figures)


def _global_test(sigma0: float, freedom: float, alpha: float) -> PrintedSigmaTest | None:
    if not np.isfinite([sigma0, freedom]).all():
        return None
    return PrintedSigmaTest(sigma0, freedom * sigma0**2, float(special.chdtri(freedom, alpha)))


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


def _sets(path: Path, degrees_of_freedom: float, alpha: float) -> dict[str, PublishedSet]:
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
    sigma0 = np.full(len(table), np.nan)
    if table.has("sigma0"):
        sigma0 = table.numbers("sigma0", empty=np.nan)
    answer = {}
    for k, name in enumerate(sets):
        rows = np.flatnonzero(of_set == k)
        parameters = tuple(names[j] for j in which[rows])
        if len(set(parameters)) < len(parameters):
            raise malformed(
                f"a parameter comes twice{f' in set {name}' if name else ''}", "give a column set"
            )
        estimates = from_sigmas(parameters, values[rows].tolist(), sigmas[rows].tolist())
        redundancy, of_unit = float(freedom[rows[0]]), float(sigma0[rows[0]])
        tested = _global_test(of_unit, redundancy, alpha)
        answer[name] = PublishedSet(name, estimates, redundancy, global_test=tested)
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
            "is not a symmetric matrix with the same names in its head and its first column",
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
    removal = published.removal
    shown = ("eigenvalues", "percent", "cumulative_percent", "loadings")
    test = published.global_test
    return {
        "set": published.name or None,
        "global_test": test and {**as_plain(test), "accepted": test.accepted},
        "parameters": list(published.estimates.names),
        **{key: as_plain(getattr(published, key)) for key in ("degrees_of_freedom", "tests", "correlations")},
        "components": published.components
        and {key: as_plain(getattr(published.components, key)) for key in shown},
        "component_values": as_plain(published.component_values),
        "removal": removal
        and {
            "steps": [picked(step, "removed", "crowd", "negligible") for step in removal.steps],
            **picked(removal, "removed", "kept", "recommended"),
            "eigenvalues": as_plain(removal.final.eigenvalues),
            "percent": as_plain(removal.final.percent),
        },
        "one_angle": published.one_angle and dict(published.one_angle.figures),
    }
