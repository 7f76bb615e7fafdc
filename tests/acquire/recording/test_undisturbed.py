"""Nothing beside the log costs the log anything: terminals, devices, strangers, a clean-up of the folder."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as tables

from acquire.log.chunk import MAGIC
from drivers import rtcm3
from tests.acquire.live import Process, frames_in, free_port, is_bound, until
from tests.acquire.recording.undisturbed import GoodLink, configured, kept_in, recording, stopped
from tests.evidence.long_day import SETTINGS, day
from tests.evidence.neighbours import heard_under

# What waits for an output waits each time; a machine that is busy with other tests is slow now and then.
STOP_S, ATTEMPTS = 0.5, 3


@contextlib.contextmanager
def paused_terminal() -> Iterator[int]:
    """Give a terminal on which somebody has pressed Ctrl-S."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    termios.tcflow(theirs, termios.TCOOFF)
    yield theirs
    for end in (ours, theirs):
        os.close(end)


@contextlib.contextmanager
def full_pipe() -> Iterator[int]:
    """Give a pipe that is full, which nobody reads."""
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(theirs, b"x" * 512)
    os.set_blocking(theirs, True)
    yield theirs
    for end in (ours, theirs):
        os.close(end)


@contextlib.contextmanager
def closed_pipe() -> Iterator[int]:
    """Give a pipe whose reader has gone, as that of `| head -1`."""
    ours, theirs = os.pipe()
    os.close(ours)
    yield theirs
    os.close(theirs)


@contextlib.contextmanager
def full_disk() -> Iterator[int]:
    """Give a file on a disk without room."""
    with Path("/dev/full").open("wb") as file:
        yield file.fileno()


@pytest.mark.parametrize("output", [paused_terminal, full_pipe, closed_pipe, full_disk])
def test_an_output_that_takes_nothing_costs_no_frame_at_a_kill(
    output: Callable[[], contextlib.AbstractContextManager[int]], tmp_path: Path
) -> None:
    path, port = with_a_mute_link(tmp_path)
    with (
        output() as end,
        recording(path, "--json", stdout=end, stderr=end) as recorder,
        GoodLink(port) as good,
    ):
        time.sleep(2.5)
        assert recorder.poll() is None
        recorder.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("output", [paused_terminal, full_pipe, closed_pipe, full_disk])
def test_a_stop_waits_for_no_output(
    output: Callable[[], contextlib.AbstractContextManager[int]], order: int, tmp_path: Path
) -> None:
    took_s: list[float] = []
    while len(took_s) < ATTEMPTS and min(took_s, default=STOP_S) >= STOP_S:
        folder = tmp_path / str(len(took_s))
        folder.mkdir()
        path, port = with_a_mute_link(folder)
        with output() as end, recording(path, "--json", stdout=end, stderr=end) as recorder:
            with GoodLink(port) as good:
                time.sleep(1.0)
                assert recorder.poll() is None
            took_s.append(stopped(recorder, order))
        (log,) = (folder / "logs").iterdir()
        assert log.read_bytes().endswith(MAGIC)
        assert {frame for _, frame in good.sent} == kept_in(folder, "good")
        assert recorder.returncode == 0
    assert min(took_s) < STOP_S, took_s


def with_a_mute_link(folder: Path) -> tuple[Path, int]:
    """Configure a link that raises an alarm soon."""
    mute = f"udp://127.0.0.1:{free_port()}"
    return configured(folder, ("mute", "ubx", mute, "silent_s = 0.3"))


def corrections(base: int, every_s: float, ended: threading.Event) -> None:
    frame = rtcm3.encode(b"\x43\x50" + bytes(792))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        while not ended.wait(every_s):
            line.sendto(frame, ("127.0.0.1", base))


@contextlib.contextmanager
def terminal_nobody_reads() -> Iterator[str]:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield f"serial:{os.ttyname(theirs)}"
    for end in (ours, theirs):
        os.close(end)


