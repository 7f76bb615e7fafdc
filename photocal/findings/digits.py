"""Numbers as a report prints them: two digits of the standard deviation, no digit more."""

import math
from dataclasses import dataclass

from photocal.base.sentences import Count

MINUS = "\u2212"
SUPERSCRIPTS = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
_LOWERED = "\u2080\u2081\u2082\u2083\u2084\u2085\u2086\u2087\u2088\u2089"
SUBSCRIPTS, PLAIN = str.maketrans("0123456789", _LOWERED), str.maketrans(_LOWERED, "0123456789")

# Values outside this range of magnitude are printed with a power of ten in the unit.
SMALL, LARGE = 1e-3, 1e7


def fixed(value: float, decimals: int, mark: str) -> str:
    """Print a number with a fixed number of decimals.

    returns: with a true minus sign; a value that rounds to zero has none.
    """
    text = f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"
    if text.startswith("-"):
        text = text[1:] if not text.strip("-0.") else MINUS + text[1:]
    return text.replace(".", mark)


def decimals_of(sigma: float, digits: int = 2) -> int:
    """Give the number of decimals that shows a standard deviation with so many significant digits."""
    # The decimal rounding decides the power of ten: 0.0997 is printed as 0.10, not as 0.100.
    exponent = int(f"{sigma:.{digits - 1}e}".split("e")[1])
    return digits - 1 - exponent


def significant(value: float, digits: int, mark: str) -> str:
    """Print a number with so many significant digits, without exponent."""
    if value == 0.0:
        return "0"
    return fixed(value, decimals_of(abs(value), digits), mark)


def as_given(value: float, mark: str) -> str:
    """Print a number with the digits that it was given with, ten at most."""
    digits = next((d for d in range(1, 11) if float(f"{value:.{d}g}") == value), 10)
    return fixed(value, max(decimals_of(abs(value), digits), 0), mark) if value else "0"


def measured(value: float, sigma: float, mark: str) -> tuple[str, str, int]:
    """Print a value with its standard deviation, both to two digits of the latter.

    returns: both with the same number of decimals, and the power of ten that belongs to both.
    """
    size = max(abs(value), sigma)
    exponent = 0
    if size != 0.0 and not SMALL <= size < LARGE:
        exponent = math.floor(math.log10(size))
    scale = 10.0**exponent
    if sigma == 0.0:
        return as_given(value / scale, mark), "", exponent
    decimals = decimals_of(sigma / scale)
    return fixed(value / scale, decimals, mark), fixed(sigma / scale, decimals, mark), exponent


def with_sigma(value: float, sigma: float, sign: str = "") -> str:
    """Print a value and its standard deviation for a terminal, to two significant digits of the latter."""
    digits = max(0, 1 - math.floor(math.log10(sigma))) if sigma > 0 else 4
    return f"{value:{sign}.{digits}f} +- {sigma:.{digits}f}"


def power_of_ten(exponent: int, unit: str) -> str:
    """Write a unit with its power of ten, "10⁻⁴ mm⁻²"; the unit alone for the power 0."""
    if exponent == 0:
        return unit
    return f"10{str(exponent).translate(SUPERSCRIPTS)} {unit}".strip()


def unit_power(unit: str, power: int) -> str:
    """Write a unit to a power, "mm⁻²"; the unit alone for 1, nothing for 0."""
    if power == 0:
        return ""
    return unit if power == 1 else unit + str(power).translate(SUPERSCRIPTS)


def symbol(parameter: str) -> str:
    """Write a parameter name as a symbol, "K1" as "K₁"."""
    return parameter.translate(SUBSCRIPTS)


def probability(p: float, mark: str) -> str:
    """Write a probability: three decimals, or that it is smaller than that."""
    return relation(p, mark).removeprefix("=\u00a0")


def relation(p: float, mark: str) -> str:
    """Write how a probability compares: equal to three decimals, or smaller."""
    sign, printed = ("=", p) if p >= 0.001 else ("<", 0.001)
    return f"{sign}\u00a0{fixed(printed, 3, mark)}"


@dataclass(frozen=True)
class Number:
    """A number that a text formats itself, with the decimal mark of its language."""

    value: float
    mark: str

    def __format__(self, form: str) -> str:
        """Write it: four significant digits; "sN" N of them; "length" in m or mm; "mark|marks" as a count."""
        if form == "length":
            # In m, or in mm below a metre.
            scale, decimals, unit = (1.0, 2, "m") if abs(self.value) >= 1.0 else (1000.0, 1, "mm")
            return f"{fixed(scale * self.value, decimals, self.mark)} {unit}"
        if "|" in form:
            return format(Count(self.value), form)
        if not form or form[0] == "s":
            return significant(self.value, int(form[1:] or 4), self.mark)
        return format(self.value, form).replace("-", MINUS).replace(".", self.mark)
