"""What operating systems do differently: locks, private and user's folders, signals, pseudo terminals."""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO, Any

from photocal.base.errors import DeviceError, OutputError, reason

# Windows refuses to replace a file that another program, often a scanner, is looking at.
_REPLACE_TRIES, _REPLACE_WAIT_S = 20, 0.05

if sys.platform == "win32":
    import msvcrt

    # A process of its own group is the only one that can be asked to stop.
    CHILD_FLAGS = subprocess.CREATE_NEW_PROCESS_GROUP
    _INTERRUPT = signal.CTRL_BREAK_EVENT
    _STOPS = (signal.SIGINT, signal.SIGBREAK)

    def lock(stream: IO[Any]) -> bool:
        """Take an open file for this process alone, without waiting; the lock ends with the process."""
        try:
            stream.seek(0)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    def available_memory() -> int | None:
        """Bytes of memory that programs may still take; None where the system does not tell."""
        import ctypes

        # MEMORYSTATUSEX: its length, the load in per cent, then seven sizes; the second is what is free.
        state = (ctypes.c_uint64 * 8)()
        ctypes.cast(state, ctypes.POINTER(ctypes.c_uint32))[0] = ctypes.sizeof(state)
        return state[2] if ctypes.windll.kernel32.GlobalMemoryStatusEx(state) else None

    def keep_memory() -> None:
        """Do nothing: the C library here has no such choice."""

    def give_back_memory() -> None:
        """Do nothing: the C library here has no such call."""

    def is_private(_: Path) -> bool:
        """Say that it is."""
        # A user's profile and temporary folder are closed to others by their access lists.
        return True

    def sync_folder(_: Path) -> None:
        """Do nothing: folders are written with their files."""

    def pseudo_terminal() -> tuple[int, int, str]:
        """Refuse: there are none."""
        raise DeviceError("Windows has no pseudo terminals", "take tcp:// or udp://")

    def has_reader(_: int) -> bool:
        """Say that nobody reads a pseudo terminal."""
        return False

    def waiting_bytes(_: int) -> int:
        """Say that no byte waits in a pseudo terminal."""
        return 0

