"""Corrections of a base on their way to rovers and vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field

from acquire.recording.vehicle_dialogue import VehicleDialogue
from drivers.frames import Batch, Wire
from drivers.mavlink.corrections import FRAGMENT_BYTES, FRAGMENTS, fragments


def rtcm_frames(batch: Batch) -> list[tuple[int, bytes]]:
    """Return number and bytes of the intact RTCM 3 frames of a batch."""
    frames = [batch.frame(row) for row in (batch.wire == Wire.RTCM3).nonzero()[0].tolist()]
    return [(frame.kind, frame.data) for frame in frames]


@dataclass
class VehicleCorrections:
    """Cuts corrections for a vehicle; what does not fit is told once per message number."""

    dialogue: VehicleDialogue
    _sequence: int = 0
    _too_long: set[int] = field(default_factory=set)

    def carry(self, kind: int, frame: bytes) -> tuple[list[bytes], str]:
        """Return the frames for the vehicle, and words when the message cannot be carried."""
        pieces = fragments(frame, self._sequence)
        if not pieces:
            if kind in self._too_long:
                return [], ""
            self._too_long.add(kind)
            limit = FRAGMENT_BYTES * FRAGMENTS
            return [], f"does not get RTCM {kind}: {len(frame)} bytes, at most {limit} can be carried"
        self._sequence += 1
        return [self.dialogue.frame("GPS_RTCM_DATA", piece) for piece in pieces], ""
