"""A request to stop arrives at any time, also while the event that tells of it is being waited for."""

from __future__ import annotations

import subprocess
import sys

# Standard library: a wait for an event runs some 40 lines of its own; the signal arrives at each in turn.
AT_EACH_LINE = """
import signal, sys, threading
from photocal.base.operating_system import stopped_by_signals

def waited(line):
    stop, passed = stopped_by_signals(), 0

    def traced(frame, event, _):
        nonlocal passed
        if frame.f_code.co_filename != threading.__file__:
            return None
        if event == "line":
            passed += 1
            if passed == line:
                sys.settrace(None)
                signal.raise_signal(signal.SIGINT)
        return traced

    sys.settrace(traced)
    stop.wait(0.001)
    sys.settrace(None)
    if passed >= line:
        while not stop.wait(0.01):
            pass
    return passed

print(next(line - 1 for line in range(1, 500) if waited(line) < line))
"""


def test_a_signal_at_any_line_of_a_wait_stops_it() -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_EACH_LINE], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 10
