"""Corrections from a caster (NTRIP 1 and 2), also over TLS.

Source: RTCM 10410.1, Networked Transport of RTCM via Internet Protocol, versions 1.0 and 2.0.
"""

from __future__ import annotations

import base64
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from acquire.transports.sources import PIECE_BYTES, LinkLostError
from drivers.errors import ConfigurationError

_AGENT = "NTRIP photocal"
_LONGEST_HEAD = 1 << 16
_CONNECT_S = 10.0


@dataclass(frozen=True)
class Address:
    """A stream of a caster."""

    host: str
    port: int
    mountpoint: str
    encrypted: bool
    version: int


def ntrip_address(url: str) -> Address | None:
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
            "an address of a caster carries no user and password",
            where=f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}",
            remedy="give user = ... and password_env = the name of an environment variable",
        )
    mountpoint = parts.path.strip("/") if parts is not None else ""
    queries = {"": 2, "version=1": 1, "version=2": 2}
    clean = mountpoint.isprintable() and " " not in mountpoint
    if parts is None or host is None or not mountpoint or not clean or parts.query not in queries:
        raise ConfigurationError(
            "is no address of a caster", where=url, remedy="give ntrip://HOST:PORT/MOUNTPOINT[?version=1]"
        )
    encrypted = parts.scheme == "ntrips"
    return Address(host, port or (443 if encrypted else 2101), mountpoint, encrypted, queries[parts.query])


class NtripSource:
    """The stream of a caster; a `Source`.

    Parameters
    ----------
    address : Address
        The stream.
    user, password : str
        As the caster knows us; empty for open streams. They appear in no message.
    context : ssl.SSLContext, optional
        Whom to trust; otherwise the authorities that the system trusts.
    position : callable, optional
        Gives the GGA sentence that the caster is told when the stream is asked for; empty while none is
        known. Version 2 takes it in the request (``Ntrip-GGA``), version 1 as the first line after that.
    """

    peer = ""

    def __init__(
        self,
        address: Address,
        user: str = "",
        password: str = "",
        context: ssl.SSLContext | None = None,
        position: Callable[[], bytes] | None = None,
    ) -> None:
        self._address = address
        self._login = f"{user}:{password}" if user or password else ""
        self._context = context
        self._position = position or bytes
        self._port: socket.socket | None = None
        self._body: _Plain | _Chunked = _Plain()
        self._ready = b""

    def open(self) -> None:
        """Connect and ask for the stream."""
        address = self._address
        try:
            line = socket.create_connection((address.host, address.port), timeout=_CONNECT_S)
            try:
                if address.encrypted:
                    context = self._context or ssl.create_default_context()
                    line = context.wrap_socket(line, server_hostname=address.host)
                sentence = self._position()
                line.sendall(self._request(sentence))
                head, rest = _head(line)
                self._body = _body_of(head)
                if address.version == 1 and sentence:
                    line.sendall(sentence)
            except BaseException:
                line.close()
                raise
        except OSError as failure:
            raise LinkLostError(f"{address.host}: {failure}") from failure
        self._port = line
        self._ready = self._body.take(rest)

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived."""
        if self._ready:
            data, self._ready = self._ready, b""
            return data
        if self._port is None:
            raise LinkLostError("not open")
        self._port.settimeout(timeout_s)
        try:
            data = self._port.recv(PIECE_BYTES)
        except (TimeoutError, ssl.SSLWantReadError):
            return b""
        except OSError as failure:
            raise LinkLostError(str(failure)) from failure
        if not data or self._body.ended:
            raise LinkLostError("the caster has ended the stream")
        return self._body.take(data)

    def write(self, data: bytes) -> None:
        """Send bytes to the caster: positions as NMEA sentences."""
        if self._port is None:
            raise LinkLostError("not open")
        try:
            self._port.sendall(data)
        except OSError as failure:
            raise LinkLostError(str(failure)) from failure

    def close(self) -> None:
        """Close the connection."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _request(self, sentence: bytes) -> bytes:
        address = self._address
        lines = [f"GET /{address.mountpoint} HTTP/1.{address.version - 1}"]
        if address.version == 2:
            lines += [f"Host: {address.host}:{address.port}", "Ntrip-Version: Ntrip/2.0", "Connection: close"]
            if sentence:
                lines.append(f"Ntrip-GGA: {sentence.decode('ascii').strip()}")
        lines.append(f"User-Agent: {_AGENT}")
        if self._login:
            lines.append("Authorization: Basic " + base64.b64encode(self._login.encode()).decode())
        return "\r\n".join([*lines, "", ""]).encode()


class _Plain:
    ended = False

    def take(self, data: bytes) -> bytes:
        return data


class _Chunked:
    """Takes the lengths out of a body that comes in chunks (RFC 9112, section 7.1)."""

    def __init__(self) -> None:
        self._pending = b""
        self._left = 0
        self.ended = False

    def take(self, data: bytes) -> bytes:
        self._pending += data
        out = b""
        while self._pending and not self.ended:
            if self._left > 2:
                piece = self._pending[: self._left - 2]
                self._pending = self._pending[len(piece) :]
                self._left -= len(piece)
                out += piece
            elif self._left:
                skipped = min(self._left, len(self._pending))
                self._pending, self._left = self._pending[skipped:], self._left - skipped
            else:
                line, found, rest = self._pending.partition(b"\r\n")
                if not found and len(line) < 64:
                    break
                try:
                    size = int(line.split(b";")[0], 16)
                except ValueError:
                    raise LinkLostError("the caster's answer is damaged") from None
                self._pending, self._left, self.ended = rest, size + 2, size == 0
        return out


def _head(line: socket.socket) -> tuple[bytes, bytes]:
    data = b""
    while True:
        # A caster of version 1 ends its head with one line, or with an empty one after it.
        first, found, rest = data.partition(b"\r\n")
        if found and first.startswith(b"ICY 200"):
            return first, rest.removeprefix(b"\r\n")
        head, found, rest = data.partition(b"\r\n\r\n")
        if found:
            return head, rest
        if first.startswith(b"ERROR") and b"\n" in data:
            return first, b""
        piece = line.recv(PIECE_BYTES)
        if not piece or len(data) > _LONGEST_HEAD:
            raise LinkLostError("the caster does not answer as a caster does")
        data += piece


def _body_of(head: bytes) -> _Plain | _Chunked:
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
    return _Chunked() if fields.get("transfer-encoding") == "chunked" else _Plain()
