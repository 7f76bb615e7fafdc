"""Local pages: served on this computer alone, or with a token; what each page shares of caution.

Questions of a local page, checked, and their answers in JSON.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import secrets
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from photocal.base.errors import ConfigurationError, reason

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError, validate_call
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse

from photocal.base.checked_toml import Table
from photocal.base.errors import InputNotFoundError

TOKEN_BYTES = 18
# Nothing but what this server gives: no other host, no code within the page, no page around it.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data: blob:; frame-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "json": "application/json",
    "txt": "text/plain; charset=utf-8",
}
_READING = ("GET", "HEAD")
# A browser opens six connections; who opens a thousand, or never ends the head of a request, is no browser.
MOST_CONNECTIONS, HEAD_S = 100, 10.0
# How many connections may wait to be handled, and how long a shutdown may take.
_BACKLOG, _END_S = 64, 3.0


@dataclass(frozen=True)
class Address:
    """Where a page is served: host and port; port 0 for any that is free."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this computer can reach it."""
        return all(ipaddress.ip_address(ip.split("%")[0]).is_loopback for _, ip in self._resolved())

    def listen(self) -> socket.socket:
        """Return a socket that listens there.

        raises ConfigurationError: when the host is unknown or the port is taken.
        """
        family, ip = self._resolved()[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((ip, self.port))
            listener.listen(_BACKLOG)
        except OSError as refusal:
            listener.close()
            raise ConfigurationError(
                f"cannot be used for listening ({reason(refusal)})",
                "choose another port, or 0 for any that is free",
                where=str(self),
            ) from refusal
        return listener

    def _resolved(self) -> list[tuple[socket.AddressFamily, str]]:
        try:
            entries = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as refusal:
            raise ConfigurationError(
                "is not an address of this computer", "use for example 127.0.0.1:8740", where=str(self)
            ) from refusal
        return [(entry[0], str(entry[4][0])) for entry in entries]

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def read_address(text: str) -> Address:
    """Read ``HOST:PORT`` or ``[IPv6]:PORT``; raises ConfigurationError when it is neither."""
    host, colon, port = text.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    bracketed = host.startswith("[") and host.endswith("]")
    if not colon or not bare or (":" in bare) != bracketed or not port.isdecimal() or int(port) > 65535:
        raise ConfigurationError(
            "is not of the form HOST:PORT", "use for example 127.0.0.1:8740 or [::1]:8740", where=text
        )
    return Address(bare, int(port))


class Guard:
    """Lets nobody in who should not be: other hosts' names, other sites' pages, and who has no token.

    A page of another site can make the browser ask this server (cross-site requests), or give its own name
    this computer's address (DNS rebinding). So the Host header must be an address in numbers, ``localhost``
    or the name that was chosen; requests of other sites are refused, links to the page itself apart.

    token: what must be shown: once as ``?token=``, which leaves a cookie, or as bearer. None: nothing.
    """

    def __init__(self, app: ASGIApp, address: Address, token: str | None) -> None:
        self._app = app
        self._names = {"localhost", address.host.lower()}
        self._only_loopback = address.loopback
        self._token = token
        # Cookies are shared by all ports of a host.
        self._cookie = f"token-{address.port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def guarded(message: Message) -> None:
            """Send an answer with the headers that every page has."""
            if message["type"] == "http.response.start":
                for name, value in _HEADERS.items():
                    # A document that is shown within the page has a stricter policy of its own.
                    MutableHeaders(scope=message).setdefault(name, value)
            await send(message)

        refusal = self._refusal(scope)
        if refusal is None:
            await self._app(scope, receive, guarded)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
        else:
            await refusal(scope, receive, guarded)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._names_us(host):
            return PlainTextResponse("403: this page is not served under that name.\n", 403)
        if _of_another_site(scope, headers, host):
            return PlainTextResponse("403: asked for by a page of another site.\n", 403)
        if self._token is None:
            return None
        shown = QueryParams(scope["query_string"]).get("token")
        if shown is not None and self._opens(shown) and scope.get("method") in _READING:
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._cookie, shown, httponly=True, samesite="lax")
            return answer
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        cookie = cookie_parser(headers.get("cookie", "")).get(self._cookie, "")
        if self._opens(bearer) or self._opens(cookie):
            return None
        return PlainTextResponse(
            "401: this page needs its token: open the address that was printed where it was started.\n",
            401,
            {"www-authenticate": "Bearer"},
        )

    def _opens(self, shown: str) -> bool:
        return secrets.compare_digest(shown.encode(), (self._token or "").encode())

    def _names_us(self, host: str) -> bool:
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() else host
        name = name.removeprefix("[").removesuffix("]").lower()
        if name in self._names:
            return True
        try:
            number = ipaddress.ip_address(name)
        except ValueError:
            return False
        return number.is_loopback or not self._only_loopback


