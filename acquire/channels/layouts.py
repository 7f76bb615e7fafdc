"""The JSON message types of the flight log, and the channels that messages of one source become."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquire.channels.decoded import TIME, Decoded, JsonLayout, integer, number, times, words
from acquire.log import foxglove
from acquire.log.chunk import Channel
from photocal.base.arrays import Columns, Floats, Integers

_SOURCE = {
    "link": words("link that it came over"),
    "source": words("message that it was made from"),
    "system": integer("MAVLink system"),
    "component": integer("MAVLink component"),
}

EXPOSURE = JsonLayout(
    "photocal.Exposure",
    "A camera exposure or an edge on a time mark input. One message per edge: count the rising ones, "
    "or those that the camera makes, not the messages.",
    {
        **_SOURCE,
        "sequence": integer("number that the device gave it"),
        "edge": words("rising, falling or, where a camera reports itself, feedback or trigger"),
        "time": {**TIME, "description": "UTC of the event; null when the device did not know"},
        "gps_time": {**TIME, "description": "of an edge, GPS time since 1980-01-06; null as `time`"},
        "time_base": words("of an edge: gnss, utc or receiver, its own; null when its time is none"),
        "accuracy_ns": integer("accuracy reported by the device"),
        "latitude_deg": number("position reported by the device"),
        "longitude_deg": number("position reported by the device"),
        "altitude_msl_m": number("height above mean sea level reported by the device"),
        "roll_deg": number("attitude reported by the device"),
        "pitch_deg": number("attitude reported by the device"),
        "yaw_deg": number("attitude reported by the device"),
    },
)

CLOCK = JsonLayout(
    "photocal.Clock",
    "A device's clock at the moment of receipt.",
    {
        **_SOURCE,
        "device": {**TIME, "description": "UTC by the device"},
        "host_minus_device_s": number("clock of the host minus clock of the device"),
        "boot_s": number("time since the device started"),
        "gps_week": integer("GPS week"),
        "gps_seconds_of_week_s": number("GPS time of week"),
        "leap_s": integer("GPS time minus UTC, as the receiver reported it"),
        "round_trip_ns": integer("duration of a TIMESYNC exchange, host to device and back"),
    },
)

HEALTH = JsonLayout(
    "photocal.Health",
    "State of the vehicle, the radio and the receivers.",
    {
        **_SOURCE,
        "severity": integer("0 emergency to 7 debug"),
        "text": words("what the device said"),
        "voltage_v": number("battery"),
        "current_a": number("battery"),
        "battery_percent": integer("remaining; -1 unknown"),
        "load_percent": number("processor load"),
        "drop_rate_percent": number("dropped packets on the link, as the vehicle counts them"),
        "rssi": integer("signal here"),
        "remote_rssi": integer("signal at the vehicle"),
        "noise": integer("noise here"),
        "remote_noise": integer("noise at the vehicle"),
        "receive_errors": integer("radio packets lost"),
    },
)

PARAMETER = JsonLayout(
    "photocal.Parameter",
    "A parameter of the autopilot.",
    {**_SOURCE, "name": words("name"), "value": number("value, in the unit that the autopilot documents")},
)

GNSS_STATUS = JsonLayout(
    "photocal.GnssStatus",
    "Quality of a GNSS fix.",
    {
        **_SOURCE,
        "time": {**TIME, "description": "UTC of the fix"},
        "fix": words("none, dead_reckoning, 2d, 3d, differential, rtk_float, rtk_fixed, time_only"),
        "satellites": integer("number used"),
        "hdop": number("horizontal dilution of precision"),
        "horizontal_m": number("horizontal accuracy reported by the receiver"),
        "vertical_m": number("vertical accuracy reported by the receiver"),
        "correction_age_s": number("age of the corrections; NAV-PVT gives an upper limit, 120 for more"),
    },
)

STATION = JsonLayout(
    "photocal.Station",
    "Position of a base station, as it announces it.",
    {
        **_SOURCE,
        "station": integer("number of the station"),
        "x_m": number("earth-centred, earth-fixed"),
        "y_m": number("earth-centred, earth-fixed"),
        "z_m": number("earth-centred, earth-fixed"),
        "accuracy_m": number("accuracy of a survey-in"),
        "antenna_height_m": number("antenna above the mark"),
        "survey_valid": {"type": "boolean", "description": "whether the survey-in has ended"},
    },
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
