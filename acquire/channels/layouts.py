"""The JSON message types of the flight log."""

from __future__ import annotations

from acquire.channels.decoded import TIME, JsonLayout, integer, number, words

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
        "accuracy_ns": integer("accuracy that the device claims"),
        "latitude_deg": number("position that the device claims"),
        "longitude_deg": number("position that the device claims"),
        "altitude_msl_m": number("height above mean sea level that the device claims"),
        "roll_deg": number("attitude that the device claims"),
        "pitch_deg": number("attitude that the device claims"),
        "yaw_deg": number("attitude that the device claims"),
    },
)

CLOCK = JsonLayout(
    "photocal.Clock",
    "A device's clock at the moment of receipt.",
    {
        **_SOURCE,
        "device": {**TIME, "description": "UTC by the device"},
        "host_minus_device_s": number("clock of the host less clock of the device"),
        "boot_s": number("time since the device started"),
        "gps_week": integer("GPS week"),
        "gps_seconds_of_week_s": number("GPS time of week"),
        "leap_s": integer("GPS time less UTC, as the receiver told it"),
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
        "horizontal_m": number("horizontal accuracy that the receiver claims"),
        "vertical_m": number("vertical accuracy that the receiver claims"),
        "correction_age_s": number("age of the corrections; of NAV-PVT at most so old, 120 for more"),
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
