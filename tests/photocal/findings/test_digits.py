"""Numbers are printed with two digits of their standard deviation."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.findings.digits import (
    Number,
    decimals_of,
    fixed,
    measured,
    power_of_ten,
    probability,
    relation,
    significant,
    symbol,
    unit_power,
)


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (20.472130583, 8.61644e-3, ("20.4721", "0.0086", 0)),
        (-2.77795483e-4, 4.5553530e-6, ("−2.778", "0.046", -4)),
        (8.17176972e-10, 1.4490604e-10, ("8.2", "1.4", -10)),
        (1.04490003e-5, 4.2303818e-6, ("1.04", "0.42", -5)),
        (3673.03, 0.28, ("3673.03", "0.28", 0)),
        (1.04, 0.0996, ("1.04", "0.10", 0)),
        (12345.6, 180.0, ("12350", "180", 0)),
        (-0.0004, 0.3, ("0.00", "0.30", 0)),
        (3.0e-17, 6.0e-17, ("3.0", "6.0", -17)),
        (20.0, 0.0, ("20", "", 0)),
        (0.003, 0.0, ("0.003", "", 0)),
        (-1.25e-9, 0.0, ("−1.25", "", -9)),
        (0.0, 0.0, ("0", "", 0)),
    ],
)
def test_measured(value: float, sigma: float, expected: tuple[str, str, int]) -> None:
    assert measured(value, sigma, ".") == expected


@given(st.floats(-1e6, 1e6), st.floats(1e-12, 1e5))
def test_printed_value_is_within_a_hundredth_of_sigma_scale(value: float, sigma: float) -> None:
    """The rounding never moves a value by more than 5 % of sigma, nor sigma by more than 5 % of itself."""
    printed, printed_sigma, exponent = measured(value, sigma, ".")
    number = float(Decimal(printed.replace("−", "-")).scaleb(exponent))
    spread = float(Decimal(printed_sigma).scaleb(exponent))
    assert abs(number - value) <= 0.0501 * sigma + 1e-9 * abs(value)
    assert abs(spread - sigma) <= 0.0501 * sigma
    digits = printed_sigma.replace(".", "").lstrip("0")
    assert len(digits) == 2 or (exponent == 0 and sigma >= 99.5)


@given(st.floats(-1e9, 1e9), st.integers(-3, 9))
def test_fixed_never_prints_minus_zero(value: float, decimals: int) -> None:
    text = fixed(value, decimals, ",")
    assert "-" not in text
    assert "." not in text
    if text.startswith("−"):
        assert any(digit in text for digit in "123456789")


def test_pieces() -> None:
    assert decimals_of(0.0086) == 4
    assert decimals_of(0.00997) == 3
    assert significant(1234.5, 2, ".") == "1200"
    assert power_of_ten(-4, "mm⁻²") == "10⁻⁴ mm⁻²"
    assert power_of_ten(0, "mm") == "mm"
    assert (unit_power("mm", -6), unit_power("px", 1), unit_power("px", 0)) == ("mm⁻⁶", "px", "")
    assert symbol("K1") == "K₁"
    assert (relation(0.13, ","), relation(1e-5, ".")) == ("=\u00a00,130", "<\u00a00.001")
    assert probability(0.13, ".") == "0.130"


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (0.0135, "length", "13,5 mm"),
        (2.345678, "length", "2,35 m"),
        (-0.02771, "+.3f", "−0,028"),
        (2.6457, "", "2,646"),
        (2.6457, "s2", "2,6"),
        (0.0014, ".2%", "0,14%"),
    ],
)
def test_a_number_formats_itself_in_the_language(value: float, form: str, text: str) -> None:
    assert format(Number(value, ","), form) == text
