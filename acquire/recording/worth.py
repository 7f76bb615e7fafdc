"""What of a recording is kept longest while no disk takes anything and the memory fills."""

from acquire.log.records import ARRIVED_ENCODING, DAMAGE_ENCODING, Channel

# Words of what may be left out, and the share of the memory up to which it is kept: the least of worth first.
DECODED = "decoded messages (they can be made again from the raw ones)"
VEHICLE = "raw frames of vehicles and sentences, alarms and damage"
RECEIVER = "raw frames of GNSS receivers and corrections"
CAMERA = "camera events"
SHARE = {DECODED: 0.5, VEHICLE: 0.75, RECEIVER: 0.95, CAMERA: 1.0}
_OF_LITTLE_WORTH = ("mavlink", "nmea", DAMAGE_ENCODING, ARRIVED_ENCODING)


def worth(channel: Channel) -> str:
    """Return as what a channel counts, one of `SHARE`.

    Camera events come once, and what a receiver has measured cannot be made again; an autopilot keeps a log
    of its own.
    """
    if channel.topic.startswith("/camera/"):
        return CAMERA
    if channel.topic == "/alarm":
        return VEHICLE
    if channel.schema is not None:
        return DECODED
    return VEHICLE if channel.encoding in _OF_LITTLE_WORTH else RECEIVER
