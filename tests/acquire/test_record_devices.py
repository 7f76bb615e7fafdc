"""Recording with devices that are spoken to: message rates, receiver settings, corrections, alarms."""

from __future__ import annotations

import errno
import io
import json
import os
import socket
import threading
import time
import tty
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega as tables
from pynmeagps import NMEAReader

from acquire.log.records import Channel
from acquire.log.recovery import recover
from acquire.log.replay import raw_frames
from acquire.log.writer import LogWriter
from acquire.recording.alarms import ClockWatch, SilenceWatch
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import Configuration
from acquire.recording.files import Limits, LogFiles, WholeWrites
from acquire.recording.recorder import Host, Recorded, record
from acquire.recording.vehicle_dialogue import VehicleDialogue
from acquire.simulate.autopilot import Autopilot
from acquire.simulate.receiver import Receiver
from acquire.simulate.serve import on_pty, on_udp
from acquire.transports.sources import LinkLostError
from drivers import nmea, rtcm3
from drivers.errors import ConfigurationError, OutputError
from drivers.frames import Wire
from drivers.framing import GNSS, StreamFramer
from drivers.mavlink.dialect import ardupilotmega
from drivers.ubx import wire as ubx

START_US = 1_777_626_000_000_000


class Script:
    """The twin of a port: gives what it is told to give, and keeps what was written."""

    def __init__(self, pieces: list[bytes | str]) -> None:
        self.peer = ""
        self.written: list[bytes] = []
        self._pieces = pieces

    def open(self) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        if not self._pieces:
            time.sleep(timeout_s)
            return b""
        piece = self._pieces.pop(0)
        if isinstance(piece, bytes):
            return piece
        if piece == "unplug":
            raise LinkLostError("unplugged")
        self.peer = piece
        return b""

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        pass


def run(
    configuration: dict[str, Any],
    folder: Path,
    until: Callable[[list[str]], bool],
    host: Host | None = None,
    sources: Any = None,
) -> tuple[Recorded, list[str]]:
    """Record until a condition on what was told holds."""
    told: list[str] = []
    stop = threading.Event()
    done: list[Recorded] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            done.append(
                record(Configuration.model_validate(configuration), folder, stop, told.append, host, sources)
            )
        except BaseException as failure:
            failed.append(failure)

    thread = threading.Thread(target=work)
    thread.start()
    end = time.monotonic() + 20
    while not until(told) and thread.is_alive() and time.monotonic() < end:
        time.sleep(0.02)
    stop.set()
    thread.join(20)
    if failed:
        raise failed[0]
    return done[0], told


def said(*words: str) -> Callable[[list[str]], bool]:
    return lambda told: all(any(word in line for line in told) for word in words)


def configured(*links: dict[str, Any], **recording: Any) -> dict[str, Any]:
    return {"recording": {"output": "logs", "least_free_mb": 0, **recording}, "link": list(links)}


def messages(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream).iter_messages(topics=[topic])]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_an_autopilot_is_asked_for_rates_and_time(tmp_path: Path) -> None:
    port = free_port()
    autopilot = Autopilot(START_US)
    vehicle = {
        "name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{port}",
        "vehicle": {"rates_hz": {"ATTITUDE": 50, "GPS_RAW_INT": 5, "RAW_RPM": 1}, "timesync_s": 0.1},
    }  # fmt: skip
    with on_udp(autopilot, "127.0.0.1", port):
        done, told = run(configured(vehicle), tmp_path, said("does not send RAW_RPM"))
    assert autopilot.interval_s == {30: 0.02, 24: 0.2}
    assert "vehicle sends ATTITUDE at 50 Hz" in told
    assert "vehicle does not send RAW_RPM at 1 Hz (failed)" in told
    assert [alarm.kind for alarm in done.alarms if alarm.kind != "note"] == ["device"]
    # We never take the part of the pilot's ground station: its loss must still be noticed on board.
    assert {(system, component) for _, system, component in autopilot.heard} == {(245, 191)}
    assert "HEARTBEAT" not in {name for name, _, _ in autopilot.heard}
    clocks = [json.loads(data) for data in messages(done.paths[0], "/clock")]
    trips = [clock["round_trip_ns"] for clock in clocks if clock["source"] == "TIMESYNC"]
    assert trips
    assert all(trip >= 0 for trip in trips)
    assert len(messages(done.paths[0], "/vehicle/sent")) == len(autopilot.heard)
    assert len(messages(done.paths[0], "/alarm")) == len(done.alarms)


