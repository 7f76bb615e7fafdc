"""A plain client of the window's server, over a real socket."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from photocal.base.web import Address, serving
from photocal.desk.standing import application


@dataclass(frozen=True)
class Answer:
    status: int
    body: bytes
    headers: dict[str, str]

    @property
    def text(self) -> str:
        return self.body.decode()

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Client:
    url: str

    def ask(
        self, path: str, method: str = "GET", body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> Answer:
        connection = http.client.HTTPConnection(urlsplit(self.url).netloc, timeout=120)
        connection.request(method, path, body, headers or {})
        answer = connection.getresponse()
        told = {name.lower(): value for name, value in answer.getheaders()}
        found = Answer(answer.status, answer.read(), told)
        connection.close()
        return found

    def get(self, path: str) -> Answer:
        return self.ask(path)

    def post(self, path: str, value: Any = None) -> Answer:
        body = json.dumps({} if value is None else value).encode()
        return self.ask(path, "POST", body, {"content-type": "application/json"})


@contextmanager
def opened(folder: Path, cache: Path) -> Iterator[Client]:
    """Serve the window on a folder."""
    with serving(application(folder, cache), Address("127.0.0.1", 0)) as url:
        yield Client(url.rstrip("/"))
