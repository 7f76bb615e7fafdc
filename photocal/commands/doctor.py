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
from typing import TYPE_CHECKING, Annotated, Literal

from photocal.base.console import Check, Language, answer, argument, option
from photocal.base.errors import PhotocalError, ProgramMissingError

if TYPE_CHECKING:
    from photocal.findings.texts import Catalogue

OLDEST_PYTHON = (3, 11)
# The program is not older than this: a clock before it is wrong.
EARLIEST = dt.date(2026, 1, 1)
LEAST_MEMORY, LEAST_DISK, LEAST_DISK_RATE = 4 << 30, 10 << 30, 20e6
_PROBE_BYTES = 32 << 20
_PORTS = ("ttyUSB*", "ttyACM*")


def doctor(
    folder: Annotated[Path, argument("Folder where you will record or process.", metavar="FOLDER")] = Path(),
    crs: Annotated[
        str | None,
        option("System of a project, such as EPSG:31982+5773: check that its grids are installed."),
    ] = None,
    language: Language = "",
    as_json: Annotated[bool, option("Print the checks as JSON.", "--json")] = False,
) -> None:
    """Check whether this machine is ready to record and to process.

    Python, packages, kernels, PPK engine, browser, serial ports, clock, disk, memory, grids, leap seconds and
    key have one line each: ok, warning (something will be slow or missing) or error, with the remedy.

    Example: `photocal doctor`
    """
    from photocal.findings.texts import catalogue, spoken

    say = catalogue((language or "en") if as_json else spoken(language))
    checks = [*examine(folder, crs, say)]

    def lines() -> str:
        """Say each in a line."""
        words = [(say(f"doctor.state.{check.state}"), check) for check in checks]
        wide = max(len(word) for word, _ in words)
        return "\n".join(f"{word:<{wide}} {check.said()}" for word, check in words)

    answer(as_json, lambda: [vars(check) for check in checks], lines)
    bad = [check for check in checks if check.state == "bad"]
    if bad:
        raise ProgramMissingError(f"{bad[0].part}: {bad[0].text}", bad[0].remedy)


State = Literal["good", "poor", "bad"]
Found = tuple[State, str, str]


def examine(folder: Path, crs: str | None, say: "Catalogue") -> Iterator[Check]:
    """Check each part; one that cannot even be asked is bad."""
    parts: dict[str, Callable[[], Found]] = {
        "python": lambda: _python(say),
        "packages": lambda: _packages(say),
        "kernels": lambda: _kernels(say),
        "engine": lambda: _engine(say),
        "browser": lambda: _browser(say),
        "serial": lambda: _serial(say, Path("/dev")),
        "clock": lambda: _clock(say, dt.datetime.now(dt.UTC)),
        "disk": lambda: _disk(say, folder),
        "memory": lambda: _memory(say),
        "grids": lambda: _grids(say, crs),
        "leap": lambda: _leap_seconds(say, dt.datetime.now(dt.UTC).date()),
        "key": lambda: _key(say),
    }
    for part, check in parts.items():
        try:
            state, text, remedy = check()
        except PhotocalError as refusal:
            state, text, remedy = "bad", refusal.what, refusal.remedy
        except (OSError, ImportError, subprocess.SubprocessError, ValueError) as refusal:
            state, text, remedy = "bad", say("doctor.unasked", reason=refusal), say("doctor.install")
        yield Check(say(f"doctor.part.{part}"), state, text, remedy)


def _python(say: "Catalogue") -> Found:
    version = sys.version_info[:2]
    text = ".".join(map(str, sys.version_info[:3]))
    if version < OLDEST_PYTHON:
        return "bad", say("doctor.python_old", version=text), say("doctor.python_install")
    return "good", text, ""


def _packages(say: "Catalogue") -> Found:
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
        return "bad", say("doctor.packages_missing", names=", ".join(missing)), say("doctor.install")
    return "good", say("doctor.packages", n=len(names), version=__version__), ""


def _kernels(say: "Catalogue") -> Found:
    from photocal.base.compiled import FOLDER, PACKAGE, anything_compiled
    from photocal.base.operating_system import cache_folder

    if not any(parent in (PACKAGE, cache_folder()) for parent in FOLDER.parents):
        remedy = say("doctor.kernels_writable", folder=cache_folder())
        return "poor", say("doctor.kernels_lost", folder=FOLDER), remedy
    if not anything_compiled():
        return "poor", say("doctor.kernels_none"), say("doctor.kernels_compile")
    return "good", say("doctor.kernels", folder=FOLDER), ""


def _engine(say: "Catalogue") -> Found:
    remedy = say("doctor.engine_install")
    for name in ("rnx2rtkp", "convbin"):
        if shutil.which(name) is None:
            return "poor", say("doctor.engine_missing", name=name), remedy
    path = str(shutil.which("rnx2rtkp"))
    done = subprocess.run([path, "-?"], capture_output=True, text=True, timeout=20, check=False)  # noqa: S603
    if "rnx2rtkp" not in done.stdout + done.stderr:
        return "bad", say("doctor.engine_other", path=path), remedy
    return "good", path, ""


