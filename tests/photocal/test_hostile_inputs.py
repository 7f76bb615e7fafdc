"""What no reader may choke on: other encodings, depths, numbers and lengths beyond all measure, noise."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from acquire.simulate.world.configuration import read_configuration
from photocal.analysis.accuracy.discrepancies import read_discrepancies
from photocal.analysis.accuracy.standard import load_standard
from photocal.base.checked_toml import read_tables
from photocal.base.errors import PhotocalError
from photocal.base.text_tables import read_columns
from photocal.block.folder import read_block
from photocal.block.project import read_project
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.metashape import read_metashape
from photocal.exchange.opencv import read_opencv
from photocal.exchange.reference_table import read_references
from photocal.measurement.image_file import opened
from photocal.measurement.image_metadata import read_images
from photocal.measurement.marking.tiles import Tiles
from photocal.measurement.marks import read_any_marks, read_control_marks
from photocal.planning.area import read_area
from photocal.report.issue import read_record
from tests.evidence.fuzz_readers import readers

DEEP = 200_000
TEXTS = {
    "empty": b"",
    "latin": "Punktname,Höhe\nä,1.0\n".encode("latin-1"),
    "UTF-16": "point,X,Y,Z\n1,2,3,4\n".encode("utf-16"),
    "zeros": bytes(5000),
    "deep JSON": b"[" * DEEP,
    "deep objects": b'{"a":' * DEEP,
    "deep TOML": b"a = " + b"[" * DEEP,
    "deep keys": b"a" + b".a" * 20_000 + b" = 1",
    "deep XML": b"<a>" * DEEP,
    "entities": b'<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;">]><a>&c;</a>',
    "long number": b"a = " + b"9" * 10_000,
    "long JSON number": b'{"a": ' + b"9" * 10_000 + b"}",
    "long field": b'point,X,Y,Z\n"' + b"x" * 400_000 + b'",1,2,3\n',
    "open quote": b'point,X,Y,Z\n"1,2,3,4\n5,6,7,8\n',
    "wide": b",".join([b"a"] * 50_000) + b"\n1\n",
    "noise": random.Random(1).randbytes(20_000),  # noqa: S311 - noise, no keys
}


def control(path: Path) -> object:
    return read_control_marks(path, (0.01, 0.01), {})


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "project": ("project.toml", read_project),
    "flight plan": ("flight.toml", read_configuration),
    "particulars": ("particulars.toml", read_tables),
    "standard": ("standard.toml", lambda path: load_standard(str(path))),
    "block": ("block.toml", lambda path: read_block(path.parent)),
    "table": ("points.csv", read_columns),
    "discrepancies": ("check.csv", read_discrepancies),
    "references": ("reference.csv", read_references),
    "control": ("gcp_list.txt", control),
    "OpenSfM control": ("ground_control_points.json", control),
    "marks": ("marks.csv", lambda path: read_any_marks(path, {})),
    "times": ("times.csv", read_images),
    "area": ("area.csv", read_area),
    "GeoJSON": ("area.geojson", read_area),
    "KML": ("area.kml", read_area),
    "certificate": ("certificate.json", read_record),
    "OpenCV": ("camera.yml", read_opencv),
    "OpenCV XML": ("camera.xml", read_opencv),
    "Metashape": ("project.psx", read_metashape),
    "Metashape XML": ("chunk.xml", read_metashape),
    "foreign block": ("block.txt", read_foreign_block),
    "foreign XML": ("block.xml", read_foreign_block),
    "foreign JSON": ("reconstruction.json", read_foreign_block),
}


@contextmanager
def little_memory() -> Iterator[None]:
    """A gigabyte above what the process has mapped: more is refused by the system."""
    resource = pytest.importorskip("resource", reason="only POSIX systems limit the memory of a process")
    before = resource.getrlimit(resource.RLIMIT_AS)
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + (1 << 30), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def said_of(read: Callable[[Path], object], path: Path) -> str:
    """The line in which a reader refuses a file; anything but a refusal of ours goes through."""
    try:
        with little_memory():
            read(path)
    except PhotocalError as refusal:
        return str(refusal)
    return ""


@pytest.mark.parametrize("reader", READERS)
def test_it_is_refused_in_a_line_or_read(reader: str, tmp_path: Path) -> None:
    name, read = READERS[reader]
    for text in TEXTS.values():
        (tmp_path / name).write_bytes(text)
        line = said_of(read, tmp_path / name)
        assert "\n" not in line
        assert len(line) < 2000


@pytest.mark.parametrize("reader", READERS)
def test_noise_in_a_good_text_is_refused_or_read(reader: str, tmp_path: Path) -> None:
    name, read = READERS[reader]
    chance = random.Random(reader)  # noqa: S311 - noise, no keys
    seeds = list(TEXTS.values())
    for _ in range(60):
        text = bytearray(chance.choice(seeds)[:3000] + chance.choice(seeds)[:3000])
        for _ in range(chance.randrange(1, 20) if text else 0):
            text[chance.randrange(len(text))] = chance.choice(b'",;[]{}<>=\n\0\xff09')
        (tmp_path / name).write_bytes(text)
        assert "\n" not in said_of(read, tmp_path / name)


def png(width: int, height: int) -> bytes:
    """A valid head, and rows of zeros that unpack to whatever it claims."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes((width + 1) * 100), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_gigantic_pictures_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    path.write_bytes(png(30_000, 30_000))
    with little_memory(), pytest.raises(PhotocalError, match="30000 x 30000 pixels"), opened(path):
        pass


def test_tiles_of_impossible_levels_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "small.png"
    path.write_bytes(png(100, 100))
    tiles = Tiles(tmp_path / "cache")
    tiles.tile(path, 0, 0, 0)
    for level in (2_000_000_000, 17, -1):
        with little_memory(), pytest.raises(PhotocalError, match="no such tile"):
            tiles.tile(path, level, 0, 0)


@pytest.mark.slow
def test_every_reader_of_the_study_reads_its_file_while_it_is_whole(tmp_path: Path) -> None:
    """Else the damage (`tests.evidence.fuzz_readers`) would only be refused at the door."""
    attacked = list(readers(tmp_path))
    assert len(attacked) > 80
    for one in attacked:
        one.read(one.file)
