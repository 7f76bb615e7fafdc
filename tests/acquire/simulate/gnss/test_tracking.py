"""Slips, half cycles, gaps, clocks: what the flags say agrees with what the phase does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquire.simulate.gnss.constellation import Antenna
from acquire.simulate.gnss.observations import Session, run_clock, simulate, track
from acquire.simulate.gnss.settings import ROVER, ReceiverModel, SkySettings
from acquire.simulate.gnss.streams import Pulses, base_rtcm, base_ubx, rover_ubx, time_mark_messages
from photocal.base.errors import ConfigurationError
from tests.acquire.simulate.gnss.flights import BASE_M, SECOND, START, fly, gps_ns, streams
from tests.acquire.simulate.gnss.rtklib import to_rinex

SECONDS = np.arange(0, 3600, 0.2)


def test_slips_come_at_their_rate_and_show_in_the_lock_time() -> None:
    visible = np.ones(len(SECONDS), bool)
    counts = []
    for seed in range(20):
        held = track(SECONDS, visible, 60.0, False, np.random.default_rng(seed))
        steps = np.flatnonzero(held.phase[1:] & held.phase[:-1] & (np.diff(held.arc) != 0))
        both = held.phase[1:] & held.phase[:-1]
        jumped = both & (np.diff(held.ambiguity) != 0)
        reset = both & (np.diff(held.lock_s) < 0)
        assert np.array_equal(jumped, reset)
        assert len(steps) == jumped.sum()
        lost = np.flatnonzero(held.phase[:-1] & ~held.phase[1:])
        counts.append(held.arc.max())
        assert np.all(held.lock_s[~held.phase] == 0)
        assert len(lost) + len(steps) >= 0.8 * held.arc.max()
    # Poisson: 20 hours with 60 slips each.
    assert np.sum(counts) == pytest.approx(1200, abs=4 * np.sqrt(1200))


def test_half_cycles_are_known_in_time() -> None:
    visible = np.ones(len(SECONDS), bool)
    held = track(SECONDS, visible, 120.0, True, np.random.default_rng(5))
    whole = held.ambiguity % 1 == 0
    assert np.all(whole[held.half_valid])
    assert not np.all(whole[held.phase & ~held.half_valid])
    assert np.all(held.half_valid[held.phase & (held.lock_s > 6.0)])
    assert not np.any(held.half_valid[held.phase & (held.lock_s < 0.6)])
    assert held.half_subtracted.any()
    # Where half a cycle was taken off, the phase had been half a cycle off before.
    for arc in set(held.arc[held.half_subtracted].tolist()):
        before = (held.arc == arc) & ~held.half_valid
        assert np.all(held.ambiguity[before] % 1 == 0.5)


def test_without_data_there_are_no_half_cycles() -> None:
    held = track(SECONDS, np.ones(len(SECONDS), bool), 120.0, False, np.random.default_rng(5))
    assert np.array_equal(held.half_valid, held.phase)
    assert not held.half_subtracted.any()


def still(model: ReceiverModel, duration_s: int) -> Session:
    antenna = Antenna.still(BASE_M)
    stop = START + duration_s * SECOND
    rng = np.random.default_rng(11)
    return simulate(antenna, antenna, (START, stop), rng=rng, rover_model=model)


def test_phase_goes_as_the_doppler_says_between_slips() -> None:
    observations = still(ReceiverModel(slips_per_hour=20.0, code_multipath_m=0.0), 200).rover
    pairs = 0
    for index in range(len(observations.satellites)):
        for signal in (0, 1):
            rows = observations.rows
            mine = rows[(rows["satellite"] == index) & (rows["signal"] == signal)]
            near = (np.diff(mine["epoch"]) == 1) & mine["has_phase"][1:] & mine["has_phase"][:-1]
            unbroken = near & (np.diff(mine["lock_s"]) > 0) & (np.diff(mine["half_valid"].astype(int)) == 0)
            step = (
                np.diff(mine["phase_cycles"]) + 0.2 * (mine["doppler_hz"][1:] + mine["doppler_hz"][:-1]) / 2
            )
            wavelength = observations.signal(index, signal).wavelength_m if len(mine) else 1.0
            # The oscillator's noise within a step is a few centimetres, the same for all: a slip is a cycle.
            assert np.all(np.abs(step[unbroken]) * wavelength < 0.14)
            pairs += int(unbroken.sum())
    assert pairs > 20_000


def test_code_and_phase_part_by_the_ionosphere_alone() -> None:
    """Phase less code is minus twice the delay and a constant; without noise only the layer moves."""
    model = ReceiverModel(slips_per_hour=0.0, code_multipath_m=0.0, phase_multipath_m=0.0)
    observations = still(model, 300).rover
    rows = observations.rows
    for index in sorted(set(rows["satellite"].tolist())):
        drift = []
        for signal in (0, 1):
            mine = rows[(rows["satellite"] == index) & (rows["signal"] == signal) & rows["half_valid"]]
            apart = mine["code_m"] - mine["phase_cycles"] * observations.signal(index, signal).wavelength_m
            half = len(apart) // 2
            drift.append(apart[half:].mean() - apart[:half].mean())
        square = (1575.42e6 / observations.signal(index, 1).frequency_hz) ** 2
        noise = 4 * 0.5 / np.sqrt(len(rows) / len(set(rows["satellite"])) / 4)
        assert drift[1] == pytest.approx(square * drift[0], abs=noise * 3)


def test_clock_steps_move_time_code_and_phase_together() -> None:
    """A clock half a millisecond off is set: whole cycles of all carriers, no slip, flagged once."""
    model = ReceiverModel(clock_bias_s=0.4999e-3, clock_drift=1e-6, slips_per_hour=0.0, mask_deg=15.0)
    observations = still(model, 30).rover
    clock = observations.clock
    assert clock.step.sum() == 1
    at = int(np.flatnonzero(clock.step)[0])
    assert np.abs(clock.bias_s).max() <= 0.5e-3 + 1e-6
    rows = observations.rows
    checked = 0
    for index in set(rows["satellite"].tolist()):
        for signal in (0, 1):
            mine = rows[(rows["satellite"] == index) & (rows["signal"] == signal)]
            before, after = (mine[mine["epoch"] == e] for e in (at - 1, at))
            if not (len(before) and len(after) and before["half_valid"][0] and after["half_valid"][0]):
                continue
            frequency = observations.signal(index, signal).frequency_hz
            jump = float(after["phase_cycles"][0] - before["phase_cycles"][0])
            # The clock was set back: a millisecond more has passed.
            doppler = float(after["doppler_hz"][0] + before["doppler_hz"][0]) / 2 * 0.201
            assert jump + doppler == pytest.approx(-frequency * 1e-3, abs=0.8)
            assert after["lock_s"][0] > before["lock_s"][0]
            checked += 1
    assert checked > 20


def test_gap_and_mask() -> None:
    free = fly(duration_s=40)
    faulty = fly(duration_s=40, rover_model=replace(ROVER, gaps_s=((10.0, 20.0),)))
    seconds = faulty.rover.clock.tag_gps_ns[faulty.rover.rows["epoch"]] / 1e9 - START / 1e9
    assert not ((seconds > 10.01) & (seconds < 19.99)).any()
    assert (seconds > 26).any()
    assert (seconds < 9).any()
    # Nothing changes at the base.
    assert np.array_equal(free.base.rows, faulty.base.rows)
    assert np.degrees(free.rover.rows["elevation"].min()) >= 8.0


def test_the_same_seed_gives_the_same_bytes() -> None:
    one, two, other = (fly(duration_s=35, seed=seed) for seed in (1, 1, 2))
    data = [
        (rover_ubx(s, rng=np.random.default_rng(0)).data, base_ubx(s).data, base_rtcm(s).data)
        for s in (one, two, other)
    ]
    assert data[0] == data[1]
    assert all(a != b for a, b in zip(data[0], data[2], strict=True))


def test_an_unhealthy_satellite_says_so() -> None:
    session = fly(duration_s=40, sky=SkySettings(unhealthy=("G01", "E01")))
    bad = {s.name for s in session.satellites if s.truth.health != 0}
    assert bad == {"G01", "E01"} & {s.name for s in session.satellites}


def test_rtklib_sees_the_slips(tmp_path: Path) -> None:
    """Loss of lock: bit 0 where an arc begins or half a cycle goes, bit 1 while half a cycle is not known."""
    session = fly(rover_model=replace(ROVER, slips_per_hour=360.0))
    lines = to_rinex(streams(session), tmp_path).rover.read_text().split("END OF HEADER")[1].splitlines()[1:]
    seen: dict[tuple[str, int, int], int] = {}
    epoch = -1
    for line in lines:
        if line.startswith(">"):
            epoch += 1
            continue
        for signal, at in ((0, 19), (1, 83)):
            if line[at : at + 14].strip():
                seen[line[:3], signal, epoch] = int(line[at + 14 : at + 15].strip() or 0)
    rows = session.rover.rows
    begun = lost = 0
    for index, satellite in enumerate(session.satellites):
        for signal in (0, 1):
            mine = rows[(rows["satellite"] == index) & (rows["signal"] == signal) & rows["has_phase"]]
            flags = np.array([seen[satellite.name, signal, e] for e in mine["epoch"].tolist()], int)
            passed = np.diff(mine["epoch"]) * 0.2
            new = np.diff(mine["lock_s"]) < passed - 0.05
            new |= mine["half_subtracted"][1:] != mine["half_subtracted"][:-1]
            assert np.array_equal(flags[1:] & 1 > 0, new)
            assert np.array_equal(flags & 2 > 0, ~mine["half_valid"])
            begun += int(new.sum())
            lost += int((~mine["half_valid"]).sum())
    # 36 signals, a slip every ten seconds.
    assert begun > 250
    assert lost > 500


def test_sessions_that_cannot_be_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"0 s is too short for measurements every 1 s"):
        fly(duration_s=0)


def decoded(events: Pulses, start: int = START) -> list[tuple[int, int, int, int]]:
    """Week and milliseconds of the rising edge, count and flags, by the byte offsets of the description."""
    clock = run_clock(
        ReceiverModel(clock_bias_s=2e-4, clock_drift=0.0),
        start,
        start + 20 * SECOND,
        np.random.default_rng(0),
    )
    found = []
    for _, p in time_mark_messages(events, clock, 18, np.random.default_rng(0)):
        number = [int.from_bytes(p[a:b], "little") for a, b in ((4, 6), (8, 12), (2, 4), (1, 2))]
        found.append((number[0], number[1], number[2], number[3]))
    return found


def test_time_bases() -> None:
    edge = np.array([START + 5 * SECOND])
    tow = START // 1_000_000 % 604_800_000 + 5000
    assert decoded(Pulses(edge, accuracy_s=0.0))[0][1] == tow
    utc = decoded(Pulses(edge, time_base="utc", stamped_in="utc", accuracy_s=0.0))[0]
    assert (utc[1], utc[3] >> 3 & 3) == (tow - 18_000, 2)
    wrong = decoded(Pulses(edge, stamped_in="utc", accuracy_s=0.0))[0]
    assert (wrong[1], wrong[3] >> 3 & 3) == (tow - 18_000, 1)
    own = decoded(Pulses(edge, time_base="receiver", stamped_in="receiver", accuracy_s=0.0))[0]
    assert own[3] >> 3 & 3 == 0


def test_edges_share_a_message_or_follow() -> None:
    """Both within one epoch: one message; else two with the same count; the counter goes round."""
    rising = START + np.array([3.01, 3.03, 6.15]) * SECOND
    falling = START + np.array([3.02, 3.04, 6.35]) * SECOND
    found = decoded(Pulses(rising.astype(np.int64), falling.astype(np.int64), first_count=65_534))
    assert [(count, flags & 0x80 > 0, flags & 0x04 > 0) for _, _, count, flags in found] == [
        (65_535, True, True),
        (0, True, True),
        (1, True, False),
        (1, False, True),
    ]


def test_edges_at_the_change_of_the_week() -> None:
    start = gps_ns(2025, 6, 14, 23, 59, 50)
    edges = start + np.array([9.9, 10.1]) * SECOND
    found = decoded(Pulses(edges.astype(np.int64), accuracy_s=0.0), start)
    assert [(week, tow) for week, tow, *_ in found] == [(2370, 604_799_900), (2371, 100)]
