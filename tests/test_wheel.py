"""The wheel is whole: built, installed into an empty environment away from the sources, and used there."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.installed import ROOT, surroundings

pytestmark = pytest.mark.slow


def run(python: Path, folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        [str(python), *arguments],
        cwd=folder,
        env=surroundings(folder / "cache"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_data_are_in_the_wheel(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for package in ("acquire", "drivers", "photocal"):
        for path in (ROOT / package).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".md":
                assert path.relative_to(ROOT).as_posix() in names


def test_the_published_camera_is_calibrated(installed: Path, tmp_path: Path) -> None:
    """All further commands of an installed wheel are those of the guide, see `tests/docs/test_guide.py`."""
    where = run(installed, tmp_path, "-c", "import photocal; print(photocal.__file__)")
    assert str(ROOT) not in where
    demo = run(installed, tmp_path, "-m", "photocal.demo", "dcs460", "-o", "out")
    assert "20.5005 mm" in demo
    assert "810 frames" in demo


LEAN = (
    "numba",
    "scipy",
    "cv2",
    "matplotlib",
    "rasterio",
    "PIL",
    "pyarrow",
    "cryptography",
    "typst",
    "jinja2",
)
_RECORDER = f"""
import sys
for name in {LEAN!r}:
    sys.modules[name] = None
import acquire.commands.recording, acquire.recording.configuration, acquire.recording.recorder
import acquire.transports.sources
from drivers.scan import compile_search
compile_search()
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
import acquire.monitor.page, acquire.transports.sinks, acquire.importing.importer
"""


def test_a_recorder_needs_no_packages_of_the_processing(installed: Path, tmp_path: Path) -> None:
    kilobytes = int(run(installed, tmp_path, "-c", _RECORDER))
    assert kilobytes < 60_000


def test_the_container_gets_all_of_the_wheel(wheel: Path, tmp_path: Path) -> None:
    """What Containerfile copies makes the wheel that the sources make, studies included."""
    for line in (ROOT / "Containerfile").read_text(encoding="utf-8").splitlines():
        if line.startswith("COPY"):
            *given, target = line.split()[1:]
            for name in given:
                if (ROOT / name).is_dir():
                    shutil.copytree(
                        ROOT / name, tmp_path / target, ignore=shutil.ignore_patterns("__pycache__")
                    )
                else:
                    shutil.copy(ROOT / name, tmp_path / target)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "-w", str(tmp_path), str(tmp_path)], check=True)
    (made,) = tmp_path.glob("photocal-*.whl")
    assert set(zipfile.ZipFile(wheel).namelist()) <= set(zipfile.ZipFile(made).namelist())
