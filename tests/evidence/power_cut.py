"""Study: what does a recording lose when the power is cut?

Writes `docs/evidence/power_cut.md`. A recorder writes to a real file system on a disk that keeps what was
flushed and, of the rest, any part in any order (`tests.acquire.forgetful_disk`). At random moments the
picture of the disk is taken, mounted as after a start of the computer, and its logs are read as they are.

Run: `make evidence`, or `python -m tests.evidence.power_cut [RECORDINGS]`.
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.importing.recovery import recover
from acquire.log.replay import raw_frames
from photocal.base.errors import InputMalformedError
from tests.acquire.forgetful_disk import after_the_cut, disk_mounted, forbidden
from tests.acquire.live import Process
from tests.acquire.recording.undisturbed import GoodLink, configured

RECORDINGS, CUTS = 20, 10
DISK_MB = 24
COLUMNS = (
    "| file system | cuts | frames kept | more by `recover` | lost, median s | 95 % | worst | above 1 s "
    "| logs that need `recover` | named files missing | wrong frames |"
)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "power_cut.md"


@dataclass(frozen=True)
class Cut:
    """A cut: what is kept as it is and by recovery, and the age of the oldest frame that is in no log, s.

    told: logs that the recorder had named a second before, missing: those of them that are not there.
    refused: logs that could not be read to their end without recovery.
    """

    kept: int
    recovered: int
    lost_s: float
    told: int
    missing: int
    refused: int
    wrong: int


def cuts_of_recording(seed: int, kind: str, cuts: int = CUTS) -> list[Cut]:
    """Record, take pictures of the disk at random moments and look at what is in them."""
    chance = random.Random(seed)  # noqa: S311 - no secrets
    pictures = []
    with tempfile.TemporaryDirectory() as name, disk_mounted(DISK_MB, kind) as (folder, disk):
        path, port = configured(Path(name))
        text = path.read_text().replace('output = "logs"', f'output = "{folder}/logs"\nrotate_min = 0.05')
        path.write_text(text)
        command = [sys.executable, "-m", "acquire", "record", str(path)]
        with Process(command) as recorder, GoodLink(port) as good:
            named: list[tuple[float, int]] = []
            for _ in range(cuts):
                named.append((time.monotonic(), _files(recorder.told)))
                time.sleep(chance.uniform(0.05, 1.2))
                now_s, sent = time.monotonic(), len(good.sent)
                files = max((count for named_s, count in named if named_s < now_s - 1), default=0)
                pictures.append((disk.cut(chance), sent, files, now_s))
            recorder.end()
        told = [line for line in recorder.told if "recording to " in line]
        return [
            _looked_at(picture, kind, good.sent[:sent], told[:files], now_s)
            for picture, sent, files, now_s in pictures
        ]


def _files(told: list[str]) -> int:
    return sum("recording to " in line for line in told)


def _looked_at(
    picture: bytes, kind: str, sent: list[tuple[float, bytes]], told: list[str], now_s: float
) -> Cut:
    kept: set[bytes] = set()
    recovered: set[bytes] = set()
    refused = 0
    with after_the_cut(picture, kind) as folder, tempfile.TemporaryDirectory() as name:
        logs = sorted((folder / "logs").glob("*.mcap")) if (folder / "logs").is_dir() else []
        for log in logs:
            try:
                for _, frame in raw_frames(log, "good"):
                    kept.add(frame)
            except InputMalformedError:
                # One that was only just made is empty.
                refused += log.stat().st_size > 0
            fixed = Path(name) / log.name
            try:
                recover(log, fixed)
                recovered |= {frame for _, frame in raw_frames(fixed, "good")}
            except InputMalformedError:
                pass
        names = {Path(line.split("recording to ")[1].strip()).name for line in told}
        missing = names - {log.name for log in logs}
    lost = [sent_s for sent_s, frame in sent if frame not in kept]
    wrong = len((kept | recovered) - {frame for _, frame in sent})
    lost_s = now_s - lost[0] if lost else 0.0
    return Cut(len(kept), len(recovered), lost_s, len(names), len(missing), refused, wrong)


@dataclass(frozen=True)
class Wear:
    """What a flush period costs: flushes and bytes a second of the disk, for so many bytes of frames."""

    flush_s: float
    flushes: float
    bytes_s: float
    frames_s: float


def wear_of(flush_s: float, for_s: float = 12.0) -> Wear:
    """Record for a while and count what the disk is given."""
    with tempfile.TemporaryDirectory() as name, disk_mounted(DISK_MB) as (folder, disk):
        path, port = configured(Path(name))
        text = path.read_text().replace('output = "logs"', f'output = "{folder}/logs"\nflush_s = {flush_s}')
        path.write_text(text)
        command = [sys.executable, "-m", "acquire", "record", str(path)]
        with Process(command) as recorder, GoodLink(port) as good:
            time.sleep(2.0)
            before = disk.written, disk.flushed, len(good.sent), time.monotonic()
            time.sleep(for_s)
            took_s = time.monotonic() - before[3]
            wear = Wear(
                flush_s,
                (disk.flushed - before[1]) / took_s,
                (disk.written - before[0]) / took_s,
                sum(len(frame) for _, frame in good.sent[before[2] :]) / took_s,
            )
            recorder.end()
    return wear


def rows_of(kind: str, cuts: list[Cut]) -> Iterator[str]:
    """Give the row of a file system."""
    lost = np.array([cut.lost_s for cut in cuts])
    yield (
        f"| {kind} | {len(cuts)} | {sum(c.kept for c in cuts)} | {sum(c.recovered - c.kept for c in cuts)} | "
        f"{np.median(lost):.2f} | {np.quantile(lost, 0.95):.2f} | {lost.max():.2f} | "
        f"{int((lost > 1).sum())} | "
        f"{sum(c.refused for c in cuts)} | {sum(c.missing for c in cuts)} of {sum(c.told for c in cuts)} | "
        f"{sum(c.wrong for c in cuts)} |"
    )


def main() -> None:
    """Run the study and write its table."""
    recordings = int(sys.argv[1]) if len(sys.argv) > 1 else RECORDINGS
    if reason := forbidden():
        sys.stderr.write(f"this machine does not let it run: {reason}; the table stays as it is\n")
        return
    results: dict[str, list[Cut]] = {"ext4": [], "ext2": []}
    for kind, share in (("ext4", recordings), ("ext2", max(1, recordings // 4))):
        for seed in range(share):
            results[kind] += cuts_of_recording(seed, kind)
            worst = max(cut.lost_s for cut in results[kind])
            sys.stderr.write(f"{kind}: {len(results[kind])} cuts, worst {worst:.2f} s\n")
    wear = [wear_of(flush_s) for flush_s in (0.2, 0.5, 1.0)]
    kernel = subprocess.run(["uname", "-sr"], check=True, capture_output=True, text=True).stdout.strip()
    lines = [
        "# What a power cut costs a recording",
        "",
        "A recorder with one link of 100 frames a second writes to a real file system on a simulated disk,",
        "a new file every 3 s. The disk keeps what was flushed. Of what was written since, a power cut",
        "keeps any part, in any order, with single writes torn between sectors. At random moments the disk",
        "is copied in this state and mounted as at the next start (ext4 by its journal, ext2 after",
        "`e2fsck -fy`). The logs are then read as they are, without `acquire recover`. Lost: the age at",
        "the cut of the oldest frame that is in no log; required is at most 1 s. A file created a second",
        f"before the cut must exist. ({kernel}; this kernel has no device mapper, FAT or exFAT.)",
        "",
        COLUMNS,
        "|---|---|---|---|---|---|---|---|---|---|---|",
        *(row for kind, cuts in results.items() for row in rows_of(kind, cuts)),
        "",
        "## What the flushes cost",
        "",
        "The same recording on ext4, without cuts: what arrives at the disk, with journal and inodes.",
        "",
        "| `flush_s` | frames, kB/s | flushes a second | written to the disk, kB/s | in 8 hours, MB |",
        "|---|---|---|---|---|",
        *(
            f"| {w.flush_s:g} | {w.frames_s / 1e3:.1f} | {w.flushes:.1f} | {w.bytes_s / 1e3:.0f} "
            f"| {w.bytes_s * 8 * 3600 / 1e6:.0f} |"
            for w in wear
        ),
        "",
        "Made by `python -m tests.evidence.power_cut`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
