"""What each MAVLink message becomes in the flight log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import JsonLayout, NewMessages, Times
from acquire.channels.layouts import CLOCK, EXPOSURE, GNSS_STATUS, HEALTH, PARAMETER
from acquire.log import foxglove
from acquire.log.records import Channel
from drivers.arrays import Floats, Integers

SEA_LEVEL = "above mean sea level, as the autopilot computes it"
# MAV_PARAM_TYPE: what is before are whole numbers.
_FIRST_REAL_TYPE = 9
FIX_NAMES = ("none", "none", "2d", "3d", "differential", "rtk_float", "rtk_fixed", "3d", "3d")


@dataclass(frozen=True)
class Sent:
    """Messages of one kind from one source.

    link, name: the link and the name of the message.
    source: system and component.
    fields (n,): the fields, see `drivers.mavlink.decode.Messages`.
    log_ns, publish_ns (n,): time of receipt and of the device, UTC.
    """

    link: str
    name: str
    source: tuple[int, int]
    fields: NDArray[Any]
    log_ns: Integers
    publish_ns: Integers

    def json(
        self, topic: str, layout: JsonLayout, columns: Mapping[str, Any], *, common: bool = True
    ) -> NewMessages:
        """Return messages of a JSON type, with the members that tell their source."""
        count = len(self.fields)
        source: dict[str, Any] = {
            "link": self.link,
            "source": self.name,
            "system": np.full(count, self.source[0]),
            "component": np.full(count, self.source[1]),
        }
        payloads = layout.rows({**source, **columns}, count)
        return NewMessages(Channel(topic, "json", layout.schema()), payloads, np.arange(count), common)


def position(sent: Sent) -> NewMessages:
    """Make positions of the autopilot's own filter."""
    f = sent.fields
    rows = np.flatnonzero((f["lat"] != 0) | (f["lon"] != 0))
    unknown = np.full(len(rows), np.nan)
    return _location(sent, f"/{sent.link}/position", rows, unknown, unknown)


def attitude(sent: Sent) -> NewMessages:
    """Make the rotation from body to north-east-down."""
    angles = (sent.fields[name].astype(float) for name in ("roll", "pitch", "yaw"))
    payloads = foxglove.frame_transforms(
        f"{sent.link}/local_ned",
        f"{sent.link}/body_frd",
        sent.publish_ns,
        foxglove.quaternion_from_euler(*angles),
    )
    channel = Channel(
        f"/{sent.link}/attitude",
        "protobuf",
        foxglove.schema("foxglove.FrameTransform"),
        {"source": sent.name, "rotation": "body forward-right-down to north-east-down"},
    )
    return NewMessages(channel, payloads, np.arange(len(payloads)))


def gnss_fix(receiver: str) -> Callable[[Sent], NewMessages]:
    """Return what makes the positions of a receiver of the vehicle, first (``""``) or further (``"-2"``)."""

    def make(sent: Sent) -> NewMessages:
        f = sent.fields
        rows = np.flatnonzero((f["fix_type"] >= 2) & ((f["lat"] != 0) | (f["lon"] != 0)))
        horizontal, vertical = (_claimed(f, name)[rows] for name in ("h_acc", "v_acc"))
        return _location(sent, f"/gnss/{sent.link}{receiver}/fix", rows, horizontal, vertical)

    return make


def gnss_status(receiver: str) -> Callable[[Sent], NewMessages]:
    """Return what makes the quality of the fixes of a receiver of the vehicle, see `gnss_fix`."""

    def make(sent: Sent) -> NewMessages:
        f = sent.fields
        columns: dict[str, Any] = {
            "time": Times(sent.publish_ns),
            "fix": [FIX_NAMES[min(v, len(FIX_NAMES) - 1)] for v in f["fix_type"].tolist()],
            "satellites": np.where(f["satellites_visible"] == 255, -1, f["satellites_visible"].astype(int)),
            "hdop": np.where(f["eph"] == 65535, np.nan, f["eph"] * 0.01),
            "horizontal_m": _claimed(f, "h_acc"),
            "vertical_m": _claimed(f, "v_acc"),
        }
        if "dgps_age" in (f.dtype.names or ()):
            columns["correction_age_s"] = np.where(f["dgps_age"] > 0, f["dgps_age"] * 1e-3, np.nan)
        return sent.json(f"/gnss/{sent.link}{receiver}/status", GNSS_STATUS, columns, common=False)

    return make


def camera_feedback(sent: Sent) -> NewMessages:
    """Make the exposures that the camera's hot shoe or the autopilot's own count reported."""
    f = sent.fields
    return sent.json(
        "/camera/exposure",
        EXPOSURE,
        {
            "sequence": f["img_idx"],
            "edge": "feedback",
            "time": Times(sent.publish_ns),
            "latitude_deg": f["lat"] * 1e-7,
            "longitude_deg": f["lng"] * 1e-7,
            "altitude_msl_m": f["alt_msl"],
            "roll_deg": f["roll"],
            "pitch_deg": f["pitch"],
            "yaw_deg": f["yaw"],
        },
    )


def camera_trigger(sent: Sent) -> NewMessages:
    """Make the moments at which the autopilot triggered the camera."""
    columns = {"sequence": sent.fields["seq"], "edge": "trigger", "time": Times(sent.publish_ns)}
    return sent.json("/camera/exposure", EXPOSURE, columns)


