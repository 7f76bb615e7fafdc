"""One verdict: what is grave withholds, what is doubtful is a reservation, a small factor is nothing."""

from __future__ import annotations

import pytest

from photocal.findings.finding import Finding, Severity, of_global_test, verdict
from photocal.findings.texts import catalogue, finding_text


@pytest.mark.parametrize(
    ("severities", "code"),
    [
        ((), "usable"),
        (("note", "passed", "untested"), "usable"),
        (("note", "doubtful"), "usable-with-reservations"),
        (("consequence",), "usable-with-reservations"),
        (("doubtful", "grave"), "not-usable"),
        (("refused",), "not-usable"),
    ],
)
def test_the_gravest_decides(severities: tuple[Severity, ...], code: str) -> None:
    assert verdict(Finding("time-offset", one) for one in severities).code == code


def test_what_several_stages_tell_is_counted_once() -> None:
    told = Finding("rolling-shutter", "grave", "cam"), Finding("rolling-shutter", "grave", "cam")
    assert verdict(told).figures["n"] == 1.0


def test_a_factor_of_five_per_cent_is_no_finding() -> None:
    """The demonstration: 0.991, rejected for its many observations."""
    dof = 100_000
    assert of_global_test(0.991 * dof, dof, accepted=False).severity == "passed"
    assert of_global_test(1.049**2 * dof, dof, accepted=False).severity == "passed"
    assert of_global_test(1.051**2 * dof, dof, accepted=False).severity == "doubtful"
    assert of_global_test(0.949**2 * dof, dof, accepted=False).severity == "doubtful"
    assert of_global_test(4.0 * 10, 10, accepted=True).severity == "passed"


def test_sigmas_of_the_same_residuals_test_nothing() -> None:
    finding = of_global_test(4.0 * 1000, 1000, accepted=False, estimated=True)
    assert finding.severity == "untested"
    assert "no global test is claimed" in finding_text(finding, catalogue("en"))
    assert verdict([finding]).code == "usable"


def test_without_redundancy_nothing_is_tested() -> None:
    assert of_global_test(0.0, 0, accepted=None).severity == "untested"
