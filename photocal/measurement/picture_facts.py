"""The one table of what pictures state: fact, unit, meaning, the keys that makers write, and who uses it.

Keys are tags of EXIF by their names in the standard, or properties of XMP as "prefix:name"; the first one
that is written counts. What no maker of the table writes is read by the bare name, whoever wrote it; what
is not found there either stays unknown. A new maker is a key more, a new fact one entry of
`picture_facts.toml` and one field of `image_facts.ImageFacts`.

Sources: EXIF 2.32 (CIPA DC-008); DJI, manuals of Zenmuse P1 (p. 22), Mavic 3M (p. 89-90) and Matrice 4
(p. 90-91); DJI Payload SDK (kinds of altitude); Pix4D, "XMP tags of cameras"; Parrot, ANAFI photo metadata;
Skydio, "Camera and metadata overview"; pictures of a Phantom 4 Multispectral and a Zenmuse H20T.

XMP packets of pictures: properties by the prefix and name that makers write, read as plain text.

No parser of XML stands behind it: entities are never expanded beyond the five characters of XML, nothing is
fetched, and length and number are bounded. Packets that lack their declarations, as some makers write them,
are read all the same.
"""

import html
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

LONGEST, MOST_TAGS, LONGEST_VALUE = 1 << 20, 4096, 200
# A tag with its attributes, and the text behind it.
_TAG = re.compile(r"<(/?)([A-Za-z][\w.-]*:[\w.-]+)((?:\s[^<>]*?)?)(/?)>([^<>]{0,201})")
_ATTRIBUTE = re.compile(r"([A-Za-z][\w.-]*:[\w.-]+)\s*=\s*(?:\"([^\"<>]*)\"|'([^'<>]*)')")
# Namespaces whose prefixes say too little: both senseFly and Pix4D write "Camera".
_PREFIXES = {
    "http://ns.sensefly.com/camera/1.0": "sensefly",
    "http://www.dji.com/drone-dji/1.0": "drone-dji",
    "http://pix4d.com/camera/1.0": "Camera",
    "http://www.parrot.com/drone-parrot/1.0": "drone-parrot",
    "https://www.skydio.com/drone-skydio/1.0": "drone-skydio",
}
# What holds properties and is none itself.
_PLAIN = ("rdf", "x", "xml")
ANY = "*"


def read_xmp(packet: str) -> dict[str, str]:
    """Read the properties of a packet.

    returns: values by "prefix:name", those of a structure by "prefix:structure/name", items of a list joined
        with commas; and by "*:name" whoever wrote them, for makers that are not known.
    """
    found = dict[str, str]()
    prefixes = dict[str, str]()
    for name, value in _properties(packet[:LONGEST], prefixes):
        text = html.unescape(value).strip()
        if text and len(text) <= LONGEST_VALUE:
            prefix, _, rest = name.partition(":")
            found[f"{prefixes.get(prefix, prefix)}:{rest}"] = text
            found[f"{ANY}:{rest}"] = text
    return found


