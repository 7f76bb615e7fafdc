"""XML: read safely (no entities, no external references, bounded size, errors in one line), and written."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, indent, tostring

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from drivers.errors import InputMalformedError
from photocal.exchange.source import number, require_readable

MAX_XML_BYTES = 256 << 20


def read_xml(path: Path) -> Element:
    """Read an XML file.

    raises InputNotFoundError: when it is missing, empty or a folder.
    raises InputMalformedError: when it is no XML, declares entities, or is too large.
    """
    if require_readable(path) > MAX_XML_BYTES:
        raise InputMalformedError(
            f"is larger than the {MAX_XML_BYTES >> 20} MiB that are read as XML",
            where=path,
            remedy="is it the right file?",
        )
    return parse_xml(path.read_bytes(), path)


def parse_xml(content: bytes, path: object) -> Element:
    """Parse XML that is already in memory."""
    try:
        return fromstring(content, forbid_dtd=False)
    except DefusedXmlException as refusal:
        raise InputMalformedError(
            "declares XML entities or external references, which are not read",
            where=path,
            remedy="remove the DOCTYPE",
        ) from refusal
    except (ParseError, ValueError, LookupError) as failure:
        raise InputMalformedError(
            f"is no valid XML ({failure})", where=path, remedy="was it written completely?"
        ) from failure


def child(element: Element, path: str, place: object) -> Element:
    """Find an element that must be there."""
    found = element.find(path)
    if found is None:
        raise InputMalformedError(
            f"<{element.tag}> has no <{path}>", where=place, remedy="is it the right kind of file?"
        )
    return found


def text_of(element: Element, path: str, place: object) -> str:
    """Text of an element that must be there; parameters as in `child`."""
    return (child(element, path, place).text or "").strip()


def number_of(element: Element, path: str, place: object) -> float:
    """Number in an element that must be there; parameters as in `child`."""
    return number(text_of(element, path, place), place, path.rsplit("/", 1)[-1])


def write_xml(path: Path, root: Element) -> None:
    """Write a document as indented UTF-8."""
    indent(root)
    path.write_bytes(b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="utf-8") + b"\n")
