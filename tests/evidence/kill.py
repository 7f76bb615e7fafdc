"""Study: what does a recording lose when its process is killed?

Writes `docs/evidence/kill.md`. Recorders, each a process of its own with one UDP link, get 20 kB/s and are
killed (SIGKILL) at random moments; `acquire recover` repairs what they left. Frames carry their number; a
frame is lost when it was sent before the kill and is not in the repaired log.

Run: `make evidence`, or `python -m tests.evidence.kill [KILLS]`.
"""

from __future__ import annotations

import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from acquire.importing.recovery import recover
from drivers import ubx
from photocal.base.errors import InputMalformedError

KILLS = 200
AT_ONCE = 4
FRAME_BYTES, EVERY_S = 200, 0.01
LONGEST_S = 4.0
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "kill.md"


@dataclass(frozen=True)
class Killed:
    """One recording: frames sent and kept, age of the oldest lost frame at the kill, what recovery gave."""

    sent: int
    kept: int
    lost_s: float
    opens: bool
    wrong: bool = False


def numbered(number: int) -> bytes:
    """Return a frame of `FRAME_BYTES` with a number and bytes that follow from it."""
    content = random.Random(number).randbytes(FRAME_BYTES - 12)  # noqa: S311 - no secrets
    return ubx.encode(0x0213, number.to_bytes(4, "little") + content)


def kill_one(seed: int) -> Killed:
    """Record, kill at a random moment, repair, compare."""
    chance = random.Random(seed)  # noqa: S311 - no secrets
    with tempfile.TemporaryDirectory() as name, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        folder = Path(name)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        (folder / "flight.toml").write_text(
            '[recording]\noutput = "logs"\n[[link]]\nname = "rover"\nprotocol = "ubx"\n'
            f'url = "udp://127.0.0.1:{port}"\n'
        )
        sender.connect(("127.0.0.1", port))
        command = [sys.executable, "-m", "acquire", "record", str(folder / "flight.toml")]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as recorder:
            assert recorder.stderr is not None
            path = Path(recorder.stderr.readline().removeprefix("recording to ").strip())
            _wait_until_bound(sender)
            sent = _send(sender, chance.uniform(0.05, LONGEST_S))
            killed = time.monotonic()
            recorder.kill()
        return _compared(path, folder / "fixed.mcap", sent, killed)


def _wait_until_bound(sender: socket.socket) -> None:
    while True:
        try:
            sender.send(b"")
            time.sleep(0.02)
            sender.send(b"")
        except ConnectionRefusedError:
            continue
        return


def _send(sender: socket.socket, for_s: float) -> list[tuple[float, bytes]]:
    sent: list[tuple[float, bytes]] = []
    begin = time.monotonic()
    while (now := time.monotonic()) < begin + for_s:
        frame = numbered(len(sent))
        sender.send(frame)
        sent.append((now, frame))
        time.sleep(max(0.0, begin + len(sent) * EVERY_S - time.monotonic()))
    return sent


def _compared(path: Path, fixed: Path, sent: list[tuple[float, bytes]], killed: float) -> Killed:
    try:
        recover(path, fixed)
    except InputMalformedError:
        # Nothing was in the file yet: that is right while less than a second was recorded.
        return Killed(len(sent), 0, killed - sent[0][0], opens=False)
    kept = list(_raw(fixed))
    lost_s = killed - sent[len(kept)][0] if len(kept) < len(sent) else 0.0
    wrong = kept != [frame for _, frame in sent[: len(kept)]]
    return Killed(len(sent), len(kept), lost_s, opens=True, wrong=wrong)


def _raw(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(topics=["/rover/raw"])
        numbers = sorted((message.sequence, message.data) for _, _, message in found)
    yield from (data for _, data in numbers)


def main() -> None:
    """Run the study and write its table."""
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else KILLS
    with ThreadPoolExecutor(AT_ONCE) as pool:
        results = []
        for result in pool.map(kill_one, range(kills)):
            results.append(result)
            if len(results) % 20 == 0:
                sys.stderr.write(f"{len(results)} kills, worst {max(r.lost_s for r in results):.2f} s\n")
    lost = np.array([result.lost_s for result in results])
    rows = {
        "recordings killed": f"{kills}",
        "open after `acquire recover`": f"{sum(r.opens for r in results)}",
        "killed before anything was written": f"{sum(not r.opens for r in results)}",
        "frames sent": f"{sum(r.sent for r in results)}",
        "frames kept": f"{sum(r.kept for r in results)}",
        "recordings with a byte that differs in what is kept": f"{sum(r.wrong for r in results)}",
        "median of what is lost": f"{np.median(lost):.2f} s",
        "95 %": f"{np.quantile(lost, 0.95):.2f} s",
        "worst": f"{lost.max():.2f} s",
        "recordings that lost more than 1 s": f"{int((lost > 1).sum())}",
    }
    lines = [
        "# What a killed recording loses",
        "",
        f"Recorders with one UDP link at 20 kB/s, {AT_ONCE} at a time, each killed (SIGKILL) after a",
        f"random time of up to {LONGEST_S:g} s. Required: at most 1 s lost, the rest identical byte for",
        "byte, all files readable. Lost: the age, at the kill, of the oldest frame that is not in the",
        "repaired log. The recorder flushes its file to the disk every 0.5 s (`flush_s`).",
        "",
        "| | |",
        "|---|---|",
        *(f"| {what} | {figure} |" for what, figure in rows.items()),
        "",
        "Made by `python -m tests.evidence.kill`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
