"""Names that people give: on one line, without characters that hide, and compared as people read them."""

import unicodedata

# Control and format (zero width, right to left), line and paragraph ends, halves and no characters.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def one_line(name: str) -> str:
    """Return a name that a terminal prints as it is.

    raises ValueError: when a character in it cannot be seen, steers a terminal or ends a line.
    """
    hidden = next((c for c in name if unicodedata.category(c) in _HIDDEN), None)
    if hidden is not None:
        what = unicodedata.name(hidden, "control character").lower()
        raise ValueError(f"has a character that is not printed, U+{ord(hidden):04X} ({what})")
    return name


def plain_name(name: str) -> str:
    """Return a name in its one form: NFKC of Unicode, blanks folded, none at its ends.

    raises ValueError: as of `one_line`, and for a name of blanks.
    """
    plain = " ".join(unicodedata.normalize("NFKC", one_line(name)).split())
    if not plain:
        raise ValueError("is empty")
    return one_line(plain)


def compared(name: str) -> str:
    """Return what two names have in common that people take for the same: neither case nor form counts."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())
