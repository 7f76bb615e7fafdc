"""XMP packets of pictures: properties by the prefix and name that makers write, read as plain text.

No parser of XML stands behind it: entities are never expanded beyond the five characters of XML, nothing is
fetched, and length and number are bounded. Packets that lack their declarations, as some makers write them,
are read all the same.
"""

import html
import re
from collections.abc import Iterator

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
