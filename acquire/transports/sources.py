"""Where a stream comes from: serial ports, TCP, UDP, files. Each opens anew after it was lost."""

import errno
import os
import select
import socket
import struct
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from photocal.base.errors import ConfigurationError, reason

PIECE_BYTES = 65536
_WRITE_LIMIT_S = 0.5
# Linux counts the datagrams that a socket could not hold: the last of the nine numbers of SO_MEMINFO.
_MEMORY_FIGURES, _FIGURES = 55, struct.Struct("9I")
_SERIAL = ("serial", "socket", "loop", "rfc2217")


class LinkLostError(Exception):
    """The port, connection or file of a source has ended or gone away."""


class NobodyThereError(LinkLostError):
    """The port is not open, or nobody was heard who could be answered: what is sent goes nowhere."""


class Source(ABC):
    """Bytes of one link as they arrive, by a port that is open or not: a failure of it loses the link.

    peer: who sent last, where that can change; otherwise empty.
    device: the peer that is answered, see `heed`.
    lossy: whether what is not read is lost without being counted.
    missed: number of datagrams that the system could not hold until they were read.
    """

    peer = ""
    device = ""
    lossy = False
    missed = 0

    def __init__(self) -> None:
        self._port: Any = None

    @abstractmethod
    def open(self, stop: threading.Event, /) -> None:
        """Open the port; raises `LinkLostError` when that is not possible now, or `stop` is set."""

    @abstractmethod
    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, nothing after `timeout_s`; raises `LinkLostError` when all is over."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send bytes to the device; raises `LinkLostError` when that is not possible."""

    def heed(self, peer: str) -> None:
        """Take who sent intact frames last, as `peer` told, for the device: what is written goes there."""
        self.device = peer

    def close(self) -> None:
        """Close the port."""
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def _opened(self) -> Any:
        if self._port is None:
            raise NobodyThereError("not open")
        return self._port


class Deadline:
    """Time limit of opening a connection; the stop event ends it, too."""

    def __init__(self, stop: threading.Event, seconds: float) -> None:
        self._stop = stop
        self._until = time.monotonic() + seconds
        self._seconds = seconds

    def wait(self, port: socket.socket, *, writing: bool = False) -> None:
        """Wait until a socket can be read or written; raises `LinkLostError` when the time is over."""
        while not self._stop.is_set() and time.monotonic() < self._until:
            if any(select.select([] if writing else [port], [port] if writing else [], [], 0.1)):
                return
        raise LinkLostError(f"no answer within {self._seconds:g} s")


def connect(host: str, port: int, deadline: Deadline) -> socket.socket:
    """Return a connection that does not block."""
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as failure:
        raise LinkLostError(f"{host}: {reason(failure)}") from failure
    why = "has no address"
    for family, kind, protocol, _, address in addresses:
        line = socket.socket(family, kind, protocol)
        try:
            line.setblocking(False)
            if line.connect_ex(address):
                deadline.wait(line, writing=True)
            code = line.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if not code:
                return line
            why = reason(OSError(code, os.strerror(code)))
        except (OSError, LinkLostError) as failure:
            why = reason(failure)
        line.close()
    raise LinkLostError(f"{host}: {why}")


@contextmanager
def _losing(*failures: type[Exception], words: Callable[[Exception], str] = reason) -> Iterator[None]:
    """Within it such failures mean that the link is lost."""
    try:
        yield
    except failures as failure:
        raise LinkLostError(words(failure)) from failure


# pySerial says so of a port whose device has gone; the system says one of these.
_GONE = "device reports readiness to read but returned no data"
_PULLED = (errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF)


def _of_port(failure: Exception) -> str:
    """Say in the crew's words why a serial port cannot be read or opened."""
    number = failure.errno if isinstance(failure, OSError) else None
    if _GONE in str(failure) or number in _PULLED:
        return "no data from the device: cable pulled?"
    if number == errno.ENOENT:
        return "there is no such port: is the device plugged in?"
    if number in (errno.EACCES, errno.EPERM):
        return "no permission to open the port: photocal doctor shows the remedy"
    return reason(failure)


class UdpSource(Source):
    """Datagrams that arrive at a local address; answers go to whom `heed` names.

    A sender that changes its port is followed as soon as intact frames come from there; a stranger is not.
    """

    lossy = sys.platform != "linux"

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = host, port
        self._missed_before = 0

    def open(self, _stop: threading.Event) -> None:
        """Bind the local address."""
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with _losing(OSError, UnicodeError, OverflowError):
            try:
                # Room for a second of a fast link while the disk is busy.
                port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
                port.bind(self._address)
            except BaseException:
                port.close()
                raise
        self._port = port

    def read(self, timeout_s: float) -> bytes:
        """Return one datagram."""
        port = self._opened
        port.settimeout(timeout_s)
        with _losing(OSError):
            try:
                data, sender = port.recvfrom(PIECE_BYTES)
                self.peer = f"{sender[0]}:{sender[1]}"
            except TimeoutError:
                return b""
        return bytes(data)

    @property
    def missed(self) -> int:  # type: ignore[override]
        """Number of datagrams that the system could not hold; known on Linux."""
        if self._port is None or self.lossy:
            return self._missed_before
        figures = self._port.getsockopt(socket.SOL_SOCKET, _MEMORY_FIGURES, _FIGURES.size)
        return self._missed_before + int(_FIGURES.unpack(figures)[-1])

    def write(self, data: bytes) -> None:
        """Send one datagram to the device; raises `NobodyThereError` before it was heard."""
        host, _, port = self.device.rpartition(":")
        if not host:
            raise NobodyThereError("no device has sent anything yet")
        with _losing(OSError):
            self._opened.sendto(data, (host, int(port)))

    def close(self) -> None:
        """Close the port."""
        self._missed_before = self.missed
        super().close()


