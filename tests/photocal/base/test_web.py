"""The guard of local pages, asked over real sockets with a plain HTTP client."""

from __future__ import annotations

import asyncio
import http.client
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from urllib.parse import parse_qs, urlsplit

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from photocal.base.errors import ConfigurationError
from photocal.base.web import Address, read_address, serving
from tests.acquire.live import PATIENCE_S, full_pipe, until


def _app() -> Starlette:
    async def secret(request: Request) -> PlainTextResponse:
        return PlainTextResponse(f"secret {request.method}")

    return Starlette(routes=[Route(path, secret, methods=["GET", "POST"]) for path in ("/", "/feed")])


class Page:
    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.port = parts.port or 0
        self.token = parse_qs(parts.query).get("token", [""])[0]

    def ask(self, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, str, dict[str, str]]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        told = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, headers={"Host": f"127.0.0.1:{self.port}", **told})
        answer = connection.getresponse()
        body = answer.read().decode()
        connection.close()
        return answer.status, body, {name.lower(): value for name, value in answer.getheaders()}


@pytest.fixture(scope="module")
def local() -> Iterator[Page]:
    with serving(_app(), Address("127.0.0.1", 0)) as url:
        yield Page(url)


@pytest.fixture(scope="module")
def public() -> Iterator[Page]:
    with serving(_app(), Address("0.0.0.0", 0)) as url:  # noqa: S104 - that is what is tested
        yield Page(url)


def test_on_loopback_no_token_is_needed(local: Page) -> None:
    assert local.token == ""
    assert local.ask()[:2] == (200, "secret GET")


def test_loopback_is_not_heard_on_other_addresses(local: Page) -> None:
    """127.0.0.2 is this computer as well, and not what was bound; so would any outer address be."""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", local.port), timeout=5)


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "192.168.1.7"]
)
def test_a_name_that_was_bent_to_this_computer_gets_nothing(local: Page, host: str) -> None:
    status, body, _ = local.ask(Host=host)
    assert status == 403
    assert "secret" not in body


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:1", "[::1]:9000", "127.0.0.1:9000"])
def test_names_of_this_computer_are_good_on_any_forwarded_port(local: Page, host: str) -> None:
    assert local.ask(Host=host)[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_pages_of_other_sites_get_nothing(local: Page, headers: dict[str, str], method: str) -> None:
    status, body, _ = local.ask("/feed", method, **headers)
    assert (status, "secret" in body) == (403, False)


def test_a_link_from_another_site_may_open_the_page_but_not_post(local: Page) -> None:
    link = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}
    assert local.ask(**link)[0] == 200
    assert local.ask("/", "POST", **link)[0] == 403
    own = f"http://127.0.0.1:{local.port}"
    assert local.ask("/", "POST", Origin=own, Sec_Fetch_Site="same-origin")[:2] == (200, "secret POST")


@pytest.mark.parametrize("path", ["/", "/feed", "/nothing", "/?token=", "/?token=wrong", "/../etc/passwd"])
def test_without_the_token_there_is_nothing(public: Page, path: str) -> None:
    status, body, headers = public.ask(path)
    assert status == 401
    assert "secret" not in body
    assert "set-cookie" not in headers
    assert public.ask(path, Authorization="Bearer wrong", Cookie=f"token-{public.port}=x")[0] == 401


def test_the_token_opens_once_by_address_then_by_cookie(public: Page) -> None:
    assert len(public.token) >= 24
    status, body, headers = public.ask(f"/?token={public.token}")
    assert (status, headers["location"], body) == (303, "/", "")
    cookie = headers["set-cookie"]
    assert "httponly" in cookie.lower()
    assert "samesite=lax" in cookie.lower()
    assert public.ask("/feed", Cookie=cookie.split(";")[0])[:2] == (200, "secret GET")
    assert public.ask("/feed", Authorization=f"Bearer {public.token}")[0] == 200


def test_a_token_is_new_each_time(public: Page) -> None:
    with serving(_app(), Address("0.0.0.0", 0)) as url:  # noqa: S104 - that is what is tested
        assert Page(url).token not in ("", public.token)


