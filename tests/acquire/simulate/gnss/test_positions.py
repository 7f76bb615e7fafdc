"""RTKLIB by hand and `photocal ppk` find the truth in the simulated streams."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from acquire.commands.cli import app as acquire_app
from acquire.simulate.gnss.settings import ROVER, SkySettings
from photocal.commands.cli import app as photocal_app
from tests.acquire.simulate.gnss.flights import (
    AXES,
    BASE_M,
    DURATION_S,
    START,
    Flight,
    Floats,
    Loop,
    Times,
    ecef,
    fly,
    gps_ns,
    streams,
)
from tests.acquire.simulate.gnss.rtklib import Rinex, Solution, positions, to_rinex

EPOCHS = 5 * DURATION_S + 1


def at_base(time: Times) -> Floats:
    return np.tile(BASE_M, (len(time), 1))


@pytest.mark.parametrize("receiver", ["rover", "base"])
def test_codes_alone_give_the_position(receiver: str, tmp_path: Path) -> None:
    """By night and with the ionosphere of the message nothing is left but noise, multipath and delays."""
    start = gps_ns(2025, 6, 15, 4, 10, 0)
    session = fly(start, 120, sky=SkySettings(ionosphere_scale=1.0, wave_m=0.0, wet_sigma_m=0.0))
    files = to_rinex(streams(session), tmp_path)
    solution = positions([getattr(files, receiver), files.navigation], tmp_path, "single")
    error = solution.error_enu(at_base if receiver == "base" else Loop(start).position)
    assert len(error) == (121 if receiver == "base" else 601)
    # A delay of a satellite of the wrong sign, 1 to 4 m, shows in the mean; the noise shows in the scatter.
    assert np.all(np.abs(error.mean(axis=0)) < [0.6, 0.6, 1.2])
    assert np.all(error.std(axis=0) < [0.8, 0.8, 1.6])


@pytest.fixture(scope="module")
def by_hand(rinex: Rinex, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Solution]:
    """Forward and combined against the base of RTCM."""
    folder = tmp_path_factory.mktemp("by-hand")
    files = [rinex.rover, rinex.base_of_rtcm, rinex.navigation]
    return {way: positions(files, folder, "kinematic", way) for way in ("forward", "combined")}


def is_fixed_and_true(solution: Solution, start: int, epochs: int) -> None:
    error = solution.error_enu(Loop(start).position)
    fixed = solution.quality == 1
    assert len(fixed) == epochs
    assert fixed.mean() > 0.95
    assert np.linalg.norm(error[fixed], axis=1).max() < 0.03


def test_rover_against_base_is_fixed_and_true(by_hand: dict[str, Solution]) -> None:
    for solution in by_hand.values():
        is_fixed_and_true(solution, START, EPOCHS)


def test_raw_base_is_as_good_as_rtcm(rinex: Rinex, by_hand: dict[str, Solution], tmp_path: Path) -> None:
    """RTCM rounds phases to 0.14 mm, codes to 0.6 mm."""
    raw = positions([rinex.rover, rinex.base, rinex.navigation], tmp_path, "kinematic")
    is_fixed_and_true(raw, START, EPOCHS)
    assert np.abs(raw.position_m - by_hand["forward"].position_m).max() < 0.001


def test_positions_belong_to_gps_time(by_hand: dict[str, Solution]) -> None:
    """The rover's clock is a third of a millisecond off, 3 mm of its way at 10 m/s."""
    solution = by_hand["forward"]
    tags = np.rint(solution.time / 2e8).astype(np.int64) * 200_000_000
    assert np.abs(solution.time - tags).min() > 300_000
    way = Loop(START)
    along = way.velocity(solution.time)
    along /= np.linalg.norm(along, axis=1)[:, None]
    late, right = (
        float(np.einsum("ij,ij->i", solution.position_m - way.position(time), along).mean())
        for time in (tags, solution.time)
    )
    assert abs(right) < 0.0015
    assert abs(late) > 0.0025


Rows = list[dict[str, str]]


