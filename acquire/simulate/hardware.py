"""The devices of a simulated flight on ports of this computer, and what is needed to record them."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from acquire.simulate.playback import FlightClock, FlownAutopilot, FlownReceiver
from acquire.simulate.played_flight import PlayedFlight
from acquire.simulate.serve import on_pty, on_tcp, on_udp
from acquire.simulate.world.tables import toml_text

HOST = "127.0.0.1"
SPOKEN_TO = ("vehicle", "rover", "base")


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
            base_url = f"tcp://{HOST}:{stack.enter_context(on_tcp(base, HOST))}"
        else:
            base_url = f"serial:{stack.enter_context(on_pty(base))}"
        yield {"vehicle": f"udp://{HOST}:{port}", "rover": f"serial:{rover}", "base": base_url}


def awaited(flight: PlayedFlight, *, base_on_tcp: bool = False) -> tuple[str, ...]:
    """Give the devices that a recorder speaks to before it runs: not a sender of RTCM on a serial line."""
    listens = flight.base_protocol == "ubx" or base_on_tcp
    return SPOKEN_TO if listens else SPOKEN_TO[:2]


def record_settings(flight: PlayedFlight, urls: Mapping[str, str], output: Path) -> str:
    """Write the configuration with which `acquire record` records the devices.

    returns: TOML.
    """
    sections: list[tuple[str, dict[str, object]]] = [("[recording]", {"output": str(output)})]
    protocols = {"vehicle": "mavlink", "rover": "ubx", "base": flight.base_protocol}
    for name, url in urls.items():
        sections.append(("[[link]]", {"name": name, "protocol": protocols[name], "url": url}))
        if protocols[name] == "mavlink":
            sections.append(("[link.vehicle]", {"rates_hz": flight.rates_hz, "timesync_s": 1.0}))
        elif protocols[name] == "ubx":
            settings = {"port": "uart1", "rate_ms": round(flight.interval_s[name] * 1000)}
            sections.append(("[link.ublox]", settings))
    return toml_text(sections)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
