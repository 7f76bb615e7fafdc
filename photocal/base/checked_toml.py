"""TOML files checked key by key: a wrong key or value is named with its file.

JSON that says one thing: no key twice in an object, and finite numbers only.
"""

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from photocal.base.errors import ConfigurationError, InputNotFoundError, reason

Content = TypeVar("Content", bound=BaseModel)


# An unknown key, in a table and in a dataclass of options.
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


class Table(BaseModel):
    """A table of a file: unknown keys are errors, and numbers are finite where nothing else is said."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; what is nested or numbered beyond all measure is no TOML either."""
    most_parts = 100
    # Each part of a dotted name is kept with all before it: many of them would fill the memory.
    if any(line.partition("=")[0].count(".") > most_parts for line in text.splitlines()):
        raise tomllib.TOMLDecodeError(f"a name has more than {most_parts} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (RecursionError, ValueError) as failure:
        raise tomllib.TOMLDecodeError(str(failure)) from None


def read_tables(path: Path) -> dict[str, Any]:
    """Read a TOML file; errors as of `read_toml`."""
    try:
        octets = path.read_bytes()
        _refuse_other_encodings(octets, path)
        # Some editors begin UTF-8 with a mark.
        text = octets.decode("utf-8-sig")
        content = parse_toml(text)
    except OSError as refusal:
        raise InputNotFoundError(_unreadable(refusal), "check the path", where=path) from refusal
    except UnicodeDecodeError as failure:
        raise ConfigurationError("is not UTF-8", "save it as UTF-8", where=path) from failure
    except tomllib.TOMLDecodeError as failure:
        raise ConfigurationError(
            f"is not valid TOML ({failure})", _remedy(text, failure), where=path
        ) from failure
    if not text.strip():
        raise InputNotFoundError("is empty", "was it written completely?", where=path)
    return content


def _remedy(text: str, failure: tomllib.TOMLDecodeError) -> str:
    """What people write who have not met TOML before: paths of Windows, and text as letters have it."""
    place = re.search(r"at line (\d+)", str(failure))
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    if "\\" in line:
        return "write paths with /, not with \\"
    _, _, value = line.partition("=")
    if re.match(r"\s*[^\W\d]|\s*[\u2018-\u201f\u00ab]", value):
        return 'put text in straight quotes: "text"'
    return "correct it"


def _refuse_other_encodings(octets: bytes, path: Path) -> None:
    """Name what Windows calls Unicode, with its mark or without: half of its octets are zeros."""
    start = octets[:4000]
    marked = start.startswith((b"\xff\xfe", b"\xfe\xff"))
    if marked or len(start) < 3 * start.count(0) < 2 * len(start):
        raise ConfigurationError("is UTF-16, not UTF-8", "save it as UTF-8", where=path)


def read_toml(path: Path, model: type[Content], context: dict[str, Any] | None = None) -> Content:
    """Read a TOML file and check it.

    raises InputNotFoundError: when there is no such file.
    raises ConfigurationError: for what is not TOML, an unknown key, a missing one, or an impossible value.
    """
    return checked_tables(read_tables(path), model, path, context)


def checked_tables(
    content: Mapping[str, Any], model: type[Content], where: object, context: dict[str, Any] | None = None
) -> Content:
    """Check tables that were read; errors as of `read_toml`, said of `where`."""
    try:
        return model.model_validate(content, context=context)
    except ValidationError as failure:
        # A misspelt key is both unknown and missing: the first says more.
        unknown = [error for error in failure.errors() if error["type"] in _UNKNOWN]
        raise _complaint(where, (unknown or failure.errors())[0]) from failure


def _unreadable(refusal: OSError) -> str:
    if isinstance(refusal, FileNotFoundError):
        return "does not exist"
    if isinstance(refusal, IsADirectoryError):
        return "is a folder, a file was expected"
    return f"cannot be read ({reason(refusal)})"


def _complaint(path: object, error: Any) -> ConfigurationError:
    """Say in words what is wrong with a key."""
    # What has brackets is the name of a variant, not of a key.
    parts = (str(part + 1) if isinstance(part, int) else part for part in error["loc"])
    key = ".".join(part for part in parts if not re.search(r"[<\[]", part))
    text = error["msg"].removeprefix("Value error, ")
    if error["type"] in _UNKNOWN:
        return ConfigurationError(f"unknown key {key}", "correct its spelling or remove it", where=path)
    if error["type"] == "missing":
        return ConfigurationError(f"key {key} is missing", "add it", where=path)
    if error["type"] == "value_error" and isinstance(error["input"], dict):
        return ConfigurationError(f"{key}: {text}" if key else text, "correct the file", where=path)
    if "tuple" in error["type"] or "Tuple" in text:
        text = text.replace("Tuple", "list").replace("tuple", "list").replace(" after validation", "")
    return ConfigurationError(
        f"{key} = {error['input']!r}: {text.lower()}",
        "correct the value",
        where=path,
    )


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
        raise ValueError(f"contains {text} where a number is expected")
    return number
