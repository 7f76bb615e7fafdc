"""`photocal new` on small folders, and the stages of projects without a flight log."""

from __future__ import annotations

import datetime as dt
import re
import tomllib
from pathlib import Path

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from photocal.base.errors import ConfigurationError, InputNotFoundError, OutputError
from photocal.block.folder import read_points
from photocal.block.model import ROLES
from photocal.block.project import read_project
from photocal.measurement.image_facts import read_facts
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.marks import read_marks
from photocal.measurement.picture_block import pictures_of_heads
from photocal.run.campaign import stages
from photocal.run.new_project import new_project
from photocal.run.project_checks import check_project, facts_of_pictures

# Curitiba, in the zone EPSG:32722: east 677864, north 7184231.
LATITUDE, LONGITUDE = -25.4483, -49.2311
DEWARP = "2023-05-01;3666.67,3668.25,-12.3,8.4,-0.26572,0.11107,0.00035,-0.00021,-0.02812"


def picture(path: Path, north: float | None = 0.0, xmp: str = "", model: str = "TestCam") -> None:
    """Write a small picture, with a position unless `north` (m) is None."""
    exif = Image.Exif()
    exif[0x0110] = model
    if north is not None:
        gps = exif.get_ifd(0x8825)
        for key, value in ((2, -LATITUDE - north / 111e3), (4, -LONGITUDE)):
            gps[key] = (IFDRational(int(value)), IFDRational(0), IFDRational(value % 1 * 3600))
        gps[1], gps[3], gps[6] = "S", "W", IFDRational(1000)
    packet = f"<x:xmpmeta><rdf:Description {xmp}/></x:xmpmeta>".encode() if xmp else b""
    Image.new("L", (160, 120)).save(path, exif=exif, xmp=packet)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", 20.0 * k)
    return tmp_path


def test_pictures_alone(folder: Path) -> None:
    made = new_project(folder)
    assert made.asked == []
    assert any("no control points" in line for line in made.missing)
    project = read_project(made.path)
    assert project.crs == "EPSG:32722"
    assert project.images.position_sigma_m == (1.5, 1.5, 3.0)
    assert project.cameras[0].guessed
    assert [one.name for one in stages(project, dt.date(2026, 1, 1))][:2] == ["measurements", "block"]
    with pytest.raises(OutputError, match="exists already"):
        new_project(folder)


CAM = """Pix4D camera calibration file 0
#Focal Length mm assuming a sensor width of 17.5x13.125mm
F {f}
Px 8.8
Py 6.5
K1 0.0383
K2 -0.0175
K3 0.0205
T1 0.0024
T2 0.0029
"""


@pytest.mark.parametrize(("f", "taken"), [(15.0, True), (30.0, False)])
def test_what_another_program_has_computed(folder: Path, f: float, taken: bool) -> None:
    """Its camera is a start value where it may be that of the pictures; its orientations observe nothing."""
    for k in range(3):
        picture(folder / f"a{k}.jpg", 20.0 * k, f'drone-dji:CalibratedFocalLength="{15 / 17.5 * 160}"')
    params = folder / "1_initial" / "params"
    params.mkdir(parents=True)
    (params / "field_pix4d_calibrated_internal_camera_parameters.cam").write_text(CAM.format(f=f))
    rows = [f"a{k}.jpg 677864 7184231 1000 0 0 0" for k in range(3)]
    external = params / "field_calibrated_external_camera_parameters.txt"
    external.write_text("\n".join(["imageName X Y Z Omega Phi Kappa", *rows]))
    made = new_project(folder)
    (told,) = (line for line in made.missing if "not observations" in line)
    assert told.startswith("not used: 1_initial/params has results of Pix4D")
    camera = read_project(made.path).cameras[0]
    other = [line for line in made.missing if "is of another camera: c is 274 px there, and 137 px" in line]
    assert bool(other) is not taken
    if taken:
        assert camera.value("c") == pytest.approx(15.0 / 17.5 * 160)
        assert camera.value("K1") != 0
        assert camera.estimated.any()


