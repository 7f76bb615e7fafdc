"""The position that a caster of virtual reference stations wants to know, as GGA sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import nmea
from drivers.frames import Batch, Wire
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import Dialect
from drivers.ubx.decode import NAV_PVT
from drivers.ubx.decode import decode as decode_ubx

_GGA = nmea.kind_of(b"GPGGA")
# Quality of GGA by the kind of fix of GPS_RAW_INT.
_QUALITY = {2: 1, 3: 1, 4: 2, 5: 5, 6: 4}


@dataclass
class CasterPosition:
    """Keeps the last position of a link and tells when a caster is to be told it.

    Parameters
    ----------
    dialect : Dialect
        The known MAVLink messages.
    every_s : float
        Time between sentences, seconds.
    """

    dialect: Dialect
    every_s: float
    _sentence: bytes = b""
    _due_s: float = float("-inf")

    def hear(self, batch: Batch, clock_ns: int) -> None:
        """Take over the last position of a batch: a GGA sentence as it is, NAV-PVT or GPS_RAW_INT as one."""
        sentences = batch.where(Wire.NMEA, _GGA)
        if len(sentences):
            frame = batch.frame(int(sentences[-1])).data
            if frame.split(b",")[6:7] not in ([], [b""], [b"0"]):
                self._sentence = frame
                return
        pvt = decode_ubx(batch, NAV_PVT)
        good = np.flatnonzero((pvt.fields["flags"] & 1) & np.isin(pvt.fields["fixType"], (2, 3, 4)))
        if len(good):
            f = pvt.fields[good[-1]]
            quality = (1, 5, 4, 1)[int(f["flags"]) >> 6]
            lat, lon, height_m = f["lat"] * 1e-7, f["lon"] * 1e-7, f["hMSL"] * 1e-3
            self._sentence = nmea.gga(clock_ns, float(lat), float(lon), float(height_m), quality)
            return
        raw = decode(batch, self.dialect.number("GPS_RAW_INT"), self.dialect)
        good = np.flatnonzero(raw.fields["fix_type"] >= 2)
        if len(good):
            f = raw.fields[good[-1]]
            lat, lon, height_m = f["lat"] * 1e-7, f["lon"] * 1e-7, f["alt"] * 1e-3
            quality = _QUALITY.get(int(f["fix_type"]), 1)
            self._sentence = nmea.gga(clock_ns, float(lat), float(lon), float(height_m), quality)

    def due(self, steady_s: float) -> tuple[bytes, ...]:
        """Return the sentence when it is time for one and a position is known."""
        if not self._sentence or steady_s < self._due_s:
            return ()
        self._due_s = steady_s + self.every_s
        return (self._sentence,)
