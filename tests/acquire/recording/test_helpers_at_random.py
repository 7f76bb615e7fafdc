"""Whatever the helper threads of a recorder do, frozen, slowed or failing at random: no due frame is lost."""

from __future__ import annotations

import io
import random
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.log_file import WholeWrites
from acquire.recording.recorder import Host, record, source_of_link
from acquire.transports.sources import Source
from drivers import rtcm3
from tests.acquire.live import free_port
from tests.acquire.recording.undisturbed import GoodLink
from tests.acquire.scripted import configured

DISTURBANCES, EVERY_S, LOOK_EVERY = 200, 0.15, 25
STATES = ("well", "well", "slow", "frozen", "failing", "killed")


class Helper:
    """What a helper thread of the recorder comes by: there it may be held up, or fail."""

    def __init__(self) -> None:
        self.state = "well"

    def pass_by(self) -> None:
        """Let the thread pass as the state of now says."""
        while self.state == "frozen":
            time.sleep(0.01)
        if self.state == "slow":
            time.sleep(0.2)
        elif self.state == "failing":
            raise OSError("failing")
        elif self.state == "killed":
            raise SystemExit("killed")


class Disturbed(Source):
    """A port whose reading and writing are held up; it gives corrections for itself."""

    def __init__(self, reading: Helper, writing: Helper) -> None:
        super().__init__()
        self._reading, self._writing = reading, writing

    def open(self, _stop: threading.Event) -> None:
        """Be open."""

    def read(self, timeout_s: float) -> bytes:
        """Give a correction."""
        self._reading.pass_by()
        time.sleep(timeout_s)
        return rtcm3.encode(b"\x43\x50" + bytes(400))

    def write(self, _data: bytes) -> None:
        """Take what is sent."""
        self._writing.pass_by()

    def close(self) -> None:
        """Be closed."""


def test_helpers_that_fail_at_random_cost_no_due_frame(tmp_path: Path) -> None:
    chance = random.Random(3)  # noqa: S311 - no secrets
    helpers = {name: Helper() for name in ("terminal", "base", "rover", "to rover", "room", "disk")}

    def tell(_: str) -> None:
        helpers["terminal"].pass_by()

    def room(_: Path) -> int:
        helpers["room"].pass_by()
        return 1 << 40

    class Disk(WholeWrites):
        """Takes its time until all is safe."""

        def make_safe(self) -> None:
            helpers["disk"].pass_by()
            super().make_safe()

    port, stop = free_port(), threading.Event()
    good: dict[str, Any] = {"name": "good", "protocol": "ubx", "url": f"udp://127.0.0.1:{port}"}
    # A link that is silent now and then raises alarms.
    rover: dict[str, Any] = {"name": "rover", "protocol": "ubx", "url": "file:x", "silent_s": 0.2}
    rover["ublox"] = {"port": "usb", "rate_ms": 200}
    base: dict[str, Any] = {
        "name": "base",
        "protocol": "rtcm3",
        "url": "file:x",
        "silent_s": 0.2,
        "corrections_to": ["rover"],
    }
    chosen = RecordingConfiguration.model_validate(configured(good, rover, base))
    sources: dict[str, Source] = {
        "good": source_of_link(chosen.link[0]),
        "rover": Disturbed(helpers["rover"], helpers["to rover"]),
        "base": Disturbed(helpers["base"], Helper()),
    }
    host = Host(free_bytes=room, make=lambda path: Disk(io.FileIO(path, "x+b")))
    with ThreadPoolExecutor(1) as pool:
        recording = pool.submit(record, chosen, tmp_path, stop, tell, host, sources)
        try:
            with GoodLink(port) as sender:
                for number in range(1, DISTURBANCES + 1):
                    name = chance.choice(list(helpers))
                    state = chance.choice(STATES)
                    if state == "killed" and name in ("base", "rover", "disk"):
                        # Who reads a link is needed for what follows; a disk that fails says so.
                        state = "failing"
                    helpers[name].state = state
                    time.sleep(EVERY_S)
                    assert not recording.done()
                    if number % LOOK_EVERY == 0:
                        # What is in the files is what a kill would leave.
                        assert sender.lost(tmp_path, time.monotonic()) == 0, (number, name, state)
        finally:
            for helper in helpers.values():
                helper.state = "well"
            stop.set()
        done = recording.result()
    kept = {frame for _, frame in sender.sent}
    assert done.tallies["good"].frames == len(kept)