@contextlib.contextmanager
def server_that_never_reads() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize(
    ("device", "every_s"), [(terminal_nobody_reads, 0.05), (server_that_never_reads, 0.0005)]
)
def test_a_device_that_takes_nothing_costs_the_other_links_nothing(
    device: Callable[[], contextlib.AbstractContextManager[str]], every_s: float, tmp_path: Path
) -> None:
    base, ended = free_port(), threading.Event()
    with device() as url, ExitStack() as stack:
        path, port = configured(
            tmp_path,
            ("rover", "ubx", url, "silent_s = 600"),
            ("base", "rtcm3", f"udp://127.0.0.1:{base}", 'silent_s = 600\ncorrections_to = ["rover"]'),
        )
        command = [sys.executable, "-m", "acquire.cli", "record", str(path)]
        recorder = stack.enter_context(Process(command))
        good = stack.enter_context(GoodLink(port))
        until(lambda: is_bound(base), "the port of the base")
        sender = threading.Thread(target=corrections, args=(base, every_s, ended))
        stack.callback(sender.join)
        stack.callback(ended.set)
        sender.start()
        recorder.line("rover does not accept the data sent to it")
        time.sleep(2.0)
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0
    alarms = [line for line in recorder.told if "does not accept the data sent to it" in line]
    assert len(alarms) == 1


def delete_file(logs: Path) -> None:
    next(logs.iterdir()).unlink()


def move_folder(logs: Path) -> None:
    logs.rename(logs.parent / "kept")


def replace_file(logs: Path) -> None:
    log = next(logs.iterdir())
    log.unlink()
    log.write_bytes(b"something else")


@pytest.mark.parametrize("clean_up", [delete_file, shutil.rmtree, move_folder, replace_file])
def test_a_log_that_is_deleted_or_moved_is_told_and_nothing_is_lost(
    clean_up: Callable[[Path], None], tmp_path: Path
) -> None:
    path, port = configured(tmp_path)
    with Process([sys.executable, "-m", "acquire.cli", "record", str(path), "--json"]) as recorder:
        with GoodLink(port) as good:
            until(lambda: frames_in(tmp_path / "logs", "good"), "the first frames")
            clean_up(tmp_path / "logs")
            recorder.line("recording continues in ")
            time.sleep(0.2)
        figures = json.loads(recorder.end())
    assert recorder.process.returncode == 0
    assert "file_gone" in {alarm["kind"] for alarm in figures["alarms"]}
    named = [Path(file) for file in figures["files"]]
    assert all(file.is_file() for file in named)
    assert len(named) == 2
    told = {frame for file in named for frame in frames_in(file, "good")}
    assert told == {frame for _, frame in good.sent}
    assert all(file.read_bytes().endswith(MAGIC) for file in named)


def test_a_log_that_is_deleted_loses_nothing_that_is_due_at_a_kill(tmp_path: Path) -> None:
    path, port = configured(tmp_path)
    command = [sys.executable, "-m", "acquire.cli", "record", str(path)]
    with Process(command) as recorder, GoodLink(port) as good:
        until(lambda: frames_in(tmp_path / "logs", "good"), "the first frames")
        shutil.rmtree(tmp_path / "logs")
        recorder.line("is saved in ")
        time.sleep(1.5)
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0


def test_a_recorder_that_shall_outlive_its_terminal_does(tmp_path: Path) -> None:
    """By nohup a hang-up is ignored from the start."""
    path, port = configured(tmp_path)
    ignored = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    program = f"{ignored}; from acquire.cli import main; main()"
    with Process([sys.executable, "-c", program, "record", str(path)]) as recorder:
        until(lambda: is_bound(port), "the port")
        recorder.process.send_signal(signal.SIGHUP)
        time.sleep(0.5)
        assert recorder.process.poll() is None


