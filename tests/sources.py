"""What the sources of the packages say, as a test reads them."""

from __future__ import annotations

import ast


def template(text: ast.JoinedStr, value: str = "{}") -> str:
    """An f-string as it may read: with `value` wherever a value stands."""
    return "".join(str(part.value) if isinstance(part, ast.Constant) else value for part in text.values)
