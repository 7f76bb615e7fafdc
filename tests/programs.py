"""Both programs, run as a person runs them, but in this process: that is quicker than one of their own."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

from acquire.commands.cli import main as acquire_main
from photocal.commands.cli import main as photocal_main

PROGRAMS = {"acquire": acquire_main, "photocal": photocal_main}


def called(program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a program with arguments.

    Tests that kill or stop it, or look at what it imports, start processes of their own.
    """
    out, err, code = io.StringIO(), io.StringIO(), 0
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    given, sys.argv = sys.argv, [program, *map(str, arguments)]
    environment = dict(os.environ)
    try:
        with redirect_stdout(out), redirect_stderr(err):
            PROGRAMS[program]()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        sys.argv = given
        os.environ.clear()
        os.environ.update(environment)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return subprocess.CompletedProcess(sys.argv, code, out.getvalue(), err.getvalue())