def test_every_answer_forbids_foreign_code_and_copies(local: Page, public: Page) -> None:
    for _, _, headers in (local.ask(), public.ask()):
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["cache-control"] == "no-store"
        assert headers["x-content-type-options"] == "nosniff"


def test_a_port_that_is_taken_is_told(local: Page) -> None:
    with (
        pytest.raises(ConfigurationError, match="another port"),
        serving(_app(), Address("127.0.0.1", local.port)),
    ):
        pass


@pytest.mark.parametrize(
    "text", ["8740", ":8740", "localhost", "::1:8740", "[::1]", "a:b", "h:99999", "[h]:1"]
)
def test_what_is_no_address_is_told(text: str) -> None:
    with pytest.raises(ConfigurationError, match="HOST:PORT"):
        read_address(text)


def test_addresses_say_whether_others_reach_them() -> None:
    assert read_address("localhost:1").loopback
    assert read_address("[::1]:0").loopback
    assert not read_address("0.0.0.0:8740").loopback
    assert str(read_address("[::1]:87")) == "[::1]:87"


def _refused(line: socket.socket, within_s: float) -> bool:
    """Tell whether the server gives a connection up in time."""
    line.settimeout(within_s)
    try:
        return line.recv(100) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def test_connections_that_never_ask_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("photocal.base.web.HEAD_S", 0.5)
    with serving(_app(), Address("127.0.0.1", 0)) as url, ExitStack() as stack:
        page = Page(url)
        address = "127.0.0.1", page.port
        silent, half, late = (stack.enter_context(socket.create_connection(address)) for _ in range(3))
        half.sendall(b"GET / HTTP/1.1\r\nHost: 127")
        request = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()
        late.sendall(request)
        late.settimeout(PATIENCE_S)
        answer = b""
        # Head and body may come apart.
        while b"secret GET" not in answer:
            answer += late.recv(10_000)
        late.sendall(request[:20])
        assert all(_refused(line, PATIENCE_S) for line in (silent, half, late))
        assert page.ask()[0] == 200


def test_an_answer_that_takes_long_is_not_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("photocal.base.web.HEAD_S", 0.2)

    async def slow(_: Request) -> PlainTextResponse:
        await asyncio.sleep(1.0)
        return PlainTextResponse("at last")

    with serving(Starlette(routes=[Route("/", slow)]), Address("127.0.0.1", 0)) as url:
        assert Page(url).ask()[:2] == (200, "at last")


SERVER = """
import resource, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from photocal.base.operating_system import stopped_by_signals
from photocal.base.web import Address, serving
from tests.photocal.base.test_web import _app
stop = stopped_by_signals()
with serving(_app(), Address("127.0.0.1", 0)) as url:
    print(url, flush=True)
    stop.wait()
"""


def test_a_flood_of_connections_leaves_the_page_and_its_end_alone() -> None:
    """More of them than the process may have open; standard error is a full pipe that nobody reads."""
    command = [sys.executable, "-c", SERVER]
    with (
        full_pipe() as theirs,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, text=True) as process,
        ExitStack() as stack,
    ):
        stack.callback(process.kill)
        assert process.stdout is not None
        page = Page(process.stdout.readline().strip())
        lines = [stack.enter_context(socket.create_connection(("127.0.0.1", page.port))) for _ in range(400)]
        # The first are kept for their ten seconds, who comes after them is given up at once.
        assert until(lambda: sum(_refused(line, 0.001) for line in lines[-200:]) > 190, "lines given up")
        assert not any(_refused(line, 0.001) for line in lines[:90])
        for line in lines[:50]:
            line.close()
        assert until(lambda: answers(page), "the page") is True
        process.send_signal(signal.SIGINT)
        assert process.wait(5.0) == 0


def answers(page: Page) -> bool:
    """Tell whether the page is answered, not given up."""
    try:
        return page.ask()[0] == 200
    except (OSError, http.client.HTTPException):
        return False
