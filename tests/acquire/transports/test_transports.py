"""Each transport against a twin at its other end: both directions, its end told, opened again."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
import serial.rfc2217

from acquire.transports.sources import (
    LinkLostError,
    NobodyThereError,
    Source,
    TcpSource,
    UdpSource,
    source_of,
)
from photocal.base.errors import ConfigurationError
from tests.acquire.live import PATIENCE_S, until

FIRST, SECOND, ANSWER = b"from the device\r\n", b"\x00\xff\xfe once more", b"\xffto the device\x00"


@contextlib.contextmanager
def opened(url: str) -> Iterator[Source]:
    source = source_of(url, 57_600)
    source.open(threading.Event())
    try:
        yield source
    finally:
        source.close()


def heard(source: Source, count: int) -> bytes:
    """Read until so many bytes have come."""
    data = b""

    def enough() -> bool:
        nonlocal data
        data += source.read(0.05)
        return len(data) >= count

    until(enough, f"{count} bytes")
    return data


class Server:
    """A TCP server for one connection after the other."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(PATIENCE_S)
        self.port = int(self._server.getsockname()[1])
        self.connections: list[socket.socket] = []

    def accept(self) -> socket.socket:
        connection, _ = self._server.accept()
        connection.settimeout(PATIENCE_S)
        self.connections.append(connection)
        return connection

    def close(self) -> None:
        for one in (*self.connections, self._server):
            one.close()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.close()


@pytest.mark.parametrize("scheme", ["tcp", "socket"])
def test_a_stream_of_a_server(scheme: str, server: Server) -> None:
    with opened(f"{scheme}://127.0.0.1:{server.port}") as source:
        there = server.accept()
        there.sendall(FIRST)
        assert heard(source, len(FIRST)) == FIRST
        source.write(ANSWER)
        assert there.recv(100) == ANSWER
        there.close()
        with pytest.raises(LinkLostError):
            until(lambda: source.read(0.05) and False, "the end of the stream")
        source.close()
        source.open(threading.Event())
        server.accept().sendall(SECOND)
        assert heard(source, len(SECOND)) == SECOND


def test_datagrams_of_a_sender_that_moves() -> None:
    source = UdpSource("127.0.0.1", 0)
    source.open(threading.Event())
    there = "127.0.0.1", source._opened.getsockname()[1]
    assert source.read(0.01) == b""
    with pytest.raises(NobodyThereError):
        source.write(ANSWER)
    for _ in range(2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.settimeout(PATIENCE_S)
            sender.sendto(FIRST, there)
            assert source.read(PATIENCE_S) == FIRST
            assert source.peer.endswith(f":{sender.getsockname()[1]}")
            source.heed(source.peer)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"x", there)
                assert source.read(PATIENCE_S) == b"x"
            source.write(ANSWER)
            assert sender.recv(100) == ANSWER
    source.close()


def test_a_serial_line() -> None:
    ours, theirs = os.openpty()
    pytest.importorskip("tty", reason="Windows has no such terminals").setraw(theirs)
    with opened(f"serial:{os.ttyname(theirs)}") as source:
        os.write(ours, FIRST)
        assert heard(source, len(FIRST)) == FIRST
        source.write(ANSWER)
        assert os.read(ours, 100) == ANSWER
        os.close(theirs)
        os.close(ours)
        with pytest.raises(LinkLostError):
            until(lambda: source.read(0.05) and False, "the end of the line")


def test_a_line_that_ends_in_itself() -> None:
    with opened("loop://") as source:
        source.write(ANSWER)
        assert heard(source, len(ANSWER)) == ANSWER


class PortServer:
    """A serial port (one that ends in itself) behind RFC 2217, as pySerial's own server has it."""

    def __init__(self, server: Server) -> None:
        self.port: Any = serial.serial_for_url("loop://", timeout=0.02)
        self.settings = 0
        self._server = server
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        line = self._server.accept()
        line.settimeout(0.02)

        class Connection:
            """What the port manager writes its answers to."""

            def write(self, data: bytes) -> None:
                line.sendall(data)

        answers: Any = Connection()
        manager = serial.rfc2217.PortManager(self.port, answers)
        with contextlib.suppress(OSError):
            while not self._stop.is_set():
                with contextlib.suppress(TimeoutError):
                    data = line.recv(1000)
                    if not data:
                        return
                    self.settings += data.count(serial.rfc2217.COM_PORT_OPTION)
                    for text in manager.filter(data):
                        self.port.write(text)
                if back := self.port.read(self.port.in_waiting):
                    line.sendall(b"".join(manager.escape(back)))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.port.close()


# pySerial's own.
@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")
def test_a_port_behind_rfc_2217(server: Server) -> None:
    far = PortServer(server)
    with opened(f"rfc2217://127.0.0.1:{server.port}") as source:
        assert far.port.baudrate == 57_600
        source.write(ANSWER)
        assert heard(source, len(ANSWER)) == ANSWER
        agreed = far.settings
        for _ in range(5):
            source.write(SECOND)
            assert heard(source, len(SECOND)) == SECOND
        # The line is negotiated at the beginning, not anew with each look.
        assert far.settings == agreed
    far.close()


def test_a_file_is_read_once(tmp_path: Path) -> None:
    path = tmp_path / "stream"
    path.write_bytes(FIRST)
    with opened(f"file:{path}") as source:
        source.write(ANSWER)
        assert heard(source, len(FIRST)) == FIRST
        assert source.read(0.001) == b""
        source.open(threading.Event())
        assert source.read(0.001) == b""
    assert path.read_bytes() == FIRST


@pytest.mark.parametrize(
    "make",
    [
        lambda: TcpSource("127.0.0.1", 1),
        lambda: source_of("serial:/dev/no-such-port", 9600),
        lambda: source_of("socket://127.0.0.1:1", 9600),
        lambda: source_of("file:no-such-file", 9600),
    ],
)
def test_what_is_not_there_is_a_lost_link(make: Callable[[], Source]) -> None:
    with pytest.raises(LinkLostError):
        make().open(threading.Event())


@pytest.mark.parametrize(
    "url", ["", "udp://127.0.0.1", "tcp://:80", "bluetooth:x", "udp://host:port", "serial:"]
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ConfigurationError, match="not an address"):
        source_of(url, 9600)
