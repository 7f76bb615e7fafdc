"""The table of trust: what was tested how, what was asked and what was seen, from the pages of the studies.

Writes `docs/evidence/trust.md`. It measures nothing itself: figures are taken from the pages as they are, and
a page without the figure is an error. What tests of the suite hold is named with its test.

Run: `make evidence`, or `python -m tests.evidence.trust`.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

from tests.evidence.failing_media import CASES

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "evidence"


@dataclass(frozen=True)
class Row:
    """What was tested: its part of the whole, how, what was asked, and the page or test with what was seen.

    row, cells: how a row of the page's tables begins, and which of its cells are named.
    words: with a place for each cell; without a page, what the test holds.
    """

    part: str
    test: str
    how: str
    asked: str
    source: str
    words: str
    row: str = ""
    cells: tuple[int, ...] = ()

    def seen(self) -> str:
        """Give what was seen, with its source."""
        if not self.source.endswith(".md"):
            if not (ROOT / self.source).is_file():
                raise SystemExit(f"{self.source} is gone: tests.evidence.trust names it")
            return f"{self.words} (`{self.source}`)"
        page = (PAGES / self.source).read_text(encoding="utf-8")
        found = re.search(rf"^\| *{re.escape(self.row)}.*$", page, re.MULTILINE)
        if found is None:
            raise SystemExit(f"{self.source} has no row {self.row!r}: make its study first")
        cells = [cell.strip() for cell in found.group(0).strip().strip("|").split("|")]
        return f"{self.words.format(*(cells[cell] for cell in self.cells))} ([table]({self.source}))"


# Lines of `ppk_fixes.md` that tempt an engine to fix wrongly.
TRAPS = (
    "two frequencies, strong multipath and weak signals",
    "one frequency, a slip every minute",
    "one frequency, strong multipath, each signal slips every 10 s",
    "one frequency, between houses",
)
_RECORDING = "tests/acquire/recording/"
ROWS = (
    Row("0", "helper threads frozen, slowed, failing, killed", "200 times at random", "no due frame lost",
        f"{_RECORDING}test_helpers_at_random.py", "0 lost"),
    Row("0", "paused terminals, full and closed pipes, deaf devices", "real terminals, pipes, ports",
        "no due frame lost", f"{_RECORDING}test_undisturbed.py", "held"),
    Row("0", "the same terminals and pipes at a stop", "the same, two signals", "a stop within 0.5 s",
        f"{_RECORDING}test_outputs.py", "held"),
    Row("0", "the same at a hang-up", "the same, SIGHUP", "a stop within 0.5 s, none for nohup",
        f"{_RECORDING}test_hang_ups.py", "held"),
    Row("0", "a deleted, moved or replaced log", "while it is written", "no due frame lost",
        f"{_RECORDING}test_deleted_logs.py", "held"),
    Row("0", "foreign programs at the ports", "real ports", "no due frame lost",
        f"{_RECORDING}test_strangers.py", "held"),
    Row("0", "the process is killed", "SIGKILL at random moments", "at most 1 s lost", "kill.md",
        "worst {}", "worst", (1,)),
    Row("1", "power cuts, ext4", "a block device that forgets what was not flushed, in any order",
        "at most 1 s lost, no file missing", "power_cut.md", "{} cuts, worst {} s, files missing {}", "ext4",
        (1, 6, 9)),
    Row("1", "power cuts, ext2 (no journal)", "the same, after `e2fsck`", "the same", "power_cut.md",
        "{} cuts, worst {} s, files missing {}, {} logs needed `recover`", "ext2", (1, 6, 9, 8)),
    Row("1", "wear at `flush_s = 0.5`", "bytes that reach that device", "stated", "power_cut.md",
        "{} flushes a second, {} MB in 8 hours", "0.5", (2, 4)),
    *(
        Row("2", f"a disk: {name}", "the same device with faults",
            "nothing lost that can be written" if "stopped so" not in name else "what is lost is named",
            "failing_media.md", "{} of {} lost, alarm after {} s, exit code {}", name, (2, 1, 5, 8))
        for name in CASES
    ),
    Row("2", "quota, and the errors of each kind", "a layer that raises them", "nothing lost",
        f"{_RECORDING}test_record_disks.py", "0 lost"),
    Row("2", "all places full, memory full", "a layer with little room",
        "camera events and raw GNSS kept longest", f"{_RECORDING}test_record_disks.py", "in that order"),
    Row("3", "links come and go", "minutes instead of a day", "500 times, nothing lost", "long_day.md",
        "{} times", "connections of the link that closes", (1,)),
    Row("3", "a good link, bad casters and a clock that is set, at the same time", "the same", "nothing lost",
        "long_day.md", "sent, lost: {}", "frames of the good link", (1,)),
    Row("3", "memory, MB", "the same, in each quarter", "flat", "long_day.md", "{}",
        "memory in each quarter", (1,)),
    Row("3", "descriptors", "the same, in each quarter", "flat", "long_day.md", "{}",
        "descriptors in each quarter", (1,)),
    Row("3", "24 hours of flight", "20 times as fast", "nothing lost", "long-flight.md",
        "{} frames of the vehicle, {} missing", "vehicle", (1, 3)),
    Row("3", "the same: memory", "the same, in each quarter", "flat", "long-flight.md", "{}",
        "memory in each quarter", (1,)),
    Row("3", "the same: descriptors", "the same, in each quarter", "flat", "long-flight.md", "{}",
        "descriptors in each quarter", (1,)),
    Row("4", "`ulimit -n 64`, 512 MiB, one core, 20 times the load", "a memory group and a mask",
        "camera events never dropped", "neighbours.md", "{} events sent, {} lost", "camera", (1, 2)),
    Row("5", "500 half-open connections", "a process of its own", "no due frame lost", "neighbours.md",
        "{} lost, 99 % within {} ms", "Open 500", (2, 4)),
    Row("5", "readers that read nothing", "the same", "no due frame lost", "neighbours.md",
        "{} lost, 99 % within {} ms", "Ask for the feed", (2, 4)),
    Row("5", "a flood over the WebSocket", "the same", "no due frame lost", "neighbours.md",
        "{} lost, 99 % within {} ms", "Send masked", (2, 4)),
    Row("5", "bodies without an end", "the same", "no due frame lost", "neighbours.md",
        "{} lost, 99 % within {} ms", "Send bodies", (2, 4)),
    Row("5", "foreign hosts, origins, paths", "the same", "no due frame lost", "neighbours.md",
        "{} lost, 99 % within {} ms", "Ask as fast", (2, 4)),
    Row("5", "floods and hanging ports", "1000 recordings", "a stop within 2 s", "flood.md", "worst {}",
        "worst", (1,)),
    Row("6", "damaged tables", "bits, bytes, words, nesting",
        "read or refused in words, within 1 GB; none uncaught", "fuzz_readers.md",
        "{} cases by {} readers, {} of them refused", "tables", (2, 1, 3)),
    Row("6", "damaged logs (MCAP)", "the same", "the same", "fuzz_readers.md",
        "{} cases by {} readers, {} of them refused", "MCAP", (2, 1, 3)),
    Row("6", "damaged pictures", "the same", "the same", "fuzz_readers.md",
        "{} cases by {} readers, {} of them refused", "images", (2, 1, 3)),
    Row("6", "damaged archives and XML", "the same", "the same", "fuzz_readers.md",
        "{} cases by {} readers of archives, {} of them refused", "archives", (2, 1, 3)),
    Row("7", "random edits and kills between runs", "a run against one from nothing", "the same files",
        "stages.md", "{0} of {0} sequences right", "500", (1,)),
    Row("7", "two runs in one folder; the lock of a killed one", "a lock with process and computer",
        "the second is refused, a stale lock is ignored", "tests/photocal/run/test_stage.py", "held"),
    Row("8", "forged, changed, revoked, doubled keys", "tampered folders", "refused in a line",
        "tests/photocal/report/test_forgery.py", "held"),
    Row("8", "keys that others can read, names of keys", "files and names", "refused",
        "tests/photocal/report/test_keys.py", "held"),
    Row("8", "expired keys", "a clock past the last day, with and without a time stamp",
        "not authentic without the stamp", "tests/photocal/report/test_timestamp.py", "held"),
    Row("8", "time stamps (RFC 3161)", "tokens, kept and verified offline", "verified or refused",
        "tests/photocal/report/test_timestamp.py", "held"),
    Row("9", "an unprotected scheduler on another computer", "addresses", "refused without a word",
        "tests/photocal/base/test_cluster.py", "held"),
    Row("10", "packages, licences, bill of materials", "`make audit`", "all", "supply_chain.md",
        "{}", "packages locked with hashes", (2,)),
    Row("10", "two builds of the wheel", "`make audit`", "one hash", "supply_chain.md", "{}",
        "two builds of the wheel", (2,)),
    Row("11", "PPK of a moving receiver, one frequency", "a recording beside the receiver's own fixes",
        "700 of 1881 epochs fixed, none off by 0.1 m", "tests/photocal/navigation/test_ppk_figures.py",
        "held"),
    Row("11", "sigmas of epochs that are not fixed", "two such recordings",
        "below 2 (rms of error/sigma), each axis",
        "tests/photocal/navigation/test_ppk_figures.py", "held"),
    *(
        Row("11", f"fixes: {case}", "5 simulated flights of known truth", "none off by 0.1 m", "ppk_fixes.md",
            "{} of {} epochs fixed, {} of these wrong", f"{case} |", (4, 1, 5))
        for case in TRAPS
    ),
)  # fmt: skip
FORBIDDEN = (
    "The device mapper (`dm-flakey`, `dm-log-writes`) is not in the kernel on which this was made. Instead",
    "the study serves the file of a loop device over FUSE and sees each write and flush of the device. FAT",
    "and exFAT, which most cards have, are not in that kernel either; ext2 represents a file system",
    "without a journal. Quotas are not in that kernel; their error is raised by a layer. The system",
    "refuses a remount to read-only while a recorder has a file open: the file system is aborted instead,",
    "as it does by itself after an error. A card's own cache, its erase blocks and its power consumption",
    "cannot be observed here. A whole day was not run.",
)


def main() -> None:
    """Write the table."""
    lines = [
        "# Trust: attempts to lose or forge a recording and its results",
        "",
        "What was tested, how, what was required and what was seen. The linked pages have all figures and",
        "say how to make them again. `make evidence` makes all of them; `make test` and `make slow` run",
        "small versions.",
        "",
        "| part | test | how | required | seen |",
        "|---|---|---|---|---|",
        *(f"| {r.part} | {r.test} | {r.how} | {r.asked} | {r.seen()} |" for r in ROWS),
        "",
        "Parts: 0 what stops or stalls a recorder, 1 power cuts, 2 disks, 3 long days, 4 scarce resources,",
        "5 pages and sockets, 6 foreign files, 7 stages, 8 certificates, 9 clusters, 10 supply chain, 11",
        "fixes and sigmas of PPK.",
        "",
        "## What could not be tested, and the substitute",
        "",
        *FORBIDDEN,
        "",
        "To run the damaged files for an hour: `python -m tests.evidence.fuzz_readers 42 1 NEW.json` gives",
        "each reader 42 s of processor time; each other portion number gives other damage.",
        "",
        "Made by `python -m tests.evidence.trust`.",
        "",
    ]
    (PAGES / "trust.md").write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write("\n".join(lines))


if __name__ == "__main__":
    main()
