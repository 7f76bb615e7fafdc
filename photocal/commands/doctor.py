"""`photocal doctor`, `fetch-grids`: whether this machine is ready, and grids before the trip."""

import contextlib
import datetime as dt
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

from photocal.base.console import Check, answer, argument, option
from photocal.base.errors import PhotocalError, ProgramMissingError

OLDEST_PYTHON = (3, 11)
# The program is not older than this: a clock before it is wrong.
EARLIEST = dt.date(2026, 1, 1)
LEAST_MEMORY, LEAST_DISK, LEAST_DISK_RATE = 4 << 30, 10 << 30, 20e6
_PROBE_BYTES = 32 << 20
_INSTALL = "run: python -m pip install 'photocal[process]'"
_PORTS = ("ttyUSB*", "ttyACM*")


def doctor(
    folder: Annotated[Path, argument("Folder where you will record or process.")] = Path(),
    crs: Annotated[
        str | None,
        option("System of a project, such as EPSG:31982+5773: check that its grids are installed."),
    ] = None,
    as_json: Annotated[bool, option("Print the checks as JSON.", "--json")] = False,
) -> None:
    """Check whether this machine is ready to record and to process.

    Python, packages, kernels, PPK engine, browser, serial ports, clock, disk, memory, grids, leap seconds and
    key have one line each: good, poor (something will be slow or missing) or bad, with what helps.

    Example: `photocal doctor`
    """
    checks = [*examine(folder, crs)]
    answer(as_json, lambda: [vars(check) for check in checks], lambda: "\n".join(map(str, checks)))
    bad = [check for check in checks if check.state == "bad"]
    if bad:
        raise ProgramMissingError(f"{bad[0].part}: {bad[0].text}", bad[0].remedy)


def examine(folder: Path, crs: str | None = None) -> Iterator[Check]:
    """Check each part; one that cannot even be asked is bad."""
    parts: dict[str, Callable[[], Check]] = {
        "Python": _python,
        "packages": _packages,
        "kernels": _kernels,
        "PPK engine": _engine,
        "browser": _browser,
        "serial ports": lambda: _serial(Path("/dev")),
        "clock": lambda: _clock(dt.datetime.now(dt.UTC)),
        "disk": lambda: _disk(folder),
        "memory": _memory,
        "grids": lambda: _grids(crs),
        "leap seconds": lambda: _leap_seconds(dt.datetime.now(dt.UTC).date()),
        "key": _key,
    }
    for part, check in parts.items():
        try:
            yield check()
        except PhotocalError as refusal:
            yield Check(part, "bad", refusal.what, refusal.remedy)
        except (OSError, ImportError, subprocess.SubprocessError, ValueError) as refusal:
            yield Check(part, "bad", f"cannot be asked ({refusal})", _INSTALL)


def _python() -> Check:
    version = sys.version_info[:2]
    text = ".".join(map(str, sys.version_info[:3]))
    if version < OLDEST_PYTHON:
        return Check("Python", "bad", f"{text} is too old", "install Python 3.11 or newer")
    return Check("Python", "good", text)


def _packages() -> Check:
    import importlib.metadata
    import re

    from photocal.base.version import __version__

    wanted = importlib.metadata.requires("photocal") or []
    names = [re.split(r"[^\w.-]", line)[0] for line in wanted if "extra ==" not in line or "process" in line]
    missing = []
    for name in names:
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return Check("packages", "bad", f"{', '.join(missing)} missing", _INSTALL)
    return Check("packages", "good", f"{len(names)} there, photocal {__version__}")


def _kernels() -> Check:
    from photocal.base.compiled import FOLDER, PACKAGE
    from photocal.base.operating_system import cache_folder

    if not any(parent in (PACKAGE, cache_folder()) for parent in FOLDER.parents):
        remedy = f"make {cache_folder()} writable, mode 700"
        return Check("kernels", "poor", f"in {FOLDER}, which is not kept", remedy)
    if not any(FOLDER.rglob("*.nbi")):
        remedy = "run: python -m photocal.base.compiled"
        return Check("kernels", "poor", "not compiled yet: the first adjustment is slow", remedy)
    return Check("kernels", "good", f"in {FOLDER}")


def _engine() -> Check:
    remedy = "on Debian run: apt-get install rtklib; elsewhere put rnx2rtkp and convbin of RTKLIB on the path"
    for name in ("rnx2rtkp", "convbin"):
        if shutil.which(name) is None:
            return Check("PPK engine", "poor", f"{name} is missing: no PPK from raw observations", remedy)
    path = str(shutil.which("rnx2rtkp"))
    done = subprocess.run([path, "-?"], capture_output=True, text=True, timeout=20, check=False)  # noqa: S603
    if "rnx2rtkp" not in done.stdout + done.stderr:
        return Check("PPK engine", "bad", f"{path} does not answer as RTKLIB's does", remedy)
    return Check("PPK engine", "good", path)


