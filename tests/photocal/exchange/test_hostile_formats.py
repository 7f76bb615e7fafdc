"""Every reader of a format against files made to harm, or merely strange, by one table."""

from __future__ import annotations

import os
import re
import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from photocal.base.errors import PhotocalError
from photocal.block.model import Block
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result
from photocal.exchange import bal
from photocal.exchange.dbat import read_dbat_cameras
from photocal.exchange.exporting import Choices
from photocal.exchange.formats import FORMATS
from photocal.exchange.ground_points import (
    read_gcp_list,
    read_geo,
    write_gcp_list,
    write_geo,
)
from photocal.exchange.jaicov import read_scale_bars
from photocal.exchange.micmac import read_measures
from photocal.exchange.orientation_tables import read_matrices, write_matrices
from photocal.exchange.parts import Mark, PointEntry
from photocal.exchange.reference_table import read_references, write_references
from photocal.geometry.camera import Model, camera
from tests.photocal.exchange.conftest import reconstruction_of, shown

TEN_GB = 10 << 30


@dataclass(frozen=True)
class Case:
    """A reader, and something that makes what it reads."""

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], Any]


def text(name: str, content: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(content, encoding="utf-8", newline="\n")


@cache
def small(model: Model) -> Block:
    values = {"c": 20.5, "x0": 0.125, "K1": -2.5e-5, "P1": 1e-6}
    made = reconstruction_of((camera("1", model, "mm", (3060, 2036), (0.009, 0.009), values),))
    return shown(made)


def of_format(name: str) -> Case:
    form = next(form for form in FORMATS if form.name == name)
    model: Model = "brown-observed" if form.distortion == "brown-observed" else "brown-ideal"

    def make(folder: Path) -> None:
        form.write(folder, small(model), Choices("gon"))
        if name == "jaicov":
            (folder / "block.htm").write_text("S0 apriori: 0.001")

    return Case(name, make, form.read)


ANGLES = np.array([[0.1, 0.2, 0.3, 1.5, 2.5, 3.5], [0.1, 0.2, 0.3, 4.5, 5.5, 6.5]])
PLAIN = camera("1", "brown-ideal", "mm", (3060, 2036), (0.009, 0.009), {"c": 20.5, "K1": -2.5e-5})
CASES = [of_format(form.name) for form in FORMATS if form.reads and form.writes] + [
    Case(
        "gcp_list",
        lambda folder: write_gcp_list(
            folder / "g.txt",
            "EPSG:32632",
            {"p": (1.5, 2.5, 3.5)},
            [Mark("a.jpg", "p", 4.5, 5.5, (1.0, 1.0), "")],
        ),
        lambda folder: read_gcp_list(folder / "g.txt"),
    ),
    Case(
        "geo",
        lambda folder: write_geo(
            folder / "g.txt", "EPSG:32632", {"a.jpg": (1.5, 2.5, 3.5, 0.5, 0.5, 0.5, 0.25, 0.25)}
        ),
        lambda folder: read_geo(folder / "g.txt"),
    ),
    Case(
        "references",
        lambda folder: write_references(
            folder / "r.csv", "", [PointEntry("a", "tie", (1.5, 2.5, 3.5), (0.5, 0.5, 0.5))]
        ),
        lambda folder: read_references(folder / "r.csv"),
    ),
    Case(
        "bal",
        text(
            "problem-2-2-pre.txt",
            "2 2 4\n0 0 -3.5 1.5\n0 1 2.5 -4.5\n1 0 -5.5 0.5\n1 1 6.5 7.5\n"
            + "0.5\n-0.25\n0.125\n1.5\n2.5\n-9.5\n600.5\n-0.5\n0.25\n" * 2
            + "0.5\n1.5\n2.5\n" * 2,
        ),
        lambda folder: bal.read(folder / "problem-2-2-pre.txt"),
    ),
    Case(
        "matrices",
        lambda folder: write_matrices(folder / "a.txt", ("a", "b"), ANGLES),
        lambda folder: read_matrices(folder / "a.txt"),
    ),
    Case(
        "scale-bars",
        text("b.scale", '1 "bar" 1 2 1000.5 0.125 1\n'),
        lambda folder: read_scale_bars(folder / "b.scale"),
    ),
    Case(
        "dbat-camera",
        text(
            "c.xml",
            '<document dbat_camera_version="1.0"><cameras><camera><name>c</name><unit>mm</unit>'
            "<sensor>36.0,24.0</sensor><image>6000,4000</image><focal>50.5</focal><cc>50.5</cc><pp>18.5,12.5</pp>"
            "<K>0.5,0.5,0.5,0.5</K><P>0.5,0.5</P><model>3</model></camera></cameras></document>",
        ),
        lambda folder: read_dbat_cameras(folder / "c.xml"),
    ),
    Case(
        "micmac-mmvii",
        text(
            "m.xml",
            "<Root><Data><SetMesIm><NameIm>a</NameIm><Measures><el><Name>p</Name><Pt>1.5 2.5</Pt>"
            "<Sigma2>1.5 0.5 1.5</Sigma2></el></Measures></SetMesIm></Data></Root>",
        ),
        lambda folder: read_measures(folder / "m.xml"),
    ),
]
# Files that stand beside the others and that the reader leaves alone.
IDLE = {
    "micmac": "Check-Pts3D.xml",
    "patb": "orientations_gon.txt",
    "opensfm": "cameras.json",
    "opf": "scene_reference_frame.json",
}
each = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def plain(found: Any) -> Any:
    """What was read as nested plain values, without digests and places of files."""
    if is_dataclass(found):
        skipped = ("inputs", "place", "path", "name", "id")
        return {
            field.name: plain(getattr(found, field.name))
            for field in fields(found)
            if field.name not in skipped
        }
    if isinstance(found, np.ndarray):
        return found.tolist()
    if isinstance(found, dict):
        return {key: plain(value) for key, value in found.items()}
    return [plain(one) for one in found] if isinstance(found, (tuple, list)) else found


def attempt(case: Case, folder: Path) -> tuple[Any, str | None]:
    """What is read, or the complaint."""
    try:
        return case.read(folder), None
    except PhotocalError as complaint:
        return None, str(complaint)


def is_text(path: Path) -> bool:
    return b"\0" not in path.read_bytes()


@each
def test_untouched_and_with_other_line_ends(tmp_path: Path, case: Case) -> None:
    case.make(tmp_path)
    expected = repr(plain(case.read(tmp_path)))
    for ends in (b"\r\n", b"\r"):
        for path in files(tmp_path):
            if is_text(path):
                content = path.read_bytes().replace(b"\r\n", b"\n").replace(b"\r", b"\n")
                path.write_bytes(content.replace(b"\n", ends))
        assert repr(plain(case.read(tmp_path))) == expected


@each
def test_a_mark_of_utf_8_changes_nothing(tmp_path: Path, case: Case) -> None:
    case.make(tmp_path)
    expected = repr(plain(case.read(tmp_path)))
    for path in files(tmp_path):
        if is_text(path):
            path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert repr(plain(case.read(tmp_path))) == expected


NUMBER = re.compile(rb"(?<![\w.\"])-?\d+\.\d+(e-?\d+)?(?![\w.])")


@each
@pytest.mark.parametrize("bad", [b"nan", b"inf", b"1e999", b"1,5"], ids=lambda bad: bad.decode())
def test_a_number_that_is_none(tmp_path: Path, case: Case, bad: bytes) -> None:
    """In every file, a number in the middle and the last one: refused, or of no importance."""
    if (case.name, bad) == ("geo", b"nan"):
        pytest.skip("nan means not known there")
    case.make(tmp_path)
    expected = repr(plain(case.read(tmp_path)))
    refused = tried = 0
    for path in files(tmp_path):
        content = path.read_bytes()
        places = list(NUMBER.finditer(content)) if is_text(path) else []
        for place in places[len(places) // 2 :: max(len(places) // 2, 1)]:
            path.write_bytes(content[: place.start()] + bad + content[place.end() :])
            tried += 1
            found, complaint = attempt(case, tmp_path)
            refused += complaint is not None
            assert "\n" not in (complaint or "")
            assert complaint or repr(plain(found)) == expected, path.name
        path.write_bytes(content)
    assert refused or not tried


@each
def test_ten_gigabytes(tmp_path: Path, case: Case) -> None:
    """A file of that size, without taking the memory or the time."""
    case.make(tmp_path)
    for path in files(tmp_path):
        content = path.read_bytes()
        os.truncate(path, TEN_GB)
        began = time.monotonic()
        tracemalloc.start()
        _, complaint = attempt(case, tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert complaint or path.name == IDLE.get(case.name)
        assert peak < 64 << 20
        assert time.monotonic() - began < 20
        path.write_bytes(content)


@each
@pytest.mark.parametrize(
    "content", [b"", b"\xff\xfe\x00", b"\x00" * 100, "Hügel ".encode("latin-1") * 20, b'{[<"']
)
def test_another_file_in_its_place(tmp_path: Path, case: Case, content: bytes) -> None:
    case.make(tmp_path)
    refused = 0
    for path in files(tmp_path):
        kept = path.read_bytes()
        path.write_bytes(content)
        refused += attempt(case, tmp_path)[1] is not None
        path.write_bytes(kept)
    assert refused


@each
def test_entities_and_laughs(tmp_path: Path, case: Case) -> None:
    case.make(tmp_path)
    documents = [path for path in files(tmp_path) if path.suffix == ".xml"]
    laughs = "".join(f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 12))
    for path in documents:
        content = path.read_text()
        body = content[content.index("?>") + 2 :] if content.startswith("<?xml") else content
        inside = re.sub(r">([^<>\s][^<>]*)<", ">&x;<", body, count=1)
        for entity in (
            '<!ENTITY x SYSTEM "file:///etc/passwd">',
            f"<!ENTITY a0 'ha'>{laughs}<!ENTITY x '&a11;'>",
        ):
            path.write_text(f"<!DOCTYPE d [{entity}]>{inside}")
            _, complaint = attempt(case, tmp_path)
            assert "root:" not in (complaint or "")
            assert complaint or path.name == IDLE.get(case.name)
        path.write_text(content)


@each
@given(which=st.integers(0, 20), at=st.integers(0, 10**6), noise=st.binary(max_size=12), cut=st.booleans())
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_never_tracebacks(
    tmp_path_factory: pytest.TempPathFactory, case: Case, which: int, at: int, noise: bytes, cut: bool
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "inside").mkdir()
    case.make(folder / "inside")
    found = files(folder / "inside")
    path = found[which % len(found)]
    content = path.read_bytes()
    at %= len(content)
    path.write_bytes(content[:at] + noise + (b"" if cut else content[at + len(noise) :]))
    with suppress(PhotocalError):
        case.read(folder / "inside")
    # Readers write nothing.
    assert list(folder.iterdir()) == [folder / "inside"]
    assert files(folder / "inside") == found


@pytest.mark.parametrize("name", ["result.json", "images.csv", "points.csv", "residuals.csv"])
def test_run_folders(tmp_path: Path, name: str) -> None:
    (tmp_path / "result.json").write_text('{"schema": "photocal.adjustment/1", "cameras": {}, "block": {}}')
    path = tmp_path / name
    path.touch()
    os.truncate(path, TEN_GB)
    began = time.monotonic()
    with pytest.raises(PhotocalError):
        adjusted_block(read_result(tmp_path))[0]
    assert time.monotonic() - began < 20
