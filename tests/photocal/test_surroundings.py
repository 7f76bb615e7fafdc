"""The same block on a computer that is set up otherwise: the same result, the same words."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

DEMO = Path(__file__).resolve().parents[2] / "photocal" / "demo" / "dcs460"
HOMELESS = ("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME")


def certified(folder: Path, umask: int, **set_up: str | None) -> str:
    """Adjust and certify in a folder; what was printed. None takes a variable away."""
    changed = os.environ | {name: value for name, value in set_up.items() if value is not None}
    environment = {name: value for name, value in changed.items() if set_up.get(name, "") is not None}
    folder.mkdir(parents=True)
    said = ""
    for command in (
        ("adjust", DEMO, "-o", "run", "--json"),
        ("certificate", "run", "-o", "certificate", "--block", DEMO, "--date", "2026-11-21"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "photocal", *map(str, command)],
            cwd=folder,
            env=environment,
            umask=umask,
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        said = done.stdout.decode()
    return said


def figures(folder: Path) -> dict[str, Any]:
    """What a result holds."""
    result: dict[str, Any] = json.loads((folder / "run" / "result.json").read_text(encoding="utf-8"))
    return result


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has neither HOME nor a mask of modes")
def test_locale_time_zone_mask_and_home_change_nothing(tmp_path: Path) -> None:
    here = certified(tmp_path / "here", 0o022)
    elsewhere = certified(
        tmp_path / "São Tomé (2)",
        0o077,
        **dict.fromkeys(HOMELESS, None),
        LC_ALL="tr_TR.ISO-8859-9",
        LANG=None,
        PYTHONUTF8="0",
        PYTHONCOERCECLOCALE="0",
        TZ="Pacific/Kiritimati",
    )
    assert elsewhere == here
    assert figures(tmp_path / "São Tomé (2)") == figures(tmp_path / "here")
    for path in (tmp_path / "here" / "run").iterdir():
        if path.name != "result.json":
            assert (tmp_path / "São Tomé (2)" / "run" / path.name).read_bytes() == path.read_bytes(), (
                path.name
            )