def ppk(flight: Flight, folder: Path) -> Rows:
    """Import the streams and process them as a user does."""
    rover, base, log = folder / "rover.ubx", folder / "base.rtcm3", folder / "flight.mcap"
    rover.write_bytes(flight.rover.data)
    base.write_bytes(flight.base_rtcm.data)
    arguments = ["import", "--link", f"rover={rover}", "--link", f"base={base}", "-o", str(log)]
    done = CliRunner().invoke(acquire_app, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    done = CliRunner().invoke(photocal_app, ["ppk", str(log), "-o", str(folder / "ppk"), "--json"])
    assert done.exit_code == 0, (done.output, done.exception)
    with (folder / "ppk/trajectory.csv").open() as stream:
        return list(csv.DictReader(stream))


def times(rows: Rows) -> Times:
    return np.array([int(row["time_gps_ns"]) for row in rows], np.int64)


def fixes(rows: Rows) -> NDArray[np.bool_]:
    return np.array([row["status"] == "fixed" for row in rows])


def geocentric(rows: Rows) -> Floats:
    return np.array([ecef(float(r["lat_deg"]), float(r["lon_deg"]), float(r["height_m"])) for r in rows])


def errors(rows: Rows) -> Floats:
    """Distances from the truth."""
    return np.asarray(np.linalg.norm(geocentric(rows) - Loop(START).position(times(rows)), axis=1))


@pytest.fixture(scope="module")
def trajectory(flight: Flight, rinex: Rinex, tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return ppk(flight, tmp_path_factory.mktemp("ppk"))


def test_photocal_fixes_the_flight(trajectory: Rows) -> None:
    assert len(trajectory) == EPOCHS
    assert fixes(trajectory).mean() > 0.95
    assert errors(trajectory)[fixes(trajectory)].max() < 0.03


def test_photocal_agrees_with_rtklib_by_hand(trajectory: Rows, by_hand: dict[str, Solution]) -> None:
    combined = by_hand["combined"]
    assert np.abs(times(trajectory) - combined.time).max() <= 1
    assert np.abs(geocentric(trajectory) - combined.position_m).max() < 0.001


def test_a_base_off_by_a_metre_moves_all(tmp_path: Path, trajectory: Rows) -> None:
    """The same noise, another announced position: every point goes along, and the fixes do not tell it."""
    moved = ppk(streams(fly(base_shift_m=(0.6, 0.0, 0.8))), tmp_path)
    shift = (geocentric(moved) - geocentric(trajectory)) @ AXES.T
    assert np.allclose(np.median(shift, axis=0), [0.6, 0.0, 0.8], atol=0.002)
    assert fixes(moved).mean() > 0.95


@pytest.mark.parametrize("rate", [360.0, 1800.0])
def test_slips_everywhere_bring_no_wrong_fix(rate: float, rinex: Rinex, tmp_path: Path) -> None:
    """A slip of each signal every ten (two) seconds."""
    rows = ppk(streams(fly(rover_model=replace(ROVER, slips_per_hour=rate))), tmp_path)
    assert not np.any(errors(rows)[fixes(rows)] > 0.05)


def test_a_gap_is_a_gap(rinex: Rinex, tmp_path: Path) -> None:
    """The engine fixes one epoch wrongly while the channels lock again; photocal does not believe it."""
    rows = ppk(streams(fly(rover_model=replace(ROVER, gaps_s=((50.0, 65.0),)))), tmp_path)
    seconds = (times(rows) - START) / 1e9
    assert not np.any((seconds > 50.0) & (seconds < 65.0))
    # Channels need up to four seconds to lock again.
    assert 5 * 15 <= EPOCHS - len(seconds) <= 5 * 19
    assert fixes(rows).mean() > 0.95
    assert errors(rows)[fixes(rows)].max() < 0.03


def test_a_new_week_begins_in_flight(tmp_path: Path) -> None:
    """Midnight from Saturday to Sunday: a new week, new two hours, new sets of all satellites."""
    start = gps_ns(2025, 6, 14, 23, 59, 0)
    files = to_rinex(streams(fly(start, 120)), tmp_path)
    for base, navigation in ((files.base, files.navigation), (files.base_of_rtcm, files.navigation_of_rtcm)):
        is_fixed_and_true(positions([files.rover, base, navigation], tmp_path, "kinematic"), start, 601)


def test_no_fix_is_wrong_where_the_engine_combines_badly(rinex: Rinex, tmp_path: Path) -> None:
    """The engine's combination of both directions has two epochs 0.2 m off; neither of them has."""
    rows = ppk(streams(fly(seed=5)), tmp_path)
    assert errors(rows)[fixes(rows)].max() < 0.03