def test_a_brazilian_table_and_marks_beside_it(folder: Path) -> None:
    table = "Ponto;Este;Norte;Cota;Tipo\r\nÁgua;677864,5;7184231,25;912,4;controle\r\n"
    table += "P2;677870,0;7184240,0;911,9;checagem\r\n"
    (folder / "pontos.csv").write_bytes(table.encode("cp1252"))
    (folder / "marcas.csv").write_text("image;point;x;y\na0;Água;10,5;20\na1.jpg;Água;30;40\n")
    made = new_project(folder)
    assert made.asked == ["height: whether the control points' heights are ellipsoidal or orthometric"]
    with pytest.raises(ConfigurationError, match="height = '\\?' is still to be filled in"):
        read_project(made.path)
    made.path.write_text(made.path.read_text().replace('height = "?"', 'height = "ellipsoidal"'))
    project = read_project(made.path)
    assert project.crs == "EPSG:32722"
    points = read_points(project.control.points or folder)
    assert points.names == ("Água", "P2")
    assert points.values[0].tolist() == [677864.5, 7184231.25, 912.4]
    assert points.of_role("check").tolist() == [False, True]
    marks = read_marks(project.control.marks or folder)
    assert [(m.image, m.x, m.y) for m in marks] == [("a0.jpg", 10.5, 20.0), ("a1.jpg", 30.0, 40.0)]


def test_marks_under_heads_of_a_spreadsheet(folder: Path) -> None:
    """The corner of the upper-left pixel is (0, 0) in tables that are not ours."""
    (folder / "pontos.csv").write_text("Ponto;E;N;Cota\n001;677864,5;7184231,25;912,4\n")
    (folder / "marcas.csv").write_text("Imagem;Ponto;X;Y\na0;001;10,5;20\n")
    new_project(folder, height="ellipsoidal")
    assert [(m.image, m.point, m.x, m.y) for m in read_marks(folder / "marks.csv")] == [
        ("a0.jpg", "001", 10.0, 19.5)
    ]


@pytest.mark.parametrize(
    ("listed", "marked"), [("GCP-01", "gcp1"), ("1", "001"), ("P 2", "p_02"), ("G1-1", "g01_1")]
)
def test_points_that_list_and_marks_write_differently_are_the_same(
    folder: Path, listed: str, marked: str
) -> None:
    places = ";677864.5;7184231.25;912.4\n"
    (folder / "pontos.csv").write_text(f"Ponto;E;N;Cota\n{listed}{places}G11{places.replace('64', '94')}")
    (folder / "marcas.csv").write_text(f"Imagem;Ponto;X;Y\na0;{marked};10;20\na1;{marked};11;20\n")
    new_project(folder, height="ellipsoidal")
    assert [mark.point for mark in read_marks(folder / "marks.csv")] == [listed, listed]


@pytest.mark.parametrize(("second", "role"), [("check_points.csv", "check"), ("more.csv", "control")])
def test_points_of_two_tables_are_used_together(folder: Path, second: str, role: str) -> None:
    """Check points in a file of their own; before, one of the files took the place of the other."""
    (folder / "points.csv").write_text("name,E,N,H\nA,677864.5,7184231.25,912.4\nB,677870,7184241,911\n")
    (folder / second).write_text("name,E,N,H\nC,677880.5,7184250.25,913.4\n")
    (folder / "base.csv").write_text("name,E,N,H\nBASE,677881.5,7184255.25,920.4\n")
    (folder / "seen.csv").write_text(
        "Image,Point,X,Y\n" + "".join(f"a{k},{p},{10 + k},20\n" for k in (0, 1) for p in "ABC")
    )
    made = new_project(folder, height="ellipsoidal")
    points = read_points(read_project(made.path).control.points or folder)
    assert points.names == ("A", "B", "C")
    assert [ROLES[k] for k in points.role] == ["control", "control", role]
    # Heads in capitals are none of ours: the corner of the upper-left pixel is (0, 0).
    assert [(mark.point, mark.x, mark.y) for mark in read_marks(folder / "marks.csv")][:1] == [
        ("A", 9.5, 19.5)
    ]
    assert f"control: {second} lists 1 more points, and is used beside points.csv" in made.known
    assert "control: base.csv is not used beside points.csv" in [*made.known, *made.doubtful]


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("size_px", "[300, 400]", "no picture has the size of a camera: a0.jpg has "),
        ("parameters", "{ c = 8.8 }", "c = 8.8 px is 0.0"),
    ],
)
def test_a_camera_of_other_pictures_is_named_before_any_work(
    folder: Path, key: str, value: str, said: str
) -> None:
    """People put resized pictures there, or the c that stands on the lens."""
    made = new_project(folder)
    written = made.path.read_text()
    check_project(read_project(made.path))
    made.path.write_text(re.sub(f"(?m)^{key} = .*$", f"{key} = {value}", written))
    with pytest.raises(ConfigurationError, match=re.escape(said)):
        check_project(read_project(made.path))


