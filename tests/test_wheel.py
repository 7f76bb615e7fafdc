"""The wheel is whole: built, installed into an empty environment away from the sources, and used there."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    tracked = subprocess.run(
        ["git", "ls-files", "-z", "acquire", "drivers", "photocal", "pyproject.toml", "README.md", "LICENSE"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    # Built from a copy: what lies about in the sources, or an older build, is no part of it.
    for name in filter(None, tracked.split("\0")):
        (folder / "source" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "source" / name).write_bytes((ROOT / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "-w", str(folder), str(folder / "source")], check=True)
    (built,) = folder.glob("photocal-*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel; its packages are those of the tests, without the sources beside them."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (own / "packages.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--force-reinstall", str(wheel)], check=True)
    lend_kernels(own / "photocal")
    return folder / "bin" / "python"


def lend_kernels(installed: Path) -> None:
    """Lend the package what is compiled for the sources: the same text, which need not be compiled again.

    The compiler's cache knows a source by its folder's name, its time and its size.
    """
    import numba
    from numba.core.caching import _CacheLocator

    from photocal.compiled import PACKAGE

    ours = Path(str(numba.config.CACHE_DIR))  # type: ignore[attr-defined]
    for source in PACKAGE.rglob("*.py"):
        copy = installed / source.relative_to(PACKAGE)
        os.utime(copy, ns=(source.stat().st_mtime_ns,) * 2)
        places = [_CacheLocator.get_suitable_cache_subpath(str(path)) for path in (source, copy)]  # type: ignore[no-untyped-call]
        kept, taken = places
        if (ours / kept).is_dir():
            target = installed / "__pycache__" / ours.name / taken
            shutil.copytree(ours / kept, target, dirs_exist_ok=True)


def run(python: Path, folder: Path, *arguments: str) -> str:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(python), *arguments],
        cwd=folder,
        env={**kept, "XDG_CACHE_HOME": str(folder / "cache")},
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


@pytest.mark.timeout(1200)
def test_from_the_observations_to_the_verified_certificate(python: Path, tmp_path: Path) -> None:
    where = run(python, tmp_path, "-c", "import photocal; print(photocal.__file__)")
    assert str(ROOT) not in where
    demo = run(python, tmp_path, "-m", "photocal.demo", "dcs460", "-o", "out")
    assert "20.5005 mm" in demo
    assert "810 frames" in demo
    run(python, tmp_path, "-m", "photocal", "analyse", "out/run")
    run(python, tmp_path, "-m", "photocal", "certificate", "out/run", "-o", "c", "--block", str(data(where)))
    assert (
        json.loads(run(python, tmp_path, "-m", "photocal", "verify", "c", "--json"))["reproducible"] is True
    )
    run(
        python, tmp_path, "-m", "acquire", "simulate", "flight", "small", "--level", "block", "-o", "practice"
    )
    assert (tmp_path / "practice" / "site").is_dir()


def data(module: str) -> Path:
    return Path(module.strip()).parent / "demo" / "dcs460"


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
import acquire.commands.record, acquire.recording.configuration, acquire.recording.recorder
import acquire.transports.sources
from drivers.scan import compile_search
compile_search()
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
import acquire.monitor.page, acquire.transports.sinks, acquire.importing.importer
"""


def test_a_recorder_needs_no_packages_of_the_processing(python: Path, tmp_path: Path) -> None:
    kilobytes = int(run(python, tmp_path, "-c", _RECORDER))
    assert kilobytes < 60_000
