"""A session: rover and base under one sky, and the streams that they send."""

import math
from dataclasses import dataclass, replace

import numpy as np

from acquire.simulate.gnss.atmosphere import Atmosphere
from acquire.simulate.gnss.constellation import Satellite, constellation
from acquire.simulate.gnss.geometry import Antenna
from acquire.simulate.gnss.observations import SatelliteObservations, observe
from acquire.simulate.gnss.settings import BASE, ROVER, Faults, ReceiverModel, SkySettings
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError


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
    faults: Faults | None = None,
) -> Session:
    """Let a rover and a base measure.

    span_gps_ns: start and stop of the session, GPS nanoseconds since 1980-01-06.
    raises ConfigurationError: when no receiver has an epoch between start and stop.
    """
    sky, faults = sky or SkySettings(), faults or Faults()
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
        observe(
            antenna,
            satellites,
            atmosphere,
            model if slips is None else replace(model, slips_per_hour=slips),
            span_gps_ns,
            chance,
            gaps_s=gaps_s,
        )
        for antenna, model, slips, chance, gaps_s in (
            (rover, rover_model, faults.rover_slips_per_hour, for_rover, faults.rover_gaps_s),
            (base, base_model, faults.base_slips_per_hour, for_base, faults.base_gaps_s),
        )
    )
    at = still.place
    shift = np.array(faults.base_shift_m) @ at.axes[0]
    return Session(span_gps_ns, sky, satellites, moving, still, at.position_m[0] + shift)
