"""Decoded messages on their way to the log, and rows of JSON."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from acquire.log.records import Channel, Schema
from drivers.arrays import Integers
from drivers.frames import Batch

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Decoded:
    """Messages of one channel.

    payloads (n,): the encoded messages.
    index (n,): the frame of the batch that each was made from.
    publish_ns (n,): time of the device, UTC, nanoseconds since 1970; time of receipt where the device has
        none.
    """

    channel: Channel
    payloads: list[bytes]
    index: Integers
    publish_ns: Integers


def in_order(parts: Iterable[Decoded]) -> list[Decoded]:
    """Put the messages of each channel in the order of their frames, so that batches leave no trace."""
    by_channel: dict[Channel, list[Decoded]] = {}
    for part in parts:
        if part.payloads:
            by_channel.setdefault(part.channel, []).append(part)
    return [group[0] if len(group) == 1 else _merged(channel, group) for channel, group in by_channel.items()]


def _merged(channel: Channel, parts: list[Decoded]) -> Decoded:
    index = np.concatenate([part.index for part in parts])
    order = np.argsort(index, kind="stable")
    payloads = [payload for part in parts for payload in part.payloads]
    publish = np.concatenate([part.publish_ns for part in parts])
    return Decoded(channel, [payloads[i] for i in order.tolist()], index[order], publish[order])


class Decoder(Protocol):
    """Makes decoded messages from the frames of one link, batch after batch.

    The result does not depend on how the frames were cut into batches.
    """

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the device's time of each frame (UTC ns; of receipt where unknown) and the messages."""
        ...


@dataclass(frozen=True)
class JsonLayout:
    """A JSON message type: its name, what it says and its members with their JSON types."""

    name: str
    description: str
    members: Mapping[str, Mapping[str, Any]]

    def schema(self) -> Schema:
        """Return the JSON Schema of the type."""
        definition = {
            "title": self.name,
            "description": self.description,
            "type": "object",
            "properties": self.members,
        }
        return Schema(self.name, "jsonschema", json.dumps(definition).encode())

    def rows(self, columns: Mapping[str, Sequence[Any] | NDArray[Any] | str], count: int) -> list[bytes]:
        """Return `count` messages; a member without a column is left out, NaN becomes null."""
        names = [name for name in self.members if name in columns]
        template = "{" + ",".join(f'"{name}":%s' for name in names) + "}"
        texts = [_texts(columns[name], count) for name in names]
        return [(template % row).encode() for row in zip(*texts, strict=True)]


TIME: dict[str, Any] = {
    "type": "object",
    "description": "UTC",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}


def number(description: str) -> dict[str, str]:
    """Return the type of a member that holds a number."""
    return {"type": "number", "description": description}


def integer(description: str) -> dict[str, str]:
    """Return the type of a member that holds a whole number."""
    return {"type": "integer", "description": description}


def words(description: str) -> dict[str, str]:
    """Return the type of a member that holds a text."""
    return {"type": "string", "description": description}


class Times:
    """A column of times, UTC nanoseconds since 1970, that a row shows as seconds and nanoseconds."""

    def __init__(self, time_ns: Integers) -> None:
        self.time_ns = time_ns

    def texts(self) -> list[str]:
        """Return the JSON of each; negative times are null."""
        return [
            f'{{"sec":{t // SECOND_NS},"nsec":{t % SECOND_NS}}}' if t >= 0 else "null"
            for t in self.time_ns.tolist()
        ]


def _texts(column: Any, count: int) -> list[str]:
    if isinstance(column, str):
        return [json.dumps(column)] * count
    if isinstance(column, Times):
        return column.texts()
    if isinstance(column, np.ndarray):
        if column.dtype.kind == "f":
            # Nine digits carry a single precision number exactly; repr is the shortest text of a double.
            text = "{:.9g}".format if column.dtype.itemsize == 4 else repr
            return [text(v) if v - v == 0 else "null" for v in column.tolist()]
        if column.dtype.kind == "b":
            return ["true" if v else "false" for v in column.tolist()]
        if column.dtype.kind in "ui":
            return [str(v) for v in column.tolist()]
        if column.dtype.kind == "S":
            return [json.dumps(v.decode("utf-8", "replace")) for v in column.tolist()]
        return [json.dumps(v) for v in column.tolist()]
    return [json.dumps(v) for v in column]
