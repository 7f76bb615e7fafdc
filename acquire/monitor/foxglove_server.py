"""The channels of a recording for Foxglove or Lichtblick, live, over their WebSocket protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from acquire.log.reader import Messages
from acquire.log.records import Channel, Schema
from acquire.monitor.token_proxy import hidden_host, token_proxy
from acquire.web import Address
from drivers.errors import ConfigurationError, ProgramMissingError


@contextmanager
def serving_foxglove(address: Address) -> Iterator[tuple[Callable[[list[Messages]], None], str]]:
    """Serve channels until the end of the block, to those who have the token.

    The protocol and foxglove-sdk know no token: their server stands at an address that nobody can guess,
    behind a gate that asks for one.

    raises ProgramMissingError: when the package foxglove-sdk is not installed.
    raises ConfigurationError: when the address is none of this computer, or the port is taken.
    """
    try:
        import foxglove
    except ImportError as missing:
        raise ProgramMissingError(
            "the package foxglove-sdk is not installed", remedy="pip install 'photocal[foxglove]'"
        ) from missing
    # A context of its own: nothing that is logged elsewhere in the process is served.
    context = foxglove.Context()
    host = hidden_host()
    try:
        server = foxglove.start_server(
            name="photocal acquire monitor",
            host=host,
            port=0,
            capabilities=[],
            context=context,
        )
    except (RuntimeError, OSError) as refusal:
        raise ConfigurationError(
            f"cannot be listened on ({refusal})",
            where=host,
            remedy="look at the loopback interface",
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
        with token_proxy(address, (host, server.port)) as url:
            yield listen, url
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