def _browser(say: "Catalogue") -> Found:
    import webbrowser

    try:
        return "good", str(getattr(webbrowser.get(), "name", say("doctor.browser"))), ""
    except webbrowser.Error:
        return "poor", say("doctor.browser_none"), say("doctor.browser_install")


def _serial(say: "Catalogue", devices: Path) -> Found:
    ports = [port for pattern in _PORTS for port in sorted(devices.glob(pattern))]
    closed = [port.name for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        return "bad", say("doctor.serial_closed", names=", ".join(closed)), say("doctor.serial_open")
    return "good", say("doctor.serial", n=len(ports)) if ports else say("doctor.serial_none"), ""


def _clock(say: "Catalogue", now: dt.datetime) -> Found:
    remedy = say("doctor.clock_set")
    if now.date() < EARLIEST:
        return "bad", say("doctor.clock_wrong", date=f"{now:%Y-%m-%d}"), remedy
    control = shutil.which("timedatectl")
    if control is not None:
        command = [control, "show", "-p", "NTPSynchronized", "--value"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)  # noqa: S603
        if done.stdout.strip() == "no":
            return "poor", say("doctor.clock_alone"), remedy
        if done.stdout.strip() == "yes":
            return "good", say("doctor.clock"), ""
    return "good", say("doctor.clock_unknown", time=f"{now:%Y-%m-%d %H:%M} UTC"), ""


def _disk(say: "Catalogue", folder: Path) -> Found:
    free = shutil.disk_usage(folder).free
    began = time.monotonic()
    with tempfile.NamedTemporaryFile(dir=folder) as probe:
        probe.write(bytes(_PROBE_BYTES))
        probe.flush()
        os.fsync(probe.fileno())
    rate = _PROBE_BYTES / (time.monotonic() - began)
    text = say("doctor.disk", free=f"{free / 1e9:.0f}", rate=f"{rate / 1e6:.0f}")
    if free < LEAST_DISK:
        return "bad", text, say("doctor.disk_room", least=LEAST_DISK >> 30)
    if rate < LEAST_DISK_RATE:
        return "poor", text, say("doctor.disk_slow")
    return "good", text, ""


def _memory(say: "Catalogue") -> Found:
    with contextlib.suppress(OSError, ValueError, AttributeError):
        # Where there is no such call, the size is not known.
        sysconf = getattr(os, "sysconf")  # noqa: B009
        total = sysconf("SC_PAGE_SIZE") * sysconf("SC_PHYS_PAGES")
        text = f"{say.fixed(total / 2**30, 1)} GiB"
        if total < LEAST_MEMORY:
            return "poor", text, say("doctor.memory_little")
        return "good", text, ""
    return "good", say("doctor.memory_unknown"), ""


def _grids(say: "Catalogue", crs: str | None) -> Found:
    from photocal.geometry.systems import grids_here, missing_grids

    if crs is None:
        return "good", say("doctor.grids", n=len(grids_here())), ""
    missing = missing_grids(crs)
    if missing:
        text = say("doctor.grids_missing", names=", ".join(missing), crs=crs)
        return "bad", text, say("doctor.grids_fetch", crs=crs)
    return "good", say("doctor.grids_all", crs=crs), ""


def _leap_seconds(say: "Catalogue", today: dt.date) -> Found:
    from photocal.base.time_scales import installed_leap_seconds

    expires = installed_leap_seconds().expires
    text, remedy = say("doctor.leap", date=expires), say("doctor.leap_renew")
    if expires < today:
        return "bad", text, remedy
    # A table that expires sooner is to be renewed before the next flights.
    soon_days = 30
    if (expires - today).days < soon_days:
        return "poor", text, remedy
    return "good", text, ""


def _key(say: "Catalogue") -> Found:
    from photocal.base.operating_system import private_folder, settings_folder
    from photocal.report.keys import own_key

    key = own_key()
    if key is None:
        return "poor", say("doctor.key_none"), say("doctor.key_new")
    private_folder(settings_folder())
    return "good", key.fingerprint, ""


def fetch_grids(
    crs: Annotated[
        str, argument("System of the project, with its heights: EPSG:31982+5773.", metavar="SYSTEM")
    ],
    area: Annotated[
        tuple[float, float, float, float] | None,
        option("Limits in degrees; default: the whole area of the system.", metavar="WEST SOUTH EAST NORTH"),
    ] = None,
    dry: Annotated[bool, option("Only list what is missing.", "--dry-run")] = False,
    language: Language = "",
    as_json: Annotated[bool, option("Print the names as JSON.", "--json")] = False,
) -> None:
    """Fetch the grids that a reference system needs, so that it can be used without a network.

    Example: `photocal fetch-grids EPSG:31982+5773 --area -54 -31 -53 -30`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.geometry.systems import fetch_grids as fetched
    from photocal.geometry.systems import missing_grids

    names, say = missing_grids(crs, area) if dry else fetched(crs, area), catalogue(spoken(language))
    word = "missing" if dry else "fetched"
    answer(
        as_json,
        lambda: {"crs": crs, word: list(names)},
        lambda: "\n".join(say(f"grids.{word}", name=name) for name in names) or say("grids.here", crs=crs),
    )
