"""One flight in one or several logs that follow each other (rotated or resumed recordings), read once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from acquire.log.chunk import Channel
from acquire.log.reader import LoggedMessages, LogReader, Repeats, arrays_of_log
from drivers.frames import Wire
from drivers.protocols import receiver_wires
from photocal.base.errors import InputNotFoundError
from photocal.base.tables import package

EXPOSURES = "/camera/exposure"
_DECODED = ("/position", "/fix", "/attitude", "/parameter")


@dataclass(frozen=True, eq=False, repr=False)
class FlightLog:
    """One flight in one or several logs that follow each other; `acquire` writes them.

    The logs are read once, when a message is first requested. Raw frames, event lists, exposures, positions
    and attitudes are kept; everything else is skipped. Messages are numbered through all logs: a decoded
    message has the number of its frame. Frames that the recorder wrote to two files, because a disk had not
    confirmed them, appear once.

    Attributes
    ----------
    paths
        The logs in the order of time; may be empty.
    """

    paths: tuple[Path, ...] = ()

    @classmethod
    def read(cls, path: str | Path | Sequence[str | Path]) -> "FlightLog":
        """Name the logs of a flight; each is opened when a message is first asked for.

        Parameters
        ----------
        path
            One MCAP file of `acquire record` or `acquire import`, or several that follow each other.

        Returns
        -------
        FlightLog
            The flight.

        Raises
        ------
        InputNotFoundError
            When one does not exist.
        """
        paths = tuple(map(Path, (path,) if isinstance(path, str | Path) else path))
        for each in paths:
            if not each.is_file():
                raise InputNotFoundError("does not exist", "name a flight log", where=each)
        return cls(paths)

    def __repr__(self) -> str:
        """Say in one line how many logs there are, and which."""
        return f"FlightLog of {len(self.paths)} file(s): {self}" if self else "FlightLog without files"

    def tables(self, *topics: str) -> dict[str, Any]:
        """Give an Arrow table of each topic, all decoded ones without names; columns as of `read_log`."""
        pa = package("pyarrow")
        parts: dict[str, list[Any]] = {}
        repeats = Repeats()
        for path in self.paths:
            for topic, columns in arrays_of_log(path, frozenset(topics), repeats).items():
                arrays = {name: pa.array(values.tolist()) for name, values in columns.items()}
                parts.setdefault(topic, []).append(pa.table(arrays))
        return {topic: pa.concat_tables(some, promote_options="default") for topic, some in parts.items()}

    def to_pandas(self, *topics: str) -> dict[str, Any]:
        """Give the tables of `tables` as DataFrames; ProgramMissingError where pandas is not installed."""
        package("pandas")
        return {topic: table.to_pandas() for topic, table in self.tables(*topics).items()}

    def __bool__(self) -> bool:
        return bool(self.paths)

    def __str__(self) -> str:
        return ", ".join(map(str, self.paths))

    def raw(self, *wires: Wire, link: str | None = None) -> Iterator[tuple[Wire, LoggedMessages]]:
        """Give the frames of some protocols, of one link or of all, and the protocol of each."""
        by_encoding = {wire.encoding: wire for wire in wires}
        for messages in self._messages:
            channel = messages.channel
            wire = by_encoding.get(channel.encoding)
            if wire is not None and (link is None or channel.topic == f"/{link}/raw"):
                yield wire, messages

    def topic(self, name: str) -> Iterator[LoggedMessages]:
        """Give the decoded messages of a topic."""
        return (m for m in self._messages if m.channel.topic == name and m.channel.schema is not None)

    @cached_property
    def _messages(self) -> list[LoggedMessages]:
        first, every, repeats = 0, list[LoggedMessages](), Repeats()
        for path in self.paths:
            reader = LogReader(path, wanted=_is_wanted)
            for chunk in reader.chunks():
                new = repeats.without(reader, chunk)
                every += [replace(messages, sequence=messages.sequence + first) for messages in new]
            first = 1 + max((int(messages.sequence.max()) for messages in every), default=-1)
        return every


def _is_wanted(channel: Channel) -> bool:
    if channel.schema is None:
        encodings = {wire.encoding for wire in (Wire.MAVLINK, Wire.MRK, *receiver_wires())}
        return channel.encoding in encodings and channel.topic.endswith("/raw")
    return channel.topic == EXPOSURES or channel.topic.endswith(_DECODED)