def test_tables_that_have_our_names_stay(folder: Path) -> None:
    control = "name,latitude,longitude,ellipsoidal height\nW1,-25.45,-49.23,912.4\n"
    marks = "image,point,x,y\na0.jpg,W1,10.5,20\na1.jpg,other,1,2\n"
    (folder / "control.csv").write_text(control)
    (folder / "marks.csv").write_text(marks)
    project = read_project(new_project(folder, height="ellipsoidal").path)
    assert [(folder / f"{name}.csv").read_text() for name in ("control", "marks")] == [control, marks]
    points = read_points(project.control.points or folder)
    assert points.values[0, 2] == 912.4
    assert [(m.image, m.point, m.x) for m in read_marks(project.control.marks or folder)] == [
        ("a0.jpg", "W1", 10.5)
    ]


def test_a_zone_as_odm_names_it(folder: Path) -> None:
    """Its documentation: the first line is a zone of WGS84, its number and N or S."""
    row = "677864,5 7184231,25 912,4 10,5 20 a0.jpg 1e5\n"
    (folder / "gcp_list.txt").write_bytes(("WGS84 UTM 22S\n" + row).encode("utf-16"))
    made = new_project(folder, height="ellipsoidal")
    project = read_project(made.path)
    assert project.crs == "EPSG:32722"
    assert read_points(project.control.points or folder).names == ("1e5",)


def test_a_table_that_names_pictures_and_cannot_be_used_is_told(folder: Path) -> None:
    (folder / "list.csv").write_text("who,when\na1.jpg,noon\n")
    (folder / "other.csv").write_text("who,when\nnobody,noon\n")
    told = [line for line in new_project(folder).missing if line.startswith("not used")]
    assert len(told) == 1
    assert "list.csv" in told[0]


def test_cameras_of_one_size_are_told_apart_by_a_table(folder: Path) -> None:
    """Wide and tele pictures that no frame joins, for one of them is missing here and there."""
    for k in range(3, 6):
        picture(folder / f"a{k}.jpg", 20.0 * k, model="Tele")
    project = read_project(new_project(folder).path)
    assert project.images.pictures is not None
    camera_of, exposure = pictures_of_heads(project)
    assert [camera_of[f"a{k}.jpg"] for k in range(6)] == [0, 0, 0, 1, 1, 1]
    assert not any(exposure.values())


def test_nothing_says_where(tmp_path: Path) -> None:
    picture(tmp_path / "a.jpg", None)
    made = new_project(tmp_path)
    assert read_project(made.path).crs == "local"
    assert any("without scale" in line for line in made.missing)


def test_a_project_in_portuguese_is_the_same_project(folder: Path) -> None:
    english = new_project(folder, height="ellipsoidal")
    theirs = english.path.read_text(encoding="utf-8")
    english.path.unlink()
    own = new_project(folder, height="ellipsoidal", language="pt-BR")
    ours = own.path.read_text(encoding="utf-8")
    assert tomllib.loads(ours) == {**tomllib.loads(theirs), "certificate": {"language": "pt-BR"}}
    assert f"# 3 imagens em {folder.name}, 3 com posição" in ours
    assert not {line.partition("# ")[2] for line in ours.splitlines()} & {
        line.partition("# ")[2] for line in theirs.splitlines() if "# " in line
    }
    assert len(own.known) == len(english.known)
    assert not {*own.known, *own.missing} & {*english.known, *english.missing}


@pytest.mark.parametrize("language", ["en", "pt-BR"])
def test_the_certificate_speaks_the_language_in_which_the_project_was_made(
    folder: Path, language: str
) -> None:
    made = new_project(folder, height="ellipsoidal", language=language)
    day = dt.date(2026, 5, 1)
    assert stages(read_project(made.path), day)[-1].settings["language"] == language
    # Whoever chooses another one is not asked again.
    chosen = {"en": "pt-BR", "pt-BR": "en"}[language]
    text = made.path.read_text(encoding="utf-8").partition("\n[certificate]")[0]
    made.path.write_text(f'{text}\n[certificate]\nlanguage = "{chosen}"\n', encoding="utf-8")
    new_project(folder, height="ellipsoidal", language=language, again=True)
    assert stages(read_project(made.path), day)[-1].settings["language"] == chosen


