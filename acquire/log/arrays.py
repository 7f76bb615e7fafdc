"""A flight log as arrays: one for each field of each topic."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.log.reader import LogReader
from acquire.log.records import Channel, Schema

Decode = Callable[[bytes], dict[str, Any]]


def arrays_of_log(path: Path, topics: frozenset[str]) -> dict[str, dict[str, NDArray[Any]]]:
    """Read topics in one pass; without any all that are decoded."""
    rows: dict[str, list[dict[str, Any]]] = {}
    decoders: dict[Channel, Decode] = {}
    for chunk in LogReader(path).chunks():
        for messages in chunk:
            channel = messages.channel
            if channel.topic not in topics if topics else channel.schema is None:
                continue
            decode = decoders.setdefault(channel, _decoder(channel))
            rows_of_topic = rows.setdefault(channel.topic, [])
            times = zip(messages.log_ns.tolist(), messages.publish_ns.tolist(), strict=True)
            for (log_ns, publish_ns), payload in zip(times, messages.payloads, strict=True):
                rows_of_topic.append({"log_ns": log_ns, "publish_ns": publish_ns, **decode(bytes(payload))})
    return {topic: _columns(rows_of_topic) for topic, rows_of_topic in sorted(rows.items())}


def _decoder(channel: Channel) -> Decode:
    if channel.schema is None:
        return lambda payload: {"payload": payload}
    if channel.encoding == "json":
        return lambda payload: _flat(json.loads(payload))
    return _protobuf(channel.schema)


def _protobuf(schema: Schema) -> Decode:
    from google.protobuf import descriptor_pool, json_format, message_factory
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))

    def decode(payload: bytes) -> dict[str, Any]:
        """Turn a message into a flat mapping of its fields."""
        message = kind.FromString(payload)
        return _flat(json_format.MessageToDict(message, preserving_proto_field_name=True))

    return decode


def _flat(content: dict[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[before + key] = value
    return flat


def _columns(rows: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Columns of messages; what a message leaves out is NaN, an empty text, or None among lists."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    known = [value for value in values if value is not None]
    if all(isinstance(value, str) for value in known):
        return np.array(["" if value is None else value for value in values])
    if all(isinstance(value, int | float) for value in known):
        whole = len(known) == len(values) and all(isinstance(value, int) for value in known)
        return np.array(values if whole else [np.nan if value is None else float(value) for value in values])
    numbers = all(isinstance(v, list) and all(isinstance(x, int | float) for x in v) for v in values)
    if numbers and len({len(value) for value in values}) == 1:
        return np.array(values, dtype=float)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
