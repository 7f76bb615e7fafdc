"""The signals that the simulated receivers track, and the constants that all of it shares."""

from __future__ import annotations

from dataclasses import dataclass

# Exact by definition (SI) and by IS-GPS-200N table 20-IV, Galileo OS SIS ICD 2.1 table 66.
LIGHT_M_S = 299_792_458.0
EARTH_RATE_RAD_S = 7.2921151467e-5
# Both interface documents fix pi for the conversion of semicircles.
SEMICIRCLE_RAD = 3.1415926535898

GPS, GALILEO = "G", "E"


@dataclass(frozen=True)
class Signal:
    """One signal of one system.

    system: ``G`` GPS, ``E`` Galileo.
    code: RINEX 3 band and attribute, for example ``1C``.
    frequency_hz: of the carrier.
    ubx: `sigId` of u-blox's interface description (F9 HPG 1.32, section 1.5.4).
    msm: number in the signal mask of RTCM MSM (RTCM 10403.3, tables 3.5-91 and 3.5-99), counted from 1.
    chip_m: length of a chip of the code; for a binary offset carrier the length that gives its code noise.
    weaker_db: how much less power arrives than on the first frequency.
    data: whether it carries navigation data, so that its phase is ambiguous by half a cycle at first.
    """

    system: str
    code: str
    frequency_hz: float
    ubx: int
    msm: int
    chip_m: float
    weaker_db: float
    data: bool

    @property
    def wavelength_m(self) -> float:
        """Length of the carrier's wave."""
        return LIGHT_M_S / self.frequency_hz


L1CA = Signal(GPS, "1C", 1575.42e6, 0, 2, 293.05, 0.0, True)
L2CL = Signal(GPS, "2L", 1227.60e6, 3, 16, 293.05, 4.0, False)
E1C = Signal(GALILEO, "1C", 1575.42e6, 0, 2, 170.0, 0.0, False)
E5BQ = Signal(GALILEO, "7Q", 1207.14e6, 6, 15, 29.3, 0.0, False)

SIGNALS = {GPS: (L1CA, L2CL), GALILEO: (E1C, E5BQ)}
"""First and second frequency of each system."""

UBX_SYSTEM = {GPS: 0, GALILEO: 2}
"""`gnssId` of u-blox's interface description."""
