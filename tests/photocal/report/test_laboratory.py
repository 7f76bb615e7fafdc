"""Expanded uncertainty against the worked example of an R package (JCGM 100, G.4)."""

from __future__ import annotations

import pytest

from photocal.report.laboratory import combined


def test_welch_and_satterthwaite() -> None:
    """Inputs and figures of the example of metRology, welch.satterthwaite; k for 15 degrees of freedom."""
    u, freedom, k = combined([(0.1, float("inf")), (0.6, 6.0), (0.6, 8.0), (0.55, 3.0)])
    assert u == pytest.approx(1.016120, abs=1e-6)
    assert freedom == pytest.approx(15.60796, abs=1e-4)
    assert k == pytest.approx(2.131450, abs=1e-6)


def test_many_degrees_of_freedom_are_normal() -> None:
    assert combined([(0.1, float("inf"))])[2] == pytest.approx(1.959964, abs=1e-4)
