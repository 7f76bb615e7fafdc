"""Corrections from casters of both versions, with and without TLS."""

from __future__ import annotations

import base64
import contextlib
import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from acquire.recording.configuration import LinkConfiguration
from acquire.recording.recorder import source_of_link
from acquire.transports.ntrip import NtripSource, ntrip_address
from acquire.transports.sources import LinkLostError
from drivers import rtcm3
from photocal.base.errors import ConfigurationError, PhotocalError
from tests.acquire.live import PATIENCE_S

FRAMES = [rtcm3.encode(b"\x43\x50" + bytes([number]) * 100) for number in range(30)]
STREAM = b"".join(FRAMES)
LOGIN = "Basic " + base64.b64encode(b"me:hunter2").decode()


def chunked(data: bytes, size: int) -> bytes:
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    return b"".join(b"%x;note=1\r\n%s\r\n" % (len(piece), piece) for piece in pieces)


@contextlib.contextmanager
def caster(
    answer: Callable[[str], list[bytes]], context: ssl.SSLContext | None = None, lines: int = 0
) -> Iterator[tuple[int, list[str]]]:
    """A caster for one request: `answer` takes the request and gives the pieces to be sent.

    A caster of virtual stations waits for lines with the position before the second piece.
    """
    requests: list[str] = []
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(PATIENCE_S)

    def serve() -> None:
        with contextlib.suppress(OSError):
            line, _ = server.accept()
            with line if context is None else context.wrap_socket(line, server_side=True) as port:
                request = b""
                while not request.endswith(b"\r\n\r\n"):
                    request += port.recv(4096)
                requests.append(request.decode())
                first, *rest = answer(requests[0])
                port.sendall(first)
                with port.makefile("rb") as told:
                    requests.extend(told.readline().decode() for _ in range(lines))
                for piece in rest:
                    port.sendall(piece)
                    # Pieces arrive singly, mostly.
                    time.sleep(0.002)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield server.getsockname()[1], requests
    finally:
        thread.join()
        server.close()


def read_all(source: NtripSource) -> bytes:
    source.open(threading.Event())
    data = b""
    with contextlib.suppress(LinkLostError):
        while len(data) < len(STREAM):
            data += source.read(PATIENCE_S)
    source.close()
    return data


def source(
    port: int,
    version: int = 2,
    scheme: str = "ntrip",
    context: ssl.SSLContext | None = None,
    position: bytes = b"",
) -> NtripSource:
    address = ntrip_address(f"{scheme}://localhost:{port}/MOUNT?version={version}")
    assert address is not None
    return NtripSource(address, "me", "hunter2", context, lambda: position)


