"""What the commands say in both languages, and what devices, files and alarms say in English.

Records keep their sentences in English; here they are said in the language of the person.
"""

import json
import sys
from functools import cache
from importlib import resources

from photocal.base.sentences import LANGUAGES, Texts, read_texts, spoken_to


@cache
def texts(language: str) -> Texts:
    """Return all texts of a language.

    raises ConfigurationError: for a language that there are no texts in.
    """
    own = read_texts("acquire.commands", "said", language)
    # Of sentences alike the first counts: those of the page leave reasons of a lost link in English.
    messages = own | _alarms(language) | _shared(language)
    english = messages if language == "en" else texts("en").messages
    return Texts(language, messages["number.decimal_mark"], messages, english)


def _shared(language: str) -> dict[str, str]:
    """What both programs refuse."""
    shared = read_texts("photocal.base", "refusals", language)
    # The reason for a lost link may come from the operating system.
    of_system = {key: text for key, text in shared.items() if key.startswith("refusal.system.")}
    return shared | {key.replace("refusal", "stored", 1): text for key, text in of_system.items()}


def _alarms(language: str) -> dict[str, str]:
    """Sentences of alarms and links: the monitor's page has them in both languages."""
    told = json.loads(resources.files("acquire.monitor").joinpath("texts.json").read_text(encoding="utf-8"))
    at = LANGUAGES.index(language)
    return {f"stored.{key}": pair[at] for key, pair in told.items() if key.startswith("told.")}


def refused(line: str) -> str:
    """Say a refusal in the language that this program was asked for, else in that of the environment."""
    return texts(spoken_to(sys.argv[1:])).refused(line)