def test_a_stranger_does_not_take_the_ear_of_the_vehicle(tmp_path: Path) -> None:
    """A byte from elsewhere after each frame: answers and corrections go on to the vehicle, all of them."""
    vehicle, base = free_port(), free_port()
    path, _ = configured(
        tmp_path,
        (
            "vehicle",
            "mavlink",
            f"udp://127.0.0.1:{vehicle}",
            "silent_s = 600\n[link.vehicle]\ntimesync_s = 0.1",
        ),
        ("base", "rtcm3", f"udp://127.0.0.1:{base}", 'silent_s = 600\ncorrections_to = ["vehicle"]'),
    )
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    correction = rtcm3.encode(b"\x43\x50" + bytes(100))
    with ExitStack() as stack:
        stack.enter_context(recording(path, stderr=subprocess.DEVNULL))
        ours, stranger, caster = (
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(3)
        )
        for line in (ours, stranger):
            line.setblocking(False)
        until(lambda: is_bound(vehicle) and is_bound(base), "the ports")
        heard: dict[str, int] = {}
        for _ in range(100):
            ours.sendto(tables.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(mav), ("127.0.0.1", vehicle))
            stranger.sendto(b"x", ("127.0.0.1", vehicle))
            caster.sendto(correction, ("127.0.0.1", base))
            time.sleep(0.02)
            with contextlib.suppress(BlockingIOError):
                while True:
                    for message in mav.parse_buffer(ours.recv(4096)) or ():
                        heard[message.get_type()] = heard.get(message.get_type(), 0) + 1
        with pytest.raises(BlockingIOError):
            stranger.recv(4096)
    assert heard["TIMESYNC"] > 10
    assert heard["GPS_RTCM_DATA"] > 80


SENDERS = """
import socket, sys, time
lines = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
piece = bytes.fromhex(sys.argv[3])
begin, sent = time.monotonic(), 0
while True:
    for line in lines:
        line.sendto(piece, ("127.0.0.1", int(sys.argv[1])))
    sent += 2
    ahead = begin + sent / float(sys.argv[2]) - time.monotonic()
    if ahead > 0.001:
        time.sleep(ahead)
"""


def memory_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_two_senders_at_one_port_are_told_once_and_cost_nothing(tmp_path: Path) -> None:
    shared = free_port()
    path, port = configured(tmp_path, ("shared", "ubx", f"udp://127.0.0.1:{shared}", "silent_s = 600"))
    with ExitStack() as stack:
        recorder = stack.enter_context(Process([sys.executable, "-m", "acquire.cli", "record", str(path)]))
        good = stack.enter_context(GoodLink(port))
        until(lambda: is_bound(shared), "the shared port")
        arguments = [str(shared), "40000", good.sent[0][1].hex() if good.sent else "b562"]
        senders = stack.enter_context(subprocess.Popen([sys.executable, "-c", SENDERS, *arguments]))
        stack.callback(senders.kill)
        time.sleep(3.0)
        early_mb = memory_mb(recorder.process.pid)
        time.sleep(4.0)
        grown_mb = memory_mb(recorder.process.pid) - early_mb
        recorder.process.kill()
        assert good.lost(tmp_path, time.monotonic()) == 0
    moves = [line for line in recorder.told if "come from another address" in line]
    assert len(moves) == 1
    # It was 12 MB a second.
    assert grown_mb < 20


@pytest.mark.parametrize("attack", ["half_open", "websocket_flood"])
def test_an_attack_on_the_pages_costs_the_recording_nothing(attack: str) -> None:
    assert heard_under(attack, 4.0).lost == 0


def test_links_that_come_and_go_bad_casters_and_clocks_that_are_set_cost_nothing() -> None:
    """A long day in seconds; of the clock each setting is told."""
    seen = day(12.0)
    assert (seen.lost, seen.flapped_lost, seen.code) == (0, 0, 0)
    assert (seen.jumps, seen.flapped > 20) == (len(SETTINGS), True)
    assert max(seen.descriptors[4:]) <= max(seen.descriptors[:4]) + 3
