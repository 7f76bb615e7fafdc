"""The channels of a recording for Foxglove or Lichtblick, live, over their WebSocket protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from acquire.log.reader import Messages
from acquire.log.records import Channel, Schema
from acquire.web import Address
from drivers.errors import ConfigurationError, ProgramMissingError


@contextmanager
def serving_foxglove(address: Address) -> Iterator[tuple[Callable[[list[Messages]], None], str]]:
    """Serve channels on this computer until the end of the block.

    Parameters
    ----------
    address : Address
        Where: one of this computer alone. The protocol and foxglove-sdk know no token, so what other
        computers could reach would be open to all of them.

    Yields
    ------
    callable
        Takes the messages of a chunk and passes them on, raw and decoded.
    str
        The address to open in Foxglove.

    Raises
    ------
    ProgramMissingError
        When the package foxglove-sdk is not installed.
    ConfigurationError
        When other computers could reach the address, or the port is taken.
    """
    if not address.loopback:
        raise ConfigurationError(
            "would be open to every computer that reaches it: Foxglove's protocol knows no token",
            where=str(address),
            remedy=f"serve it at 127.0.0.1:{address.port} and come by a tunnel: "
            f"ssh -L {address.port}:127.0.0.1:{address.port} ...",
        )
    try:
        import foxglove
    except ImportError as missing:
        raise ProgramMissingError(
            "the package foxglove-sdk is not installed", remedy="pip install 'photocal[foxglove]'"
        ) from missing
    # A context of its own: nothing that is logged elsewhere in the process is served.
    context = foxglove.Context()
    try:
        server = foxglove.start_server(
            name="photocal acquire monitor",
            host=address.host,
            port=address.port,
            capabilities=[],
            context=context,
        )
    except (RuntimeError, OSError) as refusal:
        raise ConfigurationError(
            f"cannot be listened on ({refusal})", where=str(address), remedy="choose --foxglove-address"
        ) from refusal
    served: dict[Channel, Any] = {}

    def listen(chunk: list[Messages]) -> None:
        for part in chunk:
            channel = served.get(part.channel)
            if channel is None:
                channel = served[part.channel] = _channel(part.channel, context)
            for payload, time_ns in zip(part.payloads, part.log_ns.tolist(), strict=True):
                channel.log(payload, log_time=time_ns)

    try:
        yield listen, f"ws://{Address(address.host, server.port)}"
    finally:
        for channel in served.values():
            channel.close()
        server.stop()


def _channel(channel: Channel, context: Any) -> Any:
    import foxglove

    # Raw frames have no schema: the protocol writes that as an empty one.
    definition = channel.schema or Schema("", "", b"")
    schema = foxglove.Schema(name=definition.name, encoding=definition.encoding, data=definition.data)
    return foxglove.Channel(
        channel.topic,
        schema=schema,
        message_encoding=channel.encoding,
        context=context,
        metadata=dict(channel.metadata),
    )
