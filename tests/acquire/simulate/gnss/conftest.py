"""One flight for all tests, and what RTKLIB reads of it."""

from __future__ import annotations

import pytest

from tests.acquire.simulate.gnss.flights import Flight, fly, streams
from tests.acquire.simulate.gnss.rtklib import Rinex, to_rinex


@pytest.fixture(scope="session")
def flight() -> Flight:
    return streams(fly())


@pytest.fixture(scope="session")
def rinex(flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> Rinex:
    return to_rinex(flight, tmp_path_factory.mktemp("rinex"))
