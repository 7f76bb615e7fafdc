"""Corrections from a caster (NTRIP 1 and 2), also over TLS.

Source: RTCM 10410.1, Networked Transport of RTCM via Internet Protocol, versions 1.0 and 2.0.
"""

import base64
import re
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import urlsplit

from acquire.transports.sources import PIECE_BYTES, Deadline, LinkLostError, TcpSource, connect
from photocal.base.errors import ConfigurationError, reason

if TYPE_CHECKING:
    # Loaded where a caster asks for it: five megabytes that other recordings do without.
    import ssl

Result = TypeVar("Result")

_AGENT = "NTRIP photocal"
_LONGEST_HEAD = 1 << 16
_CHUNK_SIZE = re.compile(rb"([0-9A-Fa-f]{1,8})[ \t]*(?:;.*)?")


@dataclass(frozen=True)
class CasterAddress:
    """A stream of a caster."""

    host: str
    port: int
    mountpoint: str
    encrypted: bool
    version: int


def ntrip_address(url: str) -> CasterAddress | None:
    """Return the caster that a URL names; None when it is no NTRIP URL."""
    if not url.startswith(("ntrip:", "ntrips:")):
        return None
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = None, None, None
    if parts is not None and "@" in parts.netloc:
        # The address is shown and kept: it must not carry what is secret.
        raise ConfigurationError(
            "an address of a caster must not contain user and password",
            "give user = ... and password_env = the name of an environment variable",
            where=f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}",
        )
    mountpoint = parts.path.strip("/") if parts is not None else ""
    queries = {"": 2, "version=1": 1, "version=2": 2}
    clean = mountpoint.isprintable() and " " not in mountpoint
    if parts is None or host is None or not mountpoint or not clean or parts.query not in queries:
        raise ConfigurationError(
            "is not an address of a caster", "give ntrip://HOST:PORT/MOUNTPOINT[?version=1]", where=url
        )
    encrypted = parts.scheme == "ntrips"
    return CasterAddress(
        host, port or (443 if encrypted else 2101), mountpoint, encrypted, queries[parts.query]
    )