def _of_another_site(scope: Scope, headers: Headers, host: str) -> bool:
    origin = headers.get("origin")
    if origin is not None and origin != f"http://{host}":
        return True
    opened_by_hand = scope.get("method") in _READING and headers.get("sec-fetch-mode") == "navigate"
    return headers.get("sec-fetch-site") in ("cross-site", "same-site") and not opened_by_hand


def folder_of(package: str, folder: str, prefix: str = "/") -> list[Route]:
    """Return routes to all files of a folder of a package, and of the folders in it, by their paths in it."""
    files, waiting = dict[str, str](), [""]
    while waiting:
        under = waiting.pop()
        for entry in resources.files(package).joinpath(folder + under).iterdir():
            path = f"{under}/{entry.name}"
            if entry.is_dir():
                waiting.append(path)
            elif entry.name.rpartition(".")[2] in _TYPES:
                files[(prefix + path.removeprefix("/")).removesuffix("index.html")] = folder + path
    return packaged(package, files)


def packaged(package: str, files: Mapping[str, str]) -> list[Route]:
    """Return routes to files that are part of a package.

    The files are read now: no path of a request ever reaches the file system.
    """

    def route(path: str, name: str) -> Route:
        """Return the route to one packaged file."""
        content = resources.files(package).joinpath(name).read_bytes()
        kind = _TYPES[name.rpartition(".")[2]]

        async def give(_: Request) -> Response:
            """Answer with the file."""
            return Response(content, media_type=kind)

        return Route(path, give)

    return [route(path, name) for path, name in files.items()]


@contextmanager
def serving(app: ASGIApp, address: Address) -> Iterator[str]:
    """Serve an application behind a `Guard` in a thread of its own, until the end of the block.

    Reachable from this computer alone it needs no token; anywhere else it makes one.

    raises ConfigurationError: when nothing can be served there.
    """
    import uvicorn

    token = None if address.loopback else secrets.token_urlsafe(TOKEN_BYTES)
    listener = address.listen()
    bound = Address(address.host, listener.getsockname()[1])
    _silence("asyncio", "uvicorn")
    settings = uvicorn.Config(
        Guard(app, bound, token),
        http=_limited(),
        ws="none",
        loop="asyncio",
        backlog=_BACKLOG,
        log_config=None,
        log_level="critical",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=1,
        lifespan="off",
    )
    server = uvicorn.Server(settings)
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    try:
        while not server.started and thread.is_alive():
            time.sleep(0.005)
        yield f"http://{_shown(bound)}/" + (f"?token={token}" if token else "")
    finally:
        server.should_exit = True
        thread.join(_END_S)
        listener.close()


def _silence(*names: str) -> None:
    """Keep loggers from standard error: a terminal that takes nothing would stop the server."""
    for name in names:
        logger = logging.getLogger(name)
        logger.propagate = False
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())


