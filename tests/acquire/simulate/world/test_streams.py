"""The streams of a simulated flight, read by pymavlink and by our own import."""

from __future__ import annotations

import io
import json
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyrtcm
import pytest
import pyubx2
from pymavlink import mavutil

from acquire.simulate.world import telemetry
from acquire.simulate.world.streams import carry, make_streams
from acquire.simulate.world.world import World
from tests.acquire.simulate.world.conftest import Flight
from tests.simulated import PLANS, world_of

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def test_pymavlink_reads_every_frame(small: Flight) -> None:
    sent = telemetry.messages(small.world)
    reader = mavutil.mavlink_connection(str(small.folder / "site/vehicle.tlog"), dialect="ardupilotmega")
    counts: Counter[str] = Counter()
    sequences: dict[tuple[int, int], list[int]] = {}
    while (message := reader.recv_match()) is not None:
        assert message.get_type() != "BAD_DATA"
        counts[message.get_type()] += 1
        source = message.get_srcSystem(), message.get_srcComponent()
        sequences.setdefault(source, []).append(message.get_seq())
    assert counts == Counter(one.name for one in sent)
    for numbers in sequences.values():
        assert set(np.diff(numbers) % 256) == {1}
    reader.close()


def test_pyubx2_and_pyrtcm_read_every_frame_of_a_survey(small: Flight) -> None:
    own = small.world.configuration.gnss.model_dump(exclude_none=True)
    streams = make_streams(world_of(PLANS / "small.toml", gnss={**own, "base_protocol": "rtcm3"}))
    for wire, peer in (
        (streams["rover"], pyubx2.UBXReader),
        (streams["base"], pyrtcm.RTCMReader),
        (make_streams(small.world)["base"], pyubx2.UBXReader),
    ):
        read = [raw for raw, _ in peer(io.BytesIO(b"".join(wire.frames)), validate=1, quitonerror=2)]
        assert read == list(wire.frames)


def test_the_autopilot_tells_the_truth_with_its_errors(small: Flight) -> None:
    world = small.world
    sent = [one for one in telemetry.messages(world) if one.name == "ATTITUDE"]
    given = world.configuration.telemetry
    # Their own clock tells when the attitudes were; the filter is late.
    boot = np.array([one.fields["time_boot_ms"] for one in sent]) / 1e3
    time = (boot - 87.0) / (1 + 12e-6) - given.lag_s
    told = np.array([[one.fields[name] for name in ("roll", "pitch", "yaw")] for one in sent])
    error = (told - world.motion.angles(time) + np.pi) % (2 * np.pi) - np.pi
    sigma = np.radians(world.configuration.rig.attitude_sigma_deg)
    assert error.std(axis=0) == pytest.approx(sigma, rel=0.35)
    assert np.abs(error.mean(axis=0) / sigma).max() < 0.6
    places = [one for one in telemetry.messages(world) if one.name == "GLOBAL_POSITION_INT"]
    north = np.radians([one.fields["lat"] * 1e-7 for one in places]) - np.radians(world.place.latitude_deg)
    assert np.abs(north * 6.37e6).max() < 60
    climbed = max(one.fields["relative_alt"] for one in places) / 1e3
    assert climbed == pytest.approx(28 - world.motion.ground_m, abs=4)


def test_a_flight_is_imported_whole(small: Flight, acquire: Acquire, tmp_path: Path) -> None:
    site, log = small.folder / "site", tmp_path / "flight.mcap"
    named = {"vehicle": "vehicle.tlog", "rover": "rover.ubx", "base": "base.ubx"}
    links = [x for name, file in named.items() for x in ("--link", f"{name}={site / file}")]
    done = acquire("import", *links, "-o", log, "--json")
    assert done.returncode == 0, done.stderr
    for link in json.loads(done.stdout)["links"]:
        arrived = (small.folder / "truth/wires" / f"{link['link']}.csv").read_text().splitlines()[1:]
        assert link["frames"] == len(arrived)
        assert link["damage_bytes"] == 0
    told = acquire("info", log, "--json")
    assert told.returncode == 0
    topics = {row["topic"]: row["messages"] for row in json.loads(told.stdout)["topics"]}
    # Trigger, feedback, rising and falling edge of each picture.
    assert topics["/camera/exposure"] == 4 * len(small.world.exposures)


def test_streams_are_the_same_each_time(small: Flight) -> None:
    again = make_streams(world_of(PLANS / "small.toml"))
    assert (small.folder / "site/rover.ubx").read_bytes() == again["rover"].data
    assert (small.folder / "site/base.ubx").read_bytes() == again["base"].data


def test_losses_and_damage_on_the_wires() -> None:
    random = np.random.default_rng(1)
    frames = [bytes([k % 251, 1, 2, 3]) * 5 for k in range(4000)]
    time = np.asarray(np.arange(4000) * 0.01, dtype=np.float64)
    wire = carry(time, frames, random, latency_s=0.05, loss=0.02, damage=0.03, gap_s=(10.0, 11.0))
    assert len(frames) - len(wire.frames) - 100 == pytest.approx(80, abs=30)
    assert wire.damaged == pytest.approx(117, abs=40)
    assert (np.diff(wire.arrival_s) >= 0).all()
    kept = set(frames)
    hurt = [frame for frame in wire.frames if frame not in kept]
    # A turned bit may make another frame of the row.
    assert abs(len(hurt) - wire.damaged) < 20
    through = carry(time, frames, random)
    assert list(through.frames) == frames
    assert io.BytesIO(through.data).read() == b"".join(frames)


def test_a_lossy_link_is_imported_with_its_damage(acquire: Acquire, tmp_path: Path) -> None:
    from acquire.simulate.world.streams import telemetry_log

    world = world_of(PLANS / "small.toml", wires={"vehicle_loss": 0.02, "vehicle_damage": 0.02})
    streams = make_streams(world)
    (tmp_path / "vehicle.tlog").write_bytes(telemetry_log(world, streams["vehicle"]))
    done = acquire("import", tmp_path / "vehicle.tlog", "-o", tmp_path / "log.mcap", "--json")
    (link,) = json.loads(done.stdout)["links"]
    intact = len(streams["vehicle"].frames) - streams["vehicle"].damaged
    assert intact <= link["frames"] <= intact + 3
    assert link["damage_runs"] > 0.8 * streams["vehicle"].damaged


def attitude_gap(world: World) -> float:
    """Give the longest time without telemetry that arrived."""
    return float(np.diff(make_streams(world)["vehicle"].arrival_s).max())


def test_a_telemetry_gap_lasts_half_a_minute() -> None:
    assert attitude_gap(world_of(PLANS / "small.toml")) < 0.5
    assert attitude_gap(world_of(PLANS / "small.toml", faults=["telemetry_gap"])) > 29
