"""The texts of the reports in each language, read from the catalogues beside this module."""

from __future__ import annotations

import datetime as dt
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

from drivers.errors import ConfigurationError

LANGUAGES = ("en", "pt-BR")
# Their sections may add to each other, their keys are all different.
CATALOGUES = ("findings", "report", "analysis")


@dataclass(frozen=True)
class Catalogue:
    """All texts of one language.

    messages: texts by their dotted keys; places for values in braces.
    """

    language: str
    mark: str
    messages: Mapping[str, str]

    def __call__(self, key: str, **values: object) -> str:
        """Give one text with its values put in."""
        return self.messages[key].format(**values)

    def date(self, day: dt.date) -> str:
        """Write a date in words."""
        month = self.messages["date.months"].split()[day.month - 1]
        return self("date.form", day=day.day, month=month, year=day.year)


def catalogue(language: str) -> Catalogue:
    """Read the texts of a language; raises ConfigurationError for a language that there is none of."""
    if language not in LANGUAGES:
        raise ConfigurationError(
            f"no texts in language {language!r}", remedy=f"choose one of {', '.join(LANGUAGES)}"
        )
    messages = dict[str, str]()
    for name in CATALOGUES:
        text = resources.files(__package__).joinpath(f"{name}_{language}.toml").read_text(encoding="utf-8")
        messages |= dict(_flat(tomllib.loads(text), ""))
    return Catalogue(language, messages["number.decimal_mark"], messages)


def _flat(tree: Mapping[str, object], prefix: str) -> list[tuple[str, str]]:
    leaves: list[tuple[str, str]] = []
    for key, branch in tree.items():
        if isinstance(branch, Mapping):
            leaves += _flat(branch, f"{prefix}{key}.")
        else:
            leaves.append((prefix + key, str(branch)))
    return leaves
