"""What can be set: the sky and the receivers."""

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

    ubx: `sigId` of u-blox's interface description (F9 HPG 1.32, section 1.5.4).
    msm: number in the signal mask of RTCM MSM (RTCM 10403.3, tables 3.5-91 and 3.5-99), counted from 1.
    chip_m: length of a chip of the code; for a binary offset carrier the length that gives its code noise.
    weaker_db: how much less power arrives than on the first frequency.
    data: whether it carries navigation data, so that its phase is ambiguous by half a cycle at first.
    """

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


L1CA = Signal(1575.42e6, 0, 2, 293.05, 0.0, True)
L2CL = Signal(1227.60e6, 3, 16, 293.05, 4.0, False)
E1C = Signal(1575.42e6, 0, 2, 170.0, 0.0, False)
E5BQ = Signal(1207.14e6, 6, 15, 29.3, 0.0, False)

SIGNALS = {GPS: (L1CA, L2CL), GALILEO: (E1C, E5BQ)}
"""First and second frequency of each system."""

UBX_SYSTEM = {GPS: 0, GALILEO: 2}
"""`gnssId` of u-blox's interface description."""


@dataclass(frozen=True)
class SkySettings:
    """Satellites and atmosphere.

    unhealthy: satellites whose messages call them unhealthy.
    klobuchar: the broadcast model of the ionosphere as transmitted: four alpha and four beta.
    ionosphere_scale: what the true ionosphere has of the delay that the broadcast model says.
    wave_m: amplitude of the travelling waves in the ionosphere (vertical delay on L1), 150 to 400 km long.
    temperature_c: at sea level; 6.5 K less for each kilometre.
    relative_humidity: at all heights. At 0.5 the wet delay 100 m above the base differs by some 4 mm in the
        zenith, which no receiver knows.
    wet_sigma_m: scatter of the zenith wet delay around that of the standard atmosphere.
    leap_s: GPS time minus UTC.
    """

    unhealthy: tuple[str, ...] = ()
    klobuchar: tuple[int, ...] = (12, 2, -1, -1, 44, 1, -2, -3)
    ionosphere_scale: float = 1.15
    wave_m: float = 0.05
    temperature_c: float = 15.0
    relative_humidity: float = 0.5
    wet_sigma_m: float = 0.02
    leap_s: int = 18


@dataclass(frozen=True)
class ReceiverModel:
    """A receiver and its surroundings.

    interval_s: between measurements, a divisor or multiple of a second.
    mask_deg: satellites below are not tracked.
    cn0_dbhz: carrier to noise density of a satellite in the zenith on the first frequency.
    code_multipath_m, phase_multipath_m: standard deviation at the mask on codes of 1 Mchip/s and on L1; a
        third of it in the zenith.
    multipath_time_s: correlation time of multipath: seconds for a rover in motion, minutes for a base.
    clock_bias_s, clock_drift: receiver time minus GPS time at the start, seconds, and its rate; None: by
        chance, within 0.4 ms and 5e-7.
    clock_noise: white frequency noise of the oscillator, s / sqrt(s).
    slips_per_hour: rate of cycle slips of each signal.
    code_bias_m: standard deviation of the receiver's own delays, constant for each signal.
    gaps_s: times without any measurement, seconds from the start.
    """

    interval_s: float = 0.2
    mask_deg: float = 8.0
    cn0_dbhz: float = 50.0
    code_multipath_m: float = 0.6
    phase_multipath_m: float = 0.004
    multipath_time_s: float = 8.0
    clock_bias_s: float | None = None
    clock_drift: float | None = None
    clock_noise: float = 3e-10
    slips_per_hour: float = 0.2
    code_bias_m: float = 0.5
    gaps_s: tuple[tuple[float, float], ...] = ()


ROVER = ReceiverModel()
BASE = ReceiverModel(interval_s=1.0, code_multipath_m=0.5, multipath_time_s=60.0, slips_per_hour=0.05)
