"""Recording, monitor and replay without the processing's packages, and without what only POSIX has."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_wheel import LEAN

ROOT = Path(__file__).parents[2]

# A vehicle over UDP and a receiver over TCP are recorded, the log is shown, monitored, replayed over both and
# recorded again from the replay; frames are counted at every turn.
_SCRIPT = """
import contextlib, json, socket, sys, threading, time
from pathlib import Path
from typer.testing import CliRunner
from acquire.commands.cli import app
from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.recorder import record
from drivers.mavlink.dialect import ardupilotmega
from drivers.mavlink.decode import encode
from drivers.ubx import encode as ubx

folder = Path(sys.argv[1])
FRAMES = 300
dialect = ardupilotmega()
beat, attitude = dialect.number("HEARTBEAT"), dialect.number("ATTITUDE")
kinds = [attitude if n % 10 else beat for n in range(FRAMES)]
vehicle = [encode(dialect, kind, {}, sequence=n, system=1, component=1) for n, kind in enumerate(kinds)]
rover = [ubx(0x0107, bytes(92)) for _ in range(FRAMES)]

def call(*words):
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout

def port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]

def recorded(name, speak):
    udp, tcp = port(socket.SOCK_DGRAM), port(socket.SOCK_STREAM)
    links = [
        {"name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{udp}", "silent_s": 600},
        {"name": "rover", "protocol": "ubx", "url": f"tcp://127.0.0.1:{tcp}", "silent_s": 600},
    ]
    recording = {"output": str(folder / name), "least_free_mb": 0}
    chosen = RecordingConfiguration.model_validate({"recording": recording, "link": links})
    stop, done = threading.Event(), []
    thread = threading.Thread(target=lambda: done.append(record(chosen, folder, stop, lambda _: None)))
    thread.start()
    end = time.monotonic() + 60
    # Datagrams for a port that is not open yet are nobody's.
    while f":{udp:04X} " not in Path("/proc/net/udp").read_text() and time.monotonic() < end:
        time.sleep(0.01)
    speak(udp, tcp)
    end = time.monotonic() + 60
    while time.monotonic() < end:
        with contextlib.suppress(Exception):
            (log,) = (folder / name).glob("*.mcap")
            told = json.loads(call("info", log, "--json"))["links"]
            if {one["link"]: one["frames"] for one in told} == {"rover": FRAMES, "vehicle": FRAMES}:
                break
        time.sleep(0.1)
    stop.set()
    thread.join()
    counted = {link: tally.frames for link, tally in done[0].tallies.items()}
    assert counted == {"rover": FRAMES, "vehicle": FRAMES}, counted
    return done[0].paths[0]

def spoken(udp, tcp):
    with socket.create_server(("127.0.0.1", tcp)) as server:
        connection, _ = server.accept()
        with connection, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for a, b in zip(vehicle, rover):
                sender.sendto(a, ("127.0.0.1", udp))
                connection.sendall(b)
                time.sleep(0.001)

def replayed(udp, tcp):
    words = [("vehicle", f"udp://127.0.0.1:{udp}"), ("rover", f"tcp://127.0.0.1:{tcp}")]
    for name, to in words:
        call("replay", first, "--link", name, "--to", to, "--speed", "0")

first = recorded("logs", spoken)
assert json.loads(call("monitor", first, "--json"))["links"]
assert "vehicle" in call("monitor", first)
second = recorded("again", replayed)
call("recover", second)
(folder / "rover.ubx").write_bytes(b"".join(rover))
print("all came through")
"""

_LEAN = f"""
import sys
for name in {LEAN!r}:
    sys.modules[name] = None
"""

# As on Windows: see `tests.test_other_systems`. pyserial chooses by the system and is loaded first.
_ELSEWHERE = """
import signal, subprocess, sys, types
import serial, typer, pydantic, rich.console, os, shutil, socket, tempfile, uuid, concurrent.futures.thread
for name in ("fcntl", "termios", "pwd", "tty", "grp", "resource"):
    sys.modules[name] = None
for name in ("getuid", "fork", "openpty", "ttyname", "O_NOCTTY"):
    if hasattr(os, name):
        delattr(os, name)
sys.modules["msvcrt"] = types.SimpleNamespace(LK_NBLCK=2, locking=lambda *a: None)
subprocess.CREATE_NEW_PROCESS_GROUP = 0
import ctypes
ctypes.windll = types.SimpleNamespace(kernel32=types.SimpleNamespace(GlobalMemoryStatusEx=lambda _: 0))
signal.CTRL_BREAK_EVENT, signal.SIGBREAK = signal.SIGINT, signal.SIGTERM
sys.platform = "win32"
import photocal.base.operating_system
sys.platform = "linux"
"""


@pytest.mark.parametrize("system", [_LEAN, _ELSEWHERE], ids=["without-packages", "without-posix"])
def test_it_records_monitors_and_replays(system: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", system + _SCRIPT, str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.endswith("all came through\n")
