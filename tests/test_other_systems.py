"""Everything is imported, adjusted and certified where what only POSIX systems have is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow

# Packages of others choose by the system that they are on: they are loaded first. Then the modules and
# functions go, and the one module of ours that looks at the system is told that it is on Windows.
_SCRIPT = """
import signal, subprocess, sys, types
import cv2, matplotlib.pyplot, numba, pydantic, rasterio, scipy.optimize, serial
import starlette, typer, typst, uvicorn
import concurrent.futures.process, multiprocessing, cryptography.hazmat.primitives.serialization
import foxglove_schemas_protobuf, pymavlink, pyubx2, distributed, google.protobuf.descriptor_pb2
import os
for name in ("fcntl", "termios", "pwd", "tty", "grp", "resource"):
    sys.modules[name] = None
for name in ("getuid", "fork", "openpty", "ttyname", "O_NOCTTY"):
    if hasattr(os, name):
        delattr(os, name)
locked = []
sys.modules["msvcrt"] = types.SimpleNamespace(LK_NBLCK=2, locking=lambda *a: locked.append(a))
subprocess.CREATE_NEW_PROCESS_GROUP = 0
signal.CTRL_BREAK_EVENT, signal.SIGBREAK = signal.SIGINT, signal.SIGTERM
sys.platform = "win32"
import photocal.base.operating_system
sys.platform = "linux"
import importlib
from tests.docs.rooms import modules
for name in modules():
    if not name.endswith("__main__"):
        importlib.import_module(name)
from pathlib import Path
from photocal.commands.cli import app
from typer.testing import CliRunner
def call(*words):
    answer = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    return answer.output
folder, block = Path(sys.argv[1]), Path("photocal/demo/dcs460").resolve()
call("adjust", block, "-o", folder / "run")
call("certificate", folder / "run", "-o", folder / "certificate", "--block", block)
call("keys", "--new", "Laboratory")
call("sign", folder / "certificate")
assert locked
print(call("verify", folder / "certificate"))
# Afterwards: a verification repeats what was certified, and the analysis with it.
call("analyse", folder / "run", "--block", block)
"""


def test_it_runs_without_what_only_posix_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r'^authentic: signed with the key .* by "Laboratory"', done.stdout, re.MULTILINE)
