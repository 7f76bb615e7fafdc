"""What can be set: the sky, the receivers and what goes wrong."""

from __future__ import annotations

from dataclasses import dataclass


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
    clock_steps: whether the clock is set by a millisecond when it is half of one off (`clkReset` of
        RXM-RAWX).
    slips_per_hour: rate of cycle slips of each signal.
    code_bias_m: standard deviation of the receiver's own delays, constant for each signal.
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
    clock_steps: bool = True
    slips_per_hour: float = 0.2
    code_bias_m: float = 0.5


ROVER = ReceiverModel()
BASE = ReceiverModel(interval_s=1.0, code_multipath_m=0.5, multipath_time_s=60.0, slips_per_hour=0.05)


@dataclass(frozen=True)
class Outage:
    """Signals of a satellite that do not arrive, seconds from the start of the session."""

    satellite: str
    from_s: float
    to_s: float


@dataclass(frozen=True)
class Faults:
    """What goes wrong, each alone or together.

    base_shift_m: east, north, up: what is announced as the base's position less where it is.
    rover_slips_per_hour, base_slips_per_hour: cycle slips of each signal instead of the receiver's own rate.
    rover_gaps_s, base_gaps_s: times without any measurement, seconds from the start.
    outages: of single satellites, at the rover.
    """

    base_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rover_slips_per_hour: float | None = None
    base_slips_per_hour: float | None = None
    rover_gaps_s: tuple[tuple[float, float], ...] = ()
    base_gaps_s: tuple[tuple[float, float], ...] = ()
    outages: tuple[Outage, ...] = ()