def test_an_autopilot_that_does_not_answer_is_told() -> None:
    dialogue = VehicleDialogue(ardupilotmega(), {"ATTITUDE": 10}, 0)
    batch = StreamFramer((Wire.MAVLINK,)).feed(Autopilot(START_US).due(0.0))
    asked = 0
    alarms: list[str] = []
    for second in range(8):
        step = dialogue.step(batch if second == 0 else None, float(second), 0)
        asked += len(step.frames)
        alarms += step.alarms
    assert asked == 4
    assert alarms == ["does not send ATTITUDE at 10 Hz (no answer)"]
    assert dialogue.finished


@pytest.mark.parametrize("generation", [8, 9])
def test_a_receiver_is_configured_and_verified(generation: int, tmp_path: Path) -> None:
    receiver = Receiver(generation)
    with on_pty(receiver) as path:
        rover = {
            "name": "rover", "protocol": "ubx", "url": f"serial:{path}",
            "ublox": {"port": "usb", "rate_ms": 200},
        }  # fmt: skip
        done, told = run(configured(rover), tmp_path, said("is configured", ))  # fmt: skip
    assert "rover is configured, verified" in told
    if generation == 9:
        names = ("NAV_PVT", "RXM_RAWX", "RXM_SFRBX", "TIM_TM2")
        assert receiver.settings == {f"CFG_MSGOUT_UBX_{n}_USB": 1 for n in names} | {"CFG_RATE_MEAS": 200}
    else:
        assert receiver.rates == {(1, 7): 1, (2, 0x15): 1, (2, 0x13): 1, (0x0D, 3): 1}
        assert receiver.measurement_ms == 200
    assert all(alarm.kind == "note" for alarm in done.alarms)


@pytest.mark.parametrize(
    ("receiver", "words"),
    [
        (Receiver(7), "of no generation that can be configured"),
        (Receiver(9, refuses=True), "ACK-NAK"),
        (Receiver(8, refuses=True), "ACK-NAK"),
        (Receiver(9, forgets=True), "lost it"),
        (Receiver(8, forgets=True), "lost it"),
    ],
)
def test_a_receiver_that_is_not_configured_raises_an_alarm(
    receiver: Receiver, words: str, tmp_path: Path
) -> None:
    with on_pty(receiver) as path:
        rover = {
            "name": "rover", "protocol": "ubx", "url": f"serial:{path}",
            "ublox": {"port": "usb", "rate_ms": 200},
        }  # fmt: skip
        done, _ = run(configured(rover), tmp_path, said("is not configured"))
    (alarm,) = [a for a in done.alarms if a.kind == "device"]
    assert words in alarm.text


def test_corrections_reach_the_rover_whole_and_the_vehicle_in_fragments(tmp_path: Path) -> None:
    chance = np.random.default_rng(3)
    # 1023 bytes of payload do not fit in four fragments; 180, 360 and 720 are the edges.
    sizes = [20, 174, 175, 354, 500, 714, 1023]
    sent = [rtcm3.encode(b"\x43\x50" + chance.bytes(size - 2)) for size in sizes]
    base = Script([ubx.encode(0x0107, bytes(92)), *sent, b"\xd3\x00\x13 no frame"])
    port = free_port()
    autopilot, receiver = Autopilot(START_US), Receiver(9)
    with ExitStack() as stack:
        stack.enter_context(on_udp(autopilot, "127.0.0.1", port))
        rover = f"serial:{stack.enter_context(on_pty(receiver))}"
        links: list[dict[str, Any]] = [
            {"name": "vehicle", "protocol": "mavlink", "url": f"udp://127.0.0.1:{port}"},
            {"name": "rover", "protocol": "ubx", "url": rover},
            {"name": "base", "protocol": "rtcm3", "url": "file:x", "corrections_to": ["rover", "vehicle"]},
        ]
        from acquire.recording.configuration import Link
        from acquire.transports.of_link import source_of_link

        sources = {str(x["name"]): source_of_link(Link.model_validate(x)) for x in links[:2]}
        held = _After(base)
        done, told = run(
            configured(*links), tmp_path, lambda _: len(autopilot.corrections) >= 6 and
            len(receiver.corrections) >= sum(map(len, sent)), sources={**sources, "base": held},
        )  # fmt: skip
    assert receiver.corrections == b"".join(sent)
    assert autopilot.corrections == sent[:-1]
    assert "vehicle does not get RTCM 1077: 1029 bytes, at most 720 can be carried" in told
    assert messages(done.paths[0], "/rover/sent") == sent


