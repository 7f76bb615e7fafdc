"""Files made to harm, or merely strange: a clear error or the right reading, quickly."""

from __future__ import annotations

import os
import struct
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError, PhotocalError
from photocal.block.network import assemble
from photocal.exchange import source
from photocal.exchange.dbat import read_dbat, read_dbat_cameras
from photocal.exchange.formats import read_foreign_block
from photocal.exchange.metashape import read_metashape
from photocal.exchange.micmac import read_calibration, read_ground_points, read_measures, read_orientation
from photocal.exchange.photomodeler import read_export

XML_READERS: list[Callable[[Path], Any]] = [
    read_dbat,
    read_dbat_cameras,
    read_metashape,
    read_calibration,
    read_orientation,
    read_ground_points,
    read_measures,
    read_foreign_block,
]

LAUGHS = "<!DOCTYPE d [<!ENTITY a0 'ha'>" + "".join(
    f"<!ENTITY a{k} '{f'&a{k - 1};' * 10}'>" for k in range(1, 12)
)
EXTERNAL = (
    '<!DOCTYPE d [<!ENTITY x SYSTEM "file:///etc/passwd">]><document dbat_script_version="1">&x;</document>'
)


@pytest.mark.parametrize("read", XML_READERS)
@pytest.mark.parametrize(
    "text",
    [
        LAUGHS + ']><document dbat_script_version="1">&a11;</document>',
        EXTERNAL,
        '<!DOCTYPE d SYSTEM "http://127.0.0.1:9/x.dtd"><document/>',
        "<document",
        "not xml at all",
        "<a>" * 200_000,
    ],
)
def test_xml(tmp_path: Path, read: Callable[[Path], Any], text: str) -> None:
    path = tmp_path / "file.xml"
    path.write_text(text, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(PhotocalError) as complaint:
        read(path)
    assert time.process_time() - began < 5
    assert "root:" not in str(complaint.value)
    assert "\n" not in str(complaint.value)


@given(st.binary(max_size=400))
@settings(max_examples=100)
def test_noise(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    path = tmp_path_factory.mktemp("noise") / "file.xml"
    path.write_bytes(noise)
    for read in XML_READERS:
        with pytest.raises(PhotocalError):
            read(path)
    text = path.with_suffix(".txt")
    text.write_bytes(noise)
    for other in (read_export, read_foreign_block):
        with pytest.raises(PhotocalError):
            other(text)


# A set-up of three images that see nine points, with the tables that it names.
SETUP = """<?xml version="1.0" encoding="UTF-8"?>
<document dbat_script_version="1.0"><meta><name>små</name></meta>
<input base_dir="$HERE">
<ctrl_pts><file format="id,label,x,y,z,sx,sy,sz">reference/control.txt</file></ctrl_pts>
<images><file format="id,path">images.txt</file></images>
<image_pts><file format="id,im,x,y" sxy="0.5">marks.txt</file></image_pts>
<cameras><camera><name>cam</name><unit>mm</unit><sensor>36,24</sensor><image>6000,4000</image><focal>50</focal>
<cc>50</cc><pp>18,12</pp><K>0,0,0</K><P>0,0</P><model>3</model><skew>0</skew><aspect>1</aspect></camera></cameras>
</input>
<operations><operation><set_initial_values><io>loaded</io></set_initial_values></operation></operations>
</document>
"""


def project(x: float, y: float, z: float, shift: float) -> tuple[float, float]:
    """A vertical image from 100 m above (shift, 0), c = 50 mm, pixels of 6 um, corner at 0."""
    scale = 50 / (100 - z) / 0.006
    return 3000 + (x - shift) * scale, 2000 - y * scale


POINTS = [(float(x), float(y), float((x * y) % 5)) for x in (-15, 2, 18) for y in (-12, 1, 13)]


def small_project(folder: Path) -> Path:
    (folder / "setup.xml").write_text(SETUP, encoding="utf-8")
    control = [f"{k}, P{k}, {x}, {y}, {z}, 0.01, 0.01, 0.01" for k, (x, y, z) in enumerate(POINTS)]
    (folder / "control.txt").write_text("# id, name, X, Y, Z\n" + "\n".join(control) + "\n", encoding="utf-8")
    (folder / "images.txt").write_text("1, a/1.jpg\n2, a/2.jpg\n3, a/3.jpg\n", encoding="utf-8")
    marks = []
    for image, shift in enumerate((-5.0, 0.0, 5.0), start=1):
        for k, point in enumerate(POINTS):
            u, v = project(*point, shift)
            marks.append(f"{k}, {image}, {u!r}, {v!r}")
    (folder / "marks.txt").write_text("\n".join(marks) + "\n", encoding="utf-8")
    return folder / "setup.xml"


def test_small_project_is_read(tmp_path: Path) -> None:
    block = read_foreign_block(small_project(tmp_path))
    assert block.name == "små"
    assert block.images.names == ("1.jpg", "2.jpg", "3.jpg")
    # A set-up has no orientations; from perfect observations they come out as exactly the projection centres.
    assert np.isnan(block.images.values).all()
    assembly = assemble(block)
    centres = assembly.frame.to_given(assembly.network.exposures.values[:, 3:])
    assert centres[:, 0].tolist() == pytest.approx([-5, 0, 5], abs=1e-4)
    assert centres[:, 2].tolist() == pytest.approx([100, 100, 100], abs=1e-4)
    # Half a pixel: DBAT's corner against our centre of the upper-left pixel.
    u, v = project(*POINTS[0], -5.0)
    assert block.observations.values[0].tolist() == [u - 0.5, v - 0.5]
    assert (block.cameras[0].value("x0"), block.cameras[0].value("y0")) == (0, 0)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_other_encodings_and_line_ends_read_the_same(tmp_path: Path, encoding: str, ends: str) -> None:
    path = small_project(tmp_path)
    plain = read_dbat(path)
    for name in ("control.txt", "marks.txt", "images.txt"):
        text = (tmp_path / name).read_text(encoding="utf-8").replace("\n", ends)
        (tmp_path / name).write_bytes(text.encode(encoding))
    again = read_dbat(path)
    assert again.points.names == plain.points.names
    assert again.observations.values.tolist() == plain.observations.values.tolist()


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("setup.xml", "reference/control.txt", "/etc/passwd", "not inside its folder"),
        ("setup.xml", "reference/control.txt", "../control.txt", "not inside its folder"),
        ("setup.xml", "reference/control.txt", "a/../../control.txt", "not inside its folder"),
        ("setup.xml", "reference/control.txt", r"C:\control.txt", "not inside its folder"),
        ("setup.xml", "reference/control.txt", r"..\control.txt", "not inside its folder"),
        ("setup.xml", "$HERE", "/", "is outside the folder"),
        ("setup.xml", "<image>6000,4000", "<image>6000000000,4000", "image size"),
        ("setup.xml", "<image>6000,4000", "<image>6000", "1 values where 2"),
        ("setup.xml", "<cc>50", "<cc>1e400", "not finite"),
        ("setup.xml", "<model>3", "<model>17", "lens model 17"),
        ("setup.xml", "<unit>mm", "<unit>parsec", "camera unit"),
        ("setup.xml", "id,im,x,y", "id,im,x,why", "unknown field 'why'"),
        ("setup.xml", "<sensor>36,24", "<sensor>30,24", "not square"),
        ("setup.xml", "<input", "<inputs", "has no <input>|not valid XML"),
        ("control.txt", "1, P1, -15.0", "1, P1, nan", "not finite"),
        ("control.txt", "1, P1, -15.0", "1, P1, -15,0", "decimal points, not commas"),
        ("control.txt", "1, P1, -15.0", "0, P1, -15.0", "point 0 is listed twice"),
        ("control.txt", "0.01\n1, P1", "-0.01\n1, P1", "negative"),
        ("marks.txt", "0, 1, ", "0, 9, ", "observes image 9"),
        ("marks.txt", "1, 1, ", "0, 1, ", "observed twice"),
        ("marks.txt", "0, 1, ", "0, 1, x", "not a number"),
    ],
)
def test_wrong_content(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    path = small_project(tmp_path)
    text = (tmp_path / name).read_text(encoding="utf-8")
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputMalformedError, match=message):
        read_dbat(path)


