"""Reading JSON safely: finite numbers only, errors in one line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from drivers.errors import InputMalformedError
from photocal.exchange.source import read_text

T = TypeVar("T")


def read_json(path: Path) -> Any:
    """Read a JSON object; errors in one line.

    raises InputNotFoundError, InputMalformedError.
    """
    text = read_text(path)
    try:
        content = json.loads(text, parse_constant=_refuse_constant, parse_float=_finite)
    except (ValueError, RecursionError) as failure:
        raise InputMalformedError(
            f"is no valid JSON ({failure})", where=path, remedy="was it written completely?"
        ) from failure
    return content


def structured(path: Path, what: str, read: Callable[[], T]) -> T:
    """Read something of a JSON file; turn what a wrong structure raises into one line."""
    try:
        return read()
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, IndexError) as failure:
        raise InputMalformedError(
            f"has not the structure of {what} ({type(failure).__name__}: {str(failure)[:80]})", where=path
        ) from failure


def _refuse_constant(name: str) -> float:
    raise ValueError(f"the number {name} is not finite")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:40]} is not finite")
    return value
