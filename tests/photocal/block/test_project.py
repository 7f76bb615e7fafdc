"""The project file: read whole, each mistake named."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from photocal.base.checked_toml import read_toml
from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.block.project import Contents, read_project
from photocal.block.setup import Setup

CAMERA = """
[[camera]]
id = "P4P"
model = "brown-ideal"
unit = "px"
size_px = [1200, 800]
parameters = { c = 1000.0 }
estimate = ["c", "K1"]
prior_sigma = { c = 5.0 }
"""
WHOLE = (
    """
[project]
name = "field 3"
crs = "EPSG:31982"
height = "ellipsoidal"
output = "work"
[flight]
logs = ["a.mcap", "b.mcap"]
base_position = [-22.7, -43.2, 30.0]
[images]
folder = "images"
[rig]
camera_to_antenna_m = [0.0, 0.0, -0.3]
camera_to_antenna_sigma_m = [0.01, 0.01, 0.02]
boresight_sigma_deg = 1.0
attitude_sigma_deg = [0.5, 0.5, 1.0]
time_offset_sigma_s = "free"
[control]
points = "control.csv"
marks = "marks.csv"
targets = { dictionary = "apriltag_36h11", side_m = 0.6, names = { "3" = "P3" } }
[judgement]
scale = "1:1000"
standards = ["pec-pcd"]
"""
    + CAMERA
)

CODED = '{ dictionary = "apriltag_36h11", side_m = 0.6, names = { "3" = "P3" } }'


def _read(folder: Path, text: str) -> object:
    (folder / "project.toml").write_text(text, encoding="utf-8")
    return read_project(folder / "project.toml")


def test_paths_are_taken_from_the_folder_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(WHOLE, encoding="utf-8")
    project = read_project(tmp_path / "project.toml")
    assert project.flight.logs == (tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert project.output == tmp_path / "work"
    assert project.picture_folder == tmp_path / "images"
    assert project.control.marks == tmp_path / "marks.csv"
    (targets,) = project.control.coded_targets
    assert targets.names == {"3": "P3"}


def test_cameras_are_those_of_a_block(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(WHOLE, encoding="utf-8")
    block = '[block]\nframe = "local"\n[observations]\nunit = "px"\naxes = "pixel"\n' + CAMERA
    (tmp_path / "block.toml").write_text(block, encoding="utf-8")
    project = read_project(tmp_path / "project.toml")
    assert project.contents.camera[0] == read_toml(tmp_path / "block.toml", Setup).camera[0]
    assert project.camera.value("c") == 1000.0


def test_the_rig_is_the_mounting_of_a_block(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(WHOLE, encoding="utf-8")
    mounting = read_project(tmp_path / "project.toml").rig.mounting()
    assert mounting.lever_arm_m == (0.0, 0.0, -0.3)
    assert mounting.lever_arm_sigma_m == (0.01, 0.01, 0.02)
    assert mounting.boresight_sigma_deg == 1.0
    assert mounting.time_offset_sigma_s == "free"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "field 3"', "", "key project.name is missing"),
        ('height = "ellipsoidal"', 'height = "msl"', "project.height = 'msl'"),
        ('crs = "EPSG:31982"', 'crs = "local"', 'height = "local" go together'),
        ('logs = ["a.mcap", "b.mcap"]', "logs = []", "flight.logs"),
        ("-22.7, -43.2", "-122.7, -43.2", "flight.base_position.1 = -122.7"),
        ('folder = "images"', "", "folder (pictures) or times"),
        ("[0.0, 0.0, -0.3]", "[0.0, 0.0, nan]", "rig.camera_to_antenna_m.3"),
        ("boresight_sigma_deg = 1.0", "", "key rig.boresight_sigma_deg is missing"),
        ("boresight_sigma_deg = 1.0", "boresight_sigma_deg = -1.0", "rig.boresight_sigma_deg"),
        ("attitude_sigma_deg = [0.5,", "attitude_sigma_deg = [0.0,", "rig.attitude_sigma_deg.1"),
        ("side_m = 0.6", "side = 0.6", "unknown key control.targets.1.side"),
        (CODED, '[{ kind = "star", side_m = 1 }]', "control.targets.1.kind = 'star'"),
        (CODED, '{ kind = "cross", side_m = 0.6, names = {} }', "unknown key control.targets.1.names"),
        (CODED, '{ kind = "disc", side_m = 0.6, part = 0.2 }', "control.targets.1: a disc has no key part"),
        ("[judgement]", "[judgment]", "unknown key judgment"),
        ("c = 1000.0", "f = 1000.0", "names f, which is not a camera parameter"),
        (CAMERA, CAMERA + CAMERA, "two cameras have the same id"),
        (CAMERA, CAMERA + '[measurements]\nblock = "b"\n', "[flight] is given with a ready block"),
        ('name = "field 3"', 'nom = "x"', "unknown key project.nom"),
        ("[project]", "[project", "is not valid TOML"),
        ('folder = "images"', r'folder = "C:\Users\me"', "write paths with /, not with \\"),
        ('folder = "images"', "folder = images", "put text in straight quotes"),
        ('folder = "images"', "folder = “images”", "put text in straight quotes"),
        (
            'folder = "images"',
            'folder = "images"\nposition_sigma_m = "1.5"',
            "images.position_sigma_m = '1.5': input should be a valid list",
        ),
        (
            'folder = "images"',
            'folder = "images"\nposition_sigma_m = [1,5, 1,5, 5]',
            "list should have at most 3 items, not 5",
        ),
    ],
)
def test_mistakes_are_named(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in WHOLE
    with pytest.raises(ConfigurationError, match=re.escape(said)) as refusal:
        _read(tmp_path, WHOLE.replace(old, new, 1))
    assert "project.toml" in str(refusal.value)


def test_what_editors_save_in_an_encoding_of_windows_is_called_so(tmp_path: Path) -> None:
    file = tmp_path / "project.toml"
    file.write_bytes(WHOLE.replace("field 3", "vôo 3").encode("cp1252"))
    with pytest.raises(ConfigurationError, match="is not UTF-8; save it as UTF-8"):
        read_project(file)


def test_a_missing_section_is_named_when_it_is_needed(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(WHOLE.split("[flight]")[0], encoding="utf-8")
    project = read_project(tmp_path / "project.toml")
    for section in ("flight", "images", "rig", "camera"):
        with pytest.raises(ConfigurationError, match=rf"\[{section}\]+ is missing"):
            getattr(project, section)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError, match="does not exist"):
        read_project(tmp_path / "nowhere.toml")
    with pytest.raises(InputNotFoundError, match=r"has no project\.toml"):
        read_project(tmp_path)


def test_the_documentation_shows_every_key() -> None:
    page = (Path(__file__).parents[3] / "docs" / "project-file.md").read_text(encoding="utf-8")
    whole, ready = (tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.DOTALL))
    contents = Contents.model_validate(whole)
    Contents.model_validate(ready)
    for name, table in contents:
        # Cameras and heads are those of block.toml.
        if name in ("camera", "head") or not table:
            continue
        # Of the keys that exclude each other one stands in the second example or in the text.
        first = table[0] if isinstance(table, tuple) else table
        for key in type(first).model_fields:
            shown = whole[name][0] if isinstance(table, tuple) else whole[name]
            assert key in shown or f"`{key}" in page, f"[{name}] {key}"


@pytest.mark.parametrize(
    ("name", "character"),
    [
        (r"field \u001b[2J", "U+001B"),
        (r"field\n3", "U+000A"),
        (r"\u202e3 dleif", "U+202E"),
        (r"f\u200b", "U+200B"),
    ],
)
def test_a_name_that_no_terminal_prints_as_it_is_is_refused(
    name: str, character: str, tmp_path: Path
) -> None:
    path = tmp_path / "project.toml"
    path.write_text(WHOLE.replace('"field 3"', f'"{name}"'), encoding="utf-8")
    with pytest.raises(
        ConfigurationError, match=rf"(?i)project\.name.*{character.replace('+', '.')}"
    ) as refusal:
        read_project(path)
    assert str(refusal.value).isprintable()
