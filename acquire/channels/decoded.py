"""Decoded messages on their way to the log, and rows of JSON."""

import json
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.log.chunk import Channel, Schema
from drivers.frames import Batch
from photocal.base.arrays import Integers
from photocal.base.time_scales import SECOND_NS


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


# Makes decoded messages from the frames of one link, batch after batch: takes a batch and times of receipt,
# gives the device's time of each frame (UTC ns; of receipt where unknown) and the messages. The result does
# not depend on how the frames were cut into batches.
Decoder = Callable[[Batch, Integers], tuple[Integers, list[Decoded]]]


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


_TIME = {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}


def _members(said: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Members of a JSON type by what is said of them, each behind its own type."""
    members: dict[str, dict[str, Any]] = {}
    for name, text in said.items():
        kind, _, description = text.partition(": ")
        members[name] = {"type": kind, "description": description}
        if kind == "time":
            members[name] |= {"type": "object", "properties": _TIME}
    return members


def tables(file: str) -> dict[str, dict[str, Any]]:
    """Read the tables of a file (TOML) of this package."""
    return tomllib.loads(resources.files(__package__).joinpath(file).read_text(encoding="utf-8"))


def _layouts() -> dict[str, JsonLayout]:
    messages = tables("layouts.toml")
    source = messages.pop("source")
    return {
        name: JsonLayout(
            f"photocal.{name}",
            table["about"],
            _members((source if table["of_device"] else {}) | table["members"]),
        )
        for name, table in messages.items()
    }


# The JSON message types of the flight log.
LAYOUTS = _layouts()


def times(time_ns: Integers) -> NDArray[np.datetime64]:
    """Return nanoseconds as a column of times; rows show seconds and nanoseconds, null below zero."""
    return time_ns.astype("datetime64[ns]")


def _time(time_ns: int) -> str:
    return f'{{"sec":{time_ns // SECOND_NS},"nsec":{time_ns % SECOND_NS}}}' if time_ns >= 0 else "null"


# How a value of each kind of array is written; all others as `json.dumps` does.
_WRITTEN: dict[str, Callable[[Any], str]] = {
    "b": lambda value: "true" if value else "false",
    "i": str,
    "u": str,
    "S": lambda value: json.dumps(value.decode("utf-8", "replace")),
    # Of nanoseconds a list holds whole numbers.
    "M": _time,
}


def _texts(column: Any, count: int) -> list[str]:
    if isinstance(column, str):
        return [json.dumps(column)] * count
    if not isinstance(column, np.ndarray):
        return list(map(json.dumps, column))
    if column.dtype.kind == "f":
        # Nine digits carry a single precision number exactly; repr is the shortest text of a double.
        text = "{:.9g}".format if column.dtype.itemsize == 4 else repr
        return [text(v) if v - v == 0 else "null" for v in column.tolist()]
    return list(map(_WRITTEN.get(column.dtype.kind, json.dumps), column.tolist()))
