"""JSON that says one thing: no key twice in an object, and finite numbers only."""

import json
import math
from collections import Counter
from typing import Any


def read_checked_json(text: str | bytes) -> Any:
    """Return what JSON holds.

    raises ValueError: also for a key that stands twice, of which programs read one or the other, and for NaN,
        Infinity and numbers that are too large.
    """
    return json.loads(text, object_pairs_hook=_once, parse_constant=_finite, parse_float=_finite)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = Counter(name for name, _ in pairs)
        raise ValueError(f"has the key {names.most_common(1)[0][0]!r} twice")
    return content


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"contains {text} where a number must stand")
    return number
