"""The devices of a simulated flight on ports of this computer, and what is needed to record them."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from acquire.simulate.playback import FlightClock, FlownAutopilot, FlownReceiver, Line
from acquire.simulate.serve import on_pty, on_tcp, on_udp
from acquire.simulate.world.tables import toml_text

HOST = "127.0.0.1"
SPOKEN_TO = ("vehicle", "rover", "base")


@contextmanager
def on_ports(
    lines: Mapping[str, Line], clock: FlightClock, *, udp_port: int = 0, base_on_tcp: bool = False
) -> Iterator[dict[str, str]]:
    """Let vehicle, rover and base speak: by UDP, on a pseudo terminal, and on another one or by TCP.

    Parameters
    ----------
    lines : dict of str to Line
        What they send.
    clock : FlightClock
    udp_port : int
        To which the vehicle sends; 0 for any that is free.
    base_on_tcp : bool
        Whether the base is a TCP server instead of a serial port.

    Yields
    ------
    dict of str to str
        The URL of each link, as `acquire record` takes it.
    """
    with ExitStack() as stack:
        port = udp_port or _free_port()
        autopilot = FlownAutopilot("vehicle", lines["vehicle"], clock)
        stack.enter_context(on_udp(autopilot, HOST, port))
        rover = stack.enter_context(on_pty(FlownReceiver("rover", lines["rover"], clock)))
        base = FlownReceiver("base", lines["base"], clock)
        if base_on_tcp:
            base_url = f"tcp://{HOST}:{stack.enter_context(on_tcp(base, HOST))}"
        else:
            base_url = f"serial:{stack.enter_context(on_pty(base))}"
        yield {"vehicle": f"udp://{HOST}:{port}", "rover": f"serial:{rover}", "base": base_url}


def awaited(base_protocol: str, base_on_tcp: bool) -> tuple[str, ...]:
    """Give the devices that are spoken to before a recording runs: not a caster on a serial line."""
    listens = base_protocol == "ubx" or base_on_tcp
    return SPOKEN_TO if listens else SPOKEN_TO[:2]


def record_settings(
    urls: Mapping[str, str], base_protocol: str, interval_s: Mapping[str, float], output: Path
) -> str:
    """Write the configuration with which `acquire record` records the devices.

    Parameters
    ----------
    urls : dict of str to str
        Of the links.
    base_protocol : str
        ``ubx`` or ``rtcm3``.
    interval_s : dict of str to float
        Between the measurements of rover and base.
    output : Path
        Folder of the recording.

    Returns
    -------
    str
        TOML.
    """
    sections: list[tuple[str, dict[str, object]]] = [("[recording]", {"output": str(output)})]
    protocols = {"vehicle": "mavlink", "rover": "ubx", "base": base_protocol}
    for name, url in urls.items():
        sections.append(("[[link]]", {"name": name, "protocol": protocols[name], "url": url}))
        if protocols[name] == "mavlink":
            rates = {"ATTITUDE": 20.0, "GLOBAL_POSITION_INT": 5.0, "SYSTEM_TIME": 1.0}
            sections.append(("[link.vehicle]", {"rates_hz": rates, "timesync_s": 1.0}))
        elif protocols[name] == "ubx":
            settings = {"port": "uart1", "rate_ms": round(interval_s[name] * 1000)}
            sections.append(("[link.ublox]", settings))
    return toml_text(sections)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
