"""Telemetry logs (`.tlog`) of the MAVLink link of a flight log, for the programs of others."""

from __future__ import annotations

from pathlib import Path

from acquire.log.replay import raw_frames
from acquire.outputs import output_file
from drivers.errors import InputMalformedError
from drivers.mavlink.dialect import V1, V2

_STARTS = (V1, V2)


def export_tlog(path: Path, link: str, output: Path) -> int:
    """Write the frames of a link as a telemetry log: each after its time of receipt.

    Raises
    ------
    InputMalformedError
        When the link carries other frames than MAVLink.
    OutputError
        When the output cannot be written.
    """
    count = 0
    with output_file(output) as aside, aside.open("wb") as stream:
        for time_ns, frame in raw_frames(path, link):
            if frame[0] not in _STARTS:
                raise InputMalformedError(
                    f"the link {link!r} carries no MAVLink",
                    where=path,
                    remedy="name the vehicle's with --link",
                )
            # Whole microseconds, big-endian: what ground stations write.
            stream.write((time_ns // 1000).to_bytes(8, "big") + frame)
            count += 1
    return count