def camera_captured(sent: Sent) -> NewMessages:
    """Make the exposures that a MAVLink camera reported."""
    f = sent.fields
    utc = f["time_utc"].astype(np.int64)
    return sent.json(
        "/camera/exposure",
        EXPOSURE,
        {
            "sequence": f["image_index"],
            "edge": "feedback",
            "time": Times(np.where(utc > 0, utc * 1000, sent.publish_ns)),
            "latitude_deg": f["lat"] * 1e-7,
            "longitude_deg": f["lon"] * 1e-7,
            "altitude_msl_m": f["alt"] * 1e-3,
        },
    )


def system_time(sent: Sent) -> NewMessages:
    """Make the readings of the autopilot's clock."""
    device = sent.fields["time_unix_usec"].astype(np.int64) * 1000
    known = device > 0
    return sent.json(
        "/clock",
        CLOCK,
        {
            "device": Times(np.where(known, device, -1)),
            "host_minus_device_s": np.where(known, (sent.log_ns - device) / 1e9, np.nan),
            "boot_s": sent.fields["time_boot_ms"] * 1e-3,
        },
    )


def timesync(sent: Sent) -> NewMessages:
    """Make the duration of the comparisons of clocks that we began ourselves: they carry our own UTC."""
    round_trip = sent.log_ns - sent.fields["ts1"]
    answered = (sent.fields["tc1"] > 0) & (round_trip >= 0) & (round_trip < 10_000_000_000)
    rows = np.flatnonzero(answered)
    own = replace(sent, fields=sent.fields[rows], log_ns=sent.log_ns[rows], publish_ns=sent.publish_ns[rows])
    columns = {"boot_s": own.fields["tc1"] / 1e9, "round_trip_ns": round_trip[rows]}
    return replace(own.json("/clock", CLOCK, columns), rows=rows)


def sys_status(sent: Sent) -> NewMessages:
    """Make the state of battery, processor and link that the autopilot reports."""
    f = sent.fields
    return sent.json(
        "/health",
        HEALTH,
        {
            "voltage_v": np.where(f["voltage_battery"] == 65535, np.nan, f["voltage_battery"] * 1e-3),
            "current_a": np.where(f["current_battery"] == -1, np.nan, f["current_battery"] * 1e-2),
            "battery_percent": f["battery_remaining"],
            "load_percent": f["load"] * 0.1,
            "drop_rate_percent": f["drop_rate_comm"] * 0.01,
        },
    )


def radio_status(sent: Sent) -> NewMessages:
    """Make the state of the telemetry radio."""
    f = sent.fields
    return sent.json(
        "/health",
        HEALTH,
        {
            "rssi": f["rssi"],
            "remote_rssi": f["remrssi"],
            "noise": f["noise"],
            "remote_noise": f["remnoise"],
            "receive_errors": f["rxerrors"],
        },
    )


def status_text(sent: Sent) -> NewMessages:
    """Make the texts that the autopilot shows to the pilot."""
    return sent.json("/health", HEALTH, {"severity": sent.fields["severity"], "text": sent.fields["text"]})


def parameter(sent: Sent) -> NewMessages:
    """Make the autopilot's parameters."""
    told = sent.fields["param_value"]
    whole = sent.fields["param_type"] < _FIRST_REAL_TYPE
    # ArduPilot sends whole numbers as such, PX4 their bytes, which as a real number are next to nothing.
    with np.errstate(invalid="ignore"):
        bytewise = whole & (told != 0) & ~(np.abs(told) >= 1)
    value = np.where(bytewise, told.view("<i4").astype(float), told.astype(float))
    columns = {"name": sent.fields["param_id"], "value": value}
    return sent.json(f"/{sent.link}/parameter", PARAMETER, columns, common=False)


MAKERS: dict[str, tuple[Callable[[Sent], NewMessages], ...]] = {
    "GPS_RAW_INT": (gnss_fix(""), gnss_status("")),
    "GPS2_RAW": (gnss_fix("-2"), gnss_status("-2")),
    "GLOBAL_POSITION_INT": (position,),
    "ATTITUDE": (attitude,),
    "CAMERA_FEEDBACK": (camera_feedback,),
    "CAMERA_TRIGGER": (camera_trigger,),
    "CAMERA_IMAGE_CAPTURED": (camera_captured,),
    "SYSTEM_TIME": (system_time,),
    "TIMESYNC": (timesync,),
    "SYS_STATUS": (sys_status,),
    "RADIO_STATUS": (radio_status,),
    "STATUSTEXT": (status_text,),
    "PARAM_VALUE": (parameter,),
}


def _location(
    sent: Sent,
    topic: str,
    rows: Integers,
    horizontal_m: Floats,
    vertical_m: Floats,
) -> NewMessages:
    f = sent.fields[rows]
    payloads = foxglove.location_fixes(
        f"{sent.link}/body_frd",
        sent.publish_ns[rows],
        f["lat"] * 1e-7,
        f["lon"] * 1e-7,
        f["alt"] * 1e-3,
        horizontal_m,
        vertical_m,
    )
    metadata = {"source": sent.name, "height": SEA_LEVEL}
    channel = Channel(topic, "protobuf", foxglove.schema("foxglove.LocationFix"), metadata)
    return NewMessages(channel, payloads, rows)


def _claimed(fields: NDArray[Any], name: str) -> Floats:
    """Return an accuracy in metres; zero is what devices send that do not know it."""
    value = fields[name].astype(float) * 1e-3
    return np.where(value > 0, value, np.nan)
