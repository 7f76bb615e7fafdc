"""Study: what do full, failing, slow and pulled disks do to a recording?

Writes `docs/evidence/failing_media.md`. A recorder with a link of 100 frames a second writes to a real file
system on a disk with faults (`tests.acquire.forgetful_disk`); the fault comes after 3 s. At the end it is
stopped, and what is in all its logs, as they are, is compared with what was sent.

Run: `make evidence`, or `python -m tests.evidence.failing_media`.
"""

from __future__ import annotations

import contextlib
import errno
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from acquire.importing.recovery import recover
from acquire.log.replay import raw_frames
from photocal.base.errors import InputMalformedError
from tests.acquire.forgetful_disk import Faults, ForgetfulDisk, after_the_cut, disk_mounted, forbidden
from tests.acquire.live import Process, free_port, is_bound, until
from tests.acquire.recording.undisturbed import GoodLink, configured

BEFORE_S, FAULT_S, AFTER_S = 3.0, 12.0, 8.0
DISK_MB = 24
COLUMNS = (
    "| fault | frames sent | lost | twice | wrong | alarm after, s | memory, MB | stop, s | exit code |"
    " first alarm |"
)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "failing_media.md"


@dataclass(frozen=True)
class Case:
    """A fault: what begins it and ends it, and whether there is a second folder and a second, fast link."""

    begin: Callable[[Path, ForgetfulDisk], None]
    end: Callable[[Path, ForgetfulDisk], None]
    fallback: bool
    fast: bool = False


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    sent, lost, twice, wrong: frames of the link; lost are those in no log.
    told_s: how long after the fault the first alarm came; -1: none.
    memory_mb: growth of the recorder's memory from the fault on.
    """

    sent: int
    lost: int
    twice: int
    wrong: int
    told_s: float
    words: str
    memory_mb: float
    stop_s: float
    code: int


def nothing(_folder: Path, _disk: ForgetfulDisk) -> None:
    """Leave it so."""


def fill(folder: Path, _disk: ForgetfulDisk) -> None:
    """Take all the room."""
    with contextlib.suppress(OSError), (folder / "filler").open("wb", buffering=0) as filler:
        while True:
            filler.write(bytes(1 << 16 if filler.tell() < 1 << 24 else 512))


def make_room(folder: Path, _disk: ForgetfulDisk) -> None:
    """Give the room back."""
    (folder / "filler").unlink()


def failing(_folder: Path, disk: ForgetfulDisk) -> None:
    """Refuse each write and flush; ext4 goes read-only over it."""
    disk.faults = Faults(writes=errno.EIO, flushes=errno.EIO)


def well(_folder: Path, disk: ForgetfulDisk) -> None:
    """Be well again."""
    disk.faults = Faults()


def read_only(folder: Path, _disk: ForgetfulDisk) -> None:
    """Let the system make it read-only, as it does with a file system that it does not trust any more."""
    subprocess.run(["mount", "-o", "remount,abort", str(folder)], check=False, capture_output=True)


def pulled(folder: Path, disk: ForgetfulDisk) -> None:
    """Pull the card: nothing works any more and its folder is an empty one."""
    failing(folder, disk)
    subprocess.run(["umount", "-l", str(folder)], check=True)


def slow(_folder: Path, disk: ForgetfulDisk) -> None:
    """Take 2 MB/s, with pauses of 3 s."""
    disk.faults = Faults(bytes_s=2e6, stall_every_s=2.0, stall_s=3.0)


def hanging(_folder: Path, disk: ForgetfulDisk) -> None:
    """Do nothing for as long as the fault lasts."""
    disk.faults = Faults(stall_every_s=0.0, stall_s=FAULT_S)


CASES = {
    "full, room again after 12 s": Case(fill, make_room, fallback=False),
    "full, with a fallback": Case(fill, nothing, fallback=True),
    "read-only (aborted), with a fallback": Case(read_only, nothing, fallback=True),
    "EIO for each write and flush, with a fallback": Case(failing, nothing, fallback=True),
    "EIO, no fallback, stopped so": Case(failing, nothing, fallback=False),
    "pulled, with a fallback": Case(pulled, nothing, fallback=True),
    "pulled, no fallback": Case(pulled, nothing, fallback=False),
    "slow: 2 MB/s, pauses of 3 s each 2 s": Case(slow, nothing, fallback=False, fast=True),
    "hangs for 12 s, no fallback": Case(hanging, well, fallback=False),
    "hangs for 12 s, with a fallback": Case(hanging, well, fallback=True),
}


def outcome_of(case: Case, fault_s: float = FAULT_S, after_s: float = AFTER_S) -> Outcome:
    """Record over a fault and look what is left."""
    with (
        tempfile.TemporaryDirectory() as name,
        disk_mounted(DISK_MB) as (folder, disk),
        contextlib.ExitStack() as stack,
    ):
        fast = free_port()
        links = [("fast", "ubx", f"udp://127.0.0.1:{fast}", "silent_s = 600")] if case.fast else []
        path, port = configured(Path(name), *links)
        where = f'output = "{folder}/logs"\n' + ('fallback = "second"\n' if case.fallback else "")
        path.write_text(path.read_text().replace('output = "logs"\n', where))
        command = [sys.executable, "-m", "acquire", "record", str(path)]
        recorder = stack.enter_context(Process(command))
        with GoodLink(port) as good:
            if case.fast:
                stack.enter_context(_flooding(fast))
            time.sleep(BEFORE_S)
            lines, early_mb = len(recorder.told), _memory_mb(recorder.process.pid)
            case.begin(folder, disk)
            begun_s, told_s, peak_mb, words = time.monotonic(), -1.0, 0.0, ""
            while (now := time.monotonic() - begun_s) < fault_s + after_s:
                if now >= fault_s and case.end is not nothing:
                    case.end(folder, disk)
                    case = Case(case.begin, nothing, case.fallback, case.fast)
                if told_s < 0 and len(recorder.told) > lines:
                    told_s, words = now, recorder.told[lines].strip()
                peak_mb = max(peak_mb, _memory_mb(recorder.process.pid))
                time.sleep(0.05)
        stopped_s = time.monotonic()
        recorder.end()
        stop_s = time.monotonic() - stopped_s
        # What the system holds of the disk does not count: the disk is looked at as at the next start.
        with after_the_cut(disk.content()) as found:
            # Where a card is pulled its folder is one of this computer.
            here = [] if folder.is_mount() else folder.rglob("*.mcap")
            counts = _frames([*found.rglob("*.mcap"), *here, *Path(name).rglob("*.mcap")])
        sent = {frame for _, frame in good.sent}
        return Outcome(
            len(sent),
            sum(frame not in counts for frame in sent),
            sum(count > 1 for count in counts.values()),
            sum(frame not in sent for frame in counts),
            told_s,
            re.sub(r"\S*/(?=\S+\.mcap)", "", words),
            peak_mb - early_mb,
            stop_s,
            recorder.process.returncode,
        )


def _frames(logs: list[Path]) -> Counter[bytes]:
    counts: Counter[bytes] = Counter()
    with tempfile.TemporaryDirectory() as name:
        for number, log in enumerate(logs):
            fixed = Path(name) / f"{number}.mcap"
            with contextlib.suppress(InputMalformedError, OSError):
                recover(log, fixed)
                counts.update(frame for _, frame in raw_frames(fixed, "good"))
    return counts


@contextlib.contextmanager
def _flooding(port: int) -> Iterator[None]:
    """Send 1.5 MB/s of frames that cannot be packed."""
    from tests.evidence.kill import FRAME_BYTES, numbered

    ended = threading.Event()

    def send() -> None:
        import socket

        frames = [numbered(number) for number in range(400)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            while not ended.wait(0.02):
                for frame in frames[: round(1.5e6 * 0.02 / FRAME_BYTES)]:
                    line.sendto(frame, ("127.0.0.1", port))

    until(lambda: is_bound(port), "the fast port")
    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    try:
        yield
    finally:
        ended.set()
        sender.join()


def _memory_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6
    except (OSError, IndexError):
        return 0.0


def main() -> None:
    """Run the study and write its table."""
    if reason := forbidden():
        sys.stderr.write(f"this machine does not let it run: {reason}; the table stays as it is\n")
        return
    rows = []
    for name, case in CASES.items():
        o = outcome_of(case)
        told = f"{o.told_s:.1f}" if o.told_s >= 0 else "none"
        rows.append(
            f"| {name} | {o.sent} | {o.lost} | {o.twice} | {o.wrong} | {told} | {o.memory_mb:.0f} | "
            f"{o.stop_s:.1f} | {o.code} | {o.words[:90]} |"
        )
        sys.stderr.write(rows[-1] + "\n")
    lines = [
        "# What full, failing, slow and pulled disks do to a recording",
        "",
        "A recorder with a link of 100 frames a second writes to ext4 on a disk with faults. A fault",
        f"begins after 3 s; where it is temporary, it ends {FAULT_S:g} s later. Required: nothing lost",
        "that can be written somewhere, nothing twice, no damage to what was recorded before, an immediate",
        "alarm, bounded memory. The slow disk has a second link of 1.5 MB/s. Logs are read after",
        "`acquire recover`, as they are on the disk at the next start. This kernel has no quotas: EDQUOT",
        "is raised by a layer in `tests/acquire/recording/test_record_disks.py`.",
        "",
        COLUMNS,
        "|---|---|---|---|---|---|---|---|---|---|",
        *rows,
        "",
        "Without a second folder, nothing can be written to a disk that fails until the end. The loss is",
        "reported (exit code 8), and what was on the disk before remains. A stop waits for a slow disk.",
        "",
        "Made by `python -m tests.evidence.failing_media`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
