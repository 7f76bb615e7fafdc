"""A gate before a WebSocket server that knows no token: only who brings the token is let through."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit

from acquire.web import TOKEN_BYTES, Address

_LONGEST_HEAD = 1 << 14
_PATIENCE_S = 10.0
_PIECE_BYTES = 1 << 16
_REFUSAL = b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_host() -> str:
    """Return an address of this computer alone that no page can guess.

    All of 127.0.0.0/8 is this computer (RFC 1122, 3.2.1.3): with its port an address among 2^39. Programs of
    this computer can look it up; those may read the recording anyway.
    """
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


@contextmanager
def token_proxy(address: Address, behind: tuple[str, int]) -> Iterator[str]:
    """Let connections through to a server until the end of the block, if their address has the token."""
    token = secrets.token_urlsafe(TOKEN_BYTES)
    listener = address.listen()
    bound = Address(address.host, listener.getsockname()[1])
    started: Future[Callable[[], object]] = Future()

    async def let_in(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with contextlib.suppress(OSError, TimeoutError, asyncio.IncompleteReadError):
                await _let_in(reader, writer, token, behind)
        finally:
            writer.close()

    async def serve() -> None:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        async with await asyncio.start_server(let_in, sock=listener, limit=_LONGEST_HEAD):
            started.set_result(lambda: loop.call_soon_threadsafe(stop.set))
            await stop.wait()

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
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE_S)
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
            asyncio.create_task(_carry(reader, inner_writer)),
            asyncio.create_task(_carry(inner_reader, writer)),
        ]
        _, open_ways = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in open_ways:
            way.cancel()
    finally:
        inner_writer.close()


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while piece := await reader.read(_PIECE_BYTES):
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
