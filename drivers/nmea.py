"""NMEA 0183: framing and the sentences GGA, RMC and ZDA."""

from collections.abc import Mapping

import numpy as np

from drivers.frames import Batch, Wire
from drivers.receiver import Fixes, ReceiverProtocol
from photocal.base.arrays import Integers
from photocal.base.time_scales import SECOND_NS, utc_date_ns

_GGA_FIXES = {1: "3d", 2: "differential", 3: "3d", 4: "rtk_fixed", 5: "rtk_float", 6: "dead_reckoning"}


def kind_of(address: bytes) -> int:
    """Return the kind of a sentence: the letters of its formatter as a big-endian number.

    address: what follows the dollar sign. Of standard sentences the two letters of the talker are left out,
        of private ones ("P...") everything up to the first comma counts.
    """
    name = address.split(b",")[0].split(b"*")[0]
    return int.from_bytes(name if name.startswith(b"P") else name[2:], "big")


def kind_name(kind: int) -> str:
    """Return the letters of a kind, see `kind_of`."""
    return kind.to_bytes(8, "big").lstrip(b"\0").decode("ascii", "replace")


def gga(
    time_utc_ns: int,
    latitude_deg: float,
    longitude_deg: float,
    height_msl_m: float,
    quality: int,
    satellites: int,
    dilution: float,
) -> bytes:
    """Return the GGA sentence of a position, without the undulation of the geoid.

    time_utc_ns: UTC, nanoseconds since 1970.
    """
    second, hundredths = divmod(time_utc_ns // 10_000_000 % 8_640_000, 100)
    time = f"{second // 3600:02d}{second // 60 % 60:02d}{second % 60:02d}.{hundredths:02d}"

    def angle(value: float, degrees: int, sides: str) -> str:
        """Write an angle (deg) as degrees and minutes, with the letter of its side."""
        whole, minutes = divmod(round(abs(value) * 60 * 10**7), 60 * 10**7)
        return f"{whole:0{degrees}d}{minutes / 10**7:010.7f},{sides[value < 0]}"

    place = f"{angle(latitude_deg, 2, 'NS')},{angle(longitude_deg, 3, 'EW')}"
    seen = f"{min(satellites, 99):02d},{min(dilution, 99.9):.1f}"
    return encode(f"GPGGA,{time},{place},{quality},{seen},{height_msl_m:.3f},M,,M,,")


def encode(text: str) -> bytes:
    """Return the sentence of a text such as ``GPGGA,...``, with its checksum."""
    body = text.encode("ascii")
    check = 0
    for value in body:
        check ^= value
    return b"$" + body + b"*%02X\r\n" % check


def decode_gga(batch: Batch) -> Fixes:
    """Decode the positions of the GGA sentences of a batch.

    Heights are ellipsoidal: that of the antenna above the geoid plus the geoid separation, `geoid_m`.
    """
    index, rows = _gga(batch)
    geoid_m = np.array([_number(f[11]) for f in rows], float)
    quality = [_whole(f[6]) for f in rows]
    return Fixes.of(
        index,
        latitude_deg=np.array([_angle_deg(f[2], f[3], 2, "S") for f in rows], float),
        longitude_deg=np.array([_angle_deg(f[4], f[5], 3, "W") for f in rows], float),
        height_m=np.array([_number(f[9]) for f in rows], float) + geoid_m,
        hdop=np.array([_number(f[8]) for f in rows], float),
        age_s=np.array([_number(f[13]) for f in rows], float),
        satellites=np.array([_whole(f[7]) for f in rows], np.int64),
        valid=np.array(quality, np.int64) > 0,
        fix=[_GGA_FIXES.get(value, "none") for value in quality],
        geoid_m=geoid_m,
    )


def decode_gga_times(batch: Batch) -> tuple[Integers, Integers]:
    """Decode the times of the GGA sentences of a batch.

    returns time_of_day_ns (n,): UTC since midnight; -1 where it is missing.
    """
    index, rows = _gga(batch)
    return index, np.array([_time_of_day_ns(f[1]) for f in rows], np.int64)


def _gga(batch: Batch) -> tuple[Integers, list[list[str]]]:
    index = batch.where(Wire.NMEA, int.from_bytes(b"GGA", "big"))
    return index, [_fields(batch, i, 15) for i in index.tolist()]


def decode_times(batch: Batch) -> tuple[Integers, Integers]:
    """Decode date and time of the valid RMC and of the ZDA sentences of a batch.

    returns utc_ns (n,): UTC, nanoseconds since 1970.
    """
    moments: list[tuple[int, int]] = []
    for i in batch.where(Wire.NMEA, int.from_bytes(b"RMC", "big")).tolist():
        f = _fields(batch, i, 10)
        if f[2] == "A" and len(f[9]) == 6 and f[9].isdigit():
            moments.append((i, _moment(f[1], 2000 + int(f[9][4:]), int(f[9][2:4]), int(f[9][:2]))))
    for i in batch.where(Wire.NMEA, int.from_bytes(b"ZDA", "big")).tolist():
        f = _fields(batch, i, 5)
        if f[2].isdigit() and f[3].isdigit() and f[4].isdigit():
            moments.append((i, _moment(f[1], int(f[4]), int(f[3]), int(f[2]))))
    pairs = np.array(sorted(p for p in moments if p[1] >= 0), np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _fields(batch: Batch, index: int, count: int) -> list[str]:
    start = int(batch.start[index])
    text = batch.data[start + 1 : start + int(batch.length[index]) - 5].decode("ascii")
    fields = text.split(",")
    return fields + [""] * (count - len(fields))


def _moment(time: str, year: int, month: int, day: int) -> int:
    since_midnight = _time_of_day_ns(time)
    if since_midnight < 0 or not (1 <= month <= 12 and 1 <= day <= 31 and 1980 <= year < 2200):
        return -1
    return int(utc_date_ns(year, month, day)) + since_midnight


def _time_of_day_ns(text: str) -> int:
    whole, _, fraction = text.partition(".")
    if len(whole) != 6 or not whole.isdigit() or not (fraction == "" or fraction.isdigit()):
        return -1
    seconds = int(whole[:2]) * 3600 + int(whole[2:4]) * 60 + int(whole[4:])
    return seconds * SECOND_NS + int(fraction.ljust(9, "0")[:9])


def _angle_deg(text: str, side: str, degrees: int, negative: str) -> float:
    try:
        value = int(text[:degrees]) + float(text[degrees:]) / 60
    except ValueError:
        return float("nan")
    return -value if side == negative else value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _whole(text: str) -> int:
    return int(text) if text.isdigit() else 0


class NmeaProtocol(ReceiverProtocol):
    """Sentences of nearly every receiver."""

    wire, name = Wire.NMEA, "NMEA"

    def kinds(self, data: bytes, start: Integers, length: Integers) -> Integers:
        """Return the formatter of each sentence."""
        ends = start + np.minimum(length, 9)
        addresses = zip((start + 1).tolist(), ends.tolist(), strict=True)
        return np.array([kind_of(data[at:end]) for at, end in addresses], np.int64)

    def kind_name(self, kind: int) -> str:
        """Return the letters of the formatter."""
        return kind_name(kind)

    def fixes(self, batch: Batch) -> Mapping[str, Fixes]:
        """Return the positions of GGA."""
        return {"GGA": decode_gga(batch)}

    def told_status(self) -> tuple[str, ...]:
        """Return the one sentence, which tells all."""
        return ("GGA",)

    def utc(self, batch: Batch) -> Mapping[str, tuple[Integers, Integers]]:
        """Return the times of RMC and ZDA."""
        return {"RMC/ZDA": decode_times(batch)}


PROTOCOL = NmeaProtocol()
