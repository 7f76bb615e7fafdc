"""One flight in one or several logs that follow each other (rotated or resumed recordings), read once."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from acquire.log.reader import LoggedMessages, LogReader
from acquire.log.records import Channel
from drivers.frames import Wire
from drivers.protocols import receiver_wires

EXPOSURES = "/camera/exposure"
_DECODED = ("/position", "/fix", "/attitude", "/parameter")


class FlightLog:
    """The messages of a flight that bear on positions, attitudes and exposures.

    The logs are opened and read when a message is first asked for, and never again: raw frames, event lists,
    exposures, positions and attitudes are kept, all else is passed over. The numbers of their messages go on
    from log to log: a decoded message has that of the frame that it was made from.

    paths: the logs in the order of time; may be empty.
    """

    def __init__(self, paths: Iterable[Path] = ()) -> None:
        self.paths = tuple(paths)
        self._messages: list[LoggedMessages] | None = None

    def __bool__(self) -> bool:
        return bool(self.paths)

    def __str__(self) -> str:
        return ", ".join(map(str, self.paths))

    def raw(self, *wires: Wire, link: str | None = None) -> Iterator[tuple[Wire, LoggedMessages]]:
        """Give the frames of some protocols, of one link or of all, and the protocol of each."""
        by_encoding = {wire.encoding: wire for wire in wires}
        for messages in self._read():
            channel = messages.channel
            wire = by_encoding.get(channel.encoding)
            if wire is not None and (link is None or channel.topic == f"/{link}/raw"):
                yield wire, messages

    def topic(self, name: str) -> Iterator[LoggedMessages]:
        """Give the decoded messages of a topic."""
        return (m for m in self._read() if m.channel.topic == name and m.channel.schema is not None)

    def _read(self) -> list[LoggedMessages]:
        if self._messages is None:
            first, every = 0, list[LoggedMessages]()
            for path in self.paths:
                for chunk in LogReader(path, wanted=_is_wanted).chunks():
                    every += [replace(messages, sequence=messages.sequence + first) for messages in chunk]
                first = 1 + max((int(messages.sequence.max()) for messages in every), default=-1)
            self._messages = every
        return self._messages


def _is_wanted(channel: Channel) -> bool:
    if channel.schema is None:
        encodings = {wire.encoding for wire in (Wire.MAVLINK, Wire.MRK, *receiver_wires())}
        return channel.encoding in encodings and channel.topic.endswith("/raw")
    return channel.topic == EXPOSURES or channel.topic.endswith(_DECODED)
