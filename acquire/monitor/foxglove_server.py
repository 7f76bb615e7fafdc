"""The channels of a recording for Foxglove or Lichtblick, live, over their WebSocket protocol."""

import asyncio
import contextlib
import secrets
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qs, urlsplit

from acquire.log.chunk import Channel, Schema
from acquire.log.reader import LoggedMessages
from photocal.base.errors import ConfigurationError, ProgramMissingError
from photocal.base.web import TOKEN_BYTES, Address

_LONGEST_HEAD = 1 << 14
_PIECE_BYTES = 1 << 16
# foxglove-sdk 0.30 tells a client of a channel before it knows itself that it has told it, and refuses the
# subscription of a client that answers in between: the client would go without the topic.
_CLIENT_DELAY_S = 0.05
_REFUSAL = b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_host() -> str:
    """Return an address of this computer alone that no page can guess."""
    # All of 127.0.0.0/8 is this computer (RFC 1122, 3.2.1.3): with its port an address among 2^39. Programs
    # of this computer can look it up; those may read the recording anyway.
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


@contextmanager
def token_proxy(address: Address, behind: tuple[str, int]) -> Iterator[str]:
    """Let connections through to a server until the end of the block, if their address has the token."""
    token = secrets.token_urlsafe(TOKEN_BYTES)
    listener = address.listen()
    bound = Address(address.host, listener.getsockname()[1])
    started: Future[Callable[[], object]] = Future()

    async def let_in(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass a connection on to the inner server when it brings the token."""
        try:
            # Cancelled when the server ends: nobody waits for this task, and asyncio would print a traceback.
            with contextlib.suppress(
                OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.CancelledError
            ):
                await _let_in(reader, writer, token, behind)
        finally:
            writer.close()

    async def serve() -> None:
        """Run the server that asks for the token until the monitor ends."""
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        server = await asyncio.start_server(let_in, sock=listener, limit=_LONGEST_HEAD)
        started.set_result(lambda: loop.call_soon_threadsafe(stop.set))
        await stop.wait()
        # Its connections end with the loop: from Python 3.12 on, to wait for it is to wait for all clients.
        server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="token proxy", daemon=True)
    thread.start()
    end = started.result()
    try:
        yield f"ws://{bound}/?token={token}"
    finally:
        end()
        thread.join()


async def _let_in(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, token: str, behind: tuple[str, int]
) -> None:
    try:
        patience_s = 10.0
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), patience_s)
    except asyncio.LimitOverrunError:
        head = b""
    if not has_token(head, token):
        writer.write(_REFUSAL)
        await writer.drain()
        return
    inner_reader, inner_writer = await asyncio.open_connection(*behind)
    try:
        inner_writer.write(head)
        ways = [
            asyncio.create_task(_carry(reader, inner_writer, _CLIENT_DELAY_S)),
            asyncio.create_task(_carry(inner_reader, writer, 0.0)),
        ]
        _, open_ways = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in open_ways:
            way.cancel()
    finally:
        inner_writer.close()


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay_s: float) -> None:
    """Hand on what one side sends, each piece so much later, until it ends."""
    with contextlib.suppress(OSError):
        while piece := await reader.read(_PIECE_BYTES):
            await asyncio.sleep(delay_s)
            writer.write(piece)
            await writer.drain()


def has_token(head: bytes, token: str) -> bool:
    """Tell whether the head of a request has the token in its target."""
    words = head.partition(b"\r\n")[0].split(b" ")
    if len(words) != 3:
        return False
    try:
        given = parse_qs(urlsplit(words[1].decode("ascii")).query).get("token", [""])
    except ValueError:
        return False
    return len(given) == 1 and secrets.compare_digest(given[0].encode(), token.encode())


@contextmanager
def serving_foxglove(address: Address) -> Iterator[tuple[Callable[[list[LoggedMessages]], None], str]]:
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
            "the package foxglove-sdk is not installed", "pip install 'photocal[foxglove]'"
        ) from missing
    # A context of its own: nothing that is logged elsewhere in the process is served.
    context = foxglove.Context()
    host = hidden_host()
    try:
        server = foxglove.start_server(
            name="photocal acquire monitor", host=host, port=0, capabilities=[], context=context
        )
    except (RuntimeError, OSError) as refusal:
        raise ConfigurationError(
            f"cannot be used for listening ({refusal})", "check the loopback interface", where=host
        ) from refusal
    served: dict[Channel, Any] = {}

    def listen(chunk: list[LoggedMessages]) -> None:
        """Publish what has arrived."""
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