def _limited() -> type[asyncio.Protocol]:
    """Return the protocol of the server, limited to `MOST_CONNECTIONS` and `HEAD_S`."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Limited(H11Protocol):
        """Gives up who is one too many, and who does not end the head of a request, the first or a later one.

        uvicorn limits the requests that are answered, not the connections that never ask.
        """

        _head: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            """Take a connection while there are not too many."""
            super().connection_made(transport)
            if len(self.connections) > MOST_CONNECTIONS:
                transport.abort()
            else:
                self._await_head()

        def data_received(self, data: bytes) -> None:
            """Take bytes; a head that ends is no longer waited for."""
            super().data_received(data)
            self._await_head()

        def connection_lost(self, exc: Exception | None) -> None:
            """Forget a connection."""
            self._end_of_head()
            super().connection_lost(exc)

        def _await_head(self) -> None:
            if self.cycle is not None and not self.cycle.response_complete:
                self._end_of_head()
            elif self._head is None and not self.transport.is_closing():
                self._head = self.loop.call_later(HEAD_S, self.transport.abort)

        def _end_of_head(self) -> None:
            if self._head is not None:
                self._head.cancel()
                self._head = None

    return Limited


def _shown(bound: Address) -> Address:
    """Return the address as another computer writes it: one of all addresses is named instead of all."""
    if bound.host not in ("0.0.0.0", "::"):  # noqa: S104 - compared, not bound
        return bound
    family = socket.AF_INET6 if ":" in bound.host else socket.AF_INET
    outside = "2001:db8::1" if family == socket.AF_INET6 else "192.0.2.1"
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            # Nothing is sent: the system only chooses the address that it would send from.
            probe.connect((outside, 9))
        except OSError:
            return Address("localhost", bound.port)
        return Address(probe.getsockname()[0], bound.port)


Question = TypeVar("Question", bound=Table)


def telling(path: str, tell: Callable[[], Any]) -> Route:
    """Return a route that answers with what a function tells."""

    async def give(_: Request) -> Response:
        """Answer as JSON."""
        return JSONResponse(await run_in_threadpool(tell))

    return Route(path, give)


def finding(path: str, find: Callable[[dict[str, str]], Any]) -> Route:
    """Return a route that answers what stands in its path and query, by their names."""

    async def give(request: Request) -> Response:
        """Answer as JSON."""
        asked = {**request.query_params, **request.path_params}
        return JSONResponse(await run_in_threadpool(find, asked))

    return Route(path, give)


def doing(path: str, do: Callable[[bytes], Any]) -> Route:
    """Return a route that hands the body of a request to a function."""

    async def give(request: Request) -> Response:
        """Answer as JSON."""
        return JSONResponse(await run_in_threadpool(do, await json_body(request)))

    return Route(path, give, methods=["POST"])


def checked(kind: type[Question], body: bytes) -> Question:
    """Read a question; raises ConfigurationError when it is none of this kind."""
    with _of_the_page():
        return kind.model_validate_json(body)


def calling(do: Callable[..., Any], *given: Any) -> Callable[[bytes], Any]:
    """Return what calls a function with what a body names: its keywords, of the types in its signature.

    given: what the function takes before them.
    raises ConfigurationError: when a body names something else; what is returned does.
    """
    strict = ConfigDict(strict=True, allow_inf_nan=False)
    call, named = validate_call(config=strict)(partial(do, *given)), TypeAdapter(dict[str, Any])

    def answer(body: bytes) -> Any:
        """Call it."""
        with _of_the_page():
            return call(**named.validate_json(body))

    return answer


@contextmanager
def _of_the_page() -> Iterator[None]:
    """What is no question of ours is a ConfigurationError."""
    try:
        yield
    except ValidationError as failure:
        first = failure.errors()[0]
        what = ": ".join((".".join(map(str, first["loc"])), first["msg"])).lstrip(": ")
        raise ConfigurationError(what, "use the page", where="request") from failure


async def json_body(request: Request) -> bytes:
    """Read the body of a request; raises ConfigurationError when it is too long or no JSON."""
    # A form of another site cannot have this type.
    if request.headers.get("content-type") != "application/json":
        raise ConfigurationError("the request is not JSON", "use the page")
    longest_request = 10_000
    return await short_body(request, longest_request)


async def short_body(request: Request, longest: int) -> bytes:
    """Read the body of a request; raises ConfigurationError when it is longer than that many bytes."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > longest:
            raise ConfigurationError("the request is too long", "use the page")
    return bytes(body)


def refusing(said: Callable[[str], str]) -> Callable[[Request, Exception], Response]:
    """Return what answers with a failure that we know.

    said: gives the words of the command line in the language of the page.
    """

    def refuse(_: Request, failure: Exception) -> Response:
        """Answer with it."""
        status = 404 if isinstance(failure, InputNotFoundError) else 422
        return JSONResponse({"error": said(str(failure))}, status)

    return refuse