def test_latin_1_is_refused_with_its_line(tmp_path: Path) -> None:
    path = small_project(tmp_path)
    text = (tmp_path / "control.txt").read_text(encoding="utf-8").replace("P3", "Hügel")
    (tmp_path / "control.txt").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputMalformedError, match=r"control.txt, line 5: is not UTF-8 text \(byte 0xfc\)"):
        read_dbat(path)


def test_link_out_of_the_folder(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    path = small_project(inside)
    (tmp_path / "secret.txt").write_text((inside / "control.txt").read_text())
    (inside / "control.txt").unlink()
    (inside / "control.txt").symlink_to(tmp_path / "secret.txt")
    with pytest.raises(InputMalformedError, match="a link that leads out"):
        read_dbat(path)


def test_missing_empty_and_folders(tmp_path: Path) -> None:
    path = small_project(tmp_path)
    (tmp_path / "marks.txt").unlink()
    with pytest.raises(InputNotFoundError, match="neither there nor beside"):
        read_dbat(path)
    (tmp_path / "marks.txt").touch()
    with pytest.raises(InputNotFoundError, match="is empty"):
        read_dbat(path)
    for wrong in (tmp_path / "none.xml", tmp_path):
        with pytest.raises((InputNotFoundError, InputMalformedError)):
            read_foreign_block(wrong)


@pytest.mark.parametrize("cut", range(20, 1300, 90))
def test_cut_set_up(tmp_path: Path, cut: int) -> None:
    path = small_project(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: min(cut, len(content) - 20)])
    with pytest.raises(InputMalformedError):
        read_dbat(path)