ANSWERS = {
    "version 1": [b"ICY 200 OK\r\n\r\n", STREAM],
    "version 1, one line": [b"ICY 200 OK\r\n" + STREAM],
    "version 2": [b"HTTP/1.1 200 OK\r\nContent-Type: gnss/data\r\n\r\n" + STREAM[:50], STREAM[50:]],
    "version 2 in chunks": [b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", chunked(STREAM, 77)],
}


@pytest.mark.parametrize("kind", list(ANSWERS))
@pytest.mark.parametrize("piece", [1, 13, 100_000])
def test_the_stream_arrives_however_it_is_cut(kind: str, piece: int) -> None:
    whole = b"".join(ANSWERS[kind])[: 10**6 if piece > 1 else 450]
    pieces = [whole[at : at + piece] for at in range(0, len(whole), piece)]
    with caster(lambda _: pieces) as (port, _):
        data = read_all(source(port))
    data = data.removeprefix(b"\r\n")  # the end of a head of version 1 that was cut in between
    assert data == STREAM[: len(data)]
    assert len(data) > 300 if piece == 1 else data == STREAM


@pytest.mark.parametrize(("version", "first"), [(1, "GET /MOUNT HTTP/1.0"), (2, "GET /MOUNT HTTP/1.1")])
def test_the_request_is_that_of_the_standard(version: int, first: str) -> None:
    with caster(lambda _: ANSWERS["version 1"]) as (port, requests):
        assert read_all(source(port, version)) == STREAM
    lines = requests[0].split("\r\n")
    assert lines[0] == first
    assert any(line.startswith("User-Agent: NTRIP ") for line in lines)
    assert f"Authorization: {LOGIN}" in lines
    assert ("Ntrip-Version: Ntrip/2.0" in lines) == (version == 2)


# A position as IEC 61162-1 writes it.
GGA = b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*76\r\n"


def test_version_2_is_told_the_position_with_the_request() -> None:
    with caster(lambda _: ANSWERS["version 2"]) as (port, requests):
        assert read_all(source(port, 2, position=GGA)) == STREAM
    assert f"Ntrip-GGA: {GGA.decode().strip()}" in requests[0].split("\r\n")


def test_version_1_is_told_the_position_after_its_answer() -> None:
    with caster(lambda _: ANSWERS["version 1"], lines=1) as (port, requests):
        assert read_all(source(port, 1, position=GGA)) == STREAM
    assert "GGA" not in requests[0]
    assert requests[1].encode() == GGA


def test_without_a_position_nothing_is_told() -> None:
    with caster(lambda _: ANSWERS["version 2"]) as (port, requests):
        assert read_all(source(port, 2)) == STREAM
    assert "GGA" not in requests[0]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "refuses user and password"),
        (b"ERROR - Bad Password\r\n", "refuses user and password"),
        (b"SOURCETABLE 200 OK\r\nContent-Length: 0\r\n\r\n", "does not have this mountpoint"),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n", "does not have this mountpoint"),
        (b"HTTP/1.1 503 Busy\r\n\r\n", "503 Busy"),
        (b"SSH-2.0\r\n", "not answer as an NTRIP caster"),
        (b"\xff" * 100_000, "not answer as an NTRIP caster"),
    ],
)
def test_refusals_are_told_without_the_password(answer: bytes, words: str) -> None:
    with caster(lambda _: [answer]) as (port, _), pytest.raises(LinkLostError) as failure:
        source(port).open(threading.Event())
    assert words in str(failure.value)
    assert "hunter2" not in str(failure.value)
    assert LOGIN.split()[1] not in str(failure.value)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed: no certificate")
def test_tls_is_verified(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        [
            "openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
            "-keyout", key, "-out", certificate, "-days", "2", "-subj", "/CN=localhost",
            "-addext", "subjectAltName=DNS:localhost",
        ],
        check=True, capture_output=True,
    )  # fmt: skip
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(certificate, key)
    trusting = ssl.create_default_context(cafile=str(certificate))
    with caster(lambda _: ANSWERS["version 2 in chunks"], server) as (port, _):
        assert read_all(source(port, 2, "ntrips", trusting)) == STREAM
    with (
        caster(lambda _: [b""], server) as (port, requests),
        pytest.raises(LinkLostError, match="certificate"),
    ):
        source(port, 2, "ntrips").open(threading.Event())
    assert not requests


@pytest.mark.parametrize(
    "url",
    [
        "ntrip://me:hunter2@caster.example:2101/MOUNT",
        "ntrip://caster.example:2101",
        "ntrip://caster.example:port/MOUNT",
        "ntrip://caster.example/MOUNT?version=3",
        "ntrip://caster.example/MO UNT",
        "ntrip:///MOUNT",
    ],
)
def test_addresses_that_cannot_be_meant(url: str) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        ntrip_address(url)
    assert "hunter2" not in str(refusal.value)


def test_the_password_comes_from_the_environment() -> None:
    link = LinkConfiguration.model_validate(
        {
            "name": "base",
            "protocol": "rtcm3",
            "url": "ntrip://127.0.0.1/M",
            "user": "me",
            "password_env": "NTRIP",
        }
    )
    with pytest.raises(PhotocalError, match="NTRIP"):
        source_of_link(link, {})
    assert isinstance(source_of_link(link, {"NTRIP": "hunter2"}), NtripSource)
