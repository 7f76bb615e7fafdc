"""What pictures of several makers state, against the tags themselves; and the table of it."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from photocal.findings.texts import catalogue
from photocal.measurement.image_facts import ABOVE_TAKE_OFF, ImageFacts, facts_of_tags, read_facts
from photocal.measurement.image_metadata import image_of
from photocal.measurement.picture_facts import FACTS, LONGEST, read_xmp
from photocal.measurement.picture_tests import judge_pictures, laser_and_temperature, told_conditions

# As a Matrice 4E writes it (tests of wakeup1230-droid/uav-photo-optimizer), and what its manual adds.
M4E = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description rdf:about="DJI Meta Data"
 xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 drone-dji:AbsoluteAltitude="+592.502" drone-dji:RelativeAltitude="+451.659"
 drone-dji:GpsStatus="RTK" drone-dji:AltitudeType="RtkAlt" drone-dji:RtkFlag="50"
 drone-dji:RtkStdLon="0.00266" drone-dji:RtkStdLat="0.00269" drone-dji:RtkStdHgt="0.00722"
 drone-dji:RtkDiffAge="1.60000" drone-dji:SurveyingMode="1" drone-dji:NTRIPHost="rtk.example.org"
 drone-dji:NTRIPMountPoint="VRS&amp;3" drone-dji:UTCAtExposure="2025:05:20 02:12:54.019996"
 drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalYawDegree="+28.80" drone-dji:GimbalPitchDegree="-60.00"
 drone-dji:FlightXSpeed="3.0" drone-dji:FlightYSpeed="-4.0" drone-dji:CamReverse="0"
 drone-dji:GimbalReverse="0" drone-dji:SensorTemperature="41.5" drone-dji:LensTemperature="36.2"
 drone-dji:LensPosition="312"
 drone-dji:ShutterType="Mechanical" drone-dji:ShutterCount="4711" drone-dji:CameraSerialNumber="1ZNB"
 drone-dji:LensSerialNumber="L-7" drone-dji:DroneModel="M4E" drone-dji:DroneSerialNumber="1581F"
 drone-dji:DewarpFlag="0" drone-dji:LRFStatus="Normal" drone-dji:LRFTargetDistance="140.577"
 drone-dji:LRFTargetLat="24.0005" drone-dji:LRFTargetLon="121.0003" drone-dji:LRFTargetAbsAlt="469.3"/>
</rdf:RDF></x:xmpmeta>"""


def facts(packet: str, **exif: Any) -> ImageFacts:
    tags = {f"EXIF:{name}": value for name, value in exif.items()}
    return facts_of_tags("a.jpg", (640, 480), tags | read_xmp(packet), {}, packet)


def test_the_table_is_what_pictures_have() -> None:
    """Every field has its entry, every entry its field, a unit or none, a key and a user."""
    fields = {field.name for field in dataclasses.fields(ImageFacts)}
    assert fields - {"name", "size_px", "c_px", "table_apart_m"} == {fact.name for fact in FACTS}
    assert len({fact.name for fact in FACTS}) == len(FACTS)
    assert all(fact.meaning and fact.keys and fact.used for fact in FACTS)


def test_a_matrice_4e() -> None:
    own = facts(M4E, Make="DJI", Model="M4E", DateTimeOriginal="2025:05:20 10:12:34")
    assert (own.fix, own.height_kind, own.altitude_m) == ("fixed", "ellipsoidal", 592.502)
    assert own.position_sigma_m == (0.00266, 0.00269, 0.00722)
    assert (own.rtk_age_s, own.surveying_mode, own.caster, own.mount_point) == (
        1.6, 1.0, "rtk.example.org", "VRS&3",
    )  # fmt: skip
    assert own.exposed_utc == "2025-05-20T02:12:54.019996"
    assert own.taken == "2025-05-20T10:12:34"
    assert (own.sensor_temperature_c, own.lens_temperature_c, own.lens_position) == (41.5, 36.2, 312.0)
    assert (own.serial, own.lens_serial, own.vehicle, own.vehicle_serial) == ("1ZNB", "L-7", "M4E", "1581F")
    assert (own.shutter_type, own.shutter_count, own.dewarped) == ("Mechanical", 4711.0, 0.0)
    assert own.speed_m_s == 5.0
    assert (own.laser_m, own.laser_target) == (140.577, (24.0005, 121.0003, 469.3))
    # Its clock is 8 h and 20 s beside the UTC of the exposure, which counts.
    image = image_of(Path("a.jpg"), own)
    assert image.utc
    assert image.time_s == pytest.approx(1747707174.019996, abs=1e-6)