def test_control_of_an_unknown_system_is_asked_for(folder: Path) -> None:
    (folder / "points.csv").write_text("point,X,Y,Z\n1,1000,2000,30\n2,1010,2000,30\n")
    made = new_project(folder)
    assert [line.split(":")[0] for line in made.asked] == ["crs", "height"]
    assert tomllib.loads(made.path.read_text())["project"]["crs"] == "?"


def test_the_camera_of_dewarp_data(tmp_path: Path) -> None:
    # Expected: OpenCV's model, whose cx and cy DJI counts from the middle of the picture.
    picture(tmp_path / "a.jpg", xmp=f'drone-dji:DewarpData="{DEWARP}" drone-dji:DewarpFlag="0"')
    stated = stated_camera("a", read_facts(tmp_path / "a.jpg"))
    own = stated.camera
    assert not stated.guessed
    assert own.value("c") == 3668.25
    assert (own.value("x0"), own.value("y0")) == pytest.approx((-12.3, -8.4))
    assert own.value("K1") == pytest.approx(-0.26572 / 3668.25**2)
    assert own.value("B1") == pytest.approx(3666.67 / 3668.25 - 1)
    assert stated.prior_sigma()["c"] == pytest.approx(0.005 * 3668.25, rel=0.01)


@pytest.mark.parametrize(
    ("xmp", "words"),
    [
        (
            (
                'Camera:PerspectiveFocalLength="4.8" Camera:PrincipalPoint="3.04,2.28"'
                ' Camera:PerspectiveDistortion="0.18,-0.47,0.40,-0.0009,-0.0007"'
            ),
            ("XMP calibration of its maker", "calibração do fabricante no XMP"),
        ),
        (
            'Camera:FisheyeAffineMatrix="140.0,0.0,0.0,140.0"',
            ("XMP fisheye of its maker", "olho de peixe do fabricante"),
        ),
        ('drone-dji:CalibratedFocalLength="150.0"', ("CalibratedFocalLength of its maker", "do fabricante")),
        (f'drone-dji:DewarpData="{DEWARP}" drone-dji:DewarpFlag="0"', ("DewarpData", "do fabricante")),
    ],
)
def test_what_a_maker_writes_of_a_lens_is_told_in_both_languages(
    tmp_path: Path, xmp: str, words: tuple[str, str]
) -> None:
    """The millimetres of `Camera:` need the size of a pixel: 0.005 mm, 2000 of them a centimetre."""
    exif = Image.Exif()
    exif[0x0110] = "TestCam"
    more = exif.get_ifd(0x8769)
    more[0x920A], more[0xA20E], more[0xA20F], more[0xA210] = IFDRational(48, 10), 2000, 2000, 3
    packet = f"<x:xmpmeta><rdf:Description {xmp}/></x:xmpmeta>".encode()
    Image.new("L", (160, 120)).save(tmp_path / "a.jpg", exif=exif, xmp=packet)
    for language, said in zip(("en", "pt-BR"), words, strict=True):
        made = new_project(tmp_path, language=language)
        assert said in "\n".join(made.known)
        made.path.unlink()


