"""What happens to links, clock and disk while a flight is recorded is told."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from acquire.recording.alarms import RecordingWatch
from acquire.recording.recorder import Host
from drivers import rtcm3, ubx
from tests.acquire.live import frames_in
from tests.acquire.scripted import Script, configured, messages, run, said

START_NS = 1_777_626_000_000_000_000


def test_a_lost_port_and_a_sender_that_moves_raise_alarms(tmp_path: Path) -> None:
    frame = ubx.encode(0x0213, bytes(8))
    source = Script(["10.0.0.1:1", frame, "10.0.0.1:2", frame, "unplug", frame])
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    done, told = run(configured(rover), tmp_path, said("is back"), sources={"rover": source})
    kinds = [alarm.kind for alarm in done.alarms]
    assert kinds == ["source_changed", "lost", "back"]
    assert "rover data come from another address: 10.0.0.1:2, before 10.0.0.1:1" in told
    assert [json.loads(data)["kind"] for data in messages(done.paths[0], "/alarm")] == kinds


def test_a_silent_base_a_low_disk_and_a_clock_jump_raise_alarms(tmp_path: Path) -> None:
    """With clocks of its own, so that nobody's speed matters."""
    steady, jump = {"s": 1000.0}, {"ns": 0}
    base = {"name": "base", "protocol": "rtcm3", "url": "file:x", "silent_s": 1e5}
    host = Host(
        clock_ns=lambda: START_NS + round(steady["s"] * 1e9) + jump["ns"],
        steady_s=lambda: steady["s"],
        free_bytes=lambda _: 12_000_000,
    )
    frame = rtcm3.encode(b"\x3e\xd0")

    def reached(told: list[str]) -> bool:
        if said("no data for")(told):
            jump["ns"] = -3_600_000_000_000
        elif frame in frames_in(tmp_path / "logs", "base"):
            steady["s"] += 2e5
        else:
            # The file is made safe when half a second has gone by.
            steady["s"] += 0.1
        return said("clock of this computer jumped by -3600")(told)

    done, told = run(configured(base, least_free_mb=500), tmp_path, reached, host, {"base": Script([frame])})
    assert [a.kind for a in done.alarms] == ["disk_low", "silent", "clock_jump"]
    assert "only 12 MB are left on the disk" in told


def test_silence_is_told_once_and_its_end_too() -> None:
    watch = RecordingWatch({"base": 5.0}, start_s=100.0)
    assert not watch.silences(104.0, 1)
    assert [a.kind for a in watch.silences(106.0, 2)] == ["silent"]
    assert not watch.silences(200.0, 3)
    assert [a.kind for a in watch.hear("base", 201.0, 4)] == ["heard_again"]
    assert not watch.silences(205.0, 5)


def test_a_clock_that_drifts_is_no_jump() -> None:
    watch = RecordingWatch({}, start_s=0.0)
    assert not any(watch.jump(round(s * 1.001e9), float(s)) for s in range(1000))
    assert watch.jump(round(2000e9), 1000.0)


def test_a_computer_that_stands_still_for_a_while_has_no_jumping_clock(tmp_path: Path) -> None:
    """Busy computers pause a program for seconds, also between its looks at two clocks."""
    passed = {"s": 1000.0, "looks": 0}

    def clock_ns() -> int:
        passed["looks"] += 1
        if passed["looks"] % 3 == 0:
            passed["s"] += 50.0
        return START_NS + round(passed["s"] * 1e9)

    def reached(told: list[str]) -> bool:
        passed["s"] += 0.1
        return passed["looks"] > 30 or said("jumped")(told)

    host = Host(clock_ns=clock_ns, steady_s=lambda: passed["s"])
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x", "silent_s": 1e9}
    done, _ = run(configured(rover), tmp_path, reached, host, {"rover": Script([])})
    assert done.alarms == ()


def test_a_serial_line_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    """A real pseudo terminal: it goes away with its other end, a new one takes its name."""
    before, after = (ubx.encode(0x0213, bytes([number]) * 8) for number in range(2))
    port = tmp_path / "port"
    ends: list[int] = []

    def plug_in() -> None:
        ours, theirs = os.openpty()
        pytest.importorskip("tty", reason="Windows has no such terminals").setraw(theirs)
        port.symlink_to(os.ttyname(theirs))
        ends[:] = [ours, theirs]

    def unplug() -> None:
        port.unlink()
        for end in ends:
            os.close(end)
        ends.clear()

    def reached(told: list[str]) -> bool:
        arrived = frames_in(tmp_path / "logs", "rover") if told else []
        if after in arrived:
            return True
        if said("is back")(told):
            os.write(ends[0], after)
        elif said("is lost")(told):
            if not ends:
                plug_in()
        elif before in arrived:
            if ends:
                unplug()
        else:
            # A port that is being opened throws away what it holds.
            os.write(ends[0], before)
        return False

    plug_in()
    rover = {"name": "rover", "protocol": "ubx", "url": f"serial:{port}"}
    done, _ = run(configured(rover, flush_s=0.1), tmp_path, reached)
    unplug()
    assert [a.kind for a in done.alarms] == ["lost", "back"]
    arrived = messages(done.paths[0], "/rover/raw")
    assert list(dict.fromkeys(arrived)) == [before, after]
    assert arrived == sorted(arrived, key=[before, after].index)
