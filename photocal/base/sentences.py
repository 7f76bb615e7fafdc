"""The texts of a language, with places for values; sentences that were made in English, said in it."""

import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import pairwise

from photocal.base.errors import ConfigurationError

LANGUAGES = ("en", "pt-BR")

# In a refusal these places may have a word of ours, which has its own translation.
_WORD_PLACES = ("what", "role", "kind", "height", "height_kind", "model", "stated")
# In other sentences a place with such a name has a sentence of its own.
_SENTENCE_PLACE = "said"
_PLACE = re.compile(r"\{\w+\}")


class Count(int):
    """A count that a text formats itself: with "mark|marks" it is "1 mark", and "0 marks" or "2 marks"."""

    def __format__(self, form: str) -> str:
        """Write it."""
        one, both, many = form.partition("|")
        return f"{int(self)} {one if self == 1 else many}" if both else format(int(self), form)


@dataclass(frozen=True, eq=False)
class Texts:
    """All texts of one language.

    mark: the decimal mark.
    messages: texts by their dotted keys; places for values in braces.
    english: the same texts in English: what was made in English is found by them.
    """

    language: str
    mark: str
    messages: Mapping[str, str]
    english: Mapping[str, str]

    def __call__(self, key: str, **values: object) -> str:
        """Give one text with its values put in."""
        counts = {name: Count(value) for name, value in values.items() if type(value) is int}
        return self.messages[key].format(**(values | counts))

    def row(self, values: Iterable[float], form: str, joint: str = " ") -> str:
        """Write numbers one after another for a terminal, with the decimal mark of the language."""
        return joint.join(f"{value:{form}}".replace(".", self.mark) for value in values)

    def stored(self, text: str, own: Mapping[str, str] | None = None) -> str:
        """Say in this language what a record has in English; what is not known stands as it is.

        own: other texts that are known, English to this language, with places for values in braces.
        """
        return text if self.language == "en" else self._known(text, "stored", own)

    def helped(self, text: str) -> str:
        """Say in this language what the help has in English; what is not known stands as it is."""
        return text if self.language == "en" else self._known(text, "help")

    def refused(self, text: str) -> str:
        """Say in this language what a command refuses, "place: what happened; what to do".

        A refusal that is not known stands in English.
        """
        if self.language == "en":
            return text
        parts, said = text.split("; "), list[str]()
        while parts:
            # A sentence may have semicolons of its own.
            for n in range(1, len(parts) + 1):
                whole = "; ".join(parts[:n])
                if (known := self._placed(whole)) != whole:
                    break
            else:
                n, known = 1, parts[0]
                if not said:
                    return text
            said.append(known)
            parts = parts[n:]
        return "; ".join(said)

    def _placed(self, text: str) -> str:
        """Say a sentence behind the place that it speaks of."""
        parts = text.split(": ")
        for k in reversed(range(len(parts))):
            end = ": ".join(parts[k:])
            if (known := self._known(end, "refusal")) != end:
                return ": ".join([*(self._known(part, "refusal") for part in parts[:k]), known])
        return text

    def _known(self, text: str, section: str, own: Mapping[str, str] | None = None) -> str:
        for english, said in (*(own or {}).items(), *_twins(self, section)):
            if found := _pattern(english, said).fullmatch(text):
                parts = {name: self._part(name, part, section) for name, part in found.groupdict().items()}
                # Places alone fit many a text: where nothing of it is known, another sentence may be.
                if (whole := said.format(**parts)) != text:
                    return whole
        return text

    def _part(self, name: str, text: str, section: str) -> object:
        """Say what stands in the place of a value: a number, a sentence of its own, or a word."""
        if section == "refusal":
            word = self._known(text, "refusal_word") if name in _WORD_PLACES else text
            text = word if word != text else self._known(text, section)
        elif name.startswith(_SENTENCE_PLACE):
            text = self._known(text, section)
        # Other numbers with a zero before them are names.
        return Count(text) if re.fullmatch(r"0|[1-9]\d*", text) else self._decimal(text)

    def _decimal(self, text: str) -> str:
        """Give a number the decimal mark; what is no number stays."""
        return text.replace(".", self.mark) if re.fullmatch(r"[-+]?\d+\.\d+", text) else text


def spoken(language: str = "") -> str:
    """Return the language of texts at the terminal: the one asked for, else that of the environment."""
    told = filter(None, map(os.environ.get, ("LC_ALL", "LC_MESSAGES", "LANG")))
    return language or ("pt-BR" if next(told, "").lower().startswith("pt") else "en")


def spoken_to(arguments: Sequence[str]) -> str:
    """Return the language in which a program that was called so refuses.

    The one asked for, else that of the environment; English for programs, which ask for JSON.
    """
    words = " ".join(arguments).replace("=", " ").split()
    asked = [after for word, after in pairwise(words) if word in ("--lang", "--language")]
    language = asked[-1] if asked else "en" if "--json" in words else spoken()
    return language if language in LANGUAGES else spoken()


def known_language(language: str) -> str:
    """Return a language; raises ConfigurationError for one that there are no texts in."""
    if language not in LANGUAGES:
        raise ConfigurationError(
            f"no texts in language {language!r}", f"choose one of {', '.join(LANGUAGES)}"
        )
    return language


def read_texts(package: str, name: str, language: str) -> dict[str, str]:
    """Read a file of texts by their dotted keys; raises as `known_language`."""
    known_language(language)
    text = resources.files(package).joinpath(f"{name}_{language}.toml").read_text(encoding="utf-8")
    return dict(_flat(tomllib.loads(text), ""))


@cache
def help_texts(package: str, language: str) -> Texts:
    """Read what the help of the commands in a package says, and nothing else: help is to be quick."""
    english, own = (
        read_texts("photocal.base", "help", one) | read_texts(package, "help", one)
        for one in ("en", language)
    )
    # What is to be typed keeps its point.
    return Texts(language, ".", own, english)


@cache
def _twins(texts: Texts, section: str) -> tuple[tuple[str, str], ...]:
    """English texts of a section, and the same in another language."""
    english, other = texts.english, texts.messages
    twins = [(text, other[key]) for key, text in english.items() if key.startswith(f"{section}.")]
    if section == "refusal":
        # What is wrong with a system is said in both ways.
        told = [key for key in english if key.startswith("new.unfit_")]
        twins += [(f"crs = {{crs}}{english[key]}", f"crs = {{crs}}{other[key]}") for key in told]
    # Of sentences that fit a text, the one with the fewest places for values says it.
    return tuple(sorted(twins, key=lambda twin: -len(_PLACE.sub("", twin[0]))))


@cache
def _pattern(english: str, said: str) -> re.Pattern[str]:
    """A text with places for values, as it may read; what the other language counts is a number."""
    counted = set(re.findall(r"\{(\w+):", said))

    def place(found: re.Match[str]) -> str:
        """Say what may stand in a place; the name of a link has no blanks, or stands in quotation marks."""
        kind = r"'.*?'|[^\s:]+" if found[1] == "link" else "0|[1-9][0-9]*" if found[1] in counted else ".+?"
        return f"(?P<{found[1]}>{kind})"

    return re.compile(re.sub(r"\\{(\w+)\\}", place, re.escape(english)))


def _flat(tree: Mapping[str, object], prefix: str) -> list[tuple[str, str]]:
    leaves: list[tuple[str, str]] = []
    for key, branch in tree.items():
        if isinstance(branch, Mapping):
            leaves += _flat(branch, f"{prefix}{key}.")
        else:
            leaves.append((prefix + key, str(branch)))
    return leaves