def test_the_sensor_of_a_known_camera(tmp_path: Path) -> None:
    """The maker writes only 8.8 mm; its data sheet says 13.2 by 8.8 mm of the sensor."""

    def c_px(model: str, equivalent: int = 0) -> float:
        exif = Image.Exif()
        exif[0x0110] = model
        more = exif.get_ifd(0x8769)
        more[0x920A] = IFDRational(88, 10)
        if equivalent:
            more[0xA405] = equivalent
        Image.new("L", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
        stated = stated_camera("a", read_facts(tmp_path / "a.jpg"))
        assert stated.guessed == (stated.source.startswith("assumed"))
        return stated.camera.value("c")

    assert c_px("FC6310") == pytest.approx(160 * 8.8 / 13.2, rel=0.01)
    # 24 mm of 43.27 are 0.55 of the diagonal; a lens that another length is written of is not believed.
    assert c_px("FC6310", 24) == pytest.approx(160 * 8.8 / 13.2, rel=0.01)
    assert c_px("FC6310", 50) == pytest.approx(200 * 50 / 43.267, rel=1e-4)
    assert c_px("NoSuchCam") == pytest.approx(160 * 0.866, rel=0.001)


def test_sigmas_of_dji_rtk(tmp_path: Path) -> None:
    names = zip(("Lon", "Lat", "Hgt"), ("0.012", "0.011", "0.025"), strict=True)
    picture(tmp_path / "a.jpg", xmp=" ".join(f'drone-dji:RtkStd{n}="{v}"' for n, v in names))
    assert read_facts(tmp_path / "a.jpg").position_sigma_m == (0.012, 0.011, 0.025)


@pytest.mark.parametrize("exif", [0.0, None])
def test_positions_of_a_table_beside_the_pictures(tmp_path: Path, exif: float | None) -> None:
    """ODM's geo.txt, in place of what the pictures say or where they say nothing."""
    rows = ["EPSG:32722"]
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", None if exif is None else 20.0 * k)
        rows.append(f"a{k}.jpg 677864.0 {7184231 + 20 * k} 1000 0 0 0 0.02 0.03")
    (tmp_path / "geo.txt").write_text("\n".join(rows) + "\n")
    made = new_project(tmp_path)
    project = read_project(made.path)
    assert project.crs == "EPSG:32722"
    assert project.images.positions == tmp_path / "geo.txt"
    assert any("3 with a position, 3 with its sigma" in line for line in made.known)
    (tmp_path / "more.txt").write_text("\n".join(rows) + "\n")
    (tmp_path / "project.toml").unlink()
    made = new_project(tmp_path)
    assert read_project(made.path).images.positions is None
    assert any("geo.txt, more.txt: name one" in line for line in made.missing)


def test_the_readout_that_a_maker_states(tmp_path: Path) -> None:
    tags = 'Camera:RigName="Sequoia" Camera:LineReadoutTime="47500" Camera:IMULinearVelocity="-2.5,11,-0.95"'
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", 20.0 * k, xmp=tags)
    (own,) = read_project(new_project(tmp_path).path).cameras
    assert own.rolling
    assert own.value("readout") == pytest.approx(47.5e-6 * 120)


def test_a_folder_stands_for_the_project_file_in_it(folder: Path) -> None:
    with pytest.raises(InputNotFoundError, match=r"has no project.toml; photocal new .* writes one"):
        read_project(folder)
    assert read_project(new_project(folder).path.parent).path == folder / "project.toml"


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("reference.txt", "#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw\na{k}.jpg,{lon},{lat},950.5,0\n"),
        ("geo.csv", "a{k}.jpg,{lat},{lon},950.5,0.02,0.05\n"),
        ("geo.txt", "a{k}.jpg;{lat};{lon};950.5\n"),
        ("positions.csv", "Image,Lat,Lon,Alt\nA{k},{lat},{lon},950.5\n"),
        ("positions.csv", "file,lat,lon,alt\nD:\\flight\\A{k}.JPG,{lat},{lon},950.5\n"),
    ],
)
def test_positions_as_other_programs_list_them(folder: Path, name: str, rows: str) -> None:
    *head, row = rows.splitlines(keepends=True)
    lines = [row.format(k=k, lat=-25.43 - 1e-4 * k, lon=-49.27) for k in range(3)]
    (folder / name).write_text("".join([*head, *lines]))
    made = new_project(folder)
    assert f'positions = "{name}"' in made.path.read_text()
    assert "3 with a position" in made.known[0] or "3 with a position" in made.known[1]
    facts = facts_of_pictures(read_project(made.path))
    assert [image.latitude_deg for image in facts] == pytest.approx([-25.43, -25.4301, -25.4302])
    assert {(image.longitude_deg, image.altitude_m) for image in facts} == {(-49.27, 950.5)}


def test_marks_of_points_that_are_numbers_are_no_positions(folder: Path) -> None:
    (folder / "marks.txt").write_text("".join(f"a{k}.jpg,7,{12.5 + 10 * k},33.5\n" for k in range(3)))
    (folder / "points.csv").write_text("name,E,N,H\n7,677864.5,7184231.25,912.4\n")
    assert "positions" not in new_project(folder, height="ellipsoidal").path.read_text().replace(
        "_positions", ""
    )
    assert len(read_marks(folder / "marks.csv")) == 3


def test_positions_that_cannot_be_right_are_not_written_down(folder: Path) -> None:
    rows = "".join(f"a{k}.jpg,0,0,0\n" for k in range(3))
    (folder / "zeros.csv").write_text("image,lat,lon,alt\n" + rows)
    made = new_project(folder)
    assert any("zeros.csv: 3 of 3 positions of the list are impossible" in line for line in made.missing)
    assert "zeros.csv" not in made.path.read_text()
