"""TIMESYNC: two clocks by exchanges of known ways, and a whole dialogue with the simulated autopilot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from acquire.log.chunk import Channel
from acquire.log.writer import LogWriter
from acquire.recording.dialogues import VehicleDialogue
from drivers.frames import StreamFramer, Wire
from drivers.mavlink.dialect import ardupilotmega
from photocal.navigation.device_clocks import ComparedClocks, converted, device_by_arrival
from photocal.navigation.events import boot_exposures
from photocal.navigation.exposure_sources import events_of
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.time import HostTime, UtcTime
from photocal.navigation.vehicle import autopilot_time, read_vehicle, time_sync
from tests.acquire.devices import Autopilot

Integers = NDArray[np.int64]
SECOND = 1_000_000_000
UTC = 1_750_000_000 * SECOND
BOOT = np.arange(20, 320, dtype=np.int64) * SECOND


def nanoseconds(seconds: NDArray[np.float64]) -> Integers:
    return np.rint(seconds * 1e9).astype(np.int64)


def exchanges(there_s: float, back_s: float, seed: int) -> tuple[Integers, Integers]:
    """Arrival and duration of exchanges with the host 12 ppm slow; some answers wait in a queue."""
    rng = np.random.default_rng(seed)
    queue = np.where(rng.random(300) < 0.3, rng.exponential(0.2, 300), 0.0)
    out = there_s + rng.exponential(2e-4, 300)
    home = back_s + rng.exponential(2e-4, 300) + queue
    answered = UTC + BOOT + nanoseconds(BOOT / 1e9 * -12e-6)
    return answered + nanoseconds(home), nanoseconds(out + home)


@pytest.mark.parametrize(("there_ms", "back_ms"), [(2.0, 2.0), (0.5, 3.5), (15.0, 5.0)])
def test_the_length_of_the_exchange_bounds_the_offset(there_ms: float, back_ms: float) -> None:
    host, trip = exchanges(there_ms / 1e3, back_ms / 1e3, 2)
    sync = time_sync(BOOT, host, trip)
    assert sync is not None
    segment = sync.host_of_boot.cycles[0][0]
    assert abs(segment.drift_ppm + 12) < 4 * segment.rate_sigma * 1e6
    # Of the whole trip: uniformly distributed between none of it and all of it on one way.
    shortest = (there_ms + back_ms) / 1e3
    assert sync.host_of_boot.constant_sigma_s == pytest.approx(shortest / np.sqrt(12), rel=0.05)
    moment = UTC + BOOT[100:101] + nanoseconds(BOOT[100:101] / 1e9 * -12e-6)
    boot, sigma = sync.boot(moment)
    error = abs(int(boot[0] - BOOT[100])) / 1e9
    # The error is half the difference of both ways, to what varies from exchange to exchange.
    assert error == pytest.approx(abs(back_ms - there_ms) / 2e3, abs=3e-4)
    assert error < np.sqrt(3) * sigma[0] + 3e-4


def test_a_step_of_the_host_is_found() -> None:
    host, trip = exchanges(0.002, 0.002, 4)
    host[200:] += 30_000_000
    sync = time_sync(BOOT, host, trip)
    assert sync is not None
    assert sync.host_of_boot.figures()["jumps_s"] == pytest.approx([0.030], abs=0.002)
    after, _ = sync.boot(host[250:251] - trip[250:251] // 2)
    assert abs(int(after[0] - BOOT[250])) < 0.1 * SECOND


def test_arrival_alone_is_late_by_the_way() -> None:
    host, trip = exchanges(0.002, 0.002, 2)
    late = device_by_arrival("arrival", BOOT, host)
    sync = time_sync(BOOT, host, trip)
    assert late is not None
    assert sync is not None
    moment = UTC + BOOT[100:101] + nanoseconds(BOOT[100:101] / 1e9 * -12e-6)
    assert int(converted(late.cycles[0], moment)[0][0] - BOOT[100]) < -1_000_000
    assert abs(int(sync.boot(moment)[0][0] - BOOT[100])) < 500_000
    assert time_sync(BOOT[:0], BOOT[:0], BOOT[:0]) is None


@dataclass(frozen=True)
class Recording:
    """A log of a vehicle that does not know the date, with what was true."""

    log: Path
    gnss: ComparedClocks
    shots_s: NDArray[np.float64]


def host_ns(true_s: NDArray[np.float64]) -> Integers:
    """The recording computer is 2.5 s ahead and gains 8 ppm."""
    return UTC + nanoseconds(true_s * (1 + 8e-6) + 2.5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The recorder's own dialogue with the simulated autopilot, bytes for bytes, over a slow link."""
    rng = np.random.default_rng(9)
    dialogue = VehicleDialogue(ardupilotmega(), {}, 1.0)
    # Started at UTC 0, its times are times since boot.
    autopilot = Autopilot(0)
    framer = StreamFramer((Wire.MAVLINK,))
    came: list[tuple[float, bytes]] = []
    batch, heard_s = None, 0.0
    shots = np.arange(10.25, 110.0, 2.0)
    for step_s in np.arange(0.0, 120.0, 0.5).tolist():
        own = autopilot.due(step_s)
        for shot_s in shots[(shots >= step_s) & (shots < step_s + 0.5)].tolist():
            own += autopilot.trigger(shot_s)
        said = dialogue.step(batch, step_s, int(host_ns(np.array([step_s]))[0]))
        there, back = 0.010 + rng.exponential(0.001, 2)
        answer = b"".join(autopilot.receive(frame, step_s + there) for frame in said[0])
        heard_s = step_s + there + back if answer else step_s + 0.3
        batch = framer.feed(own + answer)
        came += [(heard_s, bytes(frame.data)) for frame in batch]
    path = tmp_path_factory.mktemp("sync") / "flight.mcap"
    times = host_ns(np.array([at for at, _ in came]))
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        raw = Channel("/vehicle/raw", Wire.MAVLINK.encoding, None, {})
        writer.messages(raw, [data for _, data in came], times, times, np.arange(len(came)))
        writer.close()
    # A receiver on the same computer, whose epochs arrive 40 to 80 ms late.
    epoch_s = np.arange(0.0, 120.0, 0.2)
    epochs = UtcTime(UTC + nanoseconds(epoch_s)).to_gps().ns
    gnss = device_by_arrival("GNSS", epochs, host_ns(epoch_s + rng.uniform(0.04, 0.08, len(epoch_s))))
    assert gnss is not None
    return Recording(path, gnss, shots)