class _After(Script):
    """Begins only when the vehicle's address is known."""

    def __init__(self, script: Script) -> None:
        super().__init__(script._pieces)
        self._begin = time.monotonic() + 1.5

    def read(self, timeout_s: float) -> bytes:
        if time.monotonic() < self._begin:
            time.sleep(timeout_s)
            return b""
        return super().read(timeout_s)


def test_a_lost_port_and_a_sender_that_moves_raise_alarms(tmp_path: Path) -> None:
    frame = ubx.encode(0x0213, bytes(8))
    source = Script(["10.0.0.1:1", frame, "10.0.0.1:2", frame, "unplug", frame])
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    done, told = run(configured(rover), tmp_path, said("is back"), sources={"rover": source})
    kinds = [alarm.kind for alarm in done.alarms]
    assert kinds == ["source_changed", "lost", "back"]
    assert "rover comes from another place: 10.0.0.1:2, before 10.0.0.1:1" in told
    assert [json.loads(data)["kind"] for data in messages(done.paths[0], "/alarm")] == kinds


def test_a_silent_base_a_low_disk_and_a_clock_jump_raise_alarms(tmp_path: Path) -> None:
    jump = {"ns": 0}
    base = {"name": "base", "protocol": "rtcm3", "url": "file:x", "silent_s": 0.3}
    host = Host(clock_ns=lambda: time.time_ns() + jump["ns"], free_bytes=lambda _: 12_000_000)

    def until(told: list[str]) -> bool:
        if said("is silent")(told):
            jump["ns"] = -3_600_000_000_000
        return said("clock of this computer jumped by -3600")(told)

    done, told = run(
        configured(base, least_free_mb=500),
        tmp_path,
        until,
        host,
        {"base": Script([rtcm3.encode(b"\x3e\xd0")])},
    )
    assert {a.kind for a in done.alarms} == {"silent", "disk_low", "clock_jump"}
    assert "only 12 MB are left on the disk" in told


def test_silence_is_told_once_and_its_end_too() -> None:
    watch = SilenceWatch({"base": 5.0}, start_s=100.0)
    assert not watch.look(104.0, 1)
    assert [a.kind for a in watch.look(106.0, 2)] == ["silent"]
    assert not watch.look(200.0, 3)
    assert [a.kind for a in watch.hear("base", 201.0, 4)] == ["heard_again"]
    assert not watch.look(205.0, 5)


def test_a_clock_that_drifts_is_no_jump() -> None:
    watch = ClockWatch()
    assert not any(watch.look(round(s * 1.001e9), float(s)) for s in range(1000))
    assert watch.look(round(2000e9), 1000.0)


class _SmallDisk(WholeWrites):
    """A disk with little room, shared by all files in a folder; the last write is cut in the middle."""

    def __init__(self, file: io.FileIO, room: dict[Path, int], folder: Path) -> None:
        super().__init__(file)
        self._room, self._folder = room, folder

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if self._room.get(self._folder, 1 << 40) < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        self._room[self._folder] = self._room.get(self._folder, 1 << 40) - len(data)
        return super().write(data)


def _fill(files: LogFiles, count: int) -> list[bytes]:
    chance = np.random.default_rng(5)
    sent = []
    for number in range(count):
        payload = chance.bytes(300)
        one = np.array([number], np.int64)
        files.messages(Channel("/rover/raw", "ubx"), [payload], one, one, one)
        sent.append(payload)
        files.make_safe()
    return sent


def _kept(paths: list[Path], folder: Path) -> list[bytes]:
    found = []
    for number, path in enumerate(paths):
        fixed = folder / f"fixed-{number}.mcap"
        recover(path, fixed)
        found += messages(fixed, "/rover/raw")
    return found


def _nothing(writer: LogWriter) -> None:
    writer.metadata("site", {"operator": "A. Surveyor"})


