"""The ministry's limits on the published Phantom 4 Pro figures."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.report.derived_figures import expected_altimetric_error_cm, limits, verdict


def test_expected_altimetric_accuracy_is_the_published_one() -> None:
    assert expected_altimetric_error_cm(100.0, 158.4, 8.8, 0.0241) == pytest.approx(24.45086, abs=5e-6)
    assert expected_altimetric_error_cm(100.0, 158.4, 8.8, 0.00241) == pytest.approx(2.44509, abs=5e-6)


def test_printed_figures_are_acceptable() -> None:
    assert verdict(limits((0.00081, 0.00046), 0.0241, (1.02, 1.44), 3.17, 24.45086)) == "acceptable"


def test_pixel_size_of_the_text_requires_a_new_calibration() -> None:
    """The text prints 2.41E-6 mm, which is the value in metres: by it the residuals exceed a pixel."""
    checked = limits((0.00081, 0.00046), 2.41e-6, (1.02, 1.44), 3.17, 24.45086)
    assert verdict(checked) == "new_calibration"
    assert [limit.met for limit in checked] == [False, False, True, True]


def test_what_is_missing_leaves_it_open() -> None:
    assert verdict(limits(None, 0.0241, (1.02, 1.44), 3.17, 24.45)) == "not_determined"
    assert verdict(limits((0.00081, 0.00046), 0.0241, None, 3.17, None)) == "not_determined"
    assert verdict(limits((0.9, 0.00046), 0.0241, None, None, None)) == "new_calibration"


@given(*[st.one_of(st.none(), st.floats(0, 10)) for _ in range(3)])
def test_never_acceptable_without_all_limits(
    pixel: float | None, gsd: float | None, dz: float | None
) -> None:
    found = verdict(limits((0.0, 0.0), pixel, (0.0, 0.0), gsd, dz))
    assert found == ("not_determined" if None in (pixel, gsd, dz) else "acceptable")