else:
    import fcntl
    import resource
    import select
    import termios
    import tty

    CHILD_FLAGS = 0
    _INTERRUPT = signal.SIGINT
    # A window that is closed and a connection that drops send SIGHUP.
    _STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def lock(stream: IO[Any]) -> bool:
        """Take an open file for this process alone, without waiting; the lock ends with the process."""
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def is_private(path: Path) -> bool:
        """Whether a file or folder is this user's and closed to all others."""
        state = path.lstat()
        return state.st_uid == os.getuid() and not state.st_mode & 0o077 and not path.is_symlink()

    def sync_folder(folder: Path) -> None:
        """Wait until the disk has the names of a folder's files."""
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def pseudo_terminal() -> tuple[int, int, str]:
        """Open one in raw mode: our end, that of the reader, and its path."""
        try:
            ours, theirs = os.openpty()
        except OSError as refusal:
            raise DeviceError(
                f"this system gives no pseudo terminal ({reason(refusal)})",
                "mount devpts on /dev/pts, as complete systems and containers do",
            ) from refusal
        tty.setraw(theirs)
        return ours, theirs, os.ttyname(theirs)

    def has_reader(ours: int) -> bool:
        """Whether a program has a pseudo terminal open."""
        watch = select.poll()
        watch.register(ours, 0)
        return not any(event & select.POLLHUP for _, event in watch.poll(0))

    def waiting_bytes(theirs: int) -> int:
        """Count the bytes of a pseudo terminal that its reader has not taken."""
        return int.from_bytes(fcntl.ioctl(theirs, termios.FIONREAD, bytes(4)), sys.byteorder)

    def available_memory() -> int | None:
        """Bytes that programs may still take; else those of the computer, or None."""
        try:
            told = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text("ascii").splitlines())
            free = 1024 * int(told["MemAvailable"].split()[0])
        except (OSError, ValueError, KeyError):
            names = getattr(os, "sysconf_names", {})
            known = "SC_PHYS_PAGES" in names and "SC_PAGE_SIZE" in names
            return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if known else None
        return min(free, _of_groups(), _of_limit())

    def keep_memory() -> None:
        """Keep the memory of arrays for later ones: the system clears each page that it gives anew."""
        import ctypes

        with contextlib.suppress(AttributeError):
            # Of the GNU library alone: from the heap all of it, and none of that back (`man mallopt`).
            change, trim_threshold, mmap_max = ctypes.CDLL(None).mallopt, -1, -4
            change(mmap_max, 0)
            change(trim_threshold, -1)

    def give_back_memory() -> None:
        """Give the system the memory that arrays have left: of many pictures half of what a process has."""
        import ctypes

        with contextlib.suppress(AttributeError):
            # Of the GNU library alone.
            ctypes.CDLL(None).malloc_trim(0)

    def _of_limit() -> int:
        """What a limit of this process's own addresses (`ulimit -v`) leaves; beyond all without one."""
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit == resource.RLIM_INFINITY:
            return sys.maxsize
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
        return max(0, limit - pages * os.sysconf("SC_PAGE_SIZE"))

    def _of_groups(told: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")) -> int:
        """What the control groups of this process leave of their limits; beyond all without a limit."""
        left = sys.maxsize
        try:
            lines = told.read_text("ascii").splitlines()
        except (OSError, ValueError):
            lines = ["0::/"]
        for line in lines:
            controllers, _, path = line.partition(":")[2].partition(":")
            if controllers and "memory" not in controllers.split(","):
                continue
            base = root / "memory" if controllers else root
            # Those that it is in bind it, too; a container shows its own at the root, whatever its path.
            own = base / path.lstrip("/")
            for folder in {base, own, *(parent for parent in own.parents if base in parent.parents)}:
                left = min(left, _of_group(folder, _FIRST_GROUPS if controllers else _GROUPS))
        return left

    # Files of a control group, with its limit and what is used of it; of the latter, files that are cached,
    # and those that programs run from, which do not give way.
    _GROUPS = ("memory.max", "memory.current", "inactive_file", "active_file", "file_mapped")
    _FIRST_GROUPS = (
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        *("total_inactive_file", "total_active_file", "total_mapped_file"),
    )

    def _of_group(folder: Path, names: tuple[str, ...]) -> int:
        """What one control group leaves; beyond all where it has no limit, or is not seen from here."""
        try:
            limit, used = (int((folder / name).read_text("ascii")) for name in names[:2])
            parts = dict(line.split() for line in (folder / "memory.stat").read_text("ascii").splitlines())
        except (OSError, ValueError):
            return sys.maxsize
        idle, busy, mapped = (int(parts.get(name, 0)) for name in names[2:])
        return max(0, limit - used + max(0, idle + busy - mapped))


def private_folder(folder: Path) -> Path:
    """Make a folder that only this user can open; one of somebody else is refused.

    raises OutputError: when it cannot be made, belongs to another user or stands open to others.
    """
    unwritten = OutputError.at(folder)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        private = is_private(folder)
    except OSError as refusal:
        raise unwritten(f"cannot be made ({reason(refusal)})") from refusal
    if not private:
        raise unwritten(
            "belongs to another user or is open to others", f"remove it, or run: chmod 700 {folder}"
        )
    return folder


def replace(aside: Path, final: Path) -> None:
    """Let a file that was written aside take its place, on the disk, too: whole or not at all."""
    with aside.open("r+b") as stream:
        os.fsync(stream.fileno())
    for left in reversed(range(_REPLACE_TRIES)):
        try:
            aside.replace(final)
            break
        except PermissionError:
            if os.name != "nt" or not left:
                raise
            time.sleep(_REPLACE_WAIT_S)
    sync_folder(final.parent)


def cache_folder() -> Path:
    """Folder of this user for what can be made again."""
    return _user_folder("XDG_CACHE_HOME", ".cache", "LOCALAPPDATA", "Caches")


def settings_folder() -> Path:
    """Folder of this user for keys and settings."""
    return _user_folder("XDG_CONFIG_HOME", ".config", "APPDATA", "Application Support")


def _user_folder(variable: str, hidden: str, windows: str, mac: str) -> Path:
    if given := os.environ.get(variable):
        return Path(given) / "photocal"
    home = Path.home()
    other = {"win32": Path(os.environ.get(windows, home)), "darwin": home / "Library" / mac}
    return other.get(sys.platform, home / hidden) / "photocal"


def stopped_by_signals() -> threading.Event:
    """Give an event that Ctrl-C, a request to end the process and the loss of its terminal set."""
    stop = threading.Event()
    # The main thread that a signal interrupts may hold the lock of the event, for which the handler would
    # wait for ever. Of what hands something to another thread, this queue alone may be used by a handler.
    asked: queue.SimpleQueue[int] = queue.SimpleQueue()

    def wait() -> None:
        """Set the event at the first signal."""
        asked.get()
        stop.set()

    threading.Thread(target=wait, name="signals", daemon=True).start()
    for number in _STOPS:
        # Who starts it by nohup wants it to outlive the terminal.
        if number == _INTERRUPT or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, _: asked.put(number))
    return stop


def wait_until(stop: threading.Event) -> None:
    """Wait for an event as `stopped_by_signals` gives it, for as long as it takes."""
    # Windows lets no signal interrupt a wait without an end.
    while not stop.wait(0.5):
        pass


def interrupt(process: subprocess.Popen[Any]) -> None:
    """Ask a process that was started with `CHILD_FLAGS` to stop, as Ctrl-C does."""
    process.send_signal(_INTERRUPT)