@pytest.mark.shared
def test_a_phantom_4_multispectral(shared: Path) -> None:
    own = [read_facts(path) for path in sorted((shared / "data/dji-xmp/p4m").glob("*.JPG"))]
    assert len(own) == 4
    assert {image.fix for image in own} == {"fixed"}
    assert {image.height_kind for image in own} == {"ellipsoidal"}
    assert own[0].position_sigma_m == (0.0116, 0.01509, 0.02154)
    assert own[0].gimbal_deg == (0.0, -89.9, 107.3)
    assert judge_pictures(own) == []
    told = told_conditions(own)["conditions"]
    assert (told["positions"], told["in_camera_correction"]) == ("RTK: 4 fixed (XMP)", "off (XMP)")


@pytest.mark.shared
def test_a_thermal_camera_with_laser(shared: Path) -> None:
    own = [read_facts(path) for path in sorted((shared / "data/dji-xmp/h20t").glob("*.JPG"))]
    assert {image.height_kind for image in own} == {"ellipsoidal"}
    assert all(image.image_source == "InfraredCamera" for image in own)
    # In nadir view height above the target and distance agree within 5 cm (README of the pictures).
    for image in own:
        assert image.altitude_m - image.laser_target[2] == pytest.approx(image.laser_m, abs=0.05)
    (line,) = laser_and_temperature(own, catalogue("en"))
    assert line.startswith("laser distances of 6 of 6 pictures: 69.2, ")
    assert line.endswith("flying height above take-off 95.0 m (median)")


@pytest.mark.parametrize("inner", [
    (
        '<drone-skydio:CameraOrientationNED rdf:parseType="Resource">'
        "<drone-skydio:Roll>1.5</drone-skydio:Roll>"
        "<drone-skydio:Pitch>-80.0</drone-skydio:Pitch><drone-skydio:Yaw>33.0</drone-skydio:Yaw>"
        "</drone-skydio:CameraOrientationNED>"
    ),
    (
        '<drone-skydio:CameraOrientationNED drone-skydio:Roll="1.5" drone-skydio:Pitch="-80.0" '
        'drone-skydio:Yaw="33.0"/>'
    ),
])  # fmt: skip
def test_a_skydio_writes_structures(inner: str) -> None:
    packet = (
        '<rdf:Description xmlns:drone-skydio="https://www.skydio.com/drone-skydio/1.0/">'
        '<drone-skydio:CameraOrientationFLU drone-skydio:Roll="9" drone-skydio:Pitch="9" '
        'drone-skydio:Yaw="9"/>'
        f"{inner}<drone-skydio:Latitude>48.5</drone-skydio:Latitude>"
        "<drone-skydio:Longitude>-2.25</drone-skydio:Longitude>"
        "<drone-skydio:AbsoluteAltitude>77.5</drone-skydio:AbsoluteAltitude></rdf:Description>"
    )
    own = facts(packet, Make="Skydio")
    assert own.gimbal_deg == (1.5, -80.0, 33.0)
    assert (own.latitude_deg, own.longitude_deg, own.altitude_m) == (48.5, -2.25, 77.5)
    assert own.height_kind == "EGM96"


def test_other_makers() -> None:
    parrot = facts(
        '<rdf:Description drone-parrot:CameraRollDegree="-0.32" drone-parrot:CameraPitchDegree="-78.36" '
        'drone-parrot:CameraYawDegree="176.31" drone-parrot:DroneYawDegree="170"/>'
    )
    assert parrot.gimbal_deg == (-0.32, -78.36, 176.31)
    tags = "<Camera:Yaw>10</Camera:Yaw><Camera:Pitch>4</Camera:Pitch><Camera:Roll>-2</Camera:Roll>"
    # Old Autel: 0 looks down; of others Pix4D's tags may be of the aircraft.
    assert facts(tags, Make="Autel Robotics").gimbal_deg == (-2.0, -86.0, 10.0)
    assert math.isnan(facts(tags, Make="Parrot").gimbal_deg[0])
    named = f'<rdf:Description xmlns:Camera="http://ns.sensefly.com/Camera/1.0/">{tags}</rdf:Description>'
    assert facts(named, Make="senseFly").vehicle_deg == (-2.0, 4.0, 10.0)
    new = facts('<rdf:Description drone-autel:RelativeAltitude="28.0" drone-dji:GimbalReverse="1"/>')
    assert (new.relative_altitude_m, new.gimbal_reverse) == (28.0, 1.0)
    # Somebody unknown who took the names over.
    assert facts('<rdf:Description acme:SensorTemperature="33"/>').sensor_temperature_c == 33.0