def test_sparse_file_of_many_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "marks.txt"
    with path.open("wb") as out:
        out.truncate(10 << 30)
    with pytest.raises(InputMalformedError, match=r"10\.0 GiB"):
        source.read_text(path)
    os.truncate(path, 1 << 20)
    with pytest.raises(InputMalformedError, match="not a text file"):
        source.read_text(path)


@pytest.mark.parametrize("text", ["1_000", "0x10", "1e999", "inf", "-nan", "1,5", "", "٣,٥"])
def test_numbers_that_are_none(text: str) -> None:
    with pytest.raises(InputMalformedError, match="line 3"):
        source.number(text, "file, line 3", "x")


@pytest.mark.shared
def test_export_without_a_priori_sigmas(shared: Path, tmp_path: Path) -> None:
    export = shared / "data" / "dbat-sxb" / "pmexports" / "w-op0-with-orient-pmexport.txt"
    path = tmp_path / "op0.txt"
    path.write_bytes(export.read_bytes())
    with pytest.raises(ConfigurationError, match=r"op0-control\.txt"):
        read_foreign_block(path)
    control = shared / "data" / "dbat-sxb" / "ref" / "ctrlpts-weighted.txt"
    (tmp_path / "op0-control.txt").write_bytes(control.read_bytes())
    block = read_foreign_block(path)
    assert block.points.of_role("control").sum() == 16
    assert [Path(file.path).name for file in block.inputs] == ["op0.txt", "op0-control.txt"]


