"""EXIF and XMP against what the recorded data's own descriptions say."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from PIL import Image

from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import opened

XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 drone-dji:GimbalRollDegree="+0.10" drone-dji:GimbalPitchDegree="-45.00" drone-dji:RelativeAltitude="+30.5">
<drone-dji:GimbalYawDegree>-170.2</drone-dji:GimbalYawDegree>
<drone-dji:RtkStdLon>0.011</drone-dji:RtkStdLon><drone-dji:RtkStdLat>0.012</drone-dji:RtkStdLat>
<drone-dji:RtkStdHgt>0.02</drone-dji:RtkStdHgt></rdf:Description></rdf:RDF></x:xmpmeta>"""


@pytest.mark.shared
def test_drone_image(shared: Path) -> None:
    facts = read_facts(shared / "data/uav-brighton-beach/images/DJI_0018.JPG")
    assert (facts.make, facts.model, facts.size_px) == ("DJI", "FC300S", (4000, 2250))
    assert facts.focal_mm == 3.61
    assert facts.taken == "2016-06-23T16:31:59"
    # 46 deg 50' 33.3855", 91 deg 59' 40.4156" W
    assert facts.latitude_deg == pytest.approx(46 + 50 / 60 + 33.3855 / 3600, abs=1e-9)
    assert facts.longitude_deg == pytest.approx(-(91 + 59 / 60 + 40.4156 / 3600), abs=1e-9)
    assert facts.altitude_m == pytest.approx(198.31)
    assert facts.relative_altitude_m == pytest.approx(39.8)
    assert facts.gimbal_deg == (0.0, -89.9, 45.0)
    assert facts.vehicle_deg == (3.0, 1.8, 46.0)


@pytest.mark.shared
def test_southern_hemisphere(shared: Path) -> None:
    # The publisher's own unit test expects these figures.
    facts = read_facts(shared / "data/mavlink-tlog-cuav-images/exifimg2018021100040450Z.jpg")
    assert facts.latitude_deg == pytest.approx(-35.36327931731889, abs=1e-7)
    assert facts.longitude_deg == pytest.approx(149.16453320132894, abs=1e-7)
    assert facts.altitude_m == pytest.approx(93.7415, abs=1e-3)


def test_xmp_as_attribute_and_as_element(tmp_path: Path) -> None:
    path = tmp_path / "image.jpg"
    Image.new("L", (32, 32)).save(path, xmp=XMP.encode())
    facts = read_facts(path)
    assert facts.gimbal_deg == (0.1, -45.0, -170.2)
    assert facts.relative_altitude_m == 30.5
    assert facts.position_sigma_m == (0.011, 0.012, 0.02)


def test_nothing_given_stays_unknown(tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    Image.new("L", (32, 32)).save(path)
    facts = read_facts(path)
    assert facts.make == facts.model == facts.taken == ""
    assert math.isnan(facts.focal_mm)
    assert not facts.has_position


def test_position_without_hemisphere_is_unknown(tmp_path: Path) -> None:
    path = tmp_path / "image.jpg"
    exif = Image.Exif()
    exif[0x8825] = {2: (46.0, 30.0, 0.0), 4: (11.0, 0.0, 0.0), 3: "E", 6: 100.0}
    Image.new("L", (32, 32)).save(path, exif=exif)
    facts = read_facts(path)
    assert math.isnan(facts.latitude_deg)
    assert facts.longitude_deg == pytest.approx(11.0)
    assert not facts.has_position


def test_lists_of_a_maker_are_read(tmp_path: Path) -> None:
    # As a RedEdge writes them.
    path = tmp_path / "image.jpg"
    items = "".join(f"\n <rdf:li>{value}</rdf:li>" for value in (-0.1, 0.13, -0.02, 3e-4, -2e-4))
    listed = f"<Camera:PerspectiveDistortion>\n<rdf:Seq>{items}\n</rdf:Seq>\n</Camera:PerspectiveDistortion>"
    capture = "<MicaSense:CaptureId>LUG7PD4D</MicaSense:CaptureId>"
    Image.new("L", (32, 32)).save(
        path, xmp=XMP.replace("</rdf:Desc", f"{capture}{listed}</rdf:Desc").encode()
    )
    tags = read_facts(path).maker_camera
    assert tags["PerspectiveDistortion"] == "-0.1,0.13,-0.02,0.0003,-0.0002"
    assert tags["CaptureId"] == "LUG7PD4D"


def _with_gps(path: Path, latitude: float, longitude: float, altitude: float | None) -> Path:
    exif = Image.Exif()
    height = {} if altitude is None else {5: b"\0", 6: altitude}
    exif.get_ifd(0x8825).update({1: "N", 2: (latitude, 0.0, 0.0), 3: "E", 4: (longitude, 0.0, 0.0), **height})
    Image.new("L", (32, 32)).save(path, exif=exif, xmp=XMP.encode())
    return path


def test_a_receiver_without_a_fix_writes_zeros(tmp_path: Path) -> None:
    facts = read_facts(_with_gps(tmp_path / "image.jpg", 0.0, 0.0, 0.0))
    assert not facts.has_position
    assert math.isnan(facts.latitude_deg)
    # One of them alone may be zero: Quito lies on the equator.
    assert read_facts(_with_gps(tmp_path / "image.jpg", 0.0, 78.0, 0.0)).has_position


def test_height_above_the_take_off_point_where_no_other_is_stated(tmp_path: Path) -> None:
    facts = read_facts(_with_gps(tmp_path / "image.jpg", 48.0, 2.0, None))
    assert (facts.altitude_m, facts.altitude_kind) == (30.5, "above take-off")
    facts = read_facts(_with_gps(tmp_path / "image.jpg", 48.0, 2.0, 110.0))
    assert (facts.altitude_m, facts.altitude_kind) == (110.0, "")


@pytest.mark.shared
def test_a_picture_is_read_once_and_again_when_it_changes(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = next((shared / "data/dji-xmp").rglob("*.JPG"))
    reads: list[Path] = []

    def counted(path: Path) -> AbstractContextManager[Image.Image]:
        reads.append(path)
        return opened(path)

    monkeypatch.setattr("photocal.measurement.image_facts.opened", counted)
    first = read_facts(source)
    assert read_facts(source) is first
    assert len(reads) <= 1
    # A file that has just been written may change without its times telling it.
    young = tmp_path / source.name
    young.write_bytes(source.read_bytes())
    assert read_facts(young).size_px == first.size_px
    Image.new("RGB", (64, 48)).save(young)
    assert read_facts(young).size_px == (64, 48)
