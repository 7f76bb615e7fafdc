"""The JSON message types of the flight log, and the channels that messages of one source become."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquire.channels.decoded import LAYOUTS, Decoded, JsonLayout, times
from acquire.log import foxglove
from acquire.log.chunk import Channel
from photocal.base.arrays import Columns, Floats, Integers

EXPOSURE, CLOCK, HEALTH, PARAMETER, GNSS_STATUS, STATION = (
    LAYOUTS[name] for name in ("Exposure", "Clock", "Health", "Parameter", "GnssStatus", "Station")
)


SEA_LEVEL = "above mean sea level, as the autopilot computes it"
ELLIPSOIDAL = "above the ellipsoid"


@dataclass(frozen=True)
class SourceMessages(Columns):
    """Messages of one kind from one source.

    link, source: the link and the name of the kind, as messages of ours carry them.
    index (n,): of each, the frame of the batch.
    utc_ns (n,): time of the device, of receipt where it has none.
    """

    link: str
    source: str
    index: Integers
    utc_ns: Integers

    def __len__(self) -> int:
        return len(self.index)

    @property
    def names(self) -> dict[str, Any]:
        """Members of a JSON message that tell its source."""
        return {"link": self.link, "source": self.source}

    def json(self, topic: str, layout: JsonLayout, columns: Mapping[str, Any]) -> Decoded:
        """Return messages of a JSON type."""
        payloads = layout.rows({**self.names, **columns}, len(self))
        return Decoded(Channel(topic, "json", layout.schema()), payloads, self.index, self.utc_ns)

    def location(
        self,
        topic: str,
        place: tuple[Floats, Floats, Floats],
        claimed_m: tuple[Floats, Floats] | None = None,
        height: str = SEA_LEVEL,
        frame: str = "body_frd",
    ) -> Decoded:
        """Return positions: latitude, longitude (deg), height (m), claimed accuracy in plane and height."""
        lat, lon, up = place
        there = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(up) & ((lat != 0) | (lon != 0))
        there &= (np.abs(lat) <= 90) & (np.abs(lon) <= 360)
        unknown = np.full(len(lat), np.nan)
        columns = (values[there] for values in (lat, lon, up, *(claimed_m or (unknown, unknown))))
        payloads = foxglove.location_fixes(f"{self.link}/{frame}", self.utc_ns[there], *columns)
        metadata = {"source": self.source, "height": height}
        channel = Channel(topic, "protobuf", foxglove.schema("foxglove.LocationFix"), metadata)
        return Decoded(channel, payloads, self.index[there], self.utc_ns[there])

    def attitude(self, quaternion_xyzw: Floats) -> Decoded:
        """Return rotations from body to north-east-down; those with a number missing are left out."""
        there = np.isfinite(quaternion_xyzw).all(axis=1)
        utc = self.utc_ns[there]
        payloads = foxglove.frame_transforms(
            f"{self.link}/local_ned", f"{self.link}/body_frd", utc, quaternion_xyzw[there]
        )
        metadata = {"source": self.source, "rotation": "body forward-right-down to north-east-down"}
        schema = foxglove.schema("foxglove.FrameTransform")
        channel = Channel(f"/{self.link}/attitude", "protobuf", schema, metadata)
        return Decoded(channel, payloads, self.index[there], utc)

    def status(self, receiver: str, columns: Mapping[str, Any]) -> Decoded:
        """Return the quality of the fixes of a receiver."""
        return self.json(
            f"/gnss/{self.link}{receiver}/status", GNSS_STATUS, {"time": times(self.utc_ns), **columns}
        )

    def exposure(self, edge: str, columns: Mapping[str, Any]) -> Decoded:
        """Return exposures; `columns` may have a better time than that of the messages."""
        return self.json("/camera/exposure", EXPOSURE, {"edge": edge, "time": times(self.utc_ns), **columns})

    def clock(self, columns: Mapping[str, Any]) -> Decoded:
        """Return readings of a clock of the device."""
        return self.json("/clock", CLOCK, columns)

    def health(self, columns: Mapping[str, Any]) -> Decoded:
        """Return texts and the state of battery, processor and links."""
        return self.json("/health", HEALTH, columns)
