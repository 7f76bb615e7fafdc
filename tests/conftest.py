"""Fixtures that all tests share."""

from __future__ import annotations

import functools
import gc
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import pytest
import typer.main
import typer.testing
from hypothesis import HealthCheck, settings

from photocal.base.operating_system import lock
from tests import installed as installed_package

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).resolve().parent.parent

# The same cases each time, and none fails because the machine is busy.
settings.register_profile(
    "photocal", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("photocal")

# A worker asks the command line some hundred times: its commands are put together once.
for _module, _name in ((typer.main, "get_command"), (typer.testing, "_get_command")):
    setattr(_module, _name, functools.cache(typer.main.get_command))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the recorded data and the published figures, beside the project."""
    folder = Path(os.environ.get("PHOTOCAL_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        reason = f"recorded data not found in {folder.name}/ beside the project (or in $PHOTOCAL_SHARED)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


def needs_engine() -> None:
    """Leave a test out where trajectories cannot be computed."""
    if shutil.which("rnx2rtkp") is None or shutil.which("convbin") is None:
        pytest.skip("RTKLIB (rnx2rtkp, convbin) is not installed (Debian: apt-get install rtklib)")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The system's Chromium, without a window."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        reason = "Chromium is not installed (Debian: apt-get install chromium)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    reason = "playwright is not installed (the extra dev has it)"
    playwright_api = pytest.importorskip("playwright.sync_api", reason=reason)
    with playwright_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield running
        running.close()


@contextmanager
def locked(file: IO[Any]) -> Iterator[None]:
    """Wait for a lock, as each system has it."""
    while not lock(file):
        time.sleep(0.05)
    yield


Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Fill a folder once for all workers of a run; who asks later waits for it, and only reads."""
    common = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        common = common.parent

    def folder(name: str, fill: Callable[[Path], object]) -> Path:
        made, filled = common / name, common / f"{name}.filled"
        with (common / f"{name}.lock").open("w") as file, locked(file):
            if not filled.exists():
                shutil.rmtree(made, ignore_errors=True)
                made.mkdir()
                fill(made)
                filled.touch()
        return made

    return folder


@pytest.fixture(scope="session")
def wheel(once: Once) -> Path:
    """The wheel of the sources."""
    (built,) = once("wheel", installed_package.build).glob("photocal-*.whl")
    return built


@pytest.fixture(scope="session")
def installed(once: Once, wheel: Path) -> Path:
    """The interpreter of an environment that has the wheel and not the sources."""
    return once("installed", lambda folder: installed_package.install(wheel, folder)) / "bin" / "python"


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A cluster of Dask with two workers on this computer."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        # A port of its own: files of tests run beside each other.
        dashboard_address="127.0.0.1:0",
        local_directory=str(tmp_path_factory.mktemp("dask")),
        silence_logs=50,
    ) as running:
        yield running


def pytest_xdist_auto_num_workers() -> int:
    """One worker more than cores: some tests wait for devices, pages and other processes."""
    return (os.cpu_count() or 1) + 1


# Files whose tests take long together, with their seconds: they have runs of their own, and begin first in a
# run of all. `make times` measures them anew. What is "kept" is never left for the longest run: much stands
# on it.
TIMES = Path(__file__).with_name("times.txt")
SLOW_S, LONG_S = 20.0, 30.0


def times() -> dict[Path, float]:
    """Seconds of the files that take long."""
    lines = (line.split() for line in TIMES.read_text(encoding="utf-8").splitlines())
    return {ROOT / file: float(seconds) for seconds, file, *_ in lines}


def kept() -> set[Path]:
    """Files that are not left for the longest run, however long they take."""
    lines = (line.split() for line in TIMES.read_text(encoding="utf-8").splitlines())
    return {ROOT / file for _, file, *words in lines if words}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a run of all tests write down what took long."""
    parser.addoption(
        "--write-times", action="store_true", help="write the files that take long to tests/times.txt"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what looks at pages and what takes long; the longest begin first: none runs alone at the end."""
    known, stays = times(), kept()
    for item in items:
        seconds, asked = known.get(item.path, 0.0), getattr(item, "fixturenames", ())
        if seconds >= LONG_S and item.path not in stays:
            item.add_marker("long")
        elif seconds >= SLOW_S or "installed" in asked:
            item.add_marker("slow")
        if "browser" in asked:
            item.add_marker("browser")
    items.sort(key=lambda item: -known.get(item.path, 0.0))


def pytest_collection_finish() -> None:
    """Tests and modules stay to the end: the collector of garbage need not look at them again and again."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Write down which files take long, with what they set up."""
    if not config.getoption("--write-times"):
        return
    took: dict[str, float] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            if hasattr(report, "duration") and hasattr(report, "nodeid"):
                file = report.nodeid.partition("::")[0]
                took[file] = took.get(file, 0.0) + report.duration
    words = {file.relative_to(ROOT).as_posix(): " kept" for file in kept()}
    slow = sorted((file, seconds) for file, seconds in took.items() if seconds >= SLOW_S)
    lines = (f"{seconds:.0f} {file}{words.get(file, '')}\n" for file, seconds in slow)
    TIMES.write_text("".join(lines), encoding="utf-8")
