"""Features and matches on a Dask cluster: what one process finds, whatever dies on the way."""

from __future__ import annotations

import importlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError, DeviceError, InputNotFoundError, ProgramMissingError
from photocal.base.workers import Cluster, Workers, protected, run_tasks
from photocal.measurement.features import FeatureSettings
from photocal.measurement.image_file import read_grey
from photocal.measurement.match_images import MatchingPlan, detect_all, match_all
from photocal.measurement.tracks import Tracks
from tests.photocal.conftest import Answer
from tests.photocal.measurement.site import SIDE, flight, texture

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
FEATURES = FeatureSettings(most=600)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    folder = tmp_path_factory.mktemp("pictures")
    site = flight()
    site.render(texture(1, SIDE), folder)
    return tuple(folder / name for name in site.names)


def tracks(
    pictures: tuple[Path, ...], cache: Path, workers: Workers, done: Callable[[float], None] = lambda _: None
) -> Tracks:
    plan = MatchingPlan(cache, workers, FEATURES)

    @contextmanager
    def progress(*_: object) -> Iterator[Callable[[float], None]]:
        yield done

    keys, reasons = detect_all(pictures, plan, progress)
    assert reasons == ("",) * len(pictures)
    pairs = np.array([(a, b) for a in range(len(keys)) for b in range(a)], dtype=np.int64)
    return match_all(keys, pairs, plan, done)[0]


def assert_same(found: Tracks, wanted: Tracks) -> None:
    assert wanted.count > 300
    for name in ("track", "image", "pixels", "scale"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name
    assert found.conflicts == wanted.conflicts


@pytest.fixture(scope="module")
def alone(pictures: tuple[Path, ...], tmp_path_factory: pytest.TempPathFactory) -> Tracks:
    return tracks(pictures, tmp_path_factory.mktemp("alone"), 1)


def test_two_workers_find_the_tracks_of_one_process(
    pictures: tuple[Path, ...], two_workers: Any, alone: Tracks, tmp_path: Path
) -> None:
    cluster = Cluster(two_workers.scheduler_address)
    cluster.require_shared(pictures[0].parent, tmp_path)
    assert_same(tracks(pictures, tmp_path, cluster), alone)
    # The work was done there: what they keep is in the cache that was named.
    assert list(tmp_path.rglob("*.npz"))


def test_of_three_workers_one_killed_and_one_slow_change_nothing(
    pictures: tuple[Path, ...], two_workers: Any, alone: Tracks, tmp_path: Path
) -> None:
    """The slow one stands still for nine tenths of the time."""
    distributed: Any = pytest.importorskip("distributed")
    two_workers.scale(3)
    with distributed.Client(two_workers.scheduler_address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=60)
        # The cluster itself may hear of the third one later.
        dead, slow, _ = client.run(os.getpid).values()
    over, started = threading.Event(), list[threading.Thread]()

    def slowed() -> None:
        while not over.wait(0.1):
            os.kill(slow, signal.SIGSTOP)
            over.wait(0.9)
            os.kill(slow, signal.SIGCONT)

    def done(_: float) -> None:
        if not started:
            os.kill(dead, signal.SIGKILL)
            started.append(threading.Thread(target=slowed))
            started[0].start()

    try:
        found = tracks(pictures, tmp_path, Cluster(two_workers.scheduler_address), done)
    finally:
        over.set()
        for thread in started:
            thread.join()
    assert_same(found, alone)
    assert started


def test_failures_of_a_task_arrive_as_they_are(two_workers: Any) -> None:
    with pytest.raises(InputNotFoundError, match=r"^a\.jpg: does not exist; check the name of the image$"):
        list(run_tasks(read_grey, [Path("a.jpg")], Cluster(two_workers.scheduler_address)))


def test_folders_that_workers_do_not_see_are_named(two_workers: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"images: worker tcp://.* does not see it"):
        Cluster(two_workers.scheduler_address).require_shared(tmp_path / "images", tmp_path)


def test_no_scheduler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("photocal.base.workers._TIMEOUT_S", 1)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
        with pytest.raises(DeviceError, match="no scheduler answers there"):
            list(run_tasks(len, ["a"], Cluster(address)))
    with pytest.raises(DeviceError, match="no scheduler answers there"):
        list(run_tasks(len, ["a"], Cluster("nonsense://localhost")))


def test_the_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    original = importlib.import_module

    def without(name: str, package: str | None = None) -> object:
        if name == "distributed":
            raise ImportError(name)
        return original(name, package)

    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(ProgramMissingError, match=r"install photocal\[cluster\]"):
        list(run_tasks(len, ["a"], Cluster("tcp://127.0.0.1:1")))


def test_the_command_says_what_is_wrong_with_a_cluster(
    photocal: Callable[..., Answer], pictures: tuple[Path, ...], tmp_path: Path
) -> None:
    folder = pictures[0].parent
    told = photocal("measure", "--images", folder, "-o", tmp_path / "b", "--cluster", "nonsense://localhost")
    assert (told.code, "nonsense://localhost: no scheduler answers there" in told.err) == (10, True)
    told = photocal(
        "measure",
        "--images",
        folder,
        "-o",
        tmp_path / "b",
        "--cluster",
        "tcp://127.0.0.1:1",
        "--workers",
        "2",
    )
    assert (told.code, "--workers and --cluster are both given" in told.err) == (5, True)
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(
    "address", ["tls://10.0.0.5:8786", "tcp://127.0.0.1:8786", "tcp://[::1]:8786", "localhost:8786"]
)
def test_a_protected_scheduler_may_be_joined(address: str) -> None:
    assert protected(address) == address


@pytest.mark.parametrize(
    "address",
    ["tcp://10.0.0.5:8786", "tcp://localhost.example:8786", "10.0.0.5:8786", "ucx://[fe80::1]:8786"],
)
def test_an_unprotected_scheduler_elsewhere_needs_a_word(address: str) -> None:
    with pytest.raises(ConfigurationError, match="not protected"):
        protected(address)
    with pytest.raises(ConfigurationError, match="not protected"):
        list(run_tasks(len, ["a"], Cluster(address)))
    assert protected("unprotected+tcp://10.0.0.5:8786") == "tcp://10.0.0.5:8786"
