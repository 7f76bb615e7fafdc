"""Where a stream can be sent: UDP datagrams, a TCP reader that connects, a pseudo terminal."""

import contextlib
import itertools
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from acquire.transports.sources import host_and_port
from photocal.base.errors import ConfigurationError, DeviceError, reason
from photocal.base.operating_system import has_reader, pseudo_terminal, waiting_bytes

# A reader that takes nothing for so long is given up.
PATIENCE_S = 60.0
_QUIET_S = 0.5
# How much may wait in the socket of a reader, which holds 212 kB if it asks for no more, and what it holds of
# each datagram besides its bytes.
_IN_FLIGHT, _PER_DATAGRAM = 60_000, 800
_TABLES = ("/proc/net/udp", "/proc/net/udp6")


class Sink(Protocol):
    """Takes the frames of a stream in order."""

    def send(self, frame: bytes) -> None:
        """Send one frame; waits for a slow reader where the transport can wait."""
        ...

    @property
    def lost(self) -> int | None:
        """Number of frames that no reader got; None where that cannot be known."""
        ...


class UdpSink:
    """Each frame is one datagram; on Linux at the pace at which a reader on the same computer takes them."""

    def __init__(self, port: socket.socket) -> None:
        self._port = port
        host, self._peer = port.getpeername()[:2]
        self._local = sys.platform == "linux" and port.getsockname()[0] == host
        self._ahead = self._refused = 0
        # Of each socket that has read here, what it had lost before and what it has lost by now.
        self._losses: dict[str, tuple[int, int]] = {}
        self._look()
        self._losses = {reader: (lost, lost) for reader, (_, lost) in self._losses.items()}

    @property
    def lost(self) -> int | None:
        """Number of datagrams that no reader got; None where that cannot be known."""
        if not self._local:
            return None
        self._look()
        if self._port.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._refused += 1
        return self._refused + sum(now - before for before, now in self._losses.values())

    def send(self, frame: bytes) -> None:
        """Send one frame; that nobody listens (yet) is no failure, but counted."""
        self._ahead += len(frame) + _PER_DATAGRAM
        if self._local and self._ahead > _IN_FLIGHT:
            self._ahead = 0
            self._await_reader()
        try:
            self._port.send(frame)
        except ConnectionRefusedError:
            # This tells of the one before; the frame itself was not sent yet.
            self._refused += 1
            self._port.send(frame)

    def _await_reader(self) -> None:
        until = time.monotonic() + PATIENCE_S
        while self._look() > _IN_FLIGHT:
            if time.monotonic() > until:
                raise DeviceError(f"the reader has accepted no data for {PATIENCE_S:.0f} s", "check it")
            time.sleep(0.001)

    def _look(self) -> int:
        """Take note of what the reader's sockets have lost (proc(5)); return how many bytes wait there."""
        waiting = 0
        for table in _TABLES if self._local else ():
            with contextlib.suppress(OSError), Path(table).open(encoding="ascii") as lines:
                for line in itertools.islice(lines, 1, None):
                    fields = line.split()
                    if int(fields[1].rpartition(":")[2], 16) == self._peer:
                        waiting = max(waiting, int(fields[4].partition(":")[2], 16))
                        before, _ = self._losses.get(fields[9], (0, 0))
                        self._losses[fields[9]] = before, int(fields[12])
        return waiting


class _TcpSink:
    """A stream to the one reader that connects; the first frame waits for that."""

    lost = 0

    def __init__(self, server: socket.socket) -> None:
        self._server = server
        self._port: socket.socket | None = None

    def send(self, frame: bytes) -> None:
        """Send a frame, to the first reader that connects."""
        if self._port is None:
            try:
                self._port, _ = self._server.accept()
            except TimeoutError as failure:
                raise DeviceError(
                    f"no reader has connected within {PATIENCE_S:.0f} s", "start the reader"
                ) from failure
        try:
            self._port.sendall(frame)
        except OSError as failure:
            raise DeviceError(
                f"the reader was closed ({reason(failure)})", "start reader and replay again"
            ) from failure


class _PtySink:
    """A pseudo terminal that a program opens like a serial port; the first frame waits for it."""

    lost = 0

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.read_by_someone = False

    def send(self, frame: bytes) -> None:
        """Send a frame once somebody reads the pseudo terminal."""
        if not self.read_by_someone:
            _await_reader(self._descriptor)
            self.read_by_someone = True
        view = memoryview(frame)
        while view:
            view = view[os.write(self._descriptor, view) :]


@contextmanager
def open_sink(url: str) -> Iterator[tuple[Sink, str]]:
    """Open where a stream is to be sent.

    raises ConfigurationError: when the address is not valid.
    raises DeviceError: when it cannot be opened, or no reader comes.
    """
    if url == "pty":
        with _pty() as opened:
            yield opened
        return
    address = host_and_port(url) if url.startswith(("udp://", "tcp://")) else None
    if address is None:
        raise ConfigurationError(
            "is not an address to send to", "give udp://HOST:PORT, tcp://HOST:PORT or pty", where=url
        )
    try:
        if url.startswith("udp://"):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
                datagrams.connect(address)
                yield UdpSink(datagrams), url
        else:
            with socket.create_server(address) as server:
                server.settimeout(PATIENCE_S)
                yield _TcpSink(server), "tcp://{}:{}".format(*server.getsockname()[:2])
    except OSError as failure:
        raise DeviceError(
            f"cannot be opened ({reason(failure)})", "choose another address", where=url
        ) from failure


@contextmanager
def _pty() -> Iterator[tuple[Sink, str]]:
    ours, theirs, path = pseudo_terminal()
    # Only when nobody has it open can be seen that somebody opens it.
    os.close(theirs)
    try:
        sink = _PtySink(ours)
        yield sink, path
        if sink.read_by_someone:
            theirs = os.open(path, os.O_RDWR | getattr(os, "O_NOCTTY", 0))
            try:
                _drain(theirs)
            finally:
                os.close(theirs)
    finally:
        os.close(ours)


def _await_reader(descriptor: int) -> None:
    """Wait until a program has opened a terminal, and for a moment: many throw away what is there by then."""
    end = time.monotonic() + PATIENCE_S
    while not has_reader(descriptor):
        if time.monotonic() > end:
            raise DeviceError(
                f"no reader has opened the terminal within {PATIENCE_S:.0f} s", "start the reader"
            )
        time.sleep(0.01)
    time.sleep(_QUIET_S)


def _drain(theirs: int) -> None:
    """Wait until the reader has taken everything: closing a terminal throws away what it holds."""
    now = time.monotonic()
    until, taken = now + PATIENCE_S, now
    # The kernel passes bytes on in pieces: between two of them a terminal looks empty for a moment.
    while now < until and now - taken < _QUIET_S:
        time.sleep(0.01)
        now = time.monotonic()
        if waiting_bytes(theirs):
            taken = now
