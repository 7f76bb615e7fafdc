"""Principal components against the tables of the tank study."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from photocal.analysis.correlation import strong_correlations
from photocal.analysis.estimates import (
    Estimates,
    Proposal,
    from_sigmas,
    principal_components,
    propose_removal,
    without,
)
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.commands.cli import app
from photocal.findings.texts import catalogue, finding_text, plain

Rows = list[dict[str, str]]
# The printed labels stand one column too early: the first column is foreign, B is missing.
TRUE_LABELS = ("foreign", "c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
# Columns of Table 2 (from 0) that Tables 3 to 5 left out, as the tables themselves show ...
LEFT_OUT = {3: ("K2", "K3"), 4: ("K2", "K3", "P1"), 5: ("K2", "K3")}
LEFT_OUT_COLUMNS = {3: (6, 7), 4: (6, 7, 8), 5: (5, 6)}
# ... and as their printed labels would have it.
LEFT_OUT_BY_LABEL = {3: (5, 6), 4: (5, 6, 7), 5: (4, 5)}


def numbers(rows: Rows) -> Floats:
    return np.array([[float(value) for value in list(row.values())[1:]] for row in rows])


def sentences(proposal: Proposal) -> list[str]:
    say = catalogue("en")
    return [finding_text(remark, say, plain) for remark in proposal.remarks]


def known_only_by_correlation(names: tuple[str, ...], r: Floats) -> Estimates:
    return from_sigmas(names, [0.0] * len(names), [1.0] * len(names), r)


@pytest.fixture(scope="module")
def refined() -> Estimates:
    """One matrix within the rounding of Table 2 that has its eigenvalues and leads to Tables 3 to 5."""
    path = Path(__file__).parent / "published/tank/table02_correlation_refined_derived.csv"
    with path.open() as stream:
        r = numbers(list(csv.DictReader(stream)))
    return known_only_by_correlation(TRUE_LABELS, r)


@pytest.mark.parametrize("table", [2, 3, 4, 5])
def test_eigenvalues_and_shares(tank: Callable[[str], Rows], table: int) -> None:
    rows = tank(f"table0{table}_correlation")
    found = principal_components(known_only_by_correlation(tuple(r["param"] for r in rows), numbers(rows)))
    printed = numbers(tank(f"table0{table}_components"))
    assert np.abs(found.eigenvalues - printed[:, 1]).max() < 0.010  # rounding of the input
    assert np.abs(100 * printed[:, 1] / len(rows) - printed[:, 2]).max() < 0.005
    assert np.abs(np.cumsum(printed[:, 1]) * 100 / len(rows) - printed[:, 3]).max() < 0.0051
    # An eigenvalue within 0.010 of the printed one is a share within 0.010 / p.
    assert np.abs(found.percent - printed[:, 2]).max() < 100 * 0.010 / len(rows) + 0.005


def test_eigenvalues_of_the_refined_matrix(tank: Callable[[str], Rows], refined: Estimates) -> None:
    found, printed = principal_components(refined), numbers(tank("table02_components"))
    assert np.abs(found.eigenvalues - printed[:, 1]).max() < 1e-6
    assert np.abs(found.percent - printed[:, 2]).max() < 0.005
    assert np.abs(found.cumulative_percent - printed[:, 3]).max() < 0.005


@pytest.mark.parametrize("table", [2, 3, 4, 5])
def test_loadings(tank: Callable[[str], Rows], table: int) -> None:
    rows = tank(f"table0{table}_correlation")
    found = principal_components(known_only_by_correlation(tuple(r["param"] for r in rows), numbers(rows)))
    printed = numbers(tank(f"table0{table}_mccp"))
    signs = np.sign(np.sum(found.loadings * printed, axis=0))
    # Two decimals of the input turn nearly equal components into one another: up to 0.06.
    assert np.abs(found.loadings * signs - printed).max() <= 0.0605
    # Table 2, row c: -0.61 was misread for -0.66.
    if table == 2:
        assert printed[0, 5] == -0.61
        printed[0, 5] = -0.66
        assert np.abs(found.loadings * signs - printed)[0, 5] < 0.02
    assert np.abs(printed @ printed.T - numbers(rows)).max() < 0.0145


def test_loadings_of_the_refined_matrix(tank: Callable[[str], Rows], refined: Estimates) -> None:
    found, printed = principal_components(refined), numbers(tank("table02_mccp"))
    printed[0, 5] = -0.66
    signs = np.sign(np.sum(found.loadings * printed, axis=0))
    # One of many matrices within the rounding: nearly equal components still turn a little.
    assert np.abs(found.loadings * signs - printed).max() < 0.03
    strong = np.abs(printed) > 0.8
    assert np.abs(found.loadings * signs - printed)[strong].max() < 0.0075


def dropped(r: Floats, columns: tuple[int, ...]) -> Floats:
    names = tuple(str(i) for i in range(len(r)))
    kept = without(known_only_by_correlation(names, r), [str(i) for i in columns])
    return kept.correlation


@pytest.mark.parametrize("table", [3, 4, 5])
def test_labels_are_shifted(tank: Callable[[str], Rows], refined: Estimates, table: int) -> None:
    """Rows and columns of the inverse deleted by the true labels give the tables, by the printed ones not."""
    printed = numbers(tank(f"table0{table}_correlation"))
    by_truth = dropped(refined.correlation, LEFT_OUT_COLUMNS[table])
    by_label = dropped(refined.correlation, LEFT_OUT_BY_LABEL[table])
    assert np.abs(by_truth - printed).max() <= 0.0051
    assert np.abs(by_label - printed).max() > 0.15


def test_table_4_follows_from_table_3_without_its_seventh_column(tank: Callable[[str], Rows]) -> None:
    three, four = numbers(tank("table03_correlation")), numbers(tank("table04_correlation"))
    assert np.abs(dropped(three, (6,)) - four).max() <= 0.012
    assert np.abs(dropped(three, (5,)) - four).max() > 0.5  # the parameter that the text names


def test_label_mapping(tank: Callable[[str], Rows]) -> None:
    inferred = {"xo": "x0", "yo": "y0", "A": "B1"}
    second = [row["inferred_label"] for row in tank("pca_label_mapping") if row["table"] == "2"]
    assert tuple(inferred.get(label, label) for label in second) == TRUE_LABELS


def test_the_removal_rule_ends_where_the_study_ends(tank: Callable[[str], Rows], refined: Estimates) -> None:
    proposal = propose_removal(refined)
    assert set(proposal.removed) == {"K2", "K3"}
    printed = numbers(tank("table05_components"))
    assert np.abs(proposal.final.eigenvalues - printed[:, 1]).max() < 0.0035
    assert round(proposal.final.percent[-1], 1) == 3.2  # 3.15 printed: "not negligible"
    assert proposal.steps[0].negligible == 2  # 0.74 %, two components
    words = "The rule leaves out K3 K2: K1 K2 K3 load together and the last 2 of the components hold 0.74 %"
    assert sentences(proposal)[0].startswith(words)
    assert proposal.recommended == ("K3", "K2")
    assert sentences(proposal)[-1] == "Proposal: leave out K3 K2."


def test_nothing_is_proposed_for_parameters_that_are_distinct() -> None:
    proposal = propose_removal(
        from_sigmas(("c", "x0", "y0", "K1"), [5.0, 0.1, 0.1, 1e-3], [0.01, 0.01, 0.01, 1e-5])
    )
    assert proposal.removed == ()
    assert sentences(proposal)[0].startswith("Proposal: keep all parameters")


def test_an_essential_parameter_stays_and_its_double_leaves() -> None:
    r = np.eye(3)
    r[0, 2] = r[2, 0] = 0.97
    proposal = propose_removal(from_sigmas(("x0", "y0", "P1"), [0.1, 0.1, 1e-6], [0.01, 0.01, 1e-5], r))
    assert proposal.removed == ("P1",)
    assert "nothing is lost" in sentences(proposal)[0]


def test_a_correlated_parameter_with_a_real_effect_is_not_dropped_lightly() -> None:
    r = np.eye(2)
    r[0, 1] = r[1, 0] = 0.97
    proposal = propose_removal(from_sigmas(("x0", "P1"), [0.1, 1e-2], [0.01, 1e-5], r))
    assert "they describe a real effect" in sentences(proposal)[0]
    assert proposal.recommended == ()
    assert sentences(proposal)[-1].startswith("Proposal: keep all parameters")


def test_loadings_are_correlations_of_parameters_with_components() -> None:
    generator = np.random.default_rng(3)
    A = generator.standard_normal((5, 5))
    S = A @ A.T
    found = principal_components(Estimates(tuple("abcde"), np.zeros(5), S))
    x = generator.multivariate_normal(np.zeros(5), S, 200_000) / np.sqrt(np.diag(S))
    sampled = np.asarray(np.corrcoef(np.hstack([x, x @ found.vectors]).T))[:5, 5:]
    assert np.abs(sampled - found.loadings).max() < 0.02
    assert found.eigenvalues.sum() == pytest.approx(5.0)


def test_a_matrix_that_no_adjustment_gives_is_refused() -> None:
    r = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    with pytest.raises(IllPosedError, match="not positive definite"):
        principal_components(known_only_by_correlation(("c", "x0", "y0"), r))


def test_strong_correlations_of_set_1_are_explained(canon_sets: dict[str, Estimates]) -> None:
    pairs = strong_correlations(canon_sets["1"], 0.8)
    assert {frozenset((p.first, p.second)): p.value for p in pairs} == {
        frozenset(("K1", "K2")): pytest.approx(-0.92),
        frozenset(("K1", "K3")): pytest.approx(0.83),
        frozenset(("K2", "K3")): pytest.approx(-0.97),
        frozenset(("x0", "P1")): pytest.approx(0.90),
        frozenset(("y0", "P2")): pytest.approx(0.90),
    }
    assert pairs[0].value == pytest.approx(-0.97)
    for pair in pairs:
        assert pair.cause == ("radii" if pair.first[0] == "K" else "shift-tilt")


def test_correlations_with_the_exterior_orientation_are_explained() -> None:
    r = np.eye(2)
    r[0, 1] = r[1, 0] = 0.99
    (pair,) = strong_correlations(from_sigmas(("c", "Z0"), [1.0, 1.0], [1.0, 1.0], r))
    assert pair.cause == "height"


def test_omega_and_kappa_near_the_pole_are_explained() -> None:
    r = np.array([[1.0, 0.999], [0.999, 1.0]])
    (pair,) = strong_correlations(from_sigmas(("omega", "kappa"), [0.1, 0.1], [7.2, 7.2], r))
    assert pair.cause == "one-angle"


@pytest.mark.parametrize(("case", "told"), [(1, True), (3, False)])
def test_the_station_of_the_tank_whose_angles_are_one(case: int, told: bool) -> None:
    """The study turned its system: phi 89.6 degrees in the first, and a correlation of 0.123 in the third."""
    table = Path(__file__).parents[3] / f"configs/studies/tank/station9_case{case}.csv"
    said = CliRunner().invoke(app, ["analyse", str(table)]).output
    assert ("omega and kappa act as one angle here" in said) == told
    assert ("both turn about one axis" in said) == told
