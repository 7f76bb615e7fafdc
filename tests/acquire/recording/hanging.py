"""Ports and servers that hang: what a recorder must be able to leave behind."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

from acquire.transports.sources import Source


class HangingServer:
    """A server that gives one byte in 50 ms and never comes to an end.

    Parameters
    ----------
    head : bytes
        What it gives, after that always the same byte; when it is empty it gives nothing.
    """

    def __init__(self, head: bytes) -> None:
        self._head = head
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.port = int(self._server.getsockname()[1])
        self._ended = threading.Event()
        threading.Thread(target=self._serve, daemon=True).start()

    def end(self) -> None:
        """Close the server and its connections."""
        self._ended.set()

    def _serve(self) -> None:
        with self._server:
            while not self._ended.is_set():
                with contextlib.suppress(TimeoutError):
                    connection, _ = self._server.accept()
                    threading.Thread(target=self._drip, args=(connection,), daemon=True).start()

    def _drip(self, connection: socket.socket) -> None:
        given = 0
        connection.settimeout(0.05)
        with connection, contextlib.suppress(OSError):
            while not self._ended.is_set():
                with contextlib.suppress(TimeoutError):
                    # Who has gone is not waited for: a thousand recordings would leave as many threads.
                    if not connection.recv(1 << 16):
                        return
                if self._head:
                    connection.send(self._head[given : given + 1] or self._head[-1:])
                    given += 1


class FullServer:
    """An address that does not answer: its queue is full, and the system drops who else would connect."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0), backlog=0)
        self.port = int(self._server.getsockname()[1])
        self._waiting = [socket.socket() for _ in range(4)]
        for line in self._waiting:
            line.setblocking(False)
            line.connect_ex(("127.0.0.1", self.port))

    def end(self) -> None:
        """Close the server and what waits for it."""
        for line in (self._server, *self._waiting):
            line.close()


class DeadPort(Source):
    """A port whose driver does not come back for seconds."""

    def open(self, _stop: threading.Event) -> None:
        pass

    def read(self, _timeout_s: float) -> bytes:
        time.sleep(5)
        return b""

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


class FailingPort(DeadPort):
    """A port that fails in a way that nobody thought of, with words that would steer a terminal."""

    def read(self, _timeout_s: float) -> bytes:
        raise UnicodeError("label empty or too long\x1b]0;owned\x07")
