"""The position that a caster of virtual reference stations wants to know, as GGA sentences."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquire.recording.configuration import RecordingConfiguration
from drivers import nmea
from drivers.frames import Batch, Wire
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import Dialect
from drivers.ubx.decode import NAV_PVT
from drivers.ubx.decode import decode as decode_ubx

_GGA = nmea.kind_of(b"GPGGA")
# Quality of GGA by the kind of fix of GPS_RAW_INT.
_QUALITY = {2: 1, 3: 1, 4: 2, 5: 5, 6: 4}
# Casters refuse a sentence without satellites: of a position that a person gave these are said.
_QUALITY_GIVEN, _SATELLITES_GIVEN, _DILUTION_GIVEN = 1, 10, 1.0

# The sentence that is to be sent at a moment, UTC ns.
Sentence = Callable[[int], bytes]


@dataclass
class CasterPosition:
    """Keeps the last position of a link, or the one that was given, and tells when to send it to a caster.

    dialect: the known MAVLink messages.
    every_s: time between sentences, seconds.
    given: latitude and longitude, degrees, and height above mean sea level, m: until a device knows better.
    """

    dialect: Dialect
    every_s: float
    given: tuple[float, float, float] | None = None
    _heard: Sentence | None = None
    _due_s: float = float("-inf")

    def hear(self, batch: Batch) -> None:
        """Take over the last position of a batch: a GGA sentence as it is, NAV-PVT or GPS_RAW_INT as one."""
        self._heard = (
            self._of_nmea(batch) or self._of_receiver(batch) or self._of_vehicle(batch) or self._heard
        )

    def sentence(self, clock_ns: int) -> bytes:
        """Return the sentence of now; empty while no position is known."""
        if self._heard is not None:
            return self._heard(clock_ns)
        if self.given is None:
            return b""
        return nmea.gga(clock_ns, *self.given, _QUALITY_GIVEN, _SATELLITES_GIVEN, _DILUTION_GIVEN)

    def now(self, clock_ns: Callable[[], int]) -> Callable[[], bytes]:
        """Return what gives the sentence of each moment by a clock."""
        return lambda: self.sentence(clock_ns())

    def due(self, steady_s: float, clock_ns: int) -> tuple[bytes, ...]:
        """Return the sentence when it is time for one and a position is known."""
        sentence = self.sentence(clock_ns) if steady_s >= self._due_s else b""
        if not sentence:
            return ()
        self._due_s = steady_s + self.every_s
        return (sentence,)

    @staticmethod
    def _of_nmea(batch: Batch) -> Sentence | None:
        sentences = batch.where(Wire.NMEA, _GGA)
        if not len(sentences):
            return None
        frame = batch.frame(int(sentences[-1])).data
        has_fix = frame.split(b",")[6:7] not in ([], [b""], [b"0"])
        return (lambda _: frame) if has_fix else None

    @staticmethod
    def _of_receiver(batch: Batch) -> Sentence | None:
        fields = decode_ubx(batch, NAV_PVT).fields
        good = np.flatnonzero((fields["flags"] & 1) & np.isin(fields["fixType"], (2, 3, 4)))
        if not len(good):
            return None
        f = fields[good[-1]]
        place = float(f["lat"]) * 1e-7, float(f["lon"]) * 1e-7, float(f["hMSL"]) * 1e-3
        quality = (1, 5, 4, 1)[int(f["flags"]) >> 6]
        # The dilution of NAV-PVT is that of the position: never less than the horizontal one.
        seen = int(f["numSV"]), float(f["pDOP"]) * 0.01
        return lambda clock_ns: nmea.gga(clock_ns, *place, quality, *seen)

    def _of_vehicle(self, batch: Batch) -> Sentence | None:
        # MAVLink: the largest number of 16 bits says that it is not known.
        unknown_16 = 65535
        fields = decode(batch, self.dialect.number("GPS_RAW_INT"), self.dialect).fields
        good = np.flatnonzero(fields["fix_type"] >= 2)
        if not len(good):
            return None
        f = fields[good[-1]]
        place = float(f["lat"]) * 1e-7, float(f["lon"]) * 1e-7, float(f["alt"]) * 1e-3
        quality = _QUALITY.get(int(f["fix_type"]), 1)
        dilution = float(f["eph"]) * 0.01 if f["eph"] != unknown_16 else _DILUTION_GIVEN
        seen = int(f["satellites_visible"]), float(dilution)
        return lambda clock_ns: nmea.gga(clock_ns, *place, quality, *seen)


def caster_positions(configuration: RecordingConfiguration, dialect: Dialect) -> dict[str, CasterPosition]:
    """Return the positions for the casters of a recording, by their links."""
    return {
        link.name: CasterPosition(dialect, link.position_every_s, link.position)
        for link in configuration.link
        if link.position is not None or link.position_from is not None
    }
