"""The command `acquire`: a list of its commands."""

import os
from typing import TYPE_CHECKING

from photocal.base.console import application, run

if TYPE_CHECKING:
    from photocal.base.sentences import Texts

COMMANDS = {
    "check": "acquire.commands.recording:check",
    "export": "acquire.commands.flight_log:export",
    "import": "acquire.commands.flight_log:import_",
    "info": "acquire.commands.flight_log:info",
    "monitor": "acquire.commands.recording:monitor",
    "record": "acquire.commands.recording:record",
    "recover": "acquire.commands.flight_log:recover",
    "replay": "acquire.commands.flight_log:replay",
    "simulate": "acquire.commands.simulate:app",
}
app = application("Record, import, replay and inspect flights; the flight log is an MCAP file.", COMMANDS)


def main() -> None:
    """Run the command line."""
    # Nothing here multiplies large matrices: threads for that would cost every command a start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    run(app, texts, "acquire.commands")


def texts(language: str) -> "Texts":
    """Return all texts of a language, see `acquire.commands.texts.texts`."""
    from acquire.commands import texts as read

    return read.texts(language)
