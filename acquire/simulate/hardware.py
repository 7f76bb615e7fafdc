"""The devices of a simulated flight on ports of this computer, and what is needed to record them."""

import contextlib
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol

from acquire.simulate.playback import FlightClock, FlownAutopilot, FlownReceiver, PlayedFlight
from photocal.base.codec import toml_text
from photocal.base.operating_system import pseudo_terminal

_TICK_S = 0.005
HOST = "127.0.0.1"
SPOKEN_TO = ("vehicle", "rover", "base")


class Device(Protocol):
    """A simulated device: what it sends by itself and what it answers."""

    def due(self, time_s: float) -> bytes:
        """Return what is sent of its own accord up to a moment, seconds after the start."""
        ...

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Take bytes of the host; return the answers."""
        ...


@contextmanager
def on_udp(device: Device, host: str, port: int) -> Iterator[None]:
    """Let a device speak to a UDP port, each answer in a datagram of its own."""
    # More would be cut into fragments on the way.
    datagram_bytes = 8192
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))

    def send(data: bytes, _stop: threading.Event) -> None:
        """Hand bytes to the line; what nobody takes is lost."""
        with contextlib.suppress(OSError):
            for at in range(0, len(data), datagram_bytes):
                line.sendto(data[at : at + datagram_bytes], (host, port))

    with line, _serving(device, line.fileno(), line.recv, send):
        yield


@contextmanager
def on_pty(device: Device) -> Iterator[str]:
    """Let a device speak on a pseudo terminal; yields the path of the port."""
    ours, theirs, path = pseudo_terminal()
    os.set_blocking(ours, False)  # type: ignore[attr-defined, unused-ignore]

    gone = False

    def send(data: bytes, stop: threading.Event) -> None:
        """Hand bytes to the line; what nobody takes is lost."""
        # A line without a listener fills up; a receiver would lose the bytes, too. A listener that is busy
        # for a moment takes them piece by piece: such a line holds no more than some kilobytes.
        nonlocal gone
        taken = time.monotonic()
        with contextlib.suppress(OSError):
            # A reader that was quick enough before is waited for; one that has taken nothing for so long is
            # gone.
            patience_s = 10.0
            while data and not stop.is_set():
                _, ready, _ = select.select([], [ours], [], 0.0 if gone else _TICK_S)
                if ready:
                    data = data[os.write(ours, data) :]
                    taken, gone = time.monotonic(), False
                elif gone or time.monotonic() - taken > patience_s:
                    gone = True
                    return

    try:
        with _serving(device, ours, lambda size: os.read(ours, size), send):
            yield path
    finally:
        os.close(ours)
        os.close(theirs)


@contextmanager
def on_tcp(device: Device) -> Iterator[int]:
    """Let a device speak to whoever connects, one after the other; yields the port."""
    # The device gets an empty byte string for each new connection.
    server = socket.create_server((HOST, 0))

    def run(stop: threading.Event, start: float) -> None:
        """Let the device speak until `stop` is set."""
        server.settimeout(0.1)
        while not stop.is_set():
            with contextlib.suppress(OSError):
                line, _ = server.accept()
                with line:
                    _converse(device, line, stop, start)
            # What is sent while nobody is connected is lost.
            device.due(time.monotonic() - start)

    with server, _beside(run):
        yield int(server.getsockname()[1])


def _converse(device: Device, line: socket.socket, stop: threading.Event, start: float) -> None:
    """Speak with one host until it goes away."""
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    line.settimeout(1.0)
    data = b""
    while not stop.is_set():
        now = time.monotonic() - start
        line.sendall(device.receive(data, now) + device.due(now))
        data = b""
        ready, _, _ = select.select([line], [], [], _TICK_S)
        if ready and not (data := line.recv(65536)):
            return


@contextmanager
def _serving(
    device: Device,
    descriptor: int,
    read: Callable[[int], bytes],
    send: Callable[[bytes, threading.Event], None],
) -> Iterator[None]:
    def run(stop: threading.Event, start: float) -> None:
        """Let the device speak until `stop` is set."""
        while not stop.is_set():
            ready, _, _ = select.select([descriptor], [], [], _TICK_S)
            now = time.monotonic() - start
            data = b""
            if ready:
                with contextlib.suppress(OSError):
                    data = read(65536)
            out = (device.receive(data, now) if data else b"") + device.due(now)
            if out:
                send(out, stop)

    with _beside(run):
        yield


@contextmanager
def _beside(run: Callable[[threading.Event, float], None]) -> Iterator[None]:
    """Run something until the end of the block; it is given what tells it to stop, and when it began."""
    stop = threading.Event()
    thread = threading.Thread(target=run, args=(stop, time.monotonic()), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(5)


@contextmanager
def on_ports(
    flight: PlayedFlight, clock: FlightClock, *, udp_port: int = 0, base_on_tcp: bool = False
) -> Iterator[dict[str, str]]:
    """Let vehicle, rover and base speak: by UDP, on a pseudo terminal, and on another one or by TCP."""
    with ExitStack() as stack:
        port = udp_port or _free_port()
        autopilot = FlownAutopilot("vehicle", flight.lines["vehicle"], clock, parameters=flight.parameters)
        stack.enter_context(on_udp(autopilot, HOST, port))
        rover = stack.enter_context(on_pty(FlownReceiver("rover", flight.lines["rover"], clock)))
        base = FlownReceiver("base", flight.lines["base"], clock)
        if base_on_tcp:
            base_url = f"tcp://{HOST}:{stack.enter_context(on_tcp(base))}"
        else:
            base_url = f"serial:{stack.enter_context(on_pty(base))}"
        yield {"vehicle": f"udp://{HOST}:{port}", "rover": f"serial:{rover}", "base": base_url}


def awaited(flight: PlayedFlight, *, base_on_tcp: bool = False) -> tuple[str, ...]:
    """Give the devices that a recorder speaks to before it runs: not a sender of RTCM on a serial line."""
    listens = flight.base_protocol == "ubx" or base_on_tcp
    return SPOKEN_TO if listens else SPOKEN_TO[:2]


def record_settings(flight: PlayedFlight, urls: Mapping[str, str], output: Path) -> str:
    """Write the configuration with which `acquire record` records the devices: TOML."""
    links: list[dict[str, object]] = []
    protocols = {"vehicle": "mavlink", "rover": "ubx", "base": flight.base_protocol}
    for name, url in urls.items():
        link: dict[str, object] = {"name": name, "protocol": protocols[name], "url": url}
        if protocols[name] == "mavlink":
            link["vehicle"] = {"rates_hz": flight.rates_hz, "timesync_s": 1.0}
        elif protocols[name] == "ubx":
            link["ublox"] = {"port": "uart1", "rate_ms": round(flight.interval_s[name] * 1000)}
        links.append(link)
    return toml_text({"recording": {"output": str(output)}, "link": links})


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