@pytest.mark.shared
# Behind the marks come features, which are not read.
@pytest.mark.parametrize("cut", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
def test_cut_export(shared: Path, tmp_path: Path, cut: float) -> None:
    content = (shared / "data" / "dbat-sxb" / "pmexports" / "w-op0-with-orient-pmexport.txt").read_bytes()
    path = tmp_path / "export.txt"
    path.write_bytes(content[: int(len(content) * cut)])
    with pytest.raises(InputMalformedError):
        read_export(path)


def small_archive(folder: Path, members: dict[str, bytes]) -> Path:
    """A PhotoScan project of one image, one marker and one tie point."""
    chunk = (
        '<sensors><sensor id="0" label="s"><calibration type="frame"><resolution width="100" height="80"/>'
        "<f>90</f></calibration></sensor></sensors>"
        '<cameras><camera id="0" sensor_id="0" label="a.jpg"><transform>1 0 0 0 0 -1 0 0 0 0 -1 9 0 0 0 1'
        "</transform></camera></cameras>"
        '<markers><marker id="1" label="M"><reference x="1" y="2" z="0" sxyz="0.01"/></marker></markers>'
        '<frames><frame><markers><marker marker_id="1"><location camera_id="0" x="60.5" y="20.5"/></marker>'
        '</markers><point_cloud><points path="p.ply"/><projections camera_id="0" path="q.ply"/></point_cloud>'
        '</frame></frames><settings><property name="accuracy_tiepoints" value="1"/>'
        '<property name="accuracy_projections" value="0.1"/></settings>'
    )
    content = {
        "doc.xml": f"<document><chunks><chunk>{chunk}</chunk></chunks></document>".encode(),
        "p.ply": ply("float x,float y,float z,uint id", 1) + struct.pack("<fffI", 0.5, 0.25, 0, 7),
        "q.ply": ply("float x,float y,float size,int id", 1) + struct.pack("<fffi", 55.5, 37.5, 3, 7),
    }
    path = folder / "small.psz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in (content | members).items():
            if data:
                archive.writestr(name, data)
    return path


def ply(properties: str, count: int) -> bytes:
    rows = "".join(f"property {row}\n" for row in properties.split(","))
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{rows}end_header\n".encode()


def test_small_archive_is_read(tmp_path: Path) -> None:
    block = read_foreign_block(small_archive(tmp_path, {}))
    assert block.points.names == ("M", "tie7")
    assert block.points.sigma[0].tolist() == [0.01, 0.01, 0.01]
    assert block.observations.values.tolist() == [[60, 20], [55, 37]]
    assert block.observations.sigma[:, 0].tolist() == [0.1, 1.0]


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"doc.xml": b""}, "has no 'doc.xml'"),
        ({"doc.xml": EXTERNAL.encode()}, "entities"),
        ({"q.ply": b""}, "has no 'q.ply'"),
        ({"q.ply": b"ply\nformat ascii 1.0\nend_header\n"}, "not a binary PLY"),
        ({"q.ply": ply("float x,float y,int id", 10**12)}, "more rows than it has"),
        ({"q.ply": ply("float x,float y", 0)}, "does not have the columns"),
        ({"q.ply": ply("list uchar int x,float y,int id", 0)}, "does not have the columns"),
        ({"q.ply": ply("float x,float y,int id", 1) + struct.pack("<ffi", float("nan"), 1, 7)}, "not finite"),
    ],
)
def test_bad_archive(tmp_path: Path, members: dict[str, bytes], message: str) -> None:
    with pytest.raises(InputMalformedError, match=message):
        read_foreign_block(small_archive(tmp_path, members))


def test_archive_whose_names_are_no_text(tmp_path: Path) -> None:
    path = small_archive(tmp_path, {})
    content = bytearray(path.read_bytes())
    # The first local header: its flag of UTF-8, and the first letter of its name.
    content[7] |= 0x08
    content[30] = 0x92
    path.write_bytes(content)
    with pytest.raises(InputMalformedError, match="not a readable archive"):
        read_foreign_block(path)


def test_names_longer_than_names_can_be(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError, match="does not exist"):
        source.require_readable(tmp_path / ("a" * 5000))
    path = small_project(tmp_path)
    path.write_text(path.read_text().replace("marks.txt", "m" * 300))
    with pytest.raises(InputMalformedError, match="not inside its folder"):
        read_dbat(path)


def test_archive_that_unpacks_to_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "bomb.psz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("doc.xml", "w", force_zip64=True) as member,
    ):
        for _ in range(300):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputMalformedError, match="larger than 256 MiB"):
        read_foreign_block(path)


@given(st.integers(0, 10**6), st.binary(min_size=1, max_size=20))
@settings(max_examples=60)
def test_damaged_archive(tmp_path_factory: pytest.TempPathFactory, at: int, noise: bytes) -> None:
    path = small_archive(tmp_path_factory.mktemp("archive"), {})
    content = path.read_bytes()
    at %= len(content)
    path.write_bytes(content[:at] + noise + content[at + len(noise) :])
    with suppress(PhotocalError):
        read_foreign_block(path)
