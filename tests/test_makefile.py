"""The commands of the front page where programs are missing: they install them, or say what to do."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def system(tmp_path: Path) -> Path:
    """A path with a shell and make, without RTKLIB and without a package manager."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    for name in ("sh", "make", "id"):
        found = shutil.which(name)
        assert found is not None
        (tmp_path / name).symlink_to(found)
    return tmp_path


def made(system: Path, target: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(system / "make"), "-C", str(ROOT), target],
        env={"PATH": str(system)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_system_without_a_package_manager_is_told_what_to_do(system: Path) -> None:
    done = made(system, "engine")
    assert done.returncode != 0
    assert "apt-get install rtklib" in done.stdout


def test_what_lacks_is_installed_once_and_said(system: Path) -> None:
    """A stand-in for apt-get notes how it is called, and makes the programs."""
    log = system / "log"
    programs = " ".join(f'printf "#!/bin/sh\\n" > {system / name};' for name in ("rnx2rtkp", "convbin"))
    chmod = shutil.which("chmod")
    (system / "apt-get").write_text(
        f'#!/bin/sh\necho "$*" >> {log}\ncase "$*" in install*) {programs} '
        f"{chmod} +x {system / 'rnx2rtkp'} {system / 'convbin'};; esac\n"
    )
    (system / "apt-get").chmod(0o755)
    # Root asks nobody; another person needs sudo, which hands on.
    (system / "sudo").write_text('#!/bin/sh\n[ "$1" = -n ] && shift\n[ "$1" = true ] && exit 0\nexec "$@"\n')
    (system / "sudo").chmod(0o755)
    first = made(system, "engine")
    assert first.returncode == 0, first.stderr
    assert "rtklib is not installed: apt-get install rtklib" in first.stdout
    assert log.read_text().splitlines() == ["update -qq", "install -y -qq --no-install-recommends rtklib"]
    assert made(system, "engine").returncode == 0
    assert len(log.read_text().splitlines()) == 2