def test_a_full_disk_sends_the_recording_to_the_spare_folder(tmp_path: Path) -> None:
    first, spare = tmp_path / "first", tmp_path / "spare"
    room = {first: 5000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([first, spare], _nothing, Limits(), time.time_ns, make)
    sent = _fill(files, 40)
    files.close()
    assert [path.parent for path in files.paths] == [first, spare]
    assert _kept(files.paths, tmp_path) == sent


def test_when_every_disk_is_full_what_was_written_is_safe(tmp_path: Path) -> None:
    room = {tmp_path: 5000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, Limits(), time.time_ns, make)
    sent = _fill(files, 40)
    with pytest.raises(OutputError, match="what was written is safe"):
        files.close()
    kept = _kept(files.paths, tmp_path)
    assert len(kept) > 5
    assert kept == sent[: len(kept)]


def test_when_a_full_disk_has_room_again_nothing_is_lost(tmp_path: Path) -> None:
    room, clock = {tmp_path: 5000}, {"ns": START_US * 1000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, Limits(), lambda: clock["ns"], make)
    sent = _fill(files, 20)
    told = []
    for second in range(12):
        clock["ns"] += 1_000_000_000
        told += files.make_safe()
        if second == 7:
            assert told == []
            room[tmp_path] = 1 << 20
    sent += _fill(files, 5)
    told += files.close()
    assert [kind for kind, _ in told] == ["note"]
    assert len(files.paths) == 2
    assert sorted(_kept(files.paths, tmp_path)) == sorted(sent)


def test_a_disk_that_fails_later_sends_the_recording_to_the_next_file(tmp_path: Path) -> None:
    """What a disk took may still fail on its way to the platter: fsync tells, after the writing."""
    made: list[Path] = []

    class FailsOnce(WholeWrites):
        def make_safe(self) -> None:
            if len(made) == 1:
                raise OSError(errno.EIO, "Input/output error")
            super().make_safe()

    def make(path: Path) -> WholeWrites:
        made.append(path)
        return FailsOnce(io.FileIO(path, "xb"))

    files = LogFiles([tmp_path], _nothing, Limits(), time.time_ns, make)
    sent = _fill(files, 1)
    told: list[tuple[str, str]] = []
    end = time.monotonic() + 20
    while not told and time.monotonic() < end:
        told = files.make_safe()
    sent += _fill(files, 3)
    files.close()
    assert [kind for kind, _ in told] == ["disk_full"]
    assert "Input/output error" in told[0][1]
    assert len(files.paths) == 2
    assert sorted(_kept(files.paths, tmp_path)) == sorted(sent)


def test_too_much_held_ends_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("acquire.recording.files.HELD_BYTES", 3000)
    room = {tmp_path: 5000}

    def make(path: Path) -> WholeWrites:
        return _SmallDisk(io.FileIO(path, "xb"), room, path.parent)

    files = LogFiles([tmp_path], _nothing, Limits(), time.time_ns, make)
    with pytest.raises(OutputError, match="what was written is safe"):
        _fill(files, 40)


def test_a_serial_line_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    """A real pseudo terminal: it goes away with its other end, a new one takes its name."""
    frame = [ubx.encode(0x0213, bytes([number]) * 8) for number in range(2)]
    port = tmp_path / "port"
    told_before: list[str] = []

    def plug_in() -> tuple[int, int]:
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(theirs))
        return ours, theirs

    ends = list(plug_in())
    rover = {"name": "rover", "protocol": "ubx", "url": f"serial:{port}", "silent_s": 0.5}

    def until(told: list[str]) -> bool:
        if said("silent")(told) and not told_before:
            told_before.append("the port is open")
            os.write(ends[0], frame[0])
        elif said("is heard again")(told) and len(told_before) == 1:
            told_before.append("unplugged")
            port.unlink()
            for end in ends[:2]:
                os.close(end)
        elif said("is lost")(told) and len(told_before) == 2:
            told_before.append("plugged in")
            ends.extend(plug_in())
        elif said("is back")(told) and len(told_before) == 3:
            told_before.append("speaks")
            os.write(ends[2], frame[1])
        (log,) = (tmp_path / "logs").glob("*.mcap") if told else [None]
        return log is not None and len(list(raw_frames(log, "rover"))) == 2

    done, _ = run(configured(rover, flush_s=0.1), tmp_path, until)
    for end in ends[2:]:
        os.close(end)
    kinds = [a.kind for a in done.alarms]
    assert [kind for kind in kinds if kind in ("lost", "back")] == ["lost", "back"]
    assert messages(done.paths[0], "/rover/raw") == frame


def test_a_caster_is_told_where_the_rover_is(tmp_path: Path) -> None:
    pvt = Receiver(9).due(0.0)
    base = Script([])
    links: list[dict[str, Any]] = [
        {"name": "rover", "protocol": "ubx", "url": "file:x"},
        {
            "name": "base", "protocol": "rtcm3", "url": "ntrip://127.0.0.1/M",
            "position_from": "rover", "position_every_s": 0.1,
        },
    ]  # fmt: skip
    sources = {"rover": Script([pvt]), "base": base}
    done, _ = run(configured(*links), tmp_path, lambda _: len(base.written) >= 3, sources=sources)
    told = NMEAReader.parse(base.written[0])
    assert (told.msgID, told.lat, told.lon, told.alt, told.quality) == ("GGA", 47.5, 8.5, 462.0, 4)
    assert messages(done.paths[0], "/base/sent") == base.written