def _properties(packet: str, prefixes: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Properties as they stand; declared prefixes go into a table."""
    open_tags = list[str]()
    items = dict[str, list[str]]()
    for count, (closes, tag, attributes, empty, text) in enumerate(_TAG.findall(packet)):
        if count == MOST_TAGS:
            return
        if closes:
            if tag in open_tags:
                del open_tags[len(open_tags) - 1 - open_tags[::-1].index(tag) :]
            if tag in items:
                yield tag, ",".join(items.pop(tag))
            continue
        plain = tag.split(":")[0] in _PLAIN
        outer = next((name for name in reversed(open_tags) if name.split(":")[0] not in _PLAIN), "")
        for name, double, single in _ATTRIBUTE.findall(attributes):
            prefix, _, rest = name.partition(":")
            if prefix == "xmlns":
                address = (double or single).rstrip("/").lower()
                prefixes |= {rest: _PREFIXES[address]} if address in _PREFIXES else {}
            elif prefix not in _PLAIN:
                yield f"{outer if plain else tag}/{rest}" if outer or not plain else name, double or single
        if plain and tag == "rdf:li" and outer and text.strip():
            items.setdefault(outer, []).append(text.strip())
        elif not plain and not empty and text.strip():
            yield f"{outer}/{tag.split(':')[1]}" if outer else tag, text
        if not empty:
            open_tags.append(tag)


Triple = tuple[float, float, float]
NOT_GIVEN: Triple = (math.nan, math.nan, math.nan)
Kind = Literal["number", "positive", "text", "moment", "triple", "made"]
Tags = Mapping[str, Any]
# Of these the bare name says too little.
_OWN = ("EXIF:", "GPS:", "sensefly:", "crs:")


@dataclass(frozen=True)
class Fact:
    """One fact of a picture.

    name: of its field in `ImageFacts`.
    kind: how it is read; "made" is computed of several tags, by `image_facts`.
    keys: in the order of preference; the three of a triple stand with blanks between them.
    used: where it is used.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind
    keys: tuple[str, ...]
    used: str


def _facts() -> tuple[Fact, ...]:
    """The table, from the folder of this module."""
    text = resources.files("photocal.measurement").joinpath("picture_facts.toml").read_text("utf-8")
    rows: list[dict[str, Any]] = tomllib.loads(text)["fact"]
    return tuple(Fact(**{"unit": "", **row, "keys": tuple(row["keys"])}) for row in rows)


FACTS = _facts()


def read_table(tags: Tags) -> dict[str, Any]:
    """Read all facts of the table that need no more than their own tags, by name."""
    return {fact.name: _READERS[fact.kind](tags, fact.keys) for fact in FACTS if fact.kind != "made"}


def keys_of(name: str) -> tuple[str, ...]:
    """Keys of a fact."""
    return next(fact.keys for fact in FACTS if fact.name == name)


def stated(tags: Tags, keys: tuple[str, ...]) -> Any:
    """Give the first value that is there, by the keys themselves, then by their bare names in any XMP."""
    exact = (tags[key] for key in keys if tags.get(key) not in (None, "", b""))
    bare = (f"{ANY}:{key.partition(':')[2]}" for key in keys if not key.startswith(_OWN))
    return next(exact, next((tags[key] for key in bare if key in tags), None))


def as_text(value: object) -> str:
    """Text of a tag, cut at the first zero: what follows is left over memory."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    return "".join(c for c in value.split("\0")[0] if c.isprintable()).strip()


def as_number(value: Any) -> float:
    """Number of a tag; NaN for what is none."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def as_positive(value: Any) -> float:
    """Positive number of a tag; NaN for others."""
    number = as_number(value)
    return number if number > 0 else math.nan


def as_moment(stamp: str, fraction: str = "") -> str:
    """Moment of a stamp of EXIF or XMP as ISO 8601 without zone; empty for what is none."""
    match = re.match(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?", stamp)
    if not match or match[1] == "0000":
        return ""
    year, month, day, clock, part = match.groups()
    fraction = part or (fraction if fraction.isdigit() else "")
    return f"{year}-{month}-{day}T{clock}" + (f".{fraction}" if fraction else "")


def _triple(tags: Tags, keys: tuple[str, ...]) -> Triple:
    """Give the first of several triples that is stated in full."""
    for names in keys:
        first, second, third = (as_number(stated(tags, (name,))) for name in names.split())
        if math.isfinite(first + second + third):
            return first, second, third
    return NOT_GIVEN


_READERS: dict[str, Callable[[Tags, tuple[str, ...]], Any]] = {
    "number": lambda tags, keys: as_number(stated(tags, keys)),
    "positive": lambda tags, keys: as_positive(stated(tags, keys)),
    "text": lambda tags, keys: as_text(stated(tags, keys)),
    "moment": lambda tags, keys: as_moment(as_text(stated(tags, keys))),
    "triple": _triple,
}
