"""A synthetic telemetry log: a small survey of two strips, the same bytes each time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import Dialect

LABEL = "SYNTHETIC FLIGHT, made by photocal"
START_UTC_US = 1_777_626_000_000_000  # 2026-05-01 09:00:00 UTC
BOOT_MS_AT_START = 42_000
HOST_DELAY_US = 8_000
DURATION_S = 60.0
SYSTEM, COMPONENT = 1, 1

# The area: two strips of 275 m to the north, 30 m apart, flown at 10 m/s.
ORIGIN_DEG = (47.5, 8.5)
GROUND_MSL_M, ABOVE_GROUND_M = 430.0, 80.0
SPEED_M_S, STRIP_M, SPACING_M = 10.0, 275.0, 30.0
EXPOSURE_EVERY_S = 2.0
_METRES_PER_DEG = 111_195.0  # mean sphere of 6371 km: a demonstration needs no ellipsoid
_TICK_S = 0.05


@dataclass(frozen=True)
class State:
    """Where the vehicle is at one moment: metres from the origin, radians, metres per second."""

    north_m: float
    east_m: float
    roll: float
    pitch: float
    yaw: float
    north_m_s: float
    east_m_s: float


def state(time_s: float) -> State:
    """Return where the vehicle is: up one strip, a half circle, down the other one."""
    along = SPEED_M_S * time_s
    turn = math.pi * SPACING_M / 2
    sway = 0.02 * math.sin(1.3 * time_s), 0.015 * math.sin(0.9 * time_s + 0.4)
    if along < STRIP_M:
        return State(along, 0.0, sway[0], 0.03 + sway[1], 0.0, SPEED_M_S, 0.0)
    if along < STRIP_M + turn:
        angle = (along - STRIP_M) / (SPACING_M / 2)
        north = STRIP_M + SPACING_M / 2 * math.sin(angle)
        east = SPACING_M / 2 * (1 - math.cos(angle))
        speed = SPEED_M_S * math.cos(angle), SPEED_M_S * math.sin(angle)
        bank = math.atan2(SPEED_M_S**2, 9.81 * SPACING_M / 2)
        return State(north, east, bank + sway[0], 0.03 + sway[1], angle, *speed)
    back = min(along - STRIP_M - turn, STRIP_M)
    return State(STRIP_M - back, SPACING_M, sway[0], 0.03 + sway[1], -math.pi, -SPEED_M_S, 0.0)


def telemetry_log(dialect: Dialect) -> bytes:
    """Return the bytes of the flight as a `.tlog`."""
    log = bytearray()
    for sequence, (time_s, name, values) in enumerate(_messages()):
        frame = encode(
            dialect,
            dialect.number(name),
            values,
            sequence=sequence,
            system=SYSTEM,
            component=COMPONENT,
        )
        stamp = START_UTC_US + round(time_s * 1e6) + HOST_DELAY_US
        log += stamp.to_bytes(8, "big") + frame
    return bytes(log)


def _messages() -> Iterator[tuple[float, str, dict[str, Any]]]:
    exposure = 0
    for tick in range(round(DURATION_S / _TICK_S)):
        time_s = tick * _TICK_S
        now = state(time_s)
        if tick == 0:
            yield time_s, "STATUSTEXT", {"severity": 6, "text": LABEL.encode()}
        if tick % 20 == 0:
            yield time_s, "HEARTBEAT", _heartbeat()
            yield time_s, "SYSTEM_TIME", _system_time(time_s)
            yield time_s, "SYS_STATUS", _sys_status(time_s)
        if tick % 5 == 0:
            yield time_s, "ATTITUDE", _attitude(time_s, now)
            yield time_s, "GLOBAL_POSITION_INT", _position(time_s, now)
        if tick % 10 == 0:
            yield time_s, "GPS_RAW_INT", _gps(time_s, now)
        if tick and tick % round(EXPOSURE_EVERY_S / _TICK_S) == 0:
            exposure += 1
            yield time_s, "CAMERA_FEEDBACK", _feedback(time_s, now, exposure)


def _boot_ms(time_s: float) -> int:
    return BOOT_MS_AT_START + round(time_s * 1e3)


def _degrees_e7(now: State) -> tuple[int, int]:
    latitude = ORIGIN_DEG[0] + now.north_m / _METRES_PER_DEG
    longitude = ORIGIN_DEG[1] + now.east_m / (_METRES_PER_DEG * math.cos(math.radians(ORIGIN_DEG[0])))
    return round(latitude * 1e7), round(longitude * 1e7)


def _heartbeat() -> dict[str, Any]:
    # MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_ARDUPILOTMEGA, armed with custom mode, MAV_STATE_ACTIVE
    return {
        "type": 2,
        "autopilot": 3,
        "base_mode": 209,
        "custom_mode": 3,
        "system_status": 4,
        "mavlink_version": 3,
    }


def _system_time(time_s: float) -> dict[str, Any]:
    return {"time_unix_usec": START_UTC_US + round(time_s * 1e6), "time_boot_ms": _boot_ms(time_s)}


def _sys_status(time_s: float) -> dict[str, Any]:
    return {
        "voltage_battery": 16_200 - round(6 * time_s),
        "current_battery": 1_430,
        "battery_remaining": 91 - round(time_s / 10),
        "load": 312,
    }


def _attitude(time_s: float, now: State) -> dict[str, Any]:
    return {"time_boot_ms": _boot_ms(time_s), "roll": now.roll, "pitch": now.pitch, "yaw": now.yaw}


def _position(time_s: float, now: State) -> dict[str, Any]:
    latitude, longitude = _degrees_e7(now)
    return {
        "time_boot_ms": _boot_ms(time_s),
        "lat": latitude,
        "lon": longitude,
        "alt": round((GROUND_MSL_M + ABOVE_GROUND_M) * 1e3),
        "relative_alt": round(ABOVE_GROUND_M * 1e3),
        "vx": round(now.north_m_s * 100),
        "vy": round(now.east_m_s * 100),
        "hdg": round(math.degrees(now.yaw) % 360 * 100),
    }


def _gps(time_s: float, now: State) -> dict[str, Any]:
    latitude, longitude = _degrees_e7(now)
    return {
        "time_usec": _boot_ms(time_s) * 1000,
        "fix_type": 6 if time_s >= 5 else 5,
        "lat": latitude,
        "lon": longitude,
        "alt": round((GROUND_MSL_M + ABOVE_GROUND_M) * 1e3),
        "eph": 62,
        "epv": 90,
        "vel": round(SPEED_M_S * 100),
        "satellites_visible": 17,
        "h_acc": 14 if time_s >= 5 else 320,
        "v_acc": 21 if time_s >= 5 else 510,
    }


def _feedback(time_s: float, now: State, number: int) -> dict[str, Any]:
    latitude, longitude = _degrees_e7(now)
    return {
        "time_usec": START_UTC_US + round(time_s * 1e6),
        "img_idx": number,
        "lat": latitude,
        "lng": longitude,
        "alt_msl": GROUND_MSL_M + ABOVE_GROUND_M,
        "alt_rel": ABOVE_GROUND_M,
        "roll": math.degrees(now.roll),
        "pitch": math.degrees(now.pitch),
        "yaw": math.degrees(now.yaw),
    }