class TcpSource(Source):
    """A stream from a server that we connect to."""

    # How a connection says that nothing has come yet.
    _not_yet: tuple[type[OSError], ...] = (TimeoutError,)

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = host, port

    def open(self, stop: threading.Event) -> None:
        """Connect."""
        connect_s = 5.0
        self._port = connect(*self._address, Deadline(stop, connect_s))

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived."""
        data = self._received(timeout_s)
        if data == b"":
            raise LinkLostError("the server has closed the connection")
        return data or b""

    def _received(self, timeout_s: float) -> bytes | None:
        """Return what the connection brings: nothing when it has ended, None when nothing came in time."""
        port = self._opened
        port.settimeout(timeout_s)
        with _losing(OSError):
            try:
                return bytes(port.recv(PIECE_BYTES))
            except self._not_yet:
                return None

    def write(self, data: bytes) -> None:
        """Send bytes to the server; what it does not take within `_WRITE_LIMIT_S` is given up."""
        port, left, until = self._opened, memoryview(data), time.monotonic() + _WRITE_LIMIT_S
        not_yet: tuple[type[OSError], ...] = (*self._not_yet, BlockingIOError)
        with _losing(OSError):
            while left:
                try:
                    # Who reads sets how long this may take, a fraction of a second.
                    left = left[port.send(left) :]
                except not_yet:
                    if time.monotonic() > until:
                        raise LinkLostError(f"accepts no data for {_WRITE_LIMIT_S:g} s") from None
                    time.sleep(0.005)


class SerialSource(Source):
    """A serial port, or what pyserial makes look like one.

    url: device path, or a URL of pyserial (``socket://``, ``loop://``, ``rfc2217://``).
    """

    def __init__(self, url: str, baud: int) -> None:
        super().__init__()
        self._url = url
        self._baud = baud

    def open(self, _stop: threading.Event) -> None:
        """Open the port for us alone: of two readers each would get a part of the bytes."""
        import serial

        # pySerial knows no time limit of writing to a port behind RFC 2217.
        limit_s = None if self._url.startswith("rfc2217:") else _WRITE_LIMIT_S
        alone: Any = {} if "://" in self._url else {"exclusive": True}
        with _losing(OSError, ValueError, UnicodeError, words=_of_port):
            self._port = serial.serial_for_url(
                self._url, baudrate=self._baud, timeout=0.1, write_timeout=limit_s, **alone
            )
        line = getattr(self._port, "_socket", None)
        if limit_s is None and line is not None:
            line.settimeout(_WRITE_LIMIT_S)

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived."""
        port = self._opened
        with _losing(OSError, TypeError, words=_of_port):
            # Each change sets up the whole port anew, behind RFC 2217 by a conversation.
            if port.timeout != timeout_s:
                port.timeout = timeout_s
            first = port.read(1)
            return bytes(first + port.read(port.in_waiting)) if first else b""

    def write(self, data: bytes) -> None:
        """Send bytes to the device."""
        with _losing(OSError, TypeError, AttributeError, words=_of_port):
            self._opened.write(data)


class FileSource(Source):
    """The bytes of a file, once; then the link is silent."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def open(self, _stop: threading.Event) -> None:
        """Open the file, the first time only."""
        with _losing(OSError):
            self._port = self._port or self._path.open("rb")

    def read(self, timeout_s: float) -> bytes:
        """Return the next bytes."""
        data = bytes(self._port.read(PIECE_BYTES))
        if not data:
            time.sleep(timeout_s)
        return data

    def write(self, data: bytes) -> None:
        """Take nothing: a file does not listen."""

    def close(self) -> None:
        """Close the file, for good: its bytes come once."""
        if self._port is not None:
            self._port.close()


def host_and_port(url: str) -> tuple[str, int] | None:
    """Return host and port of a URL; None when it has not both."""
    try:
        host, port = urlsplit(url).hostname, urlsplit(url).port
    except ValueError:
        return None
    return None if host is None or port is None else (host, port)


def source_of(url: str, baud: int) -> Source:
    """Return the source of a URL."""
    scheme, _, rest = url.partition(":")
    if scheme == "serial" and rest:
        return SerialSource(rest, baud)
    if scheme in _SERIAL and rest:
        return SerialSource(url, baud)
    if scheme == "file" and rest:
        return FileSource(Path(rest))
    if scheme in ("udp", "tcp") and (address := host_and_port(url)) is not None:
        return UdpSource(*address) if scheme == "udp" else TcpSource(*address)
    raise ConfigurationError(
        "is not an address of a link",
        "give udp://HOST:PORT, tcp://HOST:PORT, serial:DEVICE or file:PATH",
        where=url,
    )