def test_an_unknown_maker_is_left_with_exif(tmp_path: Path) -> None:
    """A Wingtra writes positions into EXIF; a word more in XMP changes nothing."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "WingtraOne", "RX1RM2"
    gps = exif.get_ifd(0x8825)
    gps.update({1: "S", 2: (22.0, 30.0, 0.0), 3: "W", 4: (43.0, 0.0, 0.0), 6: 812.5})
    gps.update({7: (12.0, 1.0, 2.5), 29: "2026:05:20"})
    path = tmp_path / "a.jpg"
    Image.new("L", (32, 32)).save(path, exif=exif, xmp=b'<rdf:Description wingtra:Mood="fine"/>')
    own = read_facts(path)
    assert (own.latitude_deg, own.longitude_deg, own.altitude_m) == (-22.5, -43.0, 812.5)
    assert (own.gps_utc, own.height_kind, own.fix) == ("2026-05-20T12:01:02.500000", "", "")


@pytest.mark.parametrize(
    ("lon", "lat", "up"), [("0.0", "0.0", "0.0"), ("0.00000", "0.0113", "0.02"), ("-1", "0.01", "0.02")]
)
def test_sigmas_that_are_not_positive_are_none(lon: str, lat: str, up: str) -> None:
    tags = f'drone-dji:RtkStdLon="{lon}" drone-dji:RtkStdLat="{lat}" drone-dji:RtkStdHgt="{up}"'
    own = facts(f'<rdf:Description drone-dji:RtkFlag="0" {tags}/>')
    assert all(math.isnan(sigma) for sigma in own.position_sigma_m)


def test_only_above_take_off_is_no_ellipsoid() -> None:
    place = 'drone-dji:GpsLatitude="1.0" drone-dji:GpsLongitude="2.0"'
    packet = f'<rdf:Description {place} drone-dji:RelativeAltitude="30"/>'
    assert facts(packet).height_kind == ABOVE_TAKE_OFF


@pytest.mark.parametrize(("tags", "laser"), [
    ('drone-dji:LRFStatus="TooFar" drone-dji:LRFTargetDistance="0.000"', math.nan),
    ('drone-dji:LRFStatus="TooClose" drone-dji:LRFTargetDistance="2.5"', math.nan),
    ('drone-dji:LRFStatus="Normal" drone-dji:LRFTargetDistance="9999.000"', math.nan),
    ('drone-dji:LRFTargetDistance="0.000"', math.nan), ('drone-dji:LRFTargetDistance="6.182"', 6.182),
])  # fmt: skip
def test_a_laser_that_hit_nothing_says_nothing(tags: str, laser: float) -> None:
    assert facts(f"<rdf:Description {tags}/>").laser_m == pytest.approx(laser, nan_ok=True)


def test_packets_are_text() -> None:
    """Entities are not expanded, nothing outside is read, and a long packet costs no long time."""
    bomb = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;"><!ENTITY s SYSTEM "file:///etc/hostname">]>'
    read = read_xmp(f'{bomb}<rdf:Description drone-dji:NTRIPHost="&b;&s;" drone-dji:Model="A&amp;B"/>')
    assert read["drone-dji:NTRIPHost"] == "&b;&s;"
    assert read["drone-dji:Model"] == "A&B"
    begin = time.process_time()
    for filler in ("<a:b ", "<a:b>", '<a:b c:d="', "<", " " * 7):
        read_xmp(filler * (2 * LONGEST // len(filler)))
    assert time.process_time() - begin < 5.0


def m4e(**changed: Any) -> ImageFacts:
    own = facts(M4E, Make="DJI", Model="M4E", FocalLength=12.29, FocalLengthIn35mmFilm=24, ExposureTime=1e-3)
    return dataclasses.replace(own, **changed)


@pytest.mark.parametrize(("changed", "code", "severity"), [
    ({"lens_position": 340.0}, "refocused", "doubtful"),
    ({"focal_mm": 24.0}, "lens-changed", "doubtful"),
    ({"serial": "OTHER"}, "pictures-of-other-camera", "doubtful"),
    ({"lens_serial": "L-8"}, "pictures-of-other-camera", "doubtful"),
    ({"rtk_flag": 34.0}, "pictures-not-fixed", "doubtful"),
    ({"rtk_flag": 16.0}, "pictures-not-fixed", "doubtful"),
    ({"surveying_mode": 0.0}, "pictures-not-for-mapping", "note"),
    ({"rtk_age_s": 23.0}, "corrections-old", "doubtful"),
    ({"dewarped": 1.0}, "pictures-dewarped", "doubtful"),
    ({"lens_profile": "True"}, "pictures-dewarped", "doubtful"),
    ({"sharpness": 2.0}, "pictures-sharpened", "note"),
    ({"gimbal_reverse": 1.0}, "gimbal-turned-over", "note"),
    ({"gimbal_deg": (180.0, -90.0, 3.0)}, "gimbal-turned-over", "note"),
])  # fmt: skip
def test_what_differs_in_one_picture_is_named(changed: dict[str, Any], code: str, severity: str) -> None:
    pictures = [m4e(name=f"{k}.jpg") for k in range(8)]
    assert judge_pictures(pictures) == []
    pictures[5] = dataclasses.replace(pictures[5], **changed)
    (found,) = judge_pictures(pictures)
    assert (found.code, found.severity, found.figures["images"]) == (code, severity, ("5.jpg",))


def test_a_lens_that_rests_a_step_beside_was_not_refocused() -> None:
    pictures = [m4e(name=f"{k}.jpg", lens_position=312.0 + (0, 1, 0, -1)[k % 4]) for k in range(12)]
    assert judge_pictures(pictures) == []
    moved = [dataclasses.replace(pictures[0], name="moved.jpg", lens_position=314.0), *pictures]
    (found,) = judge_pictures(moved)
    assert (found.code, found.figures["images"]) == ("refocused", ("moved.jpg",))


def with_lens_position(path: Path, folder: Path, position: int) -> ImageFacts:
    """Write a picture anew whose packet states a lens position, in the place of blanks behind the packet."""
    stated, end = b'\n   drone-dji:LensPosition="%d"' % position, b"</x:xmpmeta>"
    head, packet, rest = path.read_bytes().partition(b"\n   drone-dji:GimbalReverse=")
    inner, _, behind = rest.partition(end)
    blanks = b" " * len(stated)
    assert packet
    assert blanks in behind
    data = head + stated + packet + inner + end + behind.replace(blanks, b"", 1)
    assert len(data) == path.stat().st_size
    (folder / path.name).write_bytes(data)
    return read_facts(folder / path.name)


@pytest.mark.parametrize("kind", ["p4m", "h20t"])
def test_a_refocus_within_a_flight_of_real_pictures_is_named(kind: str, shared: Path, tmp_path: Path) -> None:
    paths = sorted((shared / "data/dji-xmp" / kind).glob("*.JPG"))
    positions = [312] * (len(paths) - 1) + [340]
    own = [with_lens_position(path, tmp_path, at) for path, at in zip(paths, positions, strict=True)]
    assert [image.lens_position for image in own] == positions
    (found,) = (finding for finding in judge_pictures(own) if finding.code == "refocused")
    assert (found.severity, found.figures["images"]) == ("doubtful", (paths[-1].name,))
    assert found.figures["told"] == "lens position 340"
    steady = [read_facts(path) for path in paths]
    assert "refocused" not in {finding.code for finding in judge_pictures(steady)}


def test_smear_goes_by_exposure_speed_and_distance() -> None:
    """5 m/s, 1/100 s and 140.577 m: 0.05 m on the ground; 24 mm of the diagonal of 43.27 mm are 443.7 px."""
    slow = m4e(exposure_s=0.01, laser_m=14.0577)
    (found,) = judge_pictures([slow])
    assert found.code == "pictures-smeared"
    assert found.figures["smear_px"] == pytest.approx(0.05 * 443.7 / 14.0577, rel=1e-3)
    assert judge_pictures([m4e(exposure_s=0.01)]) == []


def test_conditions_have_least_median_and_largest() -> None:
    own = [m4e(sensor_temperature_c=float(t), exposure_s=1e-3) for t in (30, 31, 45)]
    told = told_conditions(own)
    assert told["conditions"]["sensor_temperature"] == "30 / 31 / 45 °C (XMP)"
    assert told["conditions"]["lens_temperature"] == "36.2 °C (XMP)"
    assert told["conditions"]["exposure"] == "1 ms (EXIF)"
    assert told["conditions"]["focus"] == "lens position 312 (XMP)"
    assert told["conditions"]["camera_temperature_c"] == 36.2
    assert told["camera"]["lens_serial"] == "L-7 (EXIF)"
    assert told["campaign"]["platform"] == "M4E (XMP) 1581F (XMP)"
    assert "caster rtk.example.org/VRS&3 (XMP)" in str(told["conditions"]["positions"])
