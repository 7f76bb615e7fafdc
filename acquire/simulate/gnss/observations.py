"""What a receiver measures: code, phase, Doppler and signal strength of every signal in view.

A session: rover and base under one sky, and the streams that they send.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss.atmosphere import Atmosphere, on
from acquire.simulate.gnss.constellation import (
    Antenna,
    AntennaTrack,
    Satellite,
    SatelliteView,
    constellation,
    link,
    place,
)
from acquire.simulate.gnss.settings import (
    BASE,
    GPS,
    LIGHT_M_S,
    ROVER,
    SIGNALS,
    ReceiverModel,
    Signal,
    SkySettings,
)
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.time_scales import SECOND_NS

# A channel that was locked before the session began; one that sees its satellite rise; one that slipped.
_LOCKED_BEFORE_S, _ACQUIRING_S, _RELOCKING_S = (60.0, 900.0), (0.5, 4.0), (0.05, 0.6)
# Until the navigation data have shown the sign of the phase.
_HALF_CYCLE_S = (0.6, 6.0)
# A code loop of 0.5 Hz with correlators 0.2 chips apart, a phase loop of 10 Hz over 20 ms.
_CODE_LOOP_HZ, _SPACING, _PHASE_LOOP_HZ, _INTEGRATION_S = 0.5, 0.2, 10.0, 0.02
_FADING_DB, _FADING_S = 0.7, 3.0

ROW = np.dtype(
    [
        *((name, "i8") for name in ("epoch", "satellite", "signal")),
        *((name, "f8") for name in ("code_m", "phase_cycles", "doppler_hz", "cn0_dbhz", "lock_s")),
        *((name, "f8") for name in ("azimuth", "elevation")),
        *((name, "f8") for name in ("code_sigma_m", "phase_sigma_cycles", "doppler_sigma_hz")),
        *((name, "?") for name in ("has_phase", "half_valid", "half_subtracted")),
    ]
)


@dataclass(frozen=True)
class Clock:
    """Epochs of a receiver, whose clock is a crystal with bias, drift and noise, set by whole milliseconds.

    start_gps_ns: GPS time of the start of the session.
    tag_gps_ns (n,): what the receiver's clock shows at its measurements.
    bias_s (n,): receiver time minus GPS time at the measurements.
    rate (n,): derivative of the bias.
    step: whether the clock was set since the last epoch.
    """

    start_gps_ns: int
    tag_gps_ns: Integers
    bias_s: Floats
    rate: Floats
    step: Flags

    def __len__(self) -> int:
        return len(self.tag_gps_ns)

    @property
    def true_gps_ns(self) -> Integers:
        """GPS time of the measurements to the nanosecond."""
        return np.asarray(self.tag_gps_ns - np.rint(self.bias_s * SECOND_NS).astype(np.int64))

    @property
    def seconds(self) -> Floats:
        """GPS time of the measurements since the start: small numbers, to the fraction of a nanosecond."""
        return np.asarray((self.tag_gps_ns - self.start_gps_ns) / SECOND_NS - self.bias_s)


def run_clock(model: ReceiverModel, start_gps_ns: int, stop_gps_ns: int, rng: np.random.Generator) -> Clock:
    """Let a clock run through a session."""
    every = round(model.interval_s * SECOND_NS)
    tag = np.arange(-(-start_gps_ns // every) * every, stop_gps_ns + 1, every, dtype=np.int64)
    bias = rng.uniform(-4e-4, 4e-4) if model.clock_bias_s is None else model.clock_bias_s
    drift = rng.uniform(-5e-7, 5e-7) if model.clock_drift is None else model.clock_drift
    rate = drift + model.clock_noise / np.sqrt(model.interval_s) * rng.standard_normal(len(tag))
    total = bias + np.concatenate([[0.0], np.cumsum(rate[:-1])]) * model.interval_s
    # Set by a millisecond when it is half of one off (`clkReset` of RXM-RAWX).
    steps = np.rint(total * 1e3)
    # The epoch after a step comes a millisecond later: the clock has gone on meanwhile.
    total[1:] += np.cumsum(rate[:-1] * np.diff(steps)) * 1e-3
    moved = np.concatenate([[False], np.diff(steps) != 0])
    return Clock(start_gps_ns, tag, total - steps * 1e-3, rate, moved)


@dataclass(frozen=True)
class Tracking:
    """A signal at the epochs of a receiver.

    lock_s (n,): how long the phase has been followed without a break; 0 where it is not.
    ambiguity (n,): cycles beyond the ones that bring the phase near the pseudorange: whole, or half where
        `half_valid` is not yet set.
    half_valid: whether the ambiguity is known to be whole.
    half_subtracted: whether half a cycle was taken off to make it whole.
    arc (n,): number of the unbroken stretch; -1 without phase.
    """

    code: Flags
    phase: Flags
    lock_s: Floats
    ambiguity: Floats
    half_valid: Flags
    half_subtracted: Flags
    arc: Integers


def track(
    seconds: Floats, visible: Flags, slips_per_hour: float, data: bool, rng: np.random.Generator
) -> Tracking:
    """Follow a signal."""
    code = np.zeros(len(seconds), bool)
    starts: list[float] = []
    ends: list[float] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], visible, [False]]).astype(np.int8)))
    for first, after in edges.reshape(-1, 2).tolist():
        begin, end = float(seconds[first]), float(seconds[after - 1])
        at = begin - rng.uniform(*_LOCKED_BEFORE_S) if first == 0 else begin + rng.uniform(*_ACQUIRING_S)
        code[first:after] = seconds[first:after] >= at
        count = rng.poisson(max(end - begin, 0) * slips_per_hour / 3600)
        slips = np.sort(rng.uniform(begin, end, count))
        relocked = slips + rng.uniform(*_RELOCKING_S, count)
        starts += [at, *relocked.tolist()]
        ends += [*slips.tolist(), end]
    return _arcs(seconds, code, np.array(starts), np.array(ends), data, rng)


def _arcs(
    seconds: Floats, code: Flags, starts: Floats, ends: Floats, data: bool, rng: np.random.Generator
) -> Tracking:
    # Cycles that a slip is long at the most.
    largest_slip = 40
    count = len(starts)
    # Steps of 1 to 80 cycles, modulo 81: two arcs in a row never have the same number.
    values = 2 * largest_slip + 1
    whole = (np.cumsum(rng.integers(1, values, count)) % values - largest_slip).astype(np.float64)
    # A slip while the lock is being found again only delays it.
    starts = np.maximum.accumulate(starts)
    known = starts + rng.uniform(*_HALF_CYCLE_S, count) if data else starts
    turned = rng.random(count) < 0.5 if data else np.zeros(count, bool)
    if not count:
        none, zero = np.zeros(len(seconds), bool), np.zeros(len(seconds))
        return Tracking(code, none, zero, zero, none, none, np.full(len(seconds), -1, np.int64))
    arc = np.searchsorted(starts, seconds, side="right") - 1
    phase = code & (arc >= 0) & (seconds <= ends[arc])
    valid = phase & (seconds >= known[arc])
    return Tracking(
        code,
        phase,
        np.where(phase, seconds - starts[arc], 0.0),
        whole[arc] + np.where(turned[arc] & ~valid, 0.5, 0.0),
        valid,
        valid & turned[arc],
        np.where(phase, arc, -1),
    )


def thermal(
    signal: Signal, elevation: Floats, model: ReceiverModel, rng: np.random.Generator
) -> dict[str, Floats]:
    """Return strength and noise of a signal at the epochs (Kaplan and Hegarty 2006, equations 5.15 and 5.8).

    returns: signal strength and standard deviations (n,) under their names in `ROW`.
    """
    # A patch antenna loses this much from the zenith to the horizon.
    low_gain_db = 13.0
    gain = low_gain_db * (1 - np.sin(np.maximum(elevation, 0.0)) ** 0.7)
    fading = correlated(rng.standard_normal(len(elevation)), model.interval_s / _FADING_S)
    cn0 = model.cn0_dbhz - signal.weaker_db - gain + _FADING_DB * fading
    power = 10 ** (cn0 / 10)
    squaring = 1 + 2 / (power * _INTEGRATION_S * (2 - _SPACING))
    code = signal.chip_m * np.sqrt(_CODE_LOOP_HZ * _SPACING / (2 * power) * squaring)
    radians = np.sqrt(_PHASE_LOOP_HZ / power * (1 + 1 / (2 * _INTEGRATION_S * power)))
    phase = radians / (2 * np.pi)
    return {
        "cn0_dbhz": cn0,
        "code_sigma_m": code,
        "phase_sigma_cycles": phase,
        "doppler_sigma_hz": np.sqrt(2) * phase / (2 * np.pi * _INTEGRATION_S),
    }


def correlated(white: Floats, step: float) -> Floats:
    """Return Gauss-Markov sequences of unit variance made of white noise, along its last axis.

    step: time between the values over the time that they stay alike.
    """
    from scipy.signal import lfilter

    keep = np.exp(-step)
    kicks = white * np.sqrt(1 - keep**2)
    kicks[..., 0] = white[..., 0]
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks))


@dataclass(frozen=True)
class SatelliteObservations:
    """Measurements of one receiver.

    rows (m,) of `ROW`: by epoch, satellite and signal; `phase_cycles` grows with the range, like `code_m`.
    """

    clock: Clock
    place: AntennaTrack
    satellites: tuple[Satellite, ...]
    rows: NDArray[np.void]

    def signal(self, satellite: int, number: int) -> Signal:
        """Return a signal by the numbers of a row."""
        return SIGNALS[self.satellites[satellite].system][number]


def observe(
    antenna: Antenna,
    satellites: tuple[Satellite, ...],
    atmosphere: Atmosphere,
    model: ReceiverModel,
    span_gps_ns: tuple[int, int],
    rng: np.random.Generator,
) -> SatelliteObservations:
    """Measure through a session."""
    # Two signals of each system.
    signal_order = 2
    clock = run_clock(model, *span_gps_ns, rng)
    here = place(antenna.position(clock.true_gps_ns), antenna.velocity(clock.true_gps_ns))
    biases = rng.normal(0, model.code_bias_m, (len(SIGNALS), signal_order))
    parts = []
    for index, (satellite, chance) in enumerate(zip(satellites, rng.spawn(len(satellites)), strict=True)):
        bias = biases[list(SIGNALS).index(satellite.system)]
        parts += _satellite(index, satellite, atmosphere, model, (clock, here), bias, chance)
    rows = np.concatenate([np.empty(0, ROW), *parts])
    order = np.lexsort((rows["signal"], rows["satellite"], rows["epoch"]))
    return SatelliteObservations(clock, here, satellites, rows[order])


def _satellite(
    index: int,
    satellite: Satellite,
    atmosphere: Atmosphere,
    model: ReceiverModel,
    receiver: tuple[Clock, AntennaTrack],
    biases: Floats,
    rng: np.random.Generator,
) -> list[NDArray[np.void]]:
    # Below this a receiver of this kind holds nothing.
    weakest_dbhz = 22.0
    mask = np.radians(model.mask_deg)
    clock, here = receiver
    seconds = clock.seconds
    if not _ever_up(satellite, clock, here, mask):
        return []
    way = link(satellite, seconds, clock.start_gps_ns, here)
    above = way.elevation >= mask
    seen = np.maximum(way.elevation, mask)
    layer = atmosphere.ionosphere_m(here, way.azimuth, seen, clock.true_gps_ns)
    air = atmosphere.troposphere_m(here, seen)
    slow = way.range_m + air + LIGHT_M_S * (clock.bias_s - way.clock_s)
    # From the zenith to the mask multipath grows threefold.
    strength = (1 + 2 * np.cos(way.elevation) ** 2) / 3
    blocked = np.zeros(len(clock), bool)
    for begin, end in model.gaps_s:
        blocked |= (seconds >= begin) & (seconds < end)
    parts = []
    for number, (signal, chance) in enumerate(zip(SIGNALS[satellite.system], rng.spawn(2), strict=True)):
        noise = thermal(signal, way.elevation, model, chance)
        arrives = above & ~blocked & (noise["cn0_dbhz"] > weakest_dbhz)
        held = track(seconds, arrives, model.slips_per_hour, signal.data, chance)
        delay = layer * on(signal.frequency_hz)
        code = slow + delay + LIGHT_M_S * group_delay_s(satellite, number) + biases[number]
        multipath = correlated(
            chance.standard_normal((2, len(code))), model.interval_s / model.multipath_time_s
        )
        multipath[0] *= model.code_multipath_m * min(signal.chip_m / 293.0, 1.0) ** 0.5 * strength
        multipath[1] *= model.phase_multipath_m * strength * signal.wavelength_m / 0.1903
        measured = slow - delay, code, multipath
        parts.append(_rows((index, number), signal, clock, way, held, noise, measured, chance))
    return parts


def _ever_up(satellite: Satellite, clock: Clock, here: AntennaTrack, mask: float) -> bool:
    """Look once a minute, with a margin for what rises in between (half a degree a minute)."""
    coarse_s = 60
    seconds = clock.seconds
    step = max(round(coarse_s / max(float(np.median(np.diff(seconds))), 1e-3)), 1)
    chosen = np.unique(np.append(np.arange(0, len(seconds), step), len(seconds) - 1))
    coarse = link(satellite, seconds[chosen], clock.start_gps_ns, here.rows(chosen))
    return bool((coarse.elevation > mask - np.radians(1.0)).any())


def group_delay_s(satellite: Satellite, number: int) -> float:
    """Return how much later than the broadcast clock says a code leaves the satellite."""
    # The clock of GPS belongs to the ionosphere-free combination of L1 and L2, that of Galileo's I/NAV to
    # that of E1 and E5b (IS-GPS-200N, 20.3.3.3.3.2; Galileo OS SIS ICD 2.1, 5.1.5).
    signal = SIGNALS[satellite.system][number]
    delay = satellite.truth.value("tgd" if satellite.system == GPS else "bgd_e5b")
    return delay * on(signal.frequency_hz)


def _rows(
    numbers: tuple[int, int],
    signal: Signal,
    clock: Clock,
    way: SatelliteView,
    held: Tracking,
    noise: dict[str, Floats],
    measured: tuple[Floats, Floats, Floats],
    rng: np.random.Generator,
) -> NDArray[np.void]:
    chosen = np.flatnonzero(held.code)
    phase_m, code_m, multipath = (values[..., chosen] for values in measured)
    rows = np.zeros(len(chosen), ROW)
    rows["epoch"], rows["satellite"], rows["signal"] = chosen, *numbers
    for name, values in noise.items():
        rows[name] = values[chosen]
    rows["code_m"] = code_m + multipath[0] + rows["code_sigma_m"] * rng.standard_normal(len(chosen))
    phase = phase_m + multipath[1]
    # The ambiguity brings the phase near the code (u-blox F9 HPG 1.32, RXM-RAWX), the same for all arcs.
    near = np.rint((code_m[:1] - phase_m[:1]) / signal.wavelength_m)
    rows["phase_cycles"] = (
        phase / signal.wavelength_m
        + near
        + held.ambiguity[chosen]
        + way.wind_up[chosen]
        + rows["phase_sigma_cycles"] * rng.standard_normal(len(chosen))
    )
    rows["phase_cycles"][~held.phase[chosen]] = 0.0
    rate = way.range_rate_m_s + LIGHT_M_S * (clock.rate - way.clock_rate)
    doppler = -rate[chosen] / (1 + clock.rate[chosen]) / signal.wavelength_m
    rows["doppler_hz"] = doppler + rows["doppler_sigma_hz"] * rng.standard_normal(len(chosen))
    rows["lock_s"] = held.lock_s[chosen]
    rows["azimuth"], rows["elevation"] = way.azimuth[chosen], way.elevation[chosen]
    rows["has_phase"] = held.phase[chosen]
    rows["half_valid"], rows["half_subtracted"] = held.half_valid[chosen], held.half_subtracted[chosen]
    return rows


@dataclass(frozen=True)
class Session:
    """What two receivers measured.

    announced_m (3,): what the base says where it is, earth-centred: the truth but for the fault.
    """

    span_gps_ns: tuple[int, int]
    sky: SkySettings
    satellites: tuple[Satellite, ...]
    rover: SatelliteObservations
    base: SatelliteObservations
    announced_m: Floats


def simulate(
    rover: Antenna,
    base: Antenna,
    span_gps_ns: tuple[int, int],
    *,
    rng: np.random.Generator,
    sky: SkySettings | None = None,
    rover_model: ReceiverModel = ROVER,
    base_model: ReceiverModel = BASE,
    base_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Session:
    """Let a rover and a base measure.

    span_gps_ns: start and stop of the session, GPS nanoseconds since 1980-01-06.
    base_shift_m: east, north, up: what is announced as the base's position less where it is.
    raises ConfigurationError: when no receiver has an epoch between start and stop.
    """
    sky = sky or SkySettings()
    longest, seconds = (
        max(rover_model.interval_s, base_model.interval_s),
        (span_gps_ns[1] - span_gps_ns[0]) / 1e9,
    )
    if seconds < 2 * longest:
        raise ConfigurationError(
            f"the session of {seconds:g} s is too short for measurements every {longest:g} s",
            "fly longer or measure more often",
            where="GNSS simulation",
        )
    # Each part has its own chance: a fault at the rover changes nothing at the base.
    for_sky, for_air, for_rover, for_base = rng.spawn(4)
    satellites = constellation(*span_gps_ns, for_sky, sky.unhealthy)
    x, y, _ = base.position(np.array(span_gps_ns[:1]))[0].tolist()
    atmosphere = Atmosphere.by_chance(sky, for_air, math.atan2(y, x))
    moving, still = (
        observe(antenna, satellites, atmosphere, model, span_gps_ns, chance)
        for antenna, model, chance in ((rover, rover_model, for_rover), (base, base_model, for_base))
    )
    at = still.place
    shift = np.array(base_shift_m) @ at.axes[0]
    return Session(span_gps_ns, sky, satellites, moving, still, at.position_m[0] + shift)