@pytest.mark.parametrize(
    ("sentence", "kept"),
    [
        (nmea.encode("GNGGA,120000.00,4730.0,N,00830.0,E,1,08,1.0,400.0,M,47.0,M,,"), True),
        (nmea.encode("GNGGA,120000.00,,,,,0,00,99.9,,M,,M,,"), False),
    ],
)
def test_sentences_of_a_receiver_go_to_the_caster_as_they_are(sentence: bytes, kept: bool) -> None:
    position = CasterPosition(ardupilotmega(), 10.0)
    position.hear(StreamFramer(GNSS).feed(sentence), 0)
    assert position.due(5.0) == ((sentence,) if kept else ())
    assert position.due(14.9) == ()
    assert position.due(15.1) == ((sentence,) if kept else ())


def test_an_autopilot_that_asks_the_time_is_answered() -> None:
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    beat = tables.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(mav)
    asked = tables.MAVLink_timesync_message(0, 123).pack(mav) + tables.MAVLink_timesync_message(7, 9).pack(
        mav
    )
    batch = StreamFramer((Wire.MAVLINK,)).feed(beat + asked)
    clock_ns = START_US * 1000
    dialogue = VehicleDialogue(ardupilotmega(), {}, 60.0)
    sent = [mav.parse_buffer(frame)[0] for frame in dialogue.step(batch, 0.0, clock_ns).frames]
    assert [(m.tc1, m.ts1) for m in sent] == [(clock_ns, 123), (0, clock_ns)]
    assert not VehicleDialogue(ardupilotmega(), {}, 0.0).step(batch, 0.0, clock_ns).frames


def test_files_rotate_and_each_stands_for_itself(tmp_path: Path) -> None:
    files = LogFiles([tmp_path], _nothing, Limits(size=4000), time.time_ns)
    sent = _fill(files, 40)
    files.close()
    assert len(files.paths) >= 4
    kept = []
    for path in files.paths:
        kept += messages(path, "/rover/raw")
        with path.open("rb") as stream:
            notes = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
        assert notes["site"] == {"operator": "A. Surveyor"}
    assert kept == sent


def test_site_antenna_and_control_file_ride_along(tmp_path: Path) -> None:
    (tmp_path / "control.csv").write_text("point,X,Y,Z\n1,0,0,0\n")
    site = {
        "operator": "A. Surveyor", "place": "runway", "antenna_height_m": 1.652,
        "antenna_height_kind": "slant", "control_file": "control.csv",
    }  # fmt: skip
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    source = Script([ubx.encode(0x0213, bytes(8))])
    done, _ = run(
        {**configured(rover), "site": site}, tmp_path, lambda told: bool(told), None, {"rover": source}
    )
    with done.paths[0].open("rb") as stream:
        reader = make_reader(stream)
        notes = {m.name: m.metadata for m in reader.iter_metadata()}
        attached = {a.name: a.data for a in reader.iter_attachments()}
    assert notes["site"] == {key: str(value) for key, value in site.items()}
    assert attached == {"control.csv": (tmp_path / "control.csv").read_bytes()}


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ({"vehicle": {}}, "mavlink"),
        ({"ublox": {"rate_ms": 200}}, "port"),
        ({"ublox": {"port": "usb"}}, "rate_ms"),
        ({"user": "me"}, "ntrip"),
        ({"corrections_to": ["nobody"]}, "nobody"),
    ],
)
def test_links_that_cannot_be_meant(link: dict[str, Any], words: str, tmp_path: Path) -> None:
    from acquire.recording.configuration import read_configuration

    def toml(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
        return json.dumps(value)

    lines = {"name": "rover", "protocol": "ubx", "url": "udp://127.0.0.1:1", **link}
    text = '[recording]\noutput = "x"\n[[link]]\n' + "".join(f"{k} = {toml(v)}\n" for k, v in lines.items())
    path = tmp_path / "flight.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        read_configuration(path)


def test_an_antenna_height_says_its_kind(tmp_path: Path) -> None:
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    with pytest.raises(ValueError, match="slant"):
        Configuration.model_validate({**configured(rover), "site": {"antenna_height_m": 1.6}})
