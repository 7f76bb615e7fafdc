"""A whole run of a simulated flight with pictures, stage by stage: seconds and peak memory.

PHOTOCAL_BENCH_PICTURES names about how many pictures there are (default "40"; "40 300"). Figures go to
.benchmarks/run.json.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from photocal.block.project import read_project
from photocal.run.campaign import stages
from tests.benchmarks.test_engine_speed import RESULTS, ROOT
from tests.processes import memory_mib

PICTURES = [int(size) for size in os.environ.get("PHOTOCAL_BENCH_PICTURES", "40").split()]
# Of the flight that is known as "survey", on 70 m by 67 m.
KNOWN = 42

pytestmark = pytest.mark.timeout(14400)


def photocal(compiled: Path, *arguments: str) -> tuple[float, float]:
    """Seconds by the clock and peak memory in MiB of a command and the largest of its processes.

    compiled: folder of what Python compiles: it is kept, as on a computer that has run the program before.
    """
    given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    given["PYTHONPYCACHEPREFIX"] = str(compiled)
    command = [sys.executable, "-m", "photocal", *arguments]
    began = time.perf_counter()
    process, peak = subprocess.Popen(command, cwd=ROOT, env=given, stdout=subprocess.DEVNULL), 0.0
    while process.poll() is None:
        peak = max([peak, *memory_mib(process.pid, "VmHWM")])
        time.sleep(0.1)
    assert process.returncode == 0, arguments
    return time.perf_counter() - began, peak


def fly(pictures: int, folder: Path) -> Path:
    """Simulate and import a flight over as much ground as so many pictures need."""
    from acquire.simulate.world.configuration import read_configuration
    from tests.simulated import FLIGHT, import_log, simulate

    plan = read_configuration(FLIGHT).plan
    wider = math.sqrt(pictures / KNOWN)
    corners = [(east * wider, north * wider) for east, north in plan.area_m]
    wide = plan.model_dump(by_alias=True, exclude_unset=True) | {"area_m": corners}
    site = simulate(folder, FLIGHT, plan=wide)
    import_log(site)
    return site / "project.toml"


@pytest.mark.parametrize("pictures", PICTURES)
def test_profile_of_a_run(
    pictures: int,
    tmp_path: Path,
    benchmark: Any,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Debrief, then every stage of the run, each as a process of its own."""
    path = fly(pictures, tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    compiled = tmp_path / "compiled"
    photocal(compiled, "run", "--help")
    figures = {"debrief": photocal(compiled, "debrief", str(path))}
    named = [stage.name for stage in stages(read_project(path), _day())]

    def whole() -> None:
        for name in named:
            figures[name] = photocal(compiled, "run", str(path), "--until", name)

    benchmark.pedantic(whole, rounds=1)
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / "run.json"
    known = json.loads(file.read_text()) if file.exists() else {}
    known[str(pictures)] = {name: {"seconds": s, "peak_mib": m} for name, (s, m) in figures.items()}
    file.write_text(json.dumps(known, indent=1) + "\n")
    with capsys.disabled():
        print(f"\n{pictures} pictures (with the start of each process)")
        for name, (seconds, peak) in figures.items():
            print(f"{name:16} {seconds:8.1f} s {peak:8.0f} MiB")


def _day() -> Any:
    import datetime as dt

    return dt.datetime.now().astimezone().date()
