"""Links that flood, ports that hang, octets that a busy computer could not frame: the others lose nothing."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import pytest

from acquire.importing.recovery import recover
from acquire.log.chunk import MAGIC
from acquire.log.replay import raw_frames
from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.files import LogFiles
from acquire.recording.link_session import link_sessions
from acquire.recording.reader import MOST_AT_ONCE, Arrival, Inbox, read_link
from acquire.recording.recorder import record, source_of_link
from acquire.transports.sources import LinkLostError, SerialSource, TcpSource, UdpSource
from drivers import ubx
from drivers.mavlink.dialect import ardupilotmega
from tests.acquire.live import PATIENCE_S, Recorder, frames_in, free_port, is_bound, until
from tests.acquire.recording.hanging import DeadPort, FailingPort, FullServer, HangingServer
from tests.acquire.scripted import Script, configured, run, said
from tests.acquire.transports.test_transports import Server

FLOOD = """
import socket, sys
piece = (bytes.fromhex("d303ff") * 3000)[:8000]
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
    while True:
        line.sendto(piece, ("127.0.0.1", int(sys.argv[1])))
"""


def numbered(number: int) -> bytes:
    return ubx.encode(0x0213, number.to_bytes(4, "little") + bytes(40))


@pytest.mark.slow
def test_a_flood_on_one_link_costs_the_others_nothing(tmp_path: Path) -> None:
    """As fast as a process sends, some tens of megabytes a second; killed without warning."""
    ports = [free_port() for _ in range(3)]
    links = "".join(
        f'[[link]]\nname = "l{n}"\nprotocol = "ubx"\nurl = "udp://127.0.0.1:{port}"\nsilent_s = 600\n'
        for n, port in enumerate(ports)
    )
    (tmp_path / "flight.toml").write_text('[recording]\noutput = "logs"\nleast_free_mb = 0\n' + links)
    with ExitStack() as opened, Recorder(tmp_path / "flight.toml") as recorder:
        sender = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        until(lambda: all(map(is_bound, ports)), "the ports")
        flooding = opened.enter_context(subprocess.Popen([sys.executable, "-c", FLOOD, str(ports[0])]))
        opened.callback(flooding.kill)
        sent: list[tuple[float, bytes]] = []
        begin = time.monotonic()
        told = "l0 more data arrive than the 4 MB/s that can be recorded"
        while time.monotonic() < begin + 1.5 or not any(told in line for line in recorder.told):
            assert time.monotonic() < begin + PATIENCE_S
            frame = numbered(len(sent))
            for port in ports[1:]:
                sender.sendto(frame, ("127.0.0.1", port))
            sent.append((time.monotonic(), frame))
            time.sleep(0.01)
        killed = time.monotonic()
        recorder.process.kill()
        recorder.process.wait()
    recover(recorder.path, tmp_path / "fixed.mcap")
    for name in ("l1", "l2"):
        kept = {frame for _, frame in raw_frames(tmp_path / "fixed.mcap", name)}
        lost = [moment for moment, frame in sent if frame not in kept]
        assert all(killed - moment < 1 for moment in lost), name


def test_a_stream_that_floods_has_to_wait_and_loses_nothing() -> None:
    data = random.Random(1).randbytes(MOST_AT_ONCE + 2_000_000)  # noqa: S311 - no secrets
    server, stop = Server(), threading.Event()
    inbox = Inbox("base", time.time_ns)
    reader = threading.Thread(target=read_link, args=(TcpSource("127.0.0.1", server.port), inbox, stop))
    reader.start()
    connection = server.accept()
    threading.Thread(target=connection.sendall, args=(data,)).start()
    taken: list[bytes] = []

    def whole() -> bool:
        taken.extend(arrival.data for arrival in inbox.take(1 << 20))
        return sum(map(len, taken)) >= len(data)

    until(whole, "all that was sent")
    stop.set()
    reader.join()
    server.close()
    assert b"".join(taken) == data
    assert inbox.slowed
    assert not inbox.dropped


def test_datagrams_above_the_rate_are_counted() -> None:
    inbox, stop = Inbox("base", time.time_ns), threading.Event()
    source = Script([bytes(60_000)] * 200)
    source.lossy = True
    reader = threading.Thread(target=read_link, args=(source, inbox, stop))
    reader.start()
    until(lambda: source.exhausted, "the end of the datagrams")
    stop.set()
    reader.join()
    kept = sum(len(arrival.data) for arrival in inbox.take(1 << 30))
    assert kept + inbox.dropped == 200 * 60_000
    assert MOST_AT_ONCE <= kept < 1.5 * MOST_AT_ONCE


def test_what_was_written_before_it_was_framed_is_framed_by_recover(tmp_path: Path) -> None:
    """Killed while a link waits: octets stand in the log, and in the repaired one as frames."""
    frames = [numbered(n) for n in range(40)]
    stream = b"".join([*frames[:20], b"noise", *frames[20:]])
    cuts = [0, 30, 333, 334, 900, 1500, len(stream)]
    pieces = [Arrival("rover", n + 1, stream[a:b]) for n, (a, b) in enumerate(pairwise(cuts))]
    chosen = RecordingConfiguration.model_validate(
        configured({"name": "rover", "protocol": "ubx", "url": "file:x"})
    )
    files = LogFiles([tmp_path], lambda _: None, time.time_ns)
    dialect = ardupilotmega()
    session = link_sessions(chosen, files.messages, {"rover": Script([])}, {}, dialect)["rover"]
    session.take(pieces[:2])
    files.end_chunk()
    session.keep(pieces[2:4])
    files.end_chunk()
    session.take(pieces[2:3])
    files.end_chunk()
    session.keep(pieces[4:])
    files.make_safe()
    assert [frame for _, frame in raw_frames(files.paths[0], "rover")] != frames
    recover(files.paths[0], tmp_path / "fixed.mcap")
    assert [frame for _, frame in raw_frames(tmp_path / "fixed.mcap", "rover")] == frames
    files.close()


def test_a_decoder_that_fails_costs_no_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from acquire.channels.receiver import ReceiverDecoder

    def stumble(*_: object) -> None:
        raise ZeroDivisionError("a week of no days\x1b[2J")

    monkeypatch.setattr(ReceiverDecoder, "feed", stumble)
    rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
    done, told = run(
        configured(rover),
        tmp_path,
        said("only raw frames are kept"),
        sources={"rover": Script([numbered(1)])},
    )
    assert any("ZeroDivisionError: a week of no days·[2J" in line for line in told)
    assert frames_in(done.paths[0], "rover") == [numbered(1)]


def test_stopping_takes_two_seconds_whatever_the_ports_do(tmp_path: Path) -> None:
    chance = random.Random(7)  # noqa: S311 - no secrets
    casters, full = [HangingServer(head) for head in (b"", b"H", b"\x16")], FullServer()
    links = [
        {
            "name": f"c{n}",
            "protocol": "rtcm3",
            "url": f"ntrip{'s' * (n == 2)}://127.0.0.1:{c.port}/M?version=1",
        }
        for n, c in enumerate(casters)
    ]
    links.append({"name": "far", "protocol": "rtcm3", "url": f"tcp://127.0.0.1:{full.port}"})
    links += [{"name": name, "protocol": "ubx", "url": "file:x"} for name in ("dead", "failing")]
    chosen = RecordingConfiguration.model_validate(configured(*links))
    for _ in range(8):
        opened = {link.name: source_of_link(link) for link in chosen.link if link.url != "file:x"}
        stop, told = threading.Event(), list[str]()
        ordered_s = time.monotonic() + chance.uniform(0, 0.5)
        order = threading.Timer(ordered_s - time.monotonic(), stop.set)
        order.start()
        done = record(
            chosen,
            tmp_path,
            stop,
            told.append,
            None,
            {**opened, "dead": DeadPort(), "failing": FailingPort()},
        )
        assert time.monotonic() - ordered_s < 2
        assert done.paths[-1].read_bytes().endswith(MAGIC)
        assert not any("\x1b" in line for line in told)
    for caster in casters:
        caster.end()
    full.end()
    assert any("dead does not stop and was abandoned" in line for line in told)


def test_a_host_name_that_cannot_be_is_tried_again(tmp_path: Path) -> None:
    stop, inbox = threading.Event(), Inbox("caster", time.time_ns)
    source = TcpSource("caster..example", 2101)
    reader = threading.Thread(target=read_link, args=(source, inbox, stop))
    reader.start()
    until(lambda: len(inbox), "the loss")
    assert "is lost: caster..example: " in inbox.take(1)[0].event
    assert reader.is_alive()
    stop.set()
    reader.join()


def test_a_serial_port_belongs_to_one_recorder() -> None:
    ours, theirs = os.openpty()
    pytest.importorskip("tty", reason="Windows has no such terminals").setraw(theirs)
    first, second = (SerialSource(os.ttyname(theirs), 115_200) for _ in range(2))
    first.open(threading.Event())
    with pytest.raises(LinkLostError, match="lock"):
        second.open(threading.Event())
    first.close()
    second.open(threading.Event())
    second.close()
    os.close(ours)
    os.close(theirs)


def test_datagrams_that_the_system_threw_away_are_counted() -> None:
    source = UdpSource("127.0.0.1", 0)
    source.open(threading.Event())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(2000):
            sender.sendto(bytes(2000), ("127.0.0.1", source._opened.getsockname()[1]))
    read = 0
    while source.read(0.01):
        read += 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"last", ("127.0.0.1", source._opened.getsockname()[1]))
    assert source.read(1.0) == b"last"
    assert 0 < read < 2000
    assert read + source.missed == 2000
    source.close()
