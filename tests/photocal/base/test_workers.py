"""Processes that work for a script: they end with it, also when it is killed, and do not run it again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

WORK = """
import os
import time


def number(_):
    time.sleep(0.5)
    return os.getpid()
"""
# It tells the numbers of its workers, which then wait for more. As in most scripts, nothing in it keeps them
# from running it again.
SCRIPT = """
import time
from photocal.base.workers import one_crew, run_tasks
from work import number

with one_crew():
    print(*set(run_tasks(number, range(4), 2)), flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads the processes of Linux")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_the_process_that_is_killed(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "work.py").write_text(WORK)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        workers = [int(number) for number in process.stdout.readline().split()]
        assert workers
        assert all(_alive(number) for number in workers)
        os.kill(process.pid, how)
    until = time.monotonic() + 20.0
    while time.monotonic() < until and any(_alive(number) for number in workers):
        time.sleep(0.05)
    assert not any(_alive(number) for number in workers)


def _alive(number: int) -> bool:
    """Whether a process is there, and has not ended without anybody asking how."""
    try:
        status = Path(f"/proc/{number}/stat").read_text(encoding="ascii")
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"
