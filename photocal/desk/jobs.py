"""Commands of the program as processes of their own: short ones are asked, long ones go on by themselves.

What the window does is done by the very commands that it shows. A long one writes into files of the project
(`.desk`): it outlives the window, and a window that is opened again finds it.
"""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from photocal.base.codec import kept_json
from photocal.base.errors import ConfigurationError
from photocal.base.files import write_file
from photocal.base.operating_system import CHILD_FLAGS

FOLDER = ".desk"
# The long ones, by name; one at a time works in the folder of a project.
RUN, DEBRIEF = "run", "debrief"
_PROGRAM = (sys.executable, "-P", "-m", "photocal")
_ERROR = re.compile("(?:error|erro): ")


def asked(arguments: Sequence[str | Path], environment: Mapping[str, str] | None = None) -> Any:
    """Run a short command and give its JSON; what it refuses is refused in its words.

    raises ConfigurationError: when it fails without an answer.
    """
    # Short commands answer within this time.
    patience_s = 600.0
    done = subprocess.run(  # noqa: S603
        [*_PROGRAM, *map(str, arguments), "--json"],
        capture_output=True,
        text=True,
        timeout=patience_s,
        stdin=subprocess.DEVNULL,
        env={**os.environ, **(environment or {})},
        check=False,
    )
    with contextlib.suppress(ValueError):
        return json.loads(done.stdout)
    raise ConfigurationError(error_of(done.stderr) or f"photocal {arguments[0]} failed ({done.returncode})")


def error_of(log: str) -> str:
    """Last error that a command has said."""
    lines = log.splitlines()
    last = [k for k, said in enumerate(lines) if _ERROR.match(said)][-1:]
    if last:
        details = [said.strip() for said in lines[last[0] + 1 :] if said.startswith("  ")]
        return "\n".join([_ERROR.sub("", lines[last[0]], count=1), *details])
    if "Traceback (most recent call last)" in log:
        return lines[-1]
    return ""


class Job:
    """A long command of a project: one at a time of each name."""

    def __init__(self, project: Path, name: str) -> None:
        self._folder, self._name = project / FOLDER, name
        self._process: subprocess.Popen[bytes] | None = None
        self._guard = threading.Lock()

    def start(self, arguments: Sequence[str | Path], line: str) -> None:
        """Begin it; raises ConfigurationError while it is at work.

        line: the same as a person types it.
        """
        with self._guard:
            if self._alive():
                raise ConfigurationError(
                    "is already running", "wait for its end, or stop it", where=self._name
                )
            self._folder.mkdir(exist_ok=True)
            command = [*_PROGRAM, *map(str, arguments), "--json"]
            with self._file("out").open("wb") as out, self._file("log").open("wb") as log:
                process = subprocess.Popen(  # noqa: S603
                    command,
                    stdout=out,
                    stderr=log,
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                    creationflags=CHILD_FLAGS,
                )
            self._process = process
            # It is waited for, whoever forgets it here.
            threading.Thread(target=process.wait, daemon=True).start()
            born = _born(process.pid)
            self._note({"pid": process.pid, "born": born, "began": time.time(), "line": line})

    def stop(self) -> None:
        """Ask it to end, with all that it has started; end it where it does not."""
        with self._guard:
            told = self._told()
            if not self._alive():
                return
            self._note({**told, "stopped": time.time()})
            # What is asked to stop may clean up so long.
            grace_s = 15.0
            for send in (_ask, _end):
                send(told["pid"])
                until = time.monotonic() + grace_s
                while self._alive() and time.monotonic() < until:
                    time.sleep(0.05)
                if not self._alive():
                    return

    def state(self) -> dict[str, Any]:
        """How it stands: none, busy, done, failed or stopped; with the error that it said."""
        told = self._told()
        if not told:
            return {"state": "none", "line": "", "error": "", "began": None}
        if self._alive():
            return {"state": "busy", "line": told["line"], "error": "", "began": told["began"]}
        error = error_of(self.log())
        # What was asked to stop may complain of it.
        failed = bool(error) and "stopped" not in told
        state = "failed" if failed else "done" if self.answer() is not None else "stopped"
        return {
            "state": state,
            "line": told["line"],
            "error": error if failed else "",
            "began": told["began"],
        }

    def answer(self) -> Any:
        """JSON that it has printed; None as long as there is none."""
        try:
            return json.loads(self._file("out").read_bytes())
        except (OSError, ValueError):
            return None

    def log(self) -> str:
        """What it has said, the last part of it; how far it was is no line of it."""
        path, longest_log = self._file("log"), 200_000
        said = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
        lines = [line for line in said.splitlines(keepends=True) if not line.startswith('{"progress"')]
        return "".join(lines)[-longest_log:]

    def _file(self, kind: str) -> Path:
        return self._folder / f"{self._name}.{kind}"

    def _told(self) -> dict[str, Any]:
        told = kept_json(self._file("json"))
        return told if {"pid", "began", "line"} <= told.keys() else {}

    def _note(self, told: Mapping[str, Any]) -> None:
        write_file(self._file("json"), json.dumps(told))

    def _alive(self) -> bool:
        if self._process is not None:
            return self._process.poll() is None
        told = self._told()
        # Its number may be that of another process by now: then it was born at another time.
        born = _born(told["pid"]) if told and isinstance(told["pid"], int) else ""
        return bool(born) and born == told.get("born")


def _born(pid: int) -> str:
    """When a process was born, in a word that no other with its number has; empty when there is none."""
    try:
        told = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return _there(pid)
    fields = told.rpartition(")")[2].split()
    # A process that has ended and that nobody has waited for is none any more.
    return "" if fields[0] in "ZX" else fields[19]


if sys.platform == "win32":

    def _there(_: int) -> str:
        """Say that it is not known: what another window has begun is taken for ended."""
        return ""

    def _ask(pid: int) -> None:
        """Ask a process and all that it has started to end."""
        with contextlib.suppress(OSError):
            os.kill(pid, signal.CTRL_BREAK_EVENT)

    def _end(pid: int) -> None:
        """End a process."""
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGTERM)

else:

    def _there(pid: int) -> str:
        """Whether a process is there, where the system does not tell more."""
        if Path("/proc/self/stat").exists():
            return ""
        try:
            os.kill(pid, 0)
        except OSError:
            return ""
        return "there"

    def _ask(pid: int) -> None:
        """Ask a process and all that it has started to end."""
        with contextlib.suppress(OSError):
            os.killpg(pid, signal.SIGINT)

    def _end(pid: int) -> None:
        """End a process and all that it has started."""
        with contextlib.suppress(OSError):
            os.killpg(pid, signal.SIGKILL)
