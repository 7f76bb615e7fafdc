"""Bad input of `photocal adjust`: one line with what, where and what to do, its exit code, no output."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.photocal.blocks import small

# Does something bad to a block folder.
Spoiler = Callable[[Path], object]

NOT_FOUND, MALFORMED, CONFIGURATION, ILL_POSED, OUTPUT = 3, 4, 5, 6, 8


def edit(name: str, old: str, new: str, count: int = 1) -> Spoiler:
    """Replace text in a file of the block."""

    def spoil(block: Path) -> None:
        text = (block / name).read_text()
        assert old in text
        (block / name).write_text(text.replace(old, new, count))

    return spoil


def write(name: str, content: bytes) -> Spoiler:
    return lambda block: (block / name).write_bytes(content)


def add(name: str, line: str) -> Spoiler:
    def spoil(block: Path) -> None:
        with (block / name).open("a") as text:
            text.write(line + "\n")

    return spoil


def remove(name: str) -> Spoiler:
    return lambda block: (block / name).unlink()


def make_folder(name: str) -> Spoiler:
    def spoil(block: Path) -> None:
        (block / name).unlink()
        (block / name).mkdir()

    return spoil


def drop_rays(*beginnings: str) -> Spoiler:
    """Take the observations out that begin so."""

    def spoil(block: Path) -> None:
        path = block / "observations.csv"
        path.write_text("".join(s for s in path.read_text().splitlines(True) if not s.startswith(beginnings)))

    return spoil


def no_control(block: Path) -> None:
    path = block / "points.csv"
    path.write_text(path.read_text().replace("0.003,0.003,0.003,control", ",,,tie"))


def duplicate_header(block: Path) -> None:
    edit("points.csv", "sX,sY,sZ", "sX,sY,sX")(block)


def camera_twice(block: Path) -> None:
    text = (block / "block.toml").read_text()
    (block / "block.toml").write_text(text + text[text.index("[[camera]]") :])


# What to spoil; the exit code; words that the message must contain.
BAD: dict[str, tuple[Spoiler, int, tuple[str, ...]]] = {
    "unknown key": (
        edit("block.toml", "datum =", "dattum ="),
        CONFIGURATION,
        ("block.toml", "unknown key", "dattum"),
    ),
    "unknown section": (add("block.toml", "[solver]\nmethod = 1"), CONFIGURATION, ("block.toml", "solver")),
    "missing key": (
        edit("block.toml", 'unit = "mm"\naxes', "axes"),
        CONFIGURATION,
        ("observations.unit", "missing"),
    ),
    "missing axes": (
        edit("block.toml", 'axes = "photo"\n', ""),
        CONFIGURATION,
        ("observations.axes", "missing"),
    ),
    "wrong model": (edit("block.toml", "brown-observed", "fisheye"), CONFIGURATION, ("model", "fisheye")),
    "unknown parameter": (edit("block.toml", '["c"]', '["c", "K5"]'), CONFIGURATION, ("K5", "K1")),
    "no pitch": (edit("block.toml", "pitch_mm = 0.009\n", ""), CONFIGURATION, ("pitch_mm", "main")),
    "no principal distance": (
        edit("block.toml", "c = 20.0", "x0 = 0.1"),
        CONFIGURATION,
        ("principal distance",),
    ),
    "negative c": (
        edit("block.toml", "c = 20.0", "c = -20.0"),
        CONFIGURATION,
        ("principal distance", "positive"),
    ),
    "c is nan": (edit("block.toml", "c = 20.0", "c = nan"), CONFIGURATION, ("block.toml", "finite")),
    "negative sigma": (
        edit("block.toml", "sigma = 0.003", "sigma = -1.0"),
        CONFIGURATION,
        ("sigma", "greater"),
    ),
    "two cameras of one id": (camera_twice, CONFIGURATION, ("same id",)),
    "frame of a map": (edit("block.toml", '"local"', '"EPSG:31982"'), CONFIGURATION, ("EPSG:31982",)),
    "not TOML": (edit("block.toml", "[block]", "[block"), CONFIGURATION, ("not valid TOML", "line 1")),
    "TOML with wrong bytes": (write("block.toml", b"\xff\xfe[block]\n"), CONFIGURATION, ("block.toml",)),
    "no setup": (remove("block.toml"), NOT_FOUND, ("block.toml", "does not exist")),
    "no images": (remove("images.csv"), NOT_FOUND, ("images.csv", "does not exist")),
    "no points": (remove("points.csv"), NOT_FOUND, ("points.csv", "does not exist")),
    "no observations": (remove("observations.csv"), NOT_FOUND, ("observations", "does not exist")),
    "empty setup": (write("block.toml", b""), NOT_FOUND, ("block.toml", "empty")),
    "empty images": (write("images.csv", b""), NOT_FOUND, ("images.csv", "empty")),
    "folder for a table": (make_folder("points.csv"), NOT_FOUND, ("points.csv", "folder")),
    "only a header": (
        write("observations.csv", b"image,point,x,y\n"),
        MALFORMED,
        ("observations.csv", "no rows"),
    ),
    "images: only a header": (
        write("images.csv", b"image,camera,X,Y,Z,omega,phi,kappa\n"),
        MALFORMED,
        ("images.csv", "no rows"),
    ),
    "unknown image": (
        edit("observations.csv", "\nc,p6", "\nz,p6"),
        MALFORMED,
        ("line 22", "'z'", "images.csv"),
    ),
    "unknown point": (
        edit("observations.csv", "\na,p3", "\na,p9"),
        MALFORMED,
        ("line 11", "'p9'", "points.csv"),
    ),
    "unknown camera": (edit("images.csv", "b,main", "b,mian"), MALFORMED, ("line 3", "'mian'", "block.toml")),
    "unknown role": (edit("points.csv", "check", "chekc"), MALFORMED, ("line 7", "'chekc'", "tie")),
    "image twice": (
        edit("images.csv", "\nb,", "\na,"),
        MALFORMED,
        ("images.csv, line 3", "a is listed twice"),
    ),
    "point twice": (
        edit("points.csv", "\np4", "\np1"),
        MALFORMED,
        ("points.csv, line 6", "p1 is listed twice"),
    ),
    "observation twice": (add("observations.csv", "a,p0,1,1"), MALFORMED, ("line 23", "already observed")),
    "nan": (edit("observations.csv", "4.8157", "nan"), MALFORMED, ("line 2", "y is not finite")),
    "infinity": (edit("points.csv", "2.7028", "inf"), MALFORMED, ("line 2", "Y is not finite")),
    "word": (edit("observations.csv", "4.8157", "4.8l57"), MALFORMED, ("line 2", "'4.8l57'", "not a number")),
    "unit in a cell": (
        edit("images.csv", "4.557", "4.557 m"),
        MALFORMED,
        ("line 2", "not a number", "without unit"),
    ),
    "empty cell": (edit("observations.csv", ",4.8157", ","), MALFORMED, ("line 2", "y is empty")),
    "empty name": (edit("observations.csv", "\na,p1", "\n,p1"), MALFORMED, ("line 5", "image is empty")),
    "decimal comma": (
        edit("observations.csv", "0.2518,4.8157", "0,2518,4,8157"),
        MALFORMED,
        ("observations.csv", "6 cells", "4"),
    ),
    "quoted decimal comma": (
        edit("observations.csv", "4.8157", '"4,8157"'),
        MALFORMED,
        ("line 2", "'4,8157'", "decimal point"),
    ),
    "points and commas mixed": (
        lambda b: (edit("points.csv", ",", ";", 1000)(b), edit("points.csv", ".", ",")(b)),
        MALFORMED,
        ("points.csv", "decimal commas", "one way"),
    ),
    "column missing": (edit("points.csv", ",role", ",rolle"), MALFORMED, ("points.csv", "role")),
    "column unknown": (edit("points.csv", "sX,", "sigmaX,"), MALFORMED, ("points.csv", "sigmaX", "sX")),
    "column twice": (duplicate_header, MALFORMED, ("points.csv", "sX", "twice")),
    "row too short": (edit("images.csv", ",2.565", ""), MALFORMED, ("images.csv", "7 cells", "8")),
    "row too long": (add("points.csv", "p7,1,1,1,,,,tie,x"), MALFORMED, ("points.csv", "9 cells", "8")),
    "not UTF-8": (write("points.csv", b"point,X\n\xff\xfe\xfa,1\n"), MALFORMED, ("points.csv",)),
    "negative sigma of a point": (edit("points.csv", ",0.003", ",-0.003"), MALFORMED, ("line 2", "negative")),
    "tie with a sigma": (
        edit("points.csv", ",,,,tie", ",0.1,,,tie"),
        MALFORMED,
        ("line 8", "tie point", "sigma"),
    ),
    "control without sigma": (
        edit("points.csv", "0.003,0.003,0.003,control", ",,,control"),
        MALFORMED,
        ("line 2", "no sigma"),
    ),
    "control without height": (
        edit("points.csv", "-0.7117", ""),
        MALFORMED,
        ("line 2", "lacks a coordinate"),
    ),
    "no sigma of observations": (
        edit("block.toml", "sigma = 0.003\n", ""),
        MALFORMED,
        ("line 2", "no sigma", "[observations]"),
    ),
    "zero sigma of an observation": (
        lambda b: (b / "observations.csv").write_text("image,point,x,y,sx,sy\na,p0,1,1,0,0.1\n"),
        MALFORMED,
        ("line 2", "not positive"),
    ),
    "tie point with one ray": (
        drop_rays("a,p6", "b,p6"),
        MALFORMED,
        ("tie point p6", "one ray", "second image"),
    ),
    "check point with one ray": (drop_rays("a,p5", "b,p5"), MALFORMED, ("check point p5", "one ray")),
    "image with two points": (
        drop_rays("a,p0", "a,p1", "a,p2", "a,p3", "a,p4"),
        ILL_POSED,
        ("image a", "4 observed value"),
    ),
    "no datum": (no_control, ILL_POSED, ("datum", "control points")),
    "two forms of observations": (
        lambda b: (b / "observations.parquet").write_bytes(b"x"),
        MALFORMED,
        ("both observations.csv and observations.parquet",),
    ),
    "no Parquet": (
        lambda b: (b / "observations.csv").rename(b / "observations.parquet"),
        MALFORMED,
        ("observations.parquet", "Parquet"),
    ),
}


def one_line(answer: Any, code: int, words: tuple[str, ...] = ()) -> None:
    assert answer.err.startswith("error: ")
    assert answer.err.count("\n") == 1
    assert answer.out == ""
    for word in words:
        assert word in answer.err
    # What, and after a semicolon what to do.
    assert ";" in answer.err
    assert answer.code == code, answer.err


@pytest.mark.parametrize("what", BAD)
def test_bad_blocks(what: str, tmp_path: Path, photocal: Callable[..., Any]) -> None:
    spoil, code, words = BAD[what]
    block = small(tmp_path / "block")
    spoil(block)
    one_line(photocal("adjust", block, "-o", tmp_path / "run"), code, words)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["block"]


def test_no_block_folder(tmp_path: Path, photocal: Callable[..., Any]) -> None:
    one_line(photocal("adjust", tmp_path / "nowhere", "-o", tmp_path / "run"), NOT_FOUND, ("does not exist",))
    (tmp_path / "file").write_text("x")
    one_line(photocal("adjust", tmp_path / "file", "-o", tmp_path / "run"), MALFORMED, ("has no block",))
    assert not (tmp_path / "run").exists()


def test_output_that_is_a_file(tmp_path: Path, photocal: Callable[..., Any]) -> None:
    (tmp_path / "run").write_text("mine")
    one_line(photocal("adjust", small(tmp_path / "block"), "-o", tmp_path / "run"), OUTPUT, ("is a file",))
    assert (tmp_path / "run").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["block", "run"]


def test_an_earlier_run_survives_a_failure(tmp_path: Path, photocal: Callable[..., Any]) -> None:
    block = small(tmp_path / "block")
    assert photocal("adjust", block, "-o", tmp_path / "run").code == 0
    before = {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()}
    no_control(block)
    assert photocal("adjust", block, "-o", tmp_path / "run").code == ILL_POSED
    assert {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()} == before


def test_the_process_itself_shows_no_traceback(tmp_path: Path) -> None:
    program = "from photocal.commands.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "adjust", str(tmp_path / "none"), "-o", str(tmp_path / "run")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == NOT_FOUND
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
