"""A field at work: a vehicle, a rover and a base that speak, and a recorder that writes what they say."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue
from typing import Any

from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.recorder import record
from acquire.transports.sources import Source
from drivers import rtcm3
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega
from tests.acquire.devices import Receiver
from tests.telemetry import state

TICK_S = 0.1
NO_FIX, RTK_FIXED = 1, 6
_METRES_PER_DEG = 111_195.0
_BASE = (47.5006, 8.5011, 480.0)


class Line(Source):
    """The twin of a port: gives what was put on it."""

    def __init__(self) -> None:
        super().__init__()
        self._pieces: Queue[bytes] = Queue()

    def put(self, data: bytes) -> None:
        self._pieces.put(data)

    def open(self, _stop: threading.Event) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        try:
            return self._pieces.get(timeout=timeout_s)
        except Empty:
            return b""

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


class Field:
    """What goes on; `fix` may be changed at any time."""

    def __init__(self) -> None:
        self.lines = {"vehicle": Line(), "rover": Line(), "base": Line()}
        self.fix = RTK_FIXED
        self.pictures = 0
        self._dialect = ardupilotmega()
        self._sequence = 0
        self._lock = threading.Lock()
        self._start_s = time.monotonic()

    @property
    def age_s(self) -> float:
        return time.monotonic() - self._start_s

    def say(self, name: str, **values: Any) -> None:
        """Let the vehicle say something."""
        with self._lock:
            self._sequence += 1
            number = self._dialect.number(name)
            frame = encode(self._dialect, number, values, sequence=self._sequence, system=1, component=1)
        self.lines["vehicle"].put(frame)

    def take_picture(self, *, feedback: bool = True) -> int:
        """Trigger the camera; return the number of the picture."""
        self.pictures += 1
        now = time.time_ns() // 1000
        self.say("CAMERA_TRIGGER", time_usec=now, seq=self.pictures)
        if feedback:
            latitude, longitude = self.place()
            self.say("CAMERA_FEEDBACK", time_usec=now, img_idx=self.pictures, lat=latitude, lng=longitude)
        return self.pictures

    def tell_fix(self) -> None:
        latitude, longitude = self.place()
        self.say(
            "GPS_RAW_INT", time_usec=round(self.age_s * 1e6), fix_type=self.fix, satellites_visible=17,
            lat=latitude, lon=longitude, alt=510_000, h_acc=14, v_acc=21,
        )  # fmt: skip

    def place(self) -> tuple[int, int]:
        now = state(4 * self.age_s % 60)
        latitude = 47.5 + now.north_m / _METRES_PER_DEG
        longitude = 8.5 + now.east_m / (_METRES_PER_DEG * math.cos(math.radians(47.5)))
        return round(latitude * 1e7), round(longitude * 1e7)

    def tick(self, number: int, receiver: Receiver) -> None:
        latitude, longitude = self.place()
        boot = round(self.age_s * 1e3)
        self.say(
            "GLOBAL_POSITION_INT",
            time_boot_ms=boot,
            lat=latitude,
            lon=longitude,
            alt=510_000,
            relative_alt=80_000,
        )
        if number % 2 == 0:
            self.tell_fix()
        if number % 10 == 0:
            self.say(
                "HEARTBEAT", type=2, autopilot=3, base_mode=209, custom_mode=3, system_status=4,
                mavlink_version=3,
            )  # fmt: skip
            self.say("SYSTEM_TIME", time_unix_usec=time.time_ns() // 1000, time_boot_ms=boot)
            self.say("SYS_STATUS", voltage_battery=15_800, current_battery=1400, battery_remaining=81)
            self.lines["base"].put(station_message())
        self.lines["rover"].put(receiver.due(self.age_s))


@contextmanager
def at_work(folder: Path, flush_s: float = 0.5) -> Iterator[Field]:
    """Let a field work and record it into a folder, safe every so often, until the end of the block."""
    field = Field()
    stop = threading.Event()
    links = [
        {"name": "vehicle", "protocol": "mavlink", "url": "file:x"},
        {"name": "rover", "protocol": "ubx", "url": "file:x"},
        {"name": "base", "protocol": "rtcm3", "url": "file:x", "corrections_to": ["rover"]},
    ]
    configuration = RecordingConfiguration.model_validate(
        {"recording": {"output": str(folder), "flush_s": flush_s}, "link": links}
    )

    def work() -> None:
        receiver, number = Receiver(9), 0
        while not stop.wait(TICK_S):
            field.tick(number, receiver)
            number += 1

    def write() -> None:
        record(configuration, folder, stop, lambda _: None, sources=dict(field.lines))

    threads = [threading.Thread(target=work), threading.Thread(target=write)]
    for thread in threads:
        thread.start()
    try:
        yield field
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def station_message() -> bytes:
    """Return RTCM 1005 of the base (RTCM 10403.3, table 3.5-6)."""
    latitude, longitude, height = math.radians(_BASE[0]), math.radians(_BASE[1]), _BASE[2]
    a, e2 = 6378137.0, 0.00669437999014
    n = a / math.sqrt(1 - e2 * math.sin(latitude) ** 2)
    x = (n + height) * math.cos(latitude) * math.cos(longitude)
    y = (n + height) * math.cos(latitude) * math.sin(longitude)
    z = (n * (1 - e2) + height) * math.sin(latitude)
    members = [(12, 1005), (12, 7), (6, 0), (4, 0b1110), (38, x), (2, 0), (38, y), (2, 0), (38, z)]
    bits = 0
    for width, value in members:
        whole = round(value * 1e4) if width == 38 else int(value)
        bits = bits << width | whole & (1 << width) - 1
    return rtcm3.encode(bits.to_bytes(19, "big"))