def test_exposures_by_boot_time_alone_are_placed(recording: Recording) -> None:
    # Without a receiver nothing tells the date.
    alone = read_vehicle(FlightLog((recording.log,)), "vehicle")
    assert alone.clocks.clock is None
    assert alone.clocks.sync is not None
    track = read_vehicle(FlightLog((recording.log,)), "vehicle", recording.gnss)
    assert track.clocks.clock is not None
    made = boot_exposures(FlightLog((recording.log,)), "vehicle", track.clocks.clock)["CAMERA_FEEDBACK"]
    assert len(made) == len(recording.shots_s)
    error = (made.time.to_utc().ns - UTC) / 1e9 - recording.shots_s
    # The receiver's delay is known to 30 ms; what the link adds varies by milliseconds.
    assert np.abs(error).max() < 0.03
    assert error.std() < 0.002
    assert made.accuracy_s == pytest.approx(0.03, abs=0.005)
    best = events_of(Sources(FlightLog((recording.log,)), vehicle_link="vehicle"), "rising", {}, track)
    assert best is not None
    assert best.time == made.time
    assert "TIMESYNC" in " ".join(best.remarks)


def test_moments_of_the_host_agree_with_those_of_the_autopilot(recording: Recording) -> None:
    track = read_vehicle(FlightLog((recording.log,)), "vehicle", recording.gnss)
    assert track.clocks.clock is not None
    made = boot_exposures(FlightLog((recording.log,)), "vehicle", track.clocks.clock)["CAMERA_FEEDBACK"]
    time, sigma = autopilot_time(track, HostTime(host_ns(recording.shots_s)))
    # Both contain the same error of the receiver's delay: only the exchange lies between them.
    assert np.abs((time.ns - made.time.ns) / 1e9).max() < 0.003
    assert (sigma > 0.02).all()


def test_a_wrong_clock_is_not_used(recording: Recording) -> None:
    fast = device_by_arrival("GNSS", UTC + BOOT - 315_964_782 * SECOND, UTC + BOOT // 5)
    assert fast is not None
    assert read_vehicle(FlightLog((recording.log,)), "vehicle", fast).clocks.clock is None
