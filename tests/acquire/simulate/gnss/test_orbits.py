"""What RTKLIB decodes is what was flown; light time, rates and clocks against independent computations."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from acquire.simulate.gnss import navigation_messages
from acquire.simulate.gnss.constellation import Satellite, constellation, link, place
from acquire.simulate.gnss.ephemeris import Ephemeris, fields_of, renewed
from acquire.simulate.gnss.navigation_messages import subframe
from acquire.simulate.gnss.settings import SkySettings
from tests.acquire.simulate.gnss.flights import BASE_M, SECOND, START, Flight, Floats, Loop, gps_ns
from tests.acquire.simulate.gnss.rtklib import Rinex

LIGHT, EARTH_RATE = 299_792_458.0, 7.2921151467e-5
MU = {"G": 3.986005e14, "E": 3.986004418e14}
NAMES = (
    *("af0", "af1", "af2", "issue", "crs", "delta_n", "m0", "cuc", "e", "cus", "sqrt_a", "toe", "cic"),
    *("omega0", "cis", "i0", "crc", "omega", "omega_dot", "idot", "source", "week", "spare", "accuracy"),
    *("health", "delay1", "delay2", "sent", "fit"),
)


def read_navigation(text: str) -> list[tuple[str, dict[str, float]]]:
    """Read RINEX 3 ephemerides by their columns."""
    lines = text[text.index("END OF HEADER") :].splitlines()[1:]
    found = []
    for at in range(0, len(lines), 8):
        numbers = [lines[at][start : start + 19] for start in (23, 42, 61)]
        for line in lines[at + 1 : at + 8]:
            numbers += [line[start : start + 19] for start in (4, 23, 42, 61)]
        values = [float(n.replace("D", "e")) for n in numbers if n.strip()]
        epoch = dt.datetime(*map(int, lines[at][4:23].split()))  # type: ignore[arg-type]
        named = dict(zip(NAMES, values, strict=False))
        found.append((lines[at][:3], named | {"toc": (epoch - dt.datetime(1980, 1, 6)).total_seconds()}))
    return found


def by_rotations(system: str, p: dict[str, float], gps_s: int, fraction: float) -> tuple[Floats, float]:
    """Position and clock from the orbit's plane, turned by rotations; Kepler's equation by bisection."""
    tk = gps_s - (p["week"] * 604_800 + p["toe"]) + fraction
    axis = p["sqrt_a"] ** 2
    mean = p["m0"] + (np.sqrt(MU[system] / axis**3) + p["delta_n"]) * tk
    anomaly = brentq(lambda e: e - p["e"] * np.sin(e) - mean, mean - 1, mean + 1, xtol=1e-14, rtol=1e-15)
    plane = axis * np.array([np.cos(anomaly) - p["e"], np.sqrt(1 - p["e"] ** 2) * np.sin(anomaly)])
    latitude = np.arctan2(plane[1], plane[0]) + p["omega"]
    twice = np.array([np.cos(2 * latitude), np.sin(2 * latitude)])
    radius = np.hypot(*plane) + twice @ [p["crc"], p["crs"]]
    argument = latitude + twice @ [p["cuc"], p["cus"]]
    tilt = p["i0"] + p["idot"] * tk + twice @ [p["cic"], p["cis"]]
    node = p["omega0"] + p["omega_dot"] * tk - EARTH_RATE * (p["toe"] + tk)
    position = Rotation.from_euler("ZXZ", [node, tilt, argument]).apply([radius, 0.0, 0.0])
    since = gps_s - p["toc"] + fraction
    # Relativity as -2 r.v / c^2 of the two-body motion: r.v = e sqrt(mu a) sin E.
    clock = p["af0"] + p["af1"] * since - 2 * p["e"] * np.sqrt(MU[system] * axis) * np.sin(anomaly) / LIGHT**2
    return position, clock


def exact(sent: Ephemeris, decoded: dict[str, float]) -> dict[str, float]:
    """Undo RINEX's rounding to twelve digits, 0.15 mm on an angle above one radian.

    What is transmitted is a whole number of units: the nearest one, from which the rounding is far.
    """
    units = {name: field.scale for name, field in fields_of(sent.system).items() if name in decoded}
    whole = {name: decoded[name] / unit for name, unit in units.items() if name != "toc"}
    assert all(abs(value - round(value)) < 0.02 for value in whole.values())
    assert {name: round(value) for name, value in whole.items()} == {name: sent.raw[name] for name in whole}
    return decoded | {name: round(value) * units[name] for name, value in whole.items()}


def test_orbits_as_rtklib_decodes_them(flight: Flight, rinex: Rinex) -> None:
    session = flight.session
    satellites = {s.name: s for s in session.satellites}
    found = read_navigation(rinex.navigation.read_text())
    names = {session.satellites[i].name for i in set(session.rover.rows["satellite"].tolist())}
    assert {name for name, _ in found} == names
    assert len(names) >= 14
    for name, decoded in found:
        sent = next(s for s in satellites[name].sets if s.toe_gps_ns == round(decoded["toc"]) * SECOND)
        parameters = exact(sent, decoded)
        for seconds in (0, 77, 109):
            state = Satellite((sent,)).state(np.array([seconds + 0.25]), START)
            position, clock = by_rotations(name[0], parameters, START // SECOND + seconds, 0.25)
            assert np.abs(state.position_m[0] - position).max() < 1e-5
            assert abs(state.clock_s[0] - clock) * LIGHT < 1e-5


@pytest.mark.parametrize("system", ["G", "E"])
def test_delays_issue_and_health_as_rtklib_decodes_them(system: str, rinex: Rinex, flight: Flight) -> None:
    satellites = {s.name: s for s in flight.session.satellites}
    for name, p in read_navigation(rinex.navigation.read_text()):
        if name[0] != system or round(p["toc"]) * SECOND != satellites[name].truth.toe_gps_ns:
            continue
        truth = satellites[name].truth
        assert p["issue"] == (truth.issue & 0xFF if system == "G" else truth.issue)
        assert p["health"] == 0
        assert p["week"] == START // SECOND // 604_800
        if system == "G":
            assert p["delay1"] == pytest.approx(truth.value("tgd"), rel=1e-11, abs=1e-20)
        else:
            assert p["delay1"] == pytest.approx(truth.value("bgd_e5a"), rel=1e-11, abs=1e-20)
            assert p["delay2"] == pytest.approx(truth.value("bgd_e5b"), rel=1e-11, abs=1e-20)


def test_rtcm_brings_the_same_ephemerides(rinex: Rinex) -> None:
    ours, theirs = (
        {(name, p["toc"]): p for name, p in read_navigation(path.read_text())}
        for path in (rinex.navigation, rinex.navigation_of_rtcm)
    )
    common = ours.keys() & theirs.keys()
    assert len(common) >= 14
    for key in common:
        for name in NAMES[:20]:
            assert ours[key][name] == theirs[key][name], (key, name)


def test_velocity_and_clock_rate_are_derivatives(flight: Flight) -> None:
    step = 0.5
    for satellite in flight.session.satellites[::7]:
        before, here, after = (satellite.state(np.array([90.0 + d]), START) for d in (-step, 0, step))
        assert np.allclose((after.position_m - before.position_m) / (2 * step), here.velocity_m_s, atol=1e-4)
        rate = (after.clock_s - before.clock_s) / (2 * step)
        assert np.allclose(rate * LIGHT, here.clock_rate * LIGHT, atol=1e-6)


def test_range_is_that_of_inertial_space(flight: Flight) -> None:
    """Both ends turned to a frame that does not rotate: there light goes straight."""
    way = Loop(START)
    seconds = np.array([33.3])
    nanoseconds = START + np.rint(seconds * 1e9).astype(np.int64)
    here = place(way.position(nanoseconds), way.velocity(nanoseconds))
    arrival = Rotation.from_euler("z", EARTH_RATE * seconds[0]).apply(here.position_m[0])
    for satellite in flight.session.satellites[::6]:

        def late(travel: float, satellite: Satellite = satellite) -> tuple[float, float]:
            sent = seconds - travel
            state = satellite.state(sent, START)
            inertial = Rotation.from_euler("z", EARTH_RATE * sent[0]).apply(state.position_m[0])
            return float(np.linalg.norm(inertial - arrival)), float(state.clock_s[0])

        travel = brentq(lambda t: late(t)[0] / LIGHT - t, 0.04, 0.12, xtol=1e-16, rtol=1e-15)
        found = link(satellite, seconds, START, here)
        assert found.range_m[0] == pytest.approx(late(travel)[0], abs=1e-5)
        assert found.clock_s[0] == pytest.approx(late(travel)[1], abs=1e-16)


def test_range_rate_is_the_derivative(flight: Flight) -> None:
    way = Loop(START)
    seconds = 60 + np.array([-0.1, 0.0, 0.1])
    nanoseconds = START + np.rint(seconds * 1e9).astype(np.int64)
    here = place(way.position(nanoseconds), way.velocity(nanoseconds))
    for satellite in flight.session.satellites[::6]:
        found = link(satellite, seconds, START, here)
        assert found.range_rate_m_s[1] == pytest.approx((found.range_m[2] - found.range_m[0]) / 0.2, abs=5e-3)


def test_almanacs_are_near_the_ephemerides(flight: Flight) -> None:
    """The pages of subframes 4 and 5 by their bits (IS-GPS-200N, figure 20-1 sheet 4): some kilometres."""
    truths = {s.truth.number: s for s in flight.session.satellites if s.system == "G"}
    almanacs = tuple(s.truth for s in truths.values())
    found = set()
    first = START // SECOND // 750 * 750
    for at in range(first, first + 750, 6):
        words = subframe(truths[min(truths)].truth, at, SkySettings(), almanacs)
        bits = "".join(format(word >> 6 & 0xFF_FFFF, "024b") for word in words)
        number = int(bits[50:56], 2)
        if bits[43:46] not in ("100", "101") or number not in truths:
            continue
        places = [(56, 16), (72, 8), (80, 16), (96, 16), (120, 24), (144, 24), (168, 24), (192, 24)]
        e, toa, tilt, node_rate, root, node, argument, mean = (signed(bits[a : a + n]) for a, n in places)
        # Two of them have no sign.
        toa, root = toa % 256 * 4096, root % (1 << 24)
        parameters = dict.fromkeys(NAMES[:21], 0.0) | {
            "toe": toa,
            "toc": 0.0,
            "week": START // SECOND // 604_800,
            "e": e * 2**-21,
            "sqrt_a": root * 2**-11,
            "i0": (0.3 + tilt * 2**-19) * np.pi,
            "omega_dot": node_rate * 2**-38 * np.pi,
            "omega0": node * 2**-23 * np.pi,
            "omega": argument * 2**-23 * np.pi,
            "m0": mean * 2**-23 * np.pi,
        }
        position, _ = by_rotations("G", parameters, START // SECOND, 0.0)
        assert abs(toa - START // SECOND % 604_800) < 3 * 4096
        assert np.linalg.norm(position - truths[number].state(np.array([0.0]), START).position_m[0]) < 10e3
        found.add(number)
    assert found == set(truths)


def test_galileo_almanacs_are_near_the_ephemerides(flight: Flight) -> None:
    """Words 7 to 10 by their bits (Galileo OS SIS ICD 2.1, tables 48 to 51): angles to 1e-4 rad, 3 km."""
    satellites = {s.truth.number: s for s in flight.session.satellites if s.system == "E"}
    truths = [s.truth for s in satellites.values()]
    first = START // SECOND // 30 * 30
    places = {"root": 13, "e": 11, "omega": 16, "tilt": 11}
    node = {"omega0": 16, "omega_dot": 11}
    clock = {"af0": 16, "af1": 13, "health": 4}
    words = {
        7: [{"week": 2, "toa": 10}, {"number": 6} | places | node | {"m0": 16}],
        8: [clock, {"number": 6} | places | node],
        9: [{"week": 2, "toa": 10}, {"m0": 16} | clock, {"number": 6} | places],
        10: [node | {"m0": 16} | clock],
    }
    # What a word brings belongs to the first, second or third satellite of its minute.
    owner = {7: (None, 0), 8: (0, 1), 9: (None, 1, 2), 10: (2,)}
    checked = set()
    for minute in range(first + first % 60, first + first % 60 + 480, 60):
        found: dict[int | None, dict[str, int]] = {None: {}, 0: {}, 1: {}, 2: {}}
        for at in (6, 8, 36, 38):
            page = "".join(
                format(w, "032b")
                for w in navigation_messages.page(truths[0], minute + at, "E5b", 18, truths)[:8]
            )
            word = page[2:114] + page[130:146]
            kind, bit = int(word[:6], 2), 10
            for whose, fields in zip(owner[kind], words[kind], strict=True):
                for name, width in fields.items():
                    found[whose][name] = signed(word[bit : bit + width])
                    bit += width
        for p in (found[0], found[1], found[2]):
            truth = satellites[p["number"] % 64]
            toe = found[None]["toa"] % 1024 * 600
            parameters = dict.fromkeys(NAMES[:21], 0.0) | {
                "toe": toe,
                "toc": 0.0,
                "week": START // SECOND // 604_800,
                "e": p["e"] * 2**-16,
                "sqrt_a": 29_600_000**0.5 + p["root"] * 2**-9,
                "i0": (56 / 180 + p["tilt"] * 2**-14) * np.pi,
                "omega_dot": p["omega_dot"] * 2**-33 * np.pi,
                "omega0": p["omega0"] * 2**-15 * np.pi,
                "omega": p["omega"] * 2**-15 * np.pi,
                "m0": p["m0"] * 2**-15 * np.pi,
            }
            position, _ = by_rotations("E", parameters, START // SECOND, 0.0)
            state = truth.state(np.array([0.0]), START)
            assert np.linalg.norm(position - state.position_m[0]) < 12e3
            assert p["af0"] * 2**-19 == pytest.approx(truth.truth.value("af0"), abs=2**-20)
            checked.add(truth.name)
    assert len(checked) == 24


def signed(bits: str) -> int:
    return int(bits, 2) - (1 << len(bits) if bits[0] == "1" else 0)


@pytest.mark.parametrize("when", [(2025, 6, 15, 13, 7, 0), (2025, 6, 14, 23, 50, 0)])
def test_a_renewed_set_goes_on_with_the_orbit(when: tuple[int, ...]) -> None:
    """Also into a new week. Left is the quantisation: 2 cm for each of the angles, 7 cm of the clock."""
    start = gps_ns(*when)
    for satellite in constellation(start, start + SECOND, np.random.default_rng(3))[::5]:
        old = satellite.truth
        new = renewed(old, old.toe_gps_ns + 7200 * SECOND, issue=old.issue + 1, from_gps_ns=start)
        seconds = np.array([0.0, 1800.0, 3600.0])
        one, two = (Satellite((s,)).state(seconds, start) for s in (old, new))
        assert np.abs(one.position_m - two.position_m).max() < 0.15
        assert np.abs(one.clock_s - two.clock_s).max() * LIGHT < 0.15


def test_the_sky_is_full_everywhere() -> None:
    """At any place and time six satellites of GPS and four of Galileo stand above 10 degrees."""
    for seed in range(4):
        satellites = constellation(START, START + SECOND, np.random.default_rng(seed))
        assert sum(s.system == "G" for s in satellites) == 31
        assert sum(s.system == "E" for s in satellites) == 24
        rng = np.random.default_rng(seed + 10)
        sites = rng.standard_normal((20, 3))
        sites *= np.linalg.norm(BASE_M) / np.linalg.norm(sites, axis=1)[:, None]
        here = place(sites, np.zeros((20, 3)))
        seconds = np.sort(rng.uniform(0, 86_400, 20))
        up = {"G": np.zeros(20), "E": np.zeros(20)}
        for satellite in satellites:
            up[satellite.system] += link(satellite, seconds, START, here).elevation > np.radians(10)
        assert np.min(up["G"]) >= 6
        assert np.min(up["E"]) >= 4