def _browser() -> Check:
    import webbrowser

    try:
        return Check("browser", "good", str(getattr(webbrowser.get(), "name", "there")))
    except webbrowser.Error:
        text = "none: pages can be opened from another computer"
        return Check("browser", "poor", text, "install one, or give the page an --address of your network")


def _serial(devices: Path) -> Check:
    ports = [port for pattern in _PORTS for port in sorted(devices.glob(pattern))]
    closed = [port.name for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        remedy = "run: sudo usermod -aG dialout $USER, then log in again"
        return Check("serial ports", "bad", f"{', '.join(closed)} may not be opened", remedy)
    return Check("serial ports", "good", f"{len(ports)} there" if ports else "none connected")


def _clock(now: dt.datetime) -> Check:
    remedy = "set the clock by the network or by GNSS before you record"
    if now.date() < EARLIEST:
        return Check("clock", "bad", f"says {now:%Y-%m-%d}", remedy)
    control = shutil.which("timedatectl")
    if control is not None:
        command = [control, "show", "-p", "NTPSynchronized", "--value"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)  # noqa: S603
        if done.stdout.strip() == "no":
            return Check("clock", "poor", "is not synchronised", remedy)
        if done.stdout.strip() == "yes":
            return Check("clock", "good", "synchronised")
    return Check("clock", "good", f"{now:%Y-%m-%d %H:%M} UTC; whether it is synchronised is not known here")


def _disk(folder: Path) -> Check:
    free = shutil.disk_usage(folder).free
    began = time.monotonic()
    with tempfile.NamedTemporaryFile(dir=folder) as probe:
        probe.write(bytes(_PROBE_BYTES))
        probe.flush()
        os.fsync(probe.fileno())
    rate = _PROBE_BYTES / (time.monotonic() - began)
    text = f"{free / 1e9:.0f} GB free, writes {rate / 1e6:.0f} MB/s"
    if free < LEAST_DISK:
        return Check("disk", "bad", text, f"make room: {LEAST_DISK >> 30} GB at least")
    if rate < LEAST_DISK_RATE:
        return Check("disk", "poor", text, "record on another disk")
    return Check("disk", "good", text)


def _memory() -> Check:
    with contextlib.suppress(OSError, ValueError, AttributeError):
        # Where there is no such call, the size is not known.
        sysconf = getattr(os, "sysconf")  # noqa: B009
        total = sysconf("SC_PAGE_SIZE") * sysconf("SC_PHYS_PAGES")
        text = f"{total / 2**30:.1f} GiB"
        if total < LEAST_MEMORY:
            return Check("memory", "poor", text, "take smaller blocks, or a machine with 4 GiB or more")
        return Check("memory", "good", text)
    return Check("memory", "good", "its size is not known here")


def _grids(crs: str | None) -> Check:
    from photocal.geometry.systems import grids_here, missing_grids

    if crs is None:
        return Check("grids", "good", f"{len(grids_here())} here; --crs looks for those of a project")
    missing = missing_grids(crs)
    if missing:
        remedy = f"run: photocal fetch-grids {crs}"
        return Check("grids", "bad", f"{', '.join(missing)} missing for {crs}", remedy)
    return Check("grids", "good", f"all that {crs} needs")


def _leap_seconds(today: dt.date) -> Check:
    from photocal.base.time_scales import installed_leap_seconds

    expires = installed_leap_seconds().expires
    remedy = "run: python -m pip install --upgrade tzdata"
    if expires < today:
        return Check("leap seconds", "bad", f"known until {expires}", remedy)
    # A table that expires sooner is to be renewed before the next flights.
    soon_days = 30
    if (expires - today).days < soon_days:
        return Check("leap seconds", "poor", f"known until {expires}", remedy)
    return Check("leap seconds", "good", f"known until {expires}")


def _key() -> Check:
    from photocal.base.operating_system import private_folder, settings_folder
    from photocal.report.keys import own_key

    key = own_key()
    if key is None:
        return Check("key", "poor", "none: certificates cannot be signed", "run: photocal keys --new NAME")
    private_folder(settings_folder())
    return Check("key", "good", key.fingerprint)


def fetch_grids(
    crs: Annotated[str, argument("System of the project, with its heights: EPSG:31982+5773.")],
    area: Annotated[
        tuple[float, float, float, float] | None,
        option("Limits in degrees; default: the whole area of the system.", metavar="W S E N"),
    ] = None,
    dry: Annotated[bool, option("Only list what is missing.", "--dry-run")] = False,
    as_json: Annotated[bool, option("Print the names as JSON.", "--json")] = False,
) -> None:
    """Fetch the grids that a reference system needs, so that it can be used without a network.

    Example: `photocal fetch-grids EPSG:31982+5773 --area -54 -31 -53 -30`
    """
    from photocal.geometry.systems import fetch_grids as fetched
    from photocal.geometry.systems import missing_grids

    names = missing_grids(crs, area) if dry else fetched(crs, area)
    word = "missing" if dry else "fetched"
    answer(
        as_json,
        lambda: {"crs": crs, word: list(names)},
        lambda: "\n".join(f"{word}: {name}" for name in names) or f"all grids of {crs} are here",
    )
