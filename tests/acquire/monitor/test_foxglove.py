"""The channels as a client of Foxglove's WebSocket protocol gets them: the browser is the client."""

from __future__ import annotations

import contextlib
import json
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

from acquire.importing.importer import import_recordings
from acquire.log.reader import LogReader
from acquire.monitor.foxglove_server import has_token, serving_foxglove
from photocal.base.errors import ConfigurationError, ProgramMissingError
from photocal.base.web import Address, read_address
from tests.acquire.live import PATIENCE_S

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ANY = Address("127.0.0.1", 0)

# Subscribes to three topics and collects messages (github.com/foxglove/ws-protocol: message data are
# opcode 1, subscription u32, time u64, payload). Refused, it asks again: a busy server may not yet know the
# channel that it has just told of.
CLIENT = """(url) => new Promise((resolve, reject) => {
  const socket = new WebSocket(url, ["foxglove.sdk.v1"]);
  const wanted = {"/vehicle/raw": 1, "/camera/exposure": 2, "/gnss/vehicle/fix": 3};
  window.got = {channels: [], messages: []};
  socket.binaryType = "arraybuffer";
  socket.onerror = () => reject("no connection");
  socket.onmessage = ({data}) => {
    if (typeof data === "string") {
      const said = JSON.parse(data);
      if (said.op === "serverInfo") { window.got.server = said; resolve(); }
      if (said.op !== "advertise" && said.op !== "status") return;
      window.got.channels.push(...(said.channels ?? []));
      const heard = new Set(window.got.messages.map((m) => m[0]));
      const subscriptions = window.got.channels.filter((c) => wanted[c.topic] && !heard.has(wanted[c.topic]))
        .map((c) => ({id: wanted[c.topic], channelId: c.id}));
      const delay = said.op === "status" ? 200 : 0;
      setTimeout(() => socket.send(JSON.stringify({op: "subscribe", subscriptions})), delay);
      return;
    }
    const view = new DataView(data);
    window.got.messages.push([view.getUint32(1, true), String(view.getBigUint64(5, true)),
      Array.from(new Uint8Array(data, 13))]);
  };
})"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, demo_flight: bytes) -> Path:
    folder = tmp_path_factory.mktemp("foxglove")
    source, made = folder / "flight.tlog", folder / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], made, lambda _: None)
    return made


def test_a_client_gets_raw_and_decoded_channels_with_their_schemas(browser: Browser, log: Path) -> None:
    (chunk,) = LogReader(log).chunks()
    page = browser.new_page()
    with serving_foxglove(ANY) as (listen, url):
        assert url.startswith("ws://127.0.0.1:")
        page.evaluate(CLIENT, url)
        # The channels are made known with the first messages; who subscribes then gets what follows.
        listen(chunk)
        while page.evaluate("new Set(got.channels.map((c) => c.topic)).size") < 8:
            page.wait_for_timeout(20)
        while page.evaluate("new Set(got.messages.map((m) => m[0])).size") < 3:
            listen(chunk)
            page.wait_for_timeout(100)
        got = page.evaluate("got")
    page.close()
    assert "photocal" in got["server"]["name"]
    channels = {channel["topic"]: channel for channel in got["channels"]}
    assert channels["/vehicle/raw"]["encoding"] == "mavlink"
    assert channels["/gnss/vehicle/fix"]["schemaName"] == "foxglove.LocationFix"
    assert json.loads(channels["/camera/exposure"]["schema"])["title"] == "photocal.Exposure"
    parts = {part.channel.topic: part for part in chunk}
    for number, topic in ((1, "/vehicle/raw"), (2, "/camera/exposure"), (3, "/gnss/vehicle/fix")):
        first = next(m for m in got["messages"] if m[0] == number)
        sent = dict(zip(parts[topic].payloads, parts[topic].log_ns.tolist(), strict=True))
        assert bytes(first[2]) in sent
        assert int(first[1]) in parts[topic].log_ns


def test_without_the_package_it_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ProgramMissingError, match=r"photocal\[foxglove\]"), serving_foxglove(ANY):
        pass


def test_a_port_that_is_taken_is_told() -> None:
    with serving_foxglove(ANY) as (_, url):
        taken = read_address(urlsplit(url).netloc)
        with pytest.raises(ConfigurationError, match="another port"), serving_foxglove(taken):
            pass


# Opens a socket and gives what it is told first.
ASK = """(url) => new Promise((resolve) => {
  const socket = new WebSocket(url, ["foxglove.sdk.v1"]);
  socket.onerror = () => resolve("nothing");
  socket.onmessage = ({data}) => resolve(JSON.parse(data).op);
})"""


def test_who_has_no_token_gets_nothing(browser: Browser) -> None:
    page = browser.new_page()
    with serving_foxglove(ANY) as (_, url):
        bare, _, token = url.partition("?token=")
        assert len(token) >= 24
        for wrong in (bare, f"{bare}?token=", f"{url[:-1]}", f"{url}&token=x", f"{bare}{token}"):
            assert page.evaluate(ASK, wrong) == "nothing"
        assert page.evaluate(ASK, url) == "serverInfo"
        # Each time another one.
        with serving_foxglove(ANY) as (_, other):
            assert page.evaluate(ASK, f"{other.partition('?')[0]}?token={token}") == "nothing"
    page.close()


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET /?token=x HTTP/1.1\r\n\r\n",
        b"GET /#?token=secret HTTP/1.1\r\n\r\n",
        b"GET //[?token=secret HTTP/1.1\r\n\r\n",
        b"GET /?token=\xff HTTP/1.1\r\n\r\n",
        b"GET /?token=secret&token=secret HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: /?token=secret\r\n\r\n",
    ],
)
def test_heads_without_the_token(head: bytes) -> None:
    assert not has_token(head, "secret")
    assert has_token(b"GET /?token=secret HTTP/1.1\r\n\r\n", "secret")


def test_noise_is_refused_at_the_gate() -> None:
    with serving_foxglove(ANY) as (_, url):
        place = "127.0.0.1", read_address(urlsplit(url).netloc).port
        for noise in (b"x" * 100_000, b"GET / HTTP/1.1\r\n\r\n"):
            with socket.create_connection(place, timeout=PATIENCE_S) as line, contextlib.suppress(OSError):
                line.sendall(noise)
                assert line.recv(1000).startswith(b"HTTP/1.1 401 ")


def test_it_is_heard_on_this_computer_alone() -> None:
    """127.0.0.2 is this computer as well, and not what was bound; so would any outer address be."""
    with serving_foxglove(ANY) as (_, url):
        port = read_address(urlsplit(url).netloc).port
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=PATIENCE_S)
