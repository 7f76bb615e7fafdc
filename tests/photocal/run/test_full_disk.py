"""Disks that are full: one line with file and cause, nothing half written, and later only what lacks."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from photocal.base.errors import DeviceError, InputNotFoundError, OutputError, PhotocalError, of_system
from photocal.base.files import output_file, output_folder, write_json, write_rows
from photocal.base.geopackage import LOCAL, geopackage
from photocal.base.progress import quiet
from photocal.run.stage import Digests, Stage, made_in, update_stage

ROOT = Path(__file__).parents[3]
DCS460 = ROOT / "photocal/demo/dcs460"
MOST = 20_000


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file may grow beyond a few kB: the system refuses each byte more, as it does on a full disk."""
    resource = pytest.importorskip("resource", reason="only POSIX systems limit the sizes of files")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def by_rows(folder: Path) -> None:
    write_rows(folder / "large.csv", ("a",), ([k] for k in range(MOST)))


def by_json(folder: Path) -> None:
    write_json(folder / "large.json", list(range(MOST)))


def by_text(folder: Path) -> None:
    (folder / "large.txt").write_text("x" * 2 * MOST, encoding="utf-8")


def by_database(folder: Path) -> None:
    with geopackage(folder / "large.gpkg", LOCAL) as database:
        database.execute("CREATE TABLE much (value TEXT)")
        database.executemany("INSERT INTO much VALUES (?)", [("x" * 1000,)] * 100)


def by_parquet(folder: Path) -> None:
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet

    table = pa.table({"a": np.random.default_rng(1).random(MOST)})
    pyarrow.parquet.write_table(table, folder / "large.parquet")


def by_arrow_rows(folder: Path) -> None:
    import pyarrow as pa
    import pyarrow.csv

    pyarrow.csv.write_csv(pa.table({"a": list(range(MOST))}), folder / "large.csv")


def by_array(folder: Path) -> None:
    import numpy as np

    np.savez(folder / "large.npz", a=np.arange(MOST))


def by_picture(folder: Path) -> None:
    from matplotlib.figure import Figure

    Figure(figsize=(9, 9)).savefig(folder / "large.png", dpi=1000)


def of_large(folder: Path) -> Path:
    """Somebody's folder with a file that is larger than what may be written."""
    source = folder / "source"
    source.mkdir()
    with (source / "large.bin").open("wb") as file:
        file.truncate(2 * MOST)
    return source


WRITERS: tuple[Callable[[Path], None], ...] = (
    by_rows, by_json, by_text, by_database, by_parquet, by_arrow_rows, by_array, by_picture,
)  # fmt: skip


@pytest.mark.parametrize("write", WRITERS)
def test_a_stage_says_what_cannot_be_written(
    write: Callable[[Path], None], small_files: None, tmp_path: Path
) -> None:
    work = tmp_path / "work"
    stage = Stage("large", "", lambda folder, _: write(folder))
    with pytest.raises(OutputError) as told:
        update_stage(stage, work, Digests(work / "digests.json"), quiet)
    assert "\n" not in str(told.value)
    assert "cannot be written" in str(told.value)
    assert str(made_in(work) / "large") in str(told.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() or ".partial" in path.name]


@pytest.mark.parametrize("whole", [True, False])
def test_copies_of_inputs_are_named(whole: bool, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    source, work = of_large(tmp_path), tmp_path / "work"
    request.getfixturevalue("small_files")

    def make(folder: Path, _: object) -> None:
        if whole:
            shutil.copytree(source, folder, dirs_exist_ok=True)
        else:
            shutil.copyfile(source / "large.bin", folder / "large.bin")

    with pytest.raises(
        OutputError, match=r"large/large\.bin: cannot be written \(file too large\); free disk space"
    ):
        update_stage(Stage("large", "", make), work, Digests(work / "digests.json"), quiet)


def test_an_input_that_cannot_be_read_is_no_output(tmp_path: Path) -> None:
    with (
        pytest.raises(InputNotFoundError, match=r"nothing\.csv: cannot be opened"),
        output_folder(tmp_path / "made"),
    ):
        (tmp_path / "nothing.csv").read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == []


def test_a_file_keeps_what_it_held(small_files: None, tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    path.write_text("before", encoding="utf-8")
    with pytest.raises(OutputError, match=r"kept\.json: cannot be written"), output_file(path) as aside:
        write_json(aside, list(range(MOST)))
    assert path.read_text(encoding="utf-8") == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_that_went_away_is_no_disk(tmp_path: Path) -> None:
    with pytest.raises(BrokenPipeError), output_file(tmp_path / "file"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")


@pytest.mark.parametrize(
    ("refusal", "kind", "line"),
    [
        (OSError(errno.ENOSPC, "x"), OutputError, "cannot be written (no space left on device)"),
        (OSError(errno.EROFS, "x", "a.csv"), OutputError, "a.csv: cannot be written (read-only file system)"),
        (PermissionError(errno.EACCES, "x", "a.csv"), InputNotFoundError, "a.csv: cannot be opened"),
        (OSError(errno.EADDRINUSE, "x"), DeviceError, "(address already in use)"),
        (OSError("12 requested and 3 written"), DeviceError, "12 requested and 3 written"),
    ],
)
def test_each_refusal_has_its_class(refusal: OSError, kind: type[PhotocalError], line: str) -> None:
    told = of_system(refusal)
    assert type(told) is kind
    assert line in str(told)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 3 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    words = ["-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)]
    if mount is None or subprocess.run([mount, *words], capture_output=True, check=False).returncode:
        pytest.skip("only the superuser of Linux can mount a small disk")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


def ran(project: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "photocal", "run", str(project)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_with_room_again_only_that_stage_is_made(disk: Path, tmp_path: Path) -> None:
    project, work = tmp_path / "project.toml", disk / "work"
    project.write_text(
        f'[project]\nname = "full"\ncrs = "local"\nheight = "local"\noutput = "{work}"\n'
        f'[measurements]\nblock = "{DCS460}"\n',
        encoding="utf-8",
    )
    assert ran(project).returncode == 0
    for name in ("analysis", "certificate"):
        shutil.rmtree(made_in(work) / name)
        shutil.rmtree(work / name)
        with (disk / "filling").open("wb", buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(65536))
        os.truncate(disk / "filling", (disk / "filling").stat().st_size - 30_000)
        before = sorted(path for path in disk.rglob("*"))
        done = ran(project)
        assert done.returncode == 8, done.stderr
        (line,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        assert str(work) in line
        assert "no space left on device" in line
        assert "Traceback" not in done.stderr
        assert sorted(path for path in disk.rglob("*")) == before
        (disk / "filling").unlink()
        done = ran(project)
        assert done.returncode == 0, done.stderr
        made = [
            line for line in done.stderr.splitlines() if line.startswith("full: ") and line.endswith(" s")
        ]
        assert [line.split(": ")[1] for line in made] == [name]
