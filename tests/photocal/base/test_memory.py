"""How much memory there is, and how many processes it bears, also under a limit as `ulimit -v` sets it."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from photocal.base import workers
from photocal.base.workers import affordable

GIB = 1 << 30
# Features of pictures by as many processes as there is memory for.
DETECTED = """
import sys
from pathlib import Path
from photocal.base.operating_system import available_memory
from photocal.base.progress import quiet
from photocal.measurement.match_images import MatchingPlan, detect_all

if __name__ == "__main__":
    plan = MatchingPlan(Path(sys.argv[1]))
    assert 0 < available_memory() < 4 << 30, available_memory()
    keys, reasons = detect_all([Path(path) for path in sys.argv[2:]], plan, quiet)
    print(plan.processes, len(keys), set(reasons))
"""

# Pages that the system has to give for an array where one as large was before.
KEPT = """
import resource
import numpy as np
from photocal.base.operating_system import keep_memory

keep_memory()
np.ones(1 << 25)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
np.ones(1 << 25)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""

# Resident memory with 400 MiB of small arrays, without them but for the last, and when that was given back.
LEFT = """
from pathlib import Path
import numpy as np
from photocal.base.operating_system import give_back_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

arrays = [np.ones(1 << 11) for _ in range(25_000)]
held = resident()
del arrays[:-1]
left = resident()
give_back_memory()
print(held, left, resident())
"""


@pytest.mark.skipif(sys.platform != "linux" or platform.libc_ver()[0] != "glibc", reason="another C library")
def test_memory_that_arrays_leave_goes_back_to_the_system() -> None:
    made = subprocess.run([sys.executable, "-c", LEFT], check=True, capture_output=True, text=True)
    held, left, given_back = map(int, made.stdout.split())
    assert left > 0.9 * held
    assert given_back < held - (300 << 20)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_memory_of_an_array_serves_the_next_one() -> None:
    made = subprocess.run([sys.executable, "-c", KEPT], check=True, capture_output=True, text=True)
    # It has 256 MiB: 128 large pages, or 65536 small ones.
    assert int(made.stdout) < 32


@pytest.mark.skipif(sys.platform != "linux", reason="control groups are those of Linux")
@pytest.mark.parametrize("first", [False, True])
def test_memory_that_control_groups_leave(tmp_path: Path, first: bool) -> None:
    """Of both versions: the group of this process, those that it is in, and the container's own."""
    from photocal.base.operating_system import _of_groups

    base = tmp_path / "memory" if first else tmp_path
    names = ("limit_in_bytes", "usage_in_bytes") if first else ("max", "current")
    kinds = ("total_inactive", "total_active", "total_mapped") if first else ("inactive", "active", "")
    cached = [f"{kind}_file" if kind else "file_mapped" for kind in kinds]

    def group(path: str, limit: object, used: int, idle: int, busy: int = 0, mapped: int = 0) -> None:
        folder = base / path
        folder.mkdir(parents=True, exist_ok=True)
        for name, value in zip(names, (limit, used), strict=True):
            (folder / f"memory.{name}").write_text(f"{value}\n")
        parts = zip(cached, (idle, busy, mapped), strict=True)
        (folder / "memory.stat").write_text("".join(f"{name} {size}\n" for name, size in parts))

    told = tmp_path / "cgroup"
    told.write_text(f"9:name=systemd:/else\n{'4:cpu,memory' if first else '0:'}:/user/own\n")
    assert _of_groups(told, tmp_path) == sys.maxsize
    group("user/own", 9223372036854771712 if first else "max", 5, 0)
    group("user", 10 * GIB, 7 * GIB, GIB)
    assert _of_groups(told, tmp_path) == 4 * GIB
    group("user/own", 4 * GIB, 2 * GIB, GIB)
    assert _of_groups(told, tmp_path) == 3 * GIB
    group("", 3 * GIB, 2 * GIB, 0)
    assert _of_groups(told, tmp_path) == GIB
    # Files that are read often give way, too; those that programs run from do not.
    group("", 3 * GIB, 2 * GIB, GIB // 2, GIB // 2, GIB // 4)
    assert _of_groups(told, tmp_path) == 7 * GIB // 4
    group("", 3 * GIB, 5 * GIB, 0)
    assert _of_groups(told, tmp_path) == 0


def test_as_many_processes_as_the_memory_bears(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    for free, expected in ((2 * GIB, 1), (4 * GIB, 3), (64 * GIB, 8), (0, 1), (None, 8)):
        monkeypatch.setattr(workers, "available_memory", lambda free=free: free)
        assert affordable(GIB, GIB) == expected


@pytest.mark.shared
@pytest.mark.skipif(sys.platform != "linux", reason="addresses are limited and counted by Linux")
def test_pictures_within_four_gibibytes(shared: Path, tmp_path: Path) -> None:
    import resource

    pictures = sorted((shared / "data" / "flight-caliterra-twelve").glob("*.jpg"))[:2]
    script = tmp_path / "detected.py"
    script.write_text(DETECTED)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "cache"), *map(str, pictures)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 * GIB, 4 * GIB)),
    )
    assert done.returncode == 0, done.stderr[-2000:]
    processes, images, reasons = done.stdout.split(maxsplit=2)
    assert 1 <= int(processes) <= 3
    assert (images, reasons.strip()) == ("2", "{''}")
