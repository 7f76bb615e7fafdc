"""The package as a user has it: a wheel in an empty environment, away from the sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = [
    "acquire",
    "drivers",
    "photocal",
    "configs/studies",
    "pyproject.toml",
    "setup.py",
    "README.md",
    "LICENSE",
]


def build(folder: Path) -> Path:
    """Build the wheel from a copy: what lies about in the sources, or an older build, is no part of it."""
    tracked = subprocess.run(
        ["git", "ls-files", "-z", *SOURCES],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    for name in filter(None, tracked.split("\0")):
        (folder / "source" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "source" / name).write_bytes((ROOT / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "-w", str(folder), str(folder / "source")], check=True)
    (built,) = folder.glob("photocal-*.whl")
    return built


def install(wheel: Path, folder: Path) -> Path:
    """Make an environment with the wheel, and the packages of the tests without the sources."""
    venv.create(folder, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (own / "packages.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--force-reinstall", str(wheel)], check=True)
    lend_kernels(own / "photocal")
    return folder / "bin" / "python"


def lend_kernels(installed: Path) -> None:
    """Lend the packages what is compiled for the sources: the same text, which need not be compiled again.

    The compiler's cache knows a source by its folder's name, its time and its size.
    """
    from numba.core.caching import _CacheLocator

    from drivers import scan
    from photocal.base.compiled import FOLDER, PACKAGE

    search = Path(scan.__file__)
    lent = installed.parent / "drivers"
    os.utime(lent / search.name, ns=(search.stat().st_mtime_ns,) * 2)
    (lent / "__pycache__").mkdir(exist_ok=True)
    for kernel in (search.parent / "__pycache__").glob("scan.*.nb?"):
        shutil.copyfile(kernel, lent / "__pycache__" / kernel.name)
    for source in PACKAGE.rglob("*.py"):
        copy = installed / source.relative_to(PACKAGE)
        os.utime(copy, ns=(source.stat().st_mtime_ns,) * 2)
        places = [_CacheLocator.get_suitable_cache_subpath(str(path)) for path in (source, copy)]  # type: ignore[no-untyped-call]
        kept, taken = places
        if (FOLDER / kept).is_dir():
            target = installed / "__pycache__" / FOLDER.name / taken
            shutil.copytree(FOLDER / kept, target, dirs_exist_ok=True)


def surroundings(cache: Path) -> dict[str, str]:
    """Return the environment variables of a user without the sources, with a cache and keys beside it."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return {**kept, "XDG_CACHE_HOME": str(cache), "XDG_CONFIG_HOME": str(cache.with_name("settings"))}
