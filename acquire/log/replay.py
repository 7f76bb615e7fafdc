"""Replay of the raw frames of a link, in their order and at their pace."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from acquire.log.chunk import DAMAGE_ENCODING
from acquire.log.reader import LoggedMessages, LogReader, link_of
from acquire.transports.sinks import Sink
from drivers.mavlink.dialect import V1, V2
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.files import output_file

_STARTS = (V1, V2)


def links_of(path: Path) -> list[str]:
    """Return the names of the links with raw frames in a log."""
    names: set[str] = set()
    for chunk in LogReader(path).chunks():
        names |= {link_of(part.channel) for part in chunk if _is_raw(part)}
    return sorted(names)


def choose_link(path: Path, link: str | None) -> str:
    """Return the link to be replayed.

    raises ConfigurationError: when it does not exist, or none was named and there are several.
    raises InputMalformedError: when the log has no raw frames.
    """
    names = links_of(path)
    if not names:
        raise InputMalformedError("holds no raw frames", "name a flight log", where=path)
    wrong = ConfigurationError.at(path)
    if link is None and len(names) > 1:
        raise wrong(f"has several links: {', '.join(names)}", "name one with --link")
    if link is not None and link not in names:
        raise wrong(f"has no link {link!r}, it has {', '.join(names)}", "name one of them")
    return link or names[0]


def replay(
    path: Path,
    link: str,
    sink: Sink,
    speed: float,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> dict[str, Any]:
    """Send the raw frames of a link in the order in which they were received.

    clock, sleep: seconds of a steady clock, and waiting for seconds.
    returns: `frames` and `bytes` that were sent, `recorded_s` of the recording, and `lost`, frames that no
        reader got; None where that is not known.
    raises InputNotFoundError, InputMalformedError: when the log cannot be read.
    raises DeviceError: when the reader goes away.
    """
    frames = size = 0
    first_ns = last_ns = None
    start = clock()
    for time_ns, frame in raw_frames(path, link):
        first_ns = time_ns if first_ns is None else first_ns
        last_ns = time_ns
        if speed > 0:
            ahead = (time_ns - first_ns) / 1e9 / speed - (clock() - start)
            if ahead > 0:
                sleep(ahead)
        sink.send(frame)
        frames += 1
        size += len(frame)
    recorded = 0.0 if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9
    return {"frames": frames, "bytes": size, "recorded_s": recorded, "lost": sink.lost}


def raw_frames(path: Path, link: str) -> Iterator[tuple[int, bytes]]:
    """Yield time of receipt (UTC ns) and bytes of the raw frames of a link, in the order of the stream."""
    for chunk in LogReader(path).chunks():
        parts = [p for p in chunk if _is_raw(p) and p.channel.topic == f"/{link}/raw"]
        if not parts:
            continue
        # Protocols that share a link lie on channels of their own; the numbers give the order of the stream.
        order = np.argsort(np.concatenate([p.sequence for p in parts]), kind="stable")
        payloads = [payload for p in parts for payload in p.payloads]
        times = np.concatenate([p.log_ns for p in parts])
        for row in order.tolist():
            yield int(times[row]), payloads[row]


def _is_raw(part: LoggedMessages) -> bool:
    channel = part.channel
    return channel.schema is None and channel.encoding != DAMAGE_ENCODING and channel.topic.endswith("/raw")


def export_tlog(path: Path, link: str, output: Path) -> int:
    """Write the frames of a link as a telemetry log: each after its time of receipt.

    raises InputMalformedError: when the link carries other frames than MAVLink.
    raises OutputError: when the output cannot be written.
    """
    count = 0
    with output_file(output) as aside, aside.open("wb") as stream:
        for time_ns, frame in raw_frames(path, link):
            if frame[0] not in _STARTS:
                raise InputMalformedError(
                    f"the link {link!r} has no MAVLink frames", "name the vehicle's with --link", where=path
                )
            # Whole microseconds, big-endian: what ground stations write.
            stream.write((time_ns // 1000).to_bytes(8, "big") + frame)
            count += 1
    return count