class NtripSource(TcpSource):
    """The stream of a caster; a `Source`.

    user, password: as the caster knows us; empty for open streams. They appear in no message.
    context: whom to trust; otherwise the authorities that the system trusts.
    position: gives the GGA sentence that the caster gets when the stream is asked for; empty while none is
        known. Version 2 takes it in the request (``Ntrip-GGA``), version 1 as the first line after that.
    """

    def __init__(
        self,
        address: CasterAddress,
        user: str = "",
        password: str = "",
        context: "ssl.SSLContext | None" = None,
        position: Callable[[], bytes] | None = None,
    ) -> None:
        super().__init__(address.host, address.port)
        self._caster = address
        self._login = f"{user}:{password}" if user or password else ""
        self._context = context
        self._position = position or bytes
        self._body = _Body(False)
        self._ready = b""

    def open(self, stop: threading.Event) -> None:
        """Connect and ask for the stream."""
        address = self._caster
        connect_s = 10.0
        deadline = Deadline(stop, connect_s)
        line = connect(address.host, address.port, deadline)
        try:
            if address.encrypted:
                import ssl

                self._not_yet = TimeoutError, ssl.SSLWantReadError
                context = self._context or ssl.create_default_context()
                line = context.wrap_socket(line, server_hostname=address.host, do_handshake_on_connect=False)
                _within(line, line.do_handshake, deadline)
            sentence = self._position()
            line.sendall(self._request(sentence))
            head, rest = _head(line, deadline)
            self._body = _body_of(head)
            if address.version == 1 and sentence:
                line.sendall(sentence)
        except (OSError, ValueError) as failure:
            line.close()
            raise LinkLostError(f"{address.host}: {reason(failure)}") from failure
        except BaseException:
            line.close()
            raise
        self._port = line
        self._ready = self._body.take(rest)

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived."""
        if self._ready:
            data, self._ready = self._ready, b""
            return data
        received = self._received(timeout_s)
        if received is None:
            return b""
        if not received or self._body.ended:
            raise LinkLostError("the caster has ended the stream")
        return self._body.take(received)

    def _request(self, sentence: bytes) -> bytes:
        address = self._caster
        lines = [f"GET /{address.mountpoint} HTTP/1.{address.version - 1}"]
        if address.version == 2:
            lines += [f"Host: {address.host}:{address.port}", "Ntrip-Version: Ntrip/2.0", "Connection: close"]
            if sentence:
                lines.append(f"Ntrip-GGA: {sentence.decode('ascii').strip()}")
        lines.append(f"User-Agent: {_AGENT}")
        if self._login:
            lines.append("Authorization: Basic " + base64.b64encode(self._login.encode()).decode())
        return "\r\n".join([*lines, "", ""]).encode()


class _Body:
    """The body of an answer: takes the lengths out of one that comes in chunks (RFC 9112, section 7.1)."""

    def __init__(self, chunked: bool) -> None:
        self._chunked = chunked
        self._pending = b""
        self._left = 0
        self.ended = False

    def take(self, data: bytes) -> bytes:
        """Return the data of received bytes, without the frames of chunks."""
        # A length in hexadecimal figures and an extension that nobody sends.
        longest_chunk_line = 64
        if not self._chunked:
            return data
        data = self._pending + data
        at, out = 0, []
        while at < len(data) and not self.ended:
            if self._left > 2:
                out.append(data[at : at + self._left - 2])
                at, self._left = at + len(out[-1]), self._left - len(out[-1])
            elif self._left:
                skipped = min(self._left, len(data) - at)
                at, self._left = at + skipped, self._left - skipped
            else:
                end = data.find(b"\r\n", at, at + longest_chunk_line)
                if end < 0 and len(data) - at < longest_chunk_line:
                    break
                size = _CHUNK_SIZE.fullmatch(data, at, max(end, at))
                if size is None:
                    raise LinkLostError("the caster's answer is damaged")
                at, self._left = end + 2, int(size[1], 16) + 2
                self.ended = self._left == 2
        self._pending = data[at:]
        return b"".join(out)


def _within(line: socket.socket, action: Callable[[], Result], deadline: Deadline) -> Result:
    """Do what a socket without blocking may refuse for now."""
    while True:
        try:
            return action()
        except BlockingIOError:
            deadline.wait(line)
        except OSError as failure:
            import ssl

            if not isinstance(failure, (ssl.SSLWantReadError, ssl.SSLWantWriteError)):
                raise
            deadline.wait(line, writing=isinstance(failure, ssl.SSLWantWriteError))


def _head(line: socket.socket, deadline: Deadline) -> tuple[bytes, bytes]:
    data = b""
    while True:
        # A caster of version 1 ends its head with one line, or with an empty one after it.
        first, separator, rest = data.partition(b"\r\n")
        if separator and first.startswith(b"ICY 200"):
            return first, rest.removeprefix(b"\r\n")
        head, separator, rest = data.partition(b"\r\n\r\n")
        if separator:
            return head, rest
        if first.startswith(b"ERROR") and b"\n" in data:
            return first, b""
        piece = _within(line, lambda: line.recv(PIECE_BYTES), deadline)
        if not piece or len(data) > _LONGEST_HEAD:
            raise LinkLostError("the server does not answer as an NTRIP caster does")
        data += piece


def _body_of(head: bytes) -> _Body:
    lines = head.decode("latin-1").split("\r\n")
    status = lines[0]
    fields = dict(line.lower().replace(" ", "").partition(":")[::2] for line in lines[1:])
    if status.startswith("SOURCETABLE") or "sourcetable" in fields.get("content-type", ""):
        raise LinkLostError("the caster does not have this mountpoint")
    words = status.split()
    code = words[1] if len(words) > 1 else ""
    if code == "401" or "Bad Password" in status:
        raise LinkLostError("the caster refuses user and password")
    if code != "200":
        raise LinkLostError(f"the caster refuses: {status[:80]}")
    return _Body(fields.get("transfer-encoding") == "chunked")
